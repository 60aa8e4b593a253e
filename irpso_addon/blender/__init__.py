"""The only room of the library that imports bpy: registration, properties, preferences, presets, files, logs.

May use everything but cli and operators.
"""
