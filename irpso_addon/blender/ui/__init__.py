"""The panels of the sidebar, one file each.

Reads state, changes none.  May use every other room of blender.
"""
