"""The maps as a set: which texels are solved, files and names, export, merging of blocks, regions of partial solves.

May use core.images, core.storage and core.tiled.
"""
