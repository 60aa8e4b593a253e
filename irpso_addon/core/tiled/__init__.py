"""Large maps in blocks: the lattice of blocks, the shared plan, the work folder, archives, cached references.

May use core.images and core.storage.
"""
