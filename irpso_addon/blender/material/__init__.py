"""Maps to the .blend: images, shader nodes, the two-lobe group, what stands in the way.

The only room that writes materials.  May use the library below blender, and no other room of blender.
"""
