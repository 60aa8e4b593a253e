"""What the Image Editor shows, by its pixels."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

PAINT = (0.6, 0.3, 0.1)  # of the ball, as in tests/support/make_scenes.py


def srgb(linear: float) -> float:
    """0..255, IEC 61966-2-1."""
    return 255 * (1.055 * linear ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize("gpu", ["opengl", "vulkan"])
def test_image_editor(blender, ball, folder, gpu):
    """The paint has its own colour (the solve is good to a per cent or two), the line follows the mouse."""
    seen = blender.run("looking:shown", folder, gpu=gpu, scene=str(ball), size=64)
    x, y = seen.told["middle"]
    picture = np.asarray(Image.open(seen.shot("base")).convert("RGB"), float)
    patch = picture[seen.told["height"] - y - 5:seen.told["height"] - y + 5, x - 5:x + 5].mean((0, 1))
    assert patch == pytest.approx([srgb(value) for value in PAINT], abs=6)
    assert seen.told["wipe"] == pytest.approx(0.25, abs=0.02)
    assert not any("IRPSO Views" in name for name in seen.told["images"] + seen.told["unsaved"])
