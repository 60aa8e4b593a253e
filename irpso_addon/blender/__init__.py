"""The only room of the library that imports bpy: registration, settings, files, logs.

May use everything but cli and operators.
"""
