"""Which pictures may have a tone curve; tests/gpu/test_tone_curve.py has the curves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.calibration.tone_curve import may_have_one
from irpso_addon.core.data import Camera, View

CAMERA = Camera("Camera", np.eye(4), np.eye(4), np.zeros(3), np.array([0.0, 0.0, -1.0]), False, 1.0)


@pytest.mark.parametrize(("file", "more", "may"), [
    ("a.jpg", {}, True),
    ("a.JPEG", {"colorspace": "sRGB"}, True),
    ("a.tif", {}, True),
    ("a.TIFF", {"colorspace": "Gamma 2.2 Encoded AdobeRGB"}, True),
    ("a.tif", {"colorspace": "Linear Rec.709"}, False),
    ("a.tif", {"colorspace": "scene_linear"}, False),
    ("a.jpg", {"response": 1.5}, False),
    ("a.tif", {"shoulder": 8.0}, False),
    ("a.png", {}, False),
    ("a.exr", {}, False),
    ("a.dng", {}, False),
])
def test_files_that_are_developed_for_viewing_may_have_one(file: str, more: dict[str, object], may: bool) -> None:
    assert may_have_one(View(Path(file), CAMERA, (), **more)) == may
