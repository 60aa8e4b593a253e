"""Records, parameters and rules without OpenGL or Blender: data, params, errors, job, log, live_maps,
models, resampling, observation_quality.

May use numpy and OpenImageIO; its rooms may not import gpu or anything above it.
"""
