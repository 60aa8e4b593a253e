"""Running jobs and their results, the region to solve, maps shown during a solve, a second Blender for indirect light.

May use blender.scene, blender.material, and the library below blender.
"""
