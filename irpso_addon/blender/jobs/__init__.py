"""What is running: jobs and their results, maps shown while they are solved, a second Blender for indirect light.

May use solve, process, blender.scene and blender.material.
"""
