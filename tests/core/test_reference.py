"""The numpy solver where it stands alone: what it refuses, what it says, holes, normal maps.

That its maps are right is shown beside the pipeline's, in tests/gpu/test_reference.py.
"""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.cpu_solver import solver
from irpso_addon.core.cpu_solver.observe import memory
from irpso_addon.core.cpu_solver.rasterise import places, rasterise
from irpso_addon.core.data import NormalMap, Region, SceneData, Solution
from irpso_addon.core.errors import BadInput
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.samples import selftest

SQUARE = selftest.build()


def solved(scene: SceneData = SQUARE.scene, **settings: Any) -> Solution:
    steps = solver.solve(scene, SolveSettings(**{"size": 16, **settings}), SQUARE.read_image)
    told = []
    while True:
        try:
            told.append(next(steps).fraction)
        except StopIteration as stop:
            assert told == sorted(told) and told[-1] <= 1
            return stop.value


def test_one_lobe_of_known_maps():
    """The self-test's square; its ramp of colour lies up to half a pixel beside a texel's middle."""
    found = solved(size=24)
    assert np.abs(found.maps.roughness - selftest.ROUGHNESS).max() < 1e-4
    assert found.texels["solved"] == found.texels["covered"] == 24 * 24
    assert found.model == {"Paint": "one-lobe"} and found.views_used == tuple(f"lamp {i}" for i in range(16))
    assert found.maps.confidence.min() > 0.99


def test_a_matte_square_is_lambert():
    """Pictures of base / pi: model lambert finds the base colour, whatever the light."""
    views = SQUARE.scene.views[:3]

    def matte(view: Any) -> Any:
        image = SQUARE.read_image(view)
        clay = reference_light(view) * np.array([0.3, 0.2, 0.1]) / np.pi
        return replace(image, rgb=(clay * image.coverage[..., None]).astype(np.float32))

    def reference_light(view: Any) -> np.ndarray:
        from irpso_addon.core.shading.lights import light_irradiance

        at = selftest.EDGE * ((np.arange(selftest.PIXELS) + 0.5) / selftest.PIXELS * 2 - 1)
        x, y = np.meshgrid(at, at)
        points = np.stack([x, y, np.zeros_like(x)], -1)
        return light_irradiance(view.lights[0], points, np.array([0.0, 0.0, 1.0]))[..., None] * view.lights[0].power

    steps = solver.solve(replace(SQUARE.scene, views=views), SolveSettings(size=16, model="lambert"), matte)
    with pytest.raises(StopIteration) as stop:
        while True:
            next(steps)
    maps = stop.value.value.maps
    np.testing.assert_allclose(maps.base_color[maps.coverage], [[0.3, 0.2, 0.1]] * 256, atol=1e-4)
    assert (maps.roughness == 1).all()


def test_what_is_too_large_is_solved_small_and_said():
    small = replace(SQUARE.scene.mesh, uvs=SQUARE.scene.mesh.uvs / 4)  # most of the map is empty
    found = solved(replace(SQUARE.scene, mesh=small, views=SQUARE.scene.views[:3]), size=1024)
    assert found.maps.roughness.shape == (64, 64)
    assert any("64 x 64 texels instead of 1024 x 1024" in warning for warning in found.warnings)


def test_maps_that_do_not_fit_in_memory_are_solved_smaller_and_said():
    """A quarter of the memory: half the size."""
    needed = memory(SQUARE.scene, 4 * 16 * 16) / 1e9
    steps = solver.solve(SQUARE.scene, SolveSettings(size=16), SQUARE.read_image, 0.26 * needed)
    with pytest.raises(StopIteration) as stop:
        while True:
            next(steps)
    found = stop.value.value
    assert found.maps.roughness.shape == (8, 8)
    assert any("8 x 8 texels instead of 16 x 16" in line and "Memory" in line for line in found.warnings)


