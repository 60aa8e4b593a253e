"""Large maps in blocks: the lattice of blocks, the plan that all blocks share, the work folder, archives, cached references.

May use core.images and core.storage.
"""
