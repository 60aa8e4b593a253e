"""Maps and an object of two materials for the export's targets, and a reader of their files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.data import Maps, MeshArrays
from irpso_addon.core.maps.map_set import MapReader
from irpso_addon.core.maps.target_export import ExportObject, Surface, write_target

Image = pytest.importorskip("PIL.Image")
SIZE = 40  # texels
STEP8, STEP16 = 0.5001 / 255, 0.5001 / 65535  # rounding


def make_maps(size: int = SIZE, seed: int = 5) -> Maps:
    rng = np.random.default_rng(seed)
    grey = [rng.random((size, size), np.float32) for _ in range(5)]
    return Maps(rng.random((size, size, 3), np.float32), *grey[:3], grey[3] > 0.5, grey[3] > -1, grey[4], grey[0])


def make_mesh(name: str = "Cow", slots: tuple[int, ...] = (0, 0)) -> MeshArrays:
    """Two quads side by side that leave a gap of a fifth of the square between them; the quads' slots."""
    corners = []
    for left, right in ((0.0, 0.4), (0.6, 1.0)):
        a, b, c, d = (left, 0), (right, 0), (right, 1), (left, 1)
        corners += [(a, b, c), (a, c, d)]
    uvs = np.array(corners, np.float32)
    positions = np.concatenate([uvs * 2 + 1, np.full((4, 3, 1), 3, np.float32)], axis=-1)
    normals = np.zeros((4, 3, 3), np.float32)
    normals[..., 2] = 1
    return MeshArrays(name, positions, normals, uvs, np.repeat(np.int32(slots), 2),
                      tuple(f"Part {slot}" for slot in range(max(slots) + 1)))


def cow(*surfaces: Surface, normal: Any = None, name: str = "Cow") -> ExportObject:
    """The mesh with these materials, at most two."""
    surfaces = surfaces or (Surface("Part 0"),)
    return ExportObject(name, make_mesh(name, (0, len(surfaces) - 1)), surfaces, normal)


def write(obj: ExportObject, maps: Maps, target: str, out: Path) -> dict[str, Path]:
    """Paths by file name, all of which are there and nothing else."""
    paths = write_target(obj, MapReader.of_maps(maps), target, out)
    assert sorted(os.listdir(out)) == sorted(path.name for path in paths)
    return {path.name: path for path in paths}


def pillow(path: Path) -> np.ndarray:
    """(h, w, channels) 0..1 of an 8-bit file, row 0 at the bottom."""
    with Image.open(path) as image:
        pixels = np.asarray(image, np.float64) / 255
    return pixels.reshape(*pixels.shape[:2], -1)[::-1]
