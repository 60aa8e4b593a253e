"""Views to observations: light visibility, indirect light, radiance over irradiance per pixel, the observation atlas.

May use gpu.gbuffer, gpu.device and core.
"""
