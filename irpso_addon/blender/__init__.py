"""The only room of the library that imports bpy: registration, settings, files, logs.

May use every room but cli and operators.
"""
