"""The only room of the library that imports bpy: registration, properties, preferences, presets, files, logs, panel_common.

May use everything but cli and operators.
"""
