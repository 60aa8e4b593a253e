"""For good pictures with an absolute scale: large maps, everything found that the pictures tell."""
import bpy

settings = bpy.context.scene.irpso
settings.size = 2048
settings.model = "auto"
settings.method = "refined"
