"""The Image Editor's views: maps, wipe, comparison, convergence, charts.

Draws; nothing of it is saved in the file.  May use blender.jobs, blender.material, and the library below blender.
"""
