"""A mesh follows its refined normals as far as these are its slopes, and cameras say whether it should."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.normals import moved_mesh
from irpso_addon.core.normals.follow_judge import CameraPair, Following, judged
from irpso_addon.core.normals.moved_mesh import moved
from tests.support import synthetic as syn

CELLS, SIZE, HEIGHT = 40, 128, 0.004
WAVE = np.array([9.0, 5.0])  # radians a metre: a quarter to a third of the plane's width
RNG = np.random.default_rng(3)


def sheet(height: float):
    """A plane of 2 m, bent in waves, with the plane's normals; UVs are places, 0..1."""
    at = np.linspace(-1, 1, CELLS + 1)
    x, y = np.meshgrid(at, at, indexing="ij")
    grid = np.stack([x, y, height * np.sin(WAVE[0] * x + WAVE[1] * y)], -1)
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    triangles = np.stack([np.stack([a, b, c], 2), np.stack([a, c, d], 2)], 2).reshape(-1, 3, 3)
    normals = np.broadcast_to([0.0, 0.0, 1.0], triangles.shape)
    return syn.mesh_arrays(triangles, normals, (triangles[..., :2] + 1) / 2)


def slopes() -> np.ndarray:
    """(SIZE, SIZE, 3) what makes the waves' normals those of the plane."""
    u, v = np.meshgrid((np.arange(SIZE) + 0.5) / SIZE, (np.arange(SIZE) + 0.5) / SIZE)
    rise = HEIGHT * np.cos(WAVE[0] * (2 * u - 1) + WAVE[1] * (2 * v - 1))
    return np.stack([WAVE[0] * rise, WAVE[1] * rise, 0 * rise], -1).astype(np.float32)


def test_waves_that_are_not_there_are_taken_out() -> None:
    mesh = sheet(HEIGHT)
    after = moved(mesh, slopes())
    assert after is not None
    before, left = (np.std(positions[..., 2]) for positions in (mesh.positions, after))
    assert before > 0.65 * HEIGHT and left < 0.2 * before
    assert np.abs(after[..., :2] - mesh.positions[..., :2]).max() < 0.1 * HEIGHT


def test_corners_at_one_place_stay_at_one_place() -> None:
    mesh = sheet(HEIGHT)
    after = moved(mesh, slopes())
    places, of = np.unique(mesh.positions.reshape(-1, 3), axis=0, return_inverse=True)
    assert len(np.unique(after.reshape(-1, 3), axis=0)) == len(places) == of.max() + 1


def test_tilts_that_are_no_slopes_move_nothing() -> None:
    """They turn around the plane's middle, as the slope of no height does."""
    u, v = np.meshgrid((np.arange(SIZE) + 0.5) / SIZE - 0.5, (np.arange(SIZE) + 0.5) / SIZE - 0.5)
    around = np.stack([-0.1 * v, 0.1 * u, 0 * u], -1).astype(np.float32)
    assert moved(sheet(0.0), around) is None


def test_meshes_of_many_triangles_stay(monkeypatch) -> None:
    monkeypatch.setattr(moved_mesh, "MOST", 2 * CELLS**2 - 1)
    assert moved(sheet(HEIGHT), slopes()) is None


def test_a_mesh_without_area_stays() -> None:
    flat = sheet(0.0)
    assert moved(syn.mesh_arrays(0 * flat.positions, flat.normals, flat.uvs), slopes()) is None


def agreement(share: float, texels: int = 4000) -> Following | None:
    """Of a texture that two cameras see a little apart, in all that a movement by ``share`` would take out.

    2 % of noise; a highlight in a tenth of what one of them sees.
    """
    place, apart = 60 * RNG.uniform(0, 1, texels), 0.05 * RNG.standard_normal(texels)

    def seen(by: float) -> np.ndarray:
        return np.asarray(0.3 * (np.sin(place + (share - by) * apart) - np.sin(place)))

    noise = 0.02 * RNG.standard_normal(texels) + np.where(RNG.uniform(size=texels) < 0.1, 1.0, 0.0)
    numbers = np.arange(texels, dtype=np.int32)
    pair = CameraPair(numbers, *((seen(by) + noise)[None].astype(np.float32) for by in (0, 1)))
    return judged([pair], (numbers // 20).astype(np.int32))


@pytest.mark.parametrize(("share", "pays"), [(0.0, False), (-1.0, False), (1.0, True)])
def test_cameras_say_how_much_of_a_movement_is_right(share: float, pays: bool) -> None:
    found = agreement(share)
    assert found is not None and found.pays == pays
    assert abs(found.share - share) < max(4 * found.error, 0.05) and found.error < 0.15


def test_cameras_that_see_no_texture_say_nothing() -> None:
    numbers = np.arange(50, dtype=np.int32)
    noise = 0.02 * RNG.standard_normal((1, 50)).astype(np.float32)
    assert judged([], numbers) is None
    assert judged([CameraPair(numbers, noise, noise)], numbers) is None
