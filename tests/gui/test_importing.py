"""Hundreds of RAW files are read while the window goes on; Esc leaves nothing, one undo takes all of it back."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.support.dng_files import save_dng
from tests.support.project_files import ring, write_transforms

from . import window

COUNT = 200
SHARED = {"camera_model": "OPENCV", "w": 1500, "h": 1000, "fl_x": 2000.0, "fl_y": 2000.0, "cx": 750.0, "cy": 500.0}


@pytest.fixture
def data() -> Path:
    """An empty folder with an empty folder in it, where the window's Blender can read it."""
    folder = window.WORK / "shoot"
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "raw").mkdir(parents=True)
    return folder


def test_the_window_goes_on(blender, folder, data):
    raw = np.random.default_rng(0).integers(1000, 9000, (2000, 3000)).astype(np.uint16)
    shots = ring(COUNT, ".dng")
    first = save_dng(data / "raw" / shots[0].name, raw)
    for shot in shots[1:]:
        os.link(first, data / "raw" / shot.name)
    write_transforms(data / "transforms.json", shots, SHARED)
    (data / "mesh.obj").write_text("v -1 -1 0\nv 1 -1 0\nv 0 1 0.5\nf 1 2 3\n")
    told = blender.run("importing:shoot", folder, data=str(data)).told
    assert told["busy"] and not told["second"] and told["stopped"] == 0
    assert told["views"] == COUNT and told["undone"] == 0
    assert told["gaps"]["looks"] > 20 and told["gaps"]["longest"] < 1000  # ms, on however busy a computer


def test_cameras_of_alembic_and_usd(blender, folder, data):
    raw = np.random.default_rng(0).integers(1000, 9000, (80, 120)).astype(np.uint16)
    for number in range(2):
        save_dng(data / "raw" / f"IMG_000{number}.dng", raw)
    told = blender.run("importing:cameras", folder, data=str(data)).told
    if not told["suffixes"]:
        pytest.skip("this Blender was built without Alembic and USD")
    for suffix in told["suffixes"]:
        assert told[suffix] == pytest.approx([6, 7], abs=1e-5)
    assert told["mesh"] == ["shot", "shot.001"][:len(told["suffixes"])]
    assert told["scenes"] == 1 and told["shown"]


def test_a_scan_is_unwrapped_in_the_window(blender, folder):
    told = blender.run("importing:unwrapped", folder).told
    assert told["used"] > 0.4 and told["mode"] == "OBJECT"
    assert told["undone"] == 0 and told["corners"] > 10_000
