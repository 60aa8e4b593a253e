"""numpy only: what IRPSO knows without a GPU and without Blender."""
