"""Roughness to finished maps: base colour, filled holes, partial solves, views checked against maps.

May use gpu.solve and the rooms below it.
"""
