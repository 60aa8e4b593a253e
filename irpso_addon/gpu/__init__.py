"""moderngl + numpy: everything that is computed per texel or per pixel.  No bpy."""
