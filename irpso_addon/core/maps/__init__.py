"""The maps as a set: files and their names, export, merging of blocks, the region that a partial solve changes.

May use core.images, core.storage and core.tiled.
"""
