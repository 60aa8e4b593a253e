"""IRPSO: base colour and roughness of a mesh from lit pictures of it, by one particle swarm per texel.

    core/       numpy only: parameters, data, BRDF twin, lights, images, captures, reports
    gpu/        moderngl + numpy: the GL thread, shaders, G-buffer, observation, solve, fill
    solve/pipeline.py the whole flow: scene -> gbuffer -> observe -> solve -> maps
    blender/    the only room that imports bpy: scene in, material out, panels
    __main__.py the command line

Arrows point one way: core <- gpu <- pipeline <- {__main__, blender, operators}.
"""
