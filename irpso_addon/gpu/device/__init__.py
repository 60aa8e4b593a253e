"""The OpenGL context and its thread, compiled programs, the draw budget, the context check, occupied cells of a grid.

May use core and moderngl.
"""
