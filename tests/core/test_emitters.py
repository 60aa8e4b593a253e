"""Patches of meshes that glow: their irradiance against closed forms, their lobe against brute force."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.data import Environment, Light
from irpso_addon.core.shading import brdf, emitters, environment, lights
from tests.support import glowing

CENTER, RADIUS = np.zeros(3), 0.5


def _places(count: int, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Places in the subject's sphere, and normals."""
    rng = np.random.default_rng(seed)
    N = rng.normal(size=(count, 3))
    return rng.uniform(-0.28, 0.28, (count, 3)), N / np.linalg.norm(N, axis=1, keepdims=True)


def _irradiance(found: emitters.Patches, P: np.ndarray, N: np.ndarray) -> np.ndarray:
    """(T, 3) with parts, as the device sums it."""
    return np.array([environment.node_values(emitters.seen_from(found, p), n, n)[0] for p, n in zip(P, N, strict=True)])


@pytest.mark.parametrize("distance", [2.0, 0.8, 0.55])
def test_a_rectangle_is_an_area_lamp(distance):
    """Lambert's closed form, of the lamp of the same radiance; at 0.55 m it all but touches the subject's sphere."""
    panel = glowing.rectangle((0, 0, distance), (0.6, 0, 0), (0, -0.4, 0), (2.0, 1.0, 0.5))
    matrix = np.diag([1.0, 1, 1, 1])
    matrix[2, 3] = distance
    lamp = Light("lamp", "AREA", np.array([2.0, 1, 0.5]) * np.pi * 1.2 * 0.8, matrix, shape="RECTANGLE",
                 size=(1.2, 0.8))
    P, N = _places(60)
    want = lights.light_irradiance(lamp, P, N)[:, None] * lamp.power
    found = _irradiance(emitters.patches([panel], CENTER, RADIUS), P, N)
    some = want[:, 0] > 0.02 * want.max()  # where the horizon cuts it, single patches count
    assert some.sum() > 25
    assert np.quantile(np.abs(found[some] / want[some] - 1), 0.9) < 0.004
    assert np.abs(found - want).max() < 0.004 * want.max()


def test_a_ball_is_a_sphere_lamp():
    bulb = glowing.ball((0.3, -0.4, 1.2), 0.2, (3.0, 3.0, 3.0))
    matrix = np.eye(4)
    matrix[:3, 3] = 0.3, -0.4, 1.2
    lamp = Light("lamp", "POINT", np.full(3, 3 * np.pi * 4 * np.pi * 0.2**2), matrix, radius=0.2, soft_falloff=False)
    P, N = _places(60)
    want = lights.light_irradiance(lamp, P, N) * lamp.power[0]
    found = _irradiance(emitters.patches([bulb], CENTER, RADIUS), P, N)[:, 0]
    some = want > 0.02 * want.max()
    assert np.quantile(np.abs(found[some] / want[some] - 1), 0.9) < 0.008  # its facets lie inside the sphere
    assert np.abs(found - want).max() < 0.008 * want.max()


def test_both_sides_shine_and_backs_of_closed_shapes_do_not():
    def total(emitter) -> float:
        return float(emitters.patches([emitter], CENTER, RADIUS).power.sum()) / 3

    panel = glowing.rectangle((0, 0, 2), (0.5, 0, 0), (0, 0.5, 0))  # its front looks away from the subject
    assert total(panel) == pytest.approx(1.0)
    assert total(glowing.rectangle((0, 0, 2), (0.5, 0, 0), (0, 0.5, 0), both_sides=False)) == 0
    edge_on = glowing.rectangle((0, 0, 2), (0.5, 0, 0), (0, 0, 0.5))
    assert total(edge_on) == pytest.approx(2.0)  # the subject lies on both sides of its plane
    bulb = glowing.ball((0, 0, 2), 0.2)
    assert 0.4 < total(bulb) / (4 * np.pi * 0.04) < 0.75  # the half that looks at the subject, and the rim


