"""The .blend to SceneData: mesh, materials, lamps, cameras; what is missing; thumbnails.

May use blender.files, blender.material and the library below blender.
"""
