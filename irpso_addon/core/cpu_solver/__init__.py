"""Device numpy: rasterisation, visibility by rays, observation and the fit of a texel, without OpenGL.

May use core's records and core.shading; shares nothing with gpu.
"""
