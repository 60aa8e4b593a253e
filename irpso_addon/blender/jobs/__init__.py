"""What is running: jobs and their results, the region to solve, maps shown while they are solved, a second Blender for indirect light.

May use solve, process, blender.scene and blender.material.
"""
