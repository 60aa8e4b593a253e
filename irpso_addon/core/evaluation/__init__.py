"""How good maps are: error metrics, prediction of held-out views, ground truth, data of charts, false colours.

May use core's records, core.shading, core.images and core.maps.
"""
