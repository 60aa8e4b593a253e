"""Shading normals refined where left-out views are then predicted better; normals as a tangent-space map.

May use core's records, core.calibration, core.shading and core.evaluation; pure functions of arrays.
"""
