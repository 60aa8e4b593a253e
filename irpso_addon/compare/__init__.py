"""Every method on one scene: observation of held-out views, judging, measuring.

May use solve, gpu and core; never Blender, so that a worker process can do it.
"""
