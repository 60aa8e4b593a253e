"""Charts of rough meshes: few, connected, without folds, and apart from each other."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from irpso_addon.core.cpu_solver.rasterise import rasterise
from irpso_addon.core.shoot import uv_charts
from irpso_addon.core.shoot.uv_charts import Charts, Faces

SIDE = 512  # texels on which overlaps are looked for


def grid(points: np.ndarray, closed: tuple[bool, bool], noise: float, seed: int = 0) -> tuple[np.ndarray, Faces]:
    """Triangles (T, 3, 3) of a grid of points (m, n, 3), rough by ``noise`` edges, and the same as faces."""
    m, n = points.shape[:2]
    edge = np.sqrt(np.linalg.norm(np.diff(points, axis=0), axis=2).mean()
                   * np.linalg.norm(np.diff(points, axis=1), axis=2).mean())
    points = points + np.random.default_rng(seed).normal(scale=noise * edge, size=points.shape)
    i, j = np.meshgrid(np.arange(m if closed[0] else m - 1), np.arange(n if closed[1] else n - 1), indexing="ij")
    a, b, c, d = (((i + di) % m * n + (j + dj) % n).ravel() for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1)))
    index = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    corners = points.reshape(-1, 3)[index]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1)
    edges = np.sort(np.concatenate([index[:, [0, 1]], index[:, [1, 2]], index[:, [2, 0]]]), axis=1)
    key = edges[:, 0] * m * n + edges[:, 1]
    face, order = np.tile(np.arange(len(index)), 3), np.argsort(key, kind="stable")
    shared = np.flatnonzero(np.diff(key[order]) == 0)
    pairs = np.stack([face[order[shared]], face[order[shared + 1]]], axis=1)
    return corners, Faces(corners.mean(axis=1), cross / length[:, None], length / 2, pairs)


def torus(noise: float) -> tuple[np.ndarray, Faces]:
    u, v = np.meshgrid(*[np.linspace(0, 2 * np.pi, n, endpoint=False) for n in (240, 80)], indexing="ij")
    ring = 1 + 0.35 * np.cos(v)
    return grid(np.stack([ring * np.cos(u), ring * np.sin(u), 0.35 * np.sin(v)], -1), (True, True), noise)


def ramp(noise: float) -> tuple[np.ndarray, Faces]:
    """A spiral ramp of three turns, each above the last: from above they lie over one another."""
    u, r = np.meshgrid(np.linspace(0, 6 * np.pi, 360), np.linspace(0.5, 1.0, 20), indexing="ij")
    return grid(np.stack([r * np.cos(u), r * np.sin(u), 0.12 * u], -1), (False, False), noise)


def places(corners: np.ndarray, charts: Charts) -> np.ndarray:
    """(T, 3, 2) within 0..1."""
    at = charts.places(np.repeat(np.arange(len(corners)), 3), corners.reshape(-1, 3))
    return (at / at.max()).reshape(-1, 3, 2)


def overlap(uvs: np.ndarray) -> float:
    """Area of the triangles that lie under others, as a share of what is covered."""
    a, b = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    area = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()
    return area / (rasterise(uvs.astype(np.float32), SIDE)[0] >= 0).mean() - 1


@pytest.mark.parametrize(("noise", "most"), [(0.0, 0.01), (0.1, 0.01), (0.3, 0.05)])
def test_a_rough_torus_has_few_charts_that_cover_it_once(noise, most):
    """The roughest has faces that are turned over: these overlap with their neighbours."""
    corners, faces = torus(noise)
    charts = uv_charts.charts_of(faces)
    assert len(charts.frames) <= 16
    assert set(charts.of_face) == set(range(len(charts.frames)))
    assert overlap(places(corners, charts)) < most
    axis = np.cross(charts.frames[:, 0], charts.frames[:, 1])
    np.testing.assert_allclose(np.linalg.norm(charts.frames, axis=2), 1, atol=1e-12)
    seen = np.einsum("fk,fk->f", faces.normals, axis[charts.of_face])
    assert faces.areas[seen < 0].sum() < most * faces.areas.sum()
    for n in range(len(charts.frames)):  # each in one piece
        inside = (charts.of_face[faces.pairs] == n).all(axis=1)
        assert len(np.unique(uv_charts._parts(charts.of_face, faces.pairs[inside])[charts.of_face == n])) == 1


def test_a_ramp_above_itself_is_divided(monkeypatch):
    corners, faces = ramp(0.1)
    assert overlap(places(corners, uv_charts.charts_of(faces))) < 0.01
    monkeypatch.setattr(uv_charts, "DIVIDED", 0)
    assert overlap(places(corners, uv_charts.charts_of(faces))) > 0.8


def test_charts_lie_apart_and_keep_their_scale():
    corners, faces = torus(0.1)
    charts = uv_charts.charts_of(faces)
    at = charts.places(np.repeat(np.arange(len(corners)), 3), corners.reshape(-1, 3)).reshape(-1, 3, 2)
    boxes = [(at[charts.of_face == n].min(axis=(0, 1)), at[charts.of_face == n].max(axis=(0, 1)))
             for n in range(len(charts.frames))]
    apart = [(high < lower).any() or (higher < low).any() for (low, high), (lower, higher) in combinations(boxes, 2)]
    assert apart
    assert all(apart)
    edge = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    assert (np.linalg.norm(at[:, 1] - at[:, 0], axis=1) <= edge * (1 + 1e-9)).all()


def test_pieces_and_faces_without_area_are_charts_too():
    """Two tori apart, some faces of which have no area and no normal."""
    _, faces = torus(0.1)
    areas, normals = faces.areas.copy(), faces.normals.copy()
    areas[::97], normals[::97] = 0, 0
    count = len(areas)
    both = Faces(np.concatenate([faces.centers, faces.centers + 5]), np.concatenate([normals] * 2),
                 np.concatenate([areas] * 2), np.concatenate([faces.pairs, faces.pairs + count]))
    charts = uv_charts.charts_of(both)
    assert not set(charts.of_face[:count]) & set(charts.of_face[count:])
    assert np.isfinite(charts.frames).all()
