"""Roughness to finished maps: base colour, filled holes, the kept part of a partial solve, views checked against maps.

May use gpu.solve and the rooms below it.
"""
