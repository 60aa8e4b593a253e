"""What the views say of the maps: residuals, lamps and exposures that are off, camera registration, warnings.

May use core's records and core.shading; pure functions of arrays.
"""
