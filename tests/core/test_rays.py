"""Rays: against closed forms (a box by slabs, a sphere) that know nothing of triangles."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.cpu_solver import rays as module
from irpso_addon.core.cpu_solver.rays import Rays
from tests.support import synthetic as syn

LOW, HIGH = (-0.7, -0.3, 0.1), (0.4, 0.9, 1.3)


@pytest.fixture(scope="module")
def ends() -> tuple[np.ndarray, np.ndarray]:
    """20,000 segments in and around the box; some along an axis."""
    rng = np.random.default_rng(2)
    start, end = rng.uniform(-2, 2, (2, 20_000, 3))
    toward = end - start
    toward[::50, 0] = 0
    toward[1::70, 1:] = 0
    return start, toward


def test_blocked_is_what_the_slabs_say(ends):
    start, toward = ends
    inside = ((start > LOW) & (start < HIGH)).all(-1) & ((start + toward > LOW) & (start + toward < HIGH)).all(-1)
    found = Rays(syn.box(LOW, HIGH)).blocked(start, toward)
    expected = syn.box_blocks(start, toward, LOW, HIGH)
    assert expected.mean() > 0.05
    np.testing.assert_array_equal(found, expected & ~inside)  # a segment inside meets no face


def test_endless_goes_on(ends):
    start, toward = ends
    found = Rays(syn.box(LOW, HIGH)).blocked(start, 1e-3 * toward, endless=True)
    np.testing.assert_array_equal(found, syn.box_blocks(start, 1e6 * toward, LOW, HIGH))


def test_nearest_is_where_a_sphere_is(ends):
    """Facets of the sphere stand at most 0.0005 below it."""
    start, toward = (x[np.linalg.norm(ends[0], axis=-1) > 1.01] for x in ends)
    triangles, _ = syn.sphere(100, 100)
    hit = Rays(triangles).nearest(start, toward)
    a, b, c = (toward**2).sum(-1), (start * toward).sum(-1), (start**2).sum(-1) - 1
    root = b * b - a * c
    met = (root > 0) & (-b - np.sqrt(np.maximum(root, 0)) > 0)
    grazing = np.abs(root / a) < 2e-3  # the chord is a matter of the facets
    np.testing.assert_array_equal((hit.triangle >= 0)[~grazing], met[~grazing])
    sure = met & ~grazing
    where = start + hit.distance[:, None].clip(max=1e6) * toward
    assert np.abs(np.linalg.norm(where[sure], axis=-1) - 1).max() < 1e-3
    by_weights = (triangles[hit.triangle] * hit.weights[..., None]).sum(1)
    np.testing.assert_allclose(by_weights[sure], where[sure], atol=1e-9)
    assert np.isinf(hit.distance[~met & ~grazing]).all()


def test_the_first_of_many_is_nearest():
    """Forty walls behind one another: the one in front, from either side."""
    walls = np.concatenate([syn.quad([(-1, -1, z), (1, -1, z), (1, 1, z), (-1, 1, z)]) for z in np.arange(40.0)])
    rays = Rays(walls[::-1])
    rng = np.random.default_rng(3)
    start = np.concatenate([rng.uniform(-0.99, 0.99, (500, 2)), rng.uniform(-1, 41, (500, 1))], -1)
    up = np.repeat([[0.0, 0.0, 2.0]], 500, 0)
    above = np.ceil(start[:, 2].clip(min=0))
    hit = rays.nearest(start, up)
    np.testing.assert_allclose(hit.distance, np.where(above < 40, (above - start[:, 2]) / 2, np.inf))
    below = np.floor(start[:, 2].clip(max=39))
    np.testing.assert_allclose(rays.nearest(start, -up).distance,
                               np.where(below >= 0, (start[:, 2] - below) / 2, np.inf))


def test_rays_through_many_boxes_are_cast_in_parts(ends, monkeypatch):
    """Nothing but the memory changes."""
    start, toward = (x[:600] for x in ends)
    triangles, _ = syn.sphere(40, 40)
    rays, most = Rays(triangles), []
    hit, blocked = rays.nearest(start, toward), rays.blocked(start, toward)
    monkeypatch.setattr(module, "PAIRS_AT_ONCE", 50)
    cross = module._cross
    monkeypatch.setattr(module, "_cross", lambda o, *rest: most.append(len(o)) or cross(o, *rest))
    for found, expected in zip(rays.nearest(start, toward), hit, strict=True):
        np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(rays.blocked(start, toward), blocked)
    assert max(most) <= 50


def test_triangles_that_are_none_stop_nothing():
    triangles = np.zeros((3, 3, 3))
    triangles[1] = np.nan
    triangles[2] = [(0, 0, 1), (1, 1, 1), (2, 2, 1)]
    start, toward = np.zeros((1, 3)), np.array([[0.0, 0.0, 5.0]])
    for rays in (Rays(triangles), Rays(np.zeros((0, 3, 3)))):
        assert not rays.blocked(start, toward).any()
        assert rays.nearest(start, toward).triangle[0] == -1
