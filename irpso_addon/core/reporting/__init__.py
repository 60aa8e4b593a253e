"""What a user is told of a solve: report.json, estimates of time and memory.

May use core's records, core.storage and core.tiled.
"""
