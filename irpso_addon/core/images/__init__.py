"""Image files: decoding in child processes, reference images as radiance, masks, colour spaces, writing.

May use core's records and core.storage.
"""
