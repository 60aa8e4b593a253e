"""The forward model in float64: brdf (microfacet terms), tables (precomputed integrals), lights (lamp irradiance).

May use core's records; each function is the twin of a GLSL function in shaders/include.
"""
