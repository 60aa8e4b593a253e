"""True maps that cannot be judged by are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.errors import BadInput
from irpso_addon.core.evaluation.ground_truth import read_truth
from irpso_addon.core.images.image_writer import write_image


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("bad", ["basecolor", "roughness"])
def test_values_that_are_not_numbers_are_named(bad: str, value: float, tmp_path: Path) -> None:
    """They would count as an error of a thousand in every method."""
    for role in ("basecolor", "roughness"):
        pixels = np.full((10, 10, 3), 0.5, np.float32)
        if role == bad:
            pixels[3, 4] = value
        write_image(tmp_path / f"Ball_{role}.exr", pixels, kind="exr", color=role == "basecolor")
    with pytest.raises(BadInput, match=rf"Ball_{bad}\.exr: 1\.00 % of its values are not numbers"):
        read_truth(tmp_path, "Ball")
