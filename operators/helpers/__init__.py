"""What several operators share: the mix-in of long jobs, polls, paths.

May use irpso_addon.blender and below; no operator imports another.
"""
