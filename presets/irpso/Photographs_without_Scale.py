"""For photographs whose brightness is relative: each material's Specular IOR Level and the exposures are solved for."""
import bpy

settings = bpy.context.scene.irpso
settings.model = "one-lobe-specular"
settings.specular = "material"
settings.exposures = "solve"
