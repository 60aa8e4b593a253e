"""Everything that touches OpenGL, stage by stage; the folders of shaders/ have the same names.

May use core and moderngl; never Blender.
"""
