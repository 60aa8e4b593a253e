"""Jobs in a process of their own: the pipe, the worker, the handle on it.

May use core and gpu.device; tasks are named, not imported.
"""
