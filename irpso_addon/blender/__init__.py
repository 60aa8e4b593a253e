"""The library's only room that imports bpy: scene in, material out, properties and panels."""
