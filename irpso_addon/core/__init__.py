"""Records, parameters and rules without OpenGL or Blender.

Its files: records (data, check_records, live_maps), params, errors, job, log, models, and helpers of several rooms
(child_process, observation_quality, resampling, versions).  May use numpy and OpenImageIO; nothing here imports gpu or
anything above it.
"""
