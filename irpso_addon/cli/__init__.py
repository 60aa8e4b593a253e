"""The command line, one command per file.

May use every other room; it reaches Blender through irpso_addon/blender alone.
"""
