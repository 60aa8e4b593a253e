"""From a real shoot to a scene: cameras of photogrammetry projects, lamps from chrome balls, scale from grey patches.

May use core's records, core.images and core.storage.
"""
