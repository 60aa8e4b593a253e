"""A shoot comes in: cameras, mesh, flash and views of a photogrammetry project as objects of the scene.

May use the rooms scene and material of blender, and what is below blender.
"""
