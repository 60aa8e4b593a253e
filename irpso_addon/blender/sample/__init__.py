"""Scenes made and rendered here: the sample scene, the demo, camera and lamp rigs, contact sheets.

May use blender.jobs, blender.viewer, and the library below blender.
"""
