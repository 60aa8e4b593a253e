"""The use cases on the GL thread: the pipeline, tiled solves, the preview, farm jobs, the device test.

May use core, gpu and process; never Blender.
"""
