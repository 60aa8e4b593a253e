"""A first look within seconds: small maps of one lobe, nothing corrected."""
import bpy

settings = bpy.context.scene.irpso
settings.size = 512
settings.model = "one-lobe"
settings.method = "draft"
settings.indirect = "off"
settings.registration = "given"