def test_the_memory_foreseen_is_what_observations_take():
    """With large lamps; what a view takes while it is looked at is for the rest."""
    views = tuple(replace(view, lights=tuple(replace(light, radius=0.2) for light in view.lights))
                  for view in SQUARE.scene.views[:8])
    scene = replace(SQUARE.scene, views=views)
    steps = solver.solve(scene, SolveSettings(size=32), SQUARE.read_image)
    next(steps)
    tracemalloc.start()
    try:
        while next(steps).stage == "observe":
            taken = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert 0.4 < taken / memory(scene, 4 * 32 * 32) < 1.0


@pytest.mark.parametrize("scene, settings, words", [
    (SQUARE.scene, {"model": "two-lobe"}, "Square: model two-lobe needs OpenGL"),
    (replace(SQUARE.scene, region=Region()), {}, "Square: solving a region needs OpenGL"),
    (replace(SQUARE.scene, mesh=replace(SQUARE.scene.mesh, uvs=SQUARE.scene.mesh.uvs + 3)), {}, "no face covers"),
    (replace(SQUARE.scene, mesh=replace(SQUARE.scene.mesh, uvs=SQUARE.scene.mesh.uvs * np.nan)), {}, "no face covers"),
    (replace(SQUARE.scene, mesh=replace(SQUARE.scene.mesh, positions=SQUARE.scene.mesh.positions + 50)), {},
     "lamp 0: no usable pixel shows 'Square'; check camera"),
])
def test_refusals_name_the_object_and_what_to_do(scene, settings, words):
    with pytest.raises(BadInput, match=words):
        solved(scene, **settings)


def test_texels_are_where_their_centres_are():
    """Against each triangle's edges by sign, on random triangles; where several claim a texel, one of them has it."""
    rng = np.random.default_rng(4)
    uvs = rng.uniform(-0.2, 1.2, (12, 3, 2)).astype(np.float32)
    owner, weights = rasterise(uvs, 40)
    at = (np.stack(np.meshgrid(np.arange(40), np.arange(40)), -1) + 0.5) / 40
    inside = []
    for corners in uvs.astype(np.float64):
        edges = np.roll(corners, -1, 0) - corners
        apart = at[..., None, :] - corners
        sides = edges[:, 0] * apart[..., 1] - edges[:, 1] * apart[..., 0]
        inside.append((sides > 0).all(-1) | (sides < 0).all(-1))
    np.testing.assert_array_equal(owner >= 0, np.any(inside, 0))
    y, x = np.nonzero(owner >= 0)
    assert np.array(inside)[owner[y, x], y, x].all()
    found = (uvs[owner[y, x]] * weights[y, x, :, None]).sum(1)
    np.testing.assert_allclose(found, at[y, x], atol=1e-6)


def test_a_normal_map_tilts_the_normal():
    """A quarter of the way to the tangent, of an object that is turned and squeezed; strength 0 tilts nothing."""
    mesh = SQUARE.scene.mesh
    slant = np.array([0.6, 0.0, 0.8])
    colour = np.broadcast_to(((slant + 1) / 2).astype(np.float32), (4, 4, 3))
    flat = {"object_normals": mesh.normals, "normal_matrix": np.diag([1.0, 1.0, 2.0]).astype(np.float32),
            "tangents": np.broadcast_to(np.array([1, 0, 0, 1], np.float32), (2, 3, 4))}
    at = np.array([0, 1]), np.full((2, 3), 1 / 3)
    for strength, expected in ((1.0, np.array([0.6, 0.0, 1.6])), (0.0, np.array([0.0, 0.0, 1.0]))):
        mapped = replace(mesh, normal_maps={0: NormalMap(colour, strength)}, **flat)
        normal = places(mapped, *at).normal
        np.testing.assert_allclose(normal, [expected / np.linalg.norm(expected)] * 2, atol=1e-6)


def test_holes_are_filled_from_around():
    rng = np.random.default_rng(1)
    values, known = rng.uniform(0, 1, (13, 20, 2)), np.zeros((13, 20))
    known[4:9, 3:15] = 1
    filled = solver.fill(values, known)
    np.testing.assert_array_equal(filled[known == 1], values[known == 1])
    assert filled.min() >= values[known == 1].min() - 1e-12 and filled.max() <= values[known == 1].max() + 1e-12
    np.testing.assert_allclose(solver.fill(np.full((13, 20, 1), 0.3), known), 0.3)
