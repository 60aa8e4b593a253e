"""What is said of pictures of which the device's memory leaves too little for a map."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.data import SceneData
from irpso_addon.core.maps.stride import pixels_per_texel, stride_of
from irpso_addon.gpu.observe.picture_memory import coarser_line, most_pixels
from tests.support import synthetic as syn
from tests.support.picture_files import save

pytest.importorskip("OpenImageIO")
SIDE = 1200  # pixels of the files


def scene(folder: Path, count: int = 12) -> SceneData:
    """A plane from above by cameras that are alike, each with a file."""
    lamp, made = syn.lamps(1)[0], []
    for n in range(count):
        camera = replace(syn.camera((0.1 * n - 0.6, 0.2, 4.0), width=2.4), name=f"Camera {n}")
        made.append((camera, [lamp]))
    shoot = syn.shoot(syn.PATCHES, made, (16, 16))
    path = save(folder / "IMG_1.png", np.full((SIDE, SIDE, 3), 100, np.uint8), "uint8")
    return replace(shoot.scene, views=tuple(replace(view, image=path) for view in shoot.scene.views))


def searched(given: SceneData, size: int, memory: float) -> int:
    """Every how many-th texel is searched, by pictures of the size that fits."""
    side = min(SIDE, int(most_pixels(given.views, memory) ** 0.5))
    return stride_of(pixels_per_texel(given.mesh, [(view.camera, (side, side)) for view in given.views], size), size)


@pytest.mark.parametrize(("size", "memory"), [(1024, 0.25), (1024, 0.05), (2048, 0.05)])
def test_the_memory_that_is_named_is_what_the_map_needs(tmp_path: Path, size: int, memory: float) -> None:
    """With it nothing is said and all texels that pictures tell apart are searched; with a tenth less they are not."""
    given = scene(tmp_path)
    finest = searched(given, size, 1e3)
    assert searched(given, size, memory) > finest
    (line,) = coarser_line(given, size, memory)
    assert line.startswith(f"all views: too many pixels for {memory:g} GB ('IMG_1.png' is reduced from 1200 x 1200 to ")
    times = (searched(given, size, memory) // finest) ** 2
    assert f"one of {times} texels that the pictures show apart" in line
    found = re.search(r"increase Memory to ([\d.]+) GB$", line)
    assert found is not None
    needed = float(found[1])
    assert searched(given, size, needed) == finest and coarser_line(given, size, needed) == ()
    assert searched(given, size, 0.9 * needed - 0.1) > finest


def test_nothing_is_said_where_the_map_is_coarser_than_what_is_left(tmp_path: Path) -> None:
    given = scene(tmp_path)
    assert most_pixels(given.views, 0.25) < SIDE**2 and coarser_line(given, 128, 0.25) == ()
    assert coarser_line(given, 2048, 100.0) == ()
