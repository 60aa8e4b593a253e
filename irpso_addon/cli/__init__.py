"""The command line, one command per file.  Blender is reached through irpso_addon/blender alone."""
