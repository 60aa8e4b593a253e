"""IRPSO: base colour and roughness of a mesh from lit pictures of it, by one particle swarm per texel.

    core/       records, parameters, forward model in float64, images, checks, reports; no OpenGL, no Blender
    gpu/        OpenGL: device, G-buffer, observation, solve, maps
    process/    jobs in a process of their own
    solve/      the use cases: the pipeline, tiled solves, preview, farm jobs, device test
    compare/    every method on one scene
    blender/    the only room that imports bpy: scene in, material out, panels
    cli/        the command line, one command per file; __main__.py starts it

Arrows point one way: core <- gpu <- process <- solve <- compare <- blender <- cli.
"""
