"""The .blend to SceneData: mesh, materials, lamps, cameras; what is missing; which region is to be solved.

May use blender.files, blender.material and the library below blender.
"""
