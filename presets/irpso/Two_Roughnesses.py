"""For coats, dust and worn paint: a sharp and a wide highlight on each texel."""
import bpy

settings = bpy.context.scene.irpso
settings.model = "two-lobe"
settings.ndf = "ggx"
