"""The float64 lamps, as the add-on reads them from Blender, against Cycles' pixels."""

from __future__ import annotations

import pytest

pytest.importorskip("bpy")

from tests.blender.measure_lights import CASES, measure, noisy

# Without noise float32 is the limit.  With it: largest error of a pixel above 2 % of the brightest, mean, signed
# mean.  The noise of 256 samples is largest where a rim or the horizon cuts the emitter.
EXACT = (1e-4, 1e-5, 1e-5)
SIZED = (0.003, 0.0005, 0.0001)
LOOSER = {
    "SUN, 40 deg wide, half set": (0.01, 0.002, 0.0005),  # noise
    "SPOT, radius 0.1 m": (0.04, 0.002, 0.0005),  # noise at the rim
    "SPOT, radius 0.1 m, sphere": (0.04, 0.002, 0.0005),
    "AREA, rectangle cut by the horizon": (0.04, 0.002, 0.001),  # pixels 1 cm from the emitter
    "AREA, rectangle, spread 120 deg": (0.005, 0.001, 0.001),  # quadrature of 144 points, here and below
    "AREA, rectangle, spread 90 deg": (0.02, 0.0015, 0.001),
    "AREA, ellipse, spread 90 deg": (0.08, 0.004, 0.001),
    "AREA, rectangle, spread 40 deg": (0.02, 0.003, 0.003),
}


@pytest.mark.parametrize("name", CASES)
def test_irradiance_equals_the_pixels(name):
    largest, mean, bias = LOOSER.get(name, SIZED if noisy(name) else EXACT)
    errors = measure(name)
    assert errors.largest < largest
    assert errors.mean < mean
    assert abs(errors.bias) < bias
