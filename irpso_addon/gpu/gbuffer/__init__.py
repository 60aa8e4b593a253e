"""The mesh on the device, drawn over the texel grid and through the cameras.

May use gpu.device and core.
"""
