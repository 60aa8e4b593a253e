"""Boxes around runs of triangles: what is found by them is what every corner of a dense mesh says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from irpso_addon.core.data import Camera
from irpso_addon.core.lens import Lens
from irpso_addon.core.triangle_bundles import BUNDLE, Bundles
from irpso_addon.gpu.gbuffer.projection import clip_matrix
from tests.support import synthetic as syn

FISHEYE = Lens(600, 400, fx=256.0, fy=256.1, cx=302.4, cy=197.3, radial=(-0.02, 0.004, -0.001, 0.0), fisheye=True)


def cloud(seed: int, count: int, spread: float = 0.5) -> np.ndarray:
    """(count, 3, 3) small triangles at random places of a ball, neighbours in space mostly in the same run."""
    rng = np.random.default_rng(seed)
    middle = spread * rng.normal(size=(count, 3)).clip(-2, 2)
    middle = middle[np.argsort(middle[:, 0].round(1), kind="stable")]
    return (middle[:, None] + rng.normal(scale=0.01, size=(count, 3, 3))).astype(np.float32)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31), count=st.integers(1, 4 * BUNDLE + 1))
def test_boxes_hold_their_triangles_and_the_longest_edges(seed, count):
    triangles = cloud(seed, count)
    bundles = Bundles.of(triangles)
    assert len(bundles.low) == -(-count // BUNDLE)
    for n in range(len(bundles.low)):
        corners = triangles[n * BUNDLE:(n + 1) * BUNDLE].astype(np.float64)
        assert (bundles.low[n] == corners.min(axis=(0, 1))).all()
        assert (bundles.high[n] == corners.max(axis=(0, 1))).all()
        away = np.linalg.norm(corners - bundles.centers[n], axis=2).max()
        assert away <= bundles.radii[n] * (1 + 1e-12)
        edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
        assert bundles.edges[n] == pytest.approx(edges.max(), rel=1e-6)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31), count=st.integers(1, 6 * BUNDLE))
def test_triangles_with_the_extremes_are_among_those_found(seed, count):
    triangles = cloud(seed, count)
    bundles, way = Bundles.of(triangles), np.random.default_rng(seed).normal(size=3)
    middle, half = bundles.centers @ way, 0.5 * (bundles.high - bundles.low) @ np.abs(way) + 1e-9
    found, every = (bundles.extremes(middle - half, middle + half) @ way, triangles.astype(np.float64) @ way)
    assert found.min() == pytest.approx(every.min(), abs=1e-12)
    assert found.max() == pytest.approx(every.max(), abs=1e-12)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31), count=st.integers(1, 6 * BUNDLE), place=st.tuples(*[st.floats(-2, 2)] * 3))
def test_the_farthest_corner_is_found(seed, count, place):
    triangles = cloud(seed, count)
    every = np.linalg.norm(triangles.astype(np.float64) - place, axis=2).max()
    assert Bundles.of(triangles).farthest(np.array(place)) == pytest.approx(every, rel=1e-12)


def test_few_triangles_of_a_dense_mesh_are_looked_at():
    triangles, _ = syn.sphere(160, 80)
    bundles = Bundles.of(triangles)
    middle, half = bundles.centers[:, 2], 0.5 * (bundles.high - bundles.low)[:, 2]
    assert len(bundles.extremes(middle - half, middle + half)) < 0.3 * len(triangles)


def cameras() -> dict[str, Camera]:
    plain = syn.camera((3.0, -2.0, 1.0))
    return {"perspective": plain, "orthographic": syn.camera((3.0, -2.0, 1.0), width=2.0),
            "inside": syn.camera((0.1, 0.0, 0.0), (1.0, 0.0, 0.2)), "fisheye": syn.through(FISHEYE, plain)}


@pytest.mark.parametrize("name", ["perspective", "orthographic", "inside", "fisheye"])
def test_near_and_far_are_those_of_every_corner(name):
    """As one box of all: a single bundle leaves nothing out."""
    camera, triangles = cameras()[name], cloud(3, 30 * BUNDLE)
    others = cloud(4, 3 * BUNDLE, 1.5)
    whole = [replace(Bundles.of(part), low=np.full((len(Bundles.of(part).low), 3), -1e3),
                     high=np.full((len(Bundles.of(part).low), 3), 1e3)) for part in (triangles, others)]
    np.testing.assert_allclose(clip_matrix(camera, [Bundles.of(triangles), Bundles.of(others)]),
                               clip_matrix(camera, whole), rtol=1e-12, atol=1e-12)
