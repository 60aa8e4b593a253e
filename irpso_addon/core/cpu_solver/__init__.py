"""Device numpy: rasterisation, visibility by rays, observation and the fit of a texel, without OpenGL.

May use core.shading and core.images; shares nothing with gpu.
"""