def test_lobes_are_those_of_brute_force():
    """A tinted panel, and a bulb beside it, against the sum over 40 000 points."""
    panel = glowing.rectangle((0.9, -0.6, 1.1), (0.35, 0.3, -0.1), (-0.2, 0.5, 0.4), (2.0, 1.0, 0.5))
    bulb = glowing.ball((-0.8, -0.9, 1.0), 0.08, (9.0, 9.0, 9.0), rings=64)
    found = emitters.patches([panel, bulb], CENTER, RADIUS)
    points, normal, power = (np.concatenate(pair) for pair in zip(_points(panel, 140), _points(bulb, 1), strict=True))
    rng, worst = np.random.default_rng(8), []
    for P, N in zip(*_places(30, 5), strict=True):
        V = N + 0.7 * rng.normal(size=3)
        V /= np.linalg.norm(V)
        if V @ N < 0.1:
            continue
        offset = points - P
        d2 = (offset * offset).sum(-1)
        L = offset / np.sqrt(d2)[:, None]
        arrives = power * (np.maximum(-(normal * L).sum(-1), 0) * np.maximum(L @ N, 0) / d2)[:, None]
        lit = arrives.any(-1)
        if not lit.any():
            continue
        E, sent, _ = environment.node_values(emitters.seen_from(found, P), N, V)
        for k, r in enumerate(environment.NODE_ROUGHNESS):
            if r < 0.09:
                continue
            shape = brdf.lobe_ggx(r, _sin2h(N, L[lit], V), 0.0, np.maximum(L[lit] @ N, 1e-3), float(V @ N))
            H = L[lit] + V
            cos_vh = (H @ V) / np.linalg.norm(H, axis=1)
            want = (shape * brdf.F_dielectric(cos_vh)) @ arrives[lit] + 0.5 / np.pi * arrives.sum(0)
            worst.append((np.abs((sent[k] + 0.5 / np.pi * E) / want - 1).max(), want.max()))
    error, light = np.array(worst).T
    error = error[light > 0.02 * light.max()]  # not where the horizon leaves some last points of an emitter
    assert len(error) > 80
    assert np.quantile(error, 0.9) < 0.009 and error.max() < 0.03


def _sin2h(N, L, V):
    H = L + V
    return (np.cross(N, H / np.linalg.norm(H, axis=1, keepdims=True)) ** 2).sum(-1)


def _points(emitter, side: int):
    """Midpoints of each triangle divided into side^2, with both sides' normals where both shine, and L times area."""
    corners = emitter.triangles.astype(np.float64)
    a, u, v = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    i, j = np.indices((side, side)).reshape(2, -1)
    up = i + j < side
    s, t = np.concatenate([np.stack([i, j])[:, up] + 1 / 3, np.stack([i, j])[:, i + j < side - 1] + 2 / 3], 1) / side
    points = a[:, None] + s[:, None] * u[:, None] + t[:, None] * v[:, None]
    cross = np.cross(u, v)
    area = np.linalg.norm(cross, axis=1)
    normal = np.broadcast_to((cross / area[:, None])[:, None], points.shape)
    power = np.broadcast_to((emitter.radiance * area[:, None] / 2 / side**2)[:, None], points.shape)
    points, normal, power = (x.reshape(-1, 3) for x in (points, normal, power))
    if emitter.both_sides:
        points, normal, power = (np.concatenate(p) for p in ((points, points), (normal, -normal), (power, power)))
    return points, normal, power


def test_an_environment_without_shadows_adds_world_and_emitters():
    panel = glowing.rectangle((0, 0, 2), (0.5, 0, 0), (0, 0.5, 0), (2.0, 1.0, 0.5))
    sky = np.ones((16, 32, 3), np.float32)
    P, N = _places(40)
    both = emitters.around_irradiance(Environment("Sky", sky, np.eye(3), emitters=(panel,)), P, N, 256)
    alone = emitters.around_irradiance(Environment("", 0 * sky, np.eye(3), emitters=(panel,)), P, N, 256)
    world = emitters.around_irradiance(Environment("Sky", sky, np.eye(3)), P, N, 256)
    assert np.allclose(both, alone + world)
    assert np.allclose(world, np.pi, rtol=0.01)
    assert alone.max() > 0.05
