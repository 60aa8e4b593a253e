"""The lamps of lights.glsl against their float64 twin, at random points around lamps of every kind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.data import Light
from irpso_addon.core.shading import lights

LIGHTS = "include/lights.glsl"
COUNT = 4_000

# Moved, turned and unevenly scaled, so that no axis can be mistaken for another.
TURN = np.linalg.qr(np.array([[0.9, 0.3, -0.2], [-0.4, 0.8, 0.5], [0.3, -0.35, 0.9]]))[0]
MATRIX = np.eye(4)
MATRIX[:3, :3] = TURN * np.array([1.3, 0.8, 1.1])
MATRIX[:3, 3] = 0.4, -0.3, 1.7
BASE = Light(name="lamp", kind="POINT", power=np.ones(3), matrix=MATRIX)
LAMPS = {
    "point": BASE,
    "point-soft": replace(BASE, radius=0.4),
    "point-sphere": replace(BASE, radius=0.4, soft_falloff=False),
    "sun": replace(BASE, kind="SUN"),
    "sun-disc": replace(BASE, kind="SUN", radius=0.3),
    "spot": replace(BASE, kind="SPOT", spot_angle=1.4, spot_blend=0.6),
    "spot-soft": replace(BASE, kind="SPOT", spot_angle=1.4, spot_blend=0.6, radius=0.2),
    "spot-sphere": replace(BASE, kind="SPOT", spot_angle=1.4, spot_blend=0.6, radius=0.2, soft_falloff=False),
    "rectangle": replace(BASE, kind="AREA", shape="RECTANGLE", size=(1.2, 0.5)),
    "square-small": replace(BASE, kind="AREA", shape="SQUARE", size=(0.05, 0.05)),
    "square-tiny": replace(BASE, kind="AREA", shape="SQUARE", size=(0.002, 0.002)),
    "ellipse": replace(BASE, kind="AREA", shape="ELLIPSE", size=(1.2, 0.5)),
    "rectangle-spread": replace(BASE, kind="AREA", shape="RECTANGLE", size=(1.2, 0.5), spread=1.5),
    "disk-spread": replace(BASE, kind="AREA", shape="DISK", size=(0.8, 0.8), spread=2.0),
}


@pytest.fixture(scope="module")
def places() -> np.ndarray:
    """(n, 6) float32 positions 0.5 to 3 m from the lamp, mostly before it, and normals mostly toward it."""
    rng = np.random.default_rng(3)
    away = rng.normal(size=(COUNT, 3)) - 1.2 * TURN[:, 2]
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    position = MATRIX[:3, 3] + away * rng.uniform(0.5, 3, (COUNT, 1))
    normal = rng.normal(size=(COUNT, 3)) - 1.5 * away
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.concatenate([position, normal], axis=1).astype(np.float32)


@pytest.mark.parametrize("name", LAMPS)
def test_irradiance_equals_its_twin(evaluate, places, name):
    lamp = LAMPS[name]
    body = "o = vec4(light_irradiance(a.xyz, vec3(a.w, b.xy)));"
    got = evaluate(LIGHTS, body, places, lights.light_uniforms(lamp))[:, 0]
    exact = lights.light_irradiance(lamp, places[:, :3].astype(float), places[:, 3:].astype(float))
    assert 0.2 < (exact > 0).mean() < 0.999
    # Relative to what an AREA of that power gives head-on: at a horizon, a rim or an edge-on emitter the
    # value itself is a difference of nearly equal float32 numbers.  An outline's edges cancel: 1e-7 * distance / size.
    distance2 = ((places[:, :3] - MATRIX[:3, 3]) ** 2).sum(1)
    scale = 1 if lamp.kind == "SUN" else 1 / (np.pi * distance2)
    np.testing.assert_array_less(np.abs(got - exact) / scale, 1e-4)
    assert np.abs(got - exact).mean() < 2e-5 * exact.mean()


@pytest.mark.parametrize("name", ["rectangle", "square-small", "ellipse"])
def test_an_outline_that_touches_the_horizon_with_a_corner(evaluate, places, name):
    """Its corner's height is rounding alone: above as the end of one edge, it may be below as the begin of the next."""
    lamp = LAMPS[name]
    of = lights.light_uniforms(lamp)
    corners = lights.area_corners(of["u_light_ellipse"]) @ np.stack([of["u_light_axis_u"], of["u_light_axis_v"]])
    way = np.asarray(of["u_light_position"]) + np.tile(corners, (COUNT, 1))[:COUNT] - places[:, :3]
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    normal = places[:, 3:] - (places[:, 3:] * way).sum(1, keepdims=True) * way
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    rows = np.concatenate([places[:, :3], normal], 1).astype(np.float32)
    got = evaluate(LIGHTS, "o = vec4(light_irradiance(a.xyz, vec3(a.w, b.xy)));", rows, of)[:, 0]
    exact = lights.light_irradiance(lamp, rows[:, :3].astype(float), rows[:, 3:].astype(float))
    scale = 1 / (np.pi * ((rows[:, :3] - MATRIX[:3, 3]) ** 2).sum(1))
    assert np.isfinite(exact).all()
    # Edges of small lamps cancel (see above), and what is left of the outline is small: 2e-4 here.
    np.testing.assert_array_less(np.abs(got - exact) / scale, 3e-4)


@pytest.mark.parametrize("name", LAMPS)
@pytest.mark.parametrize("count", [1, 16])
def test_sample_equals_its_twin(evaluate, places, name, count):
    lamp = LAMPS[name]
    body = f"float w; vec3 v = light_sample(a.xyz, int(a.w), {count}, w); o = vec4(v, w);"
    which = np.arange(COUNT) % count
    arguments = np.column_stack([places[:, :3], which]).astype(np.float32)
    got = evaluate(LIGHTS, body, arguments, lights.light_uniforms(lamp))
    offset, weight = lights.light_sample(lamp, places[:, :3].astype(float), which, count)
    # Where a spread's row of the emitter is empty the point is nowhere: only its weight, 0, is told.
    told = weight > 1e-6 * weight.max()
    np.testing.assert_allclose(got[told, :3], offset[told], atol=5e-5)
    np.testing.assert_allclose(got[:, 3], weight, atol=5e-5 * weight.max())


@pytest.mark.parametrize("name", LAMPS)
def test_ring_sample_equals_its_twin(evaluate, places, name):
    lamp, turn = LAMPS[name], np.linspace(0, 1, COUNT)
    body = "float w; vec3 v = ring_sample(a.xyz, a.w, w); o = vec4(v, w);"
    got = evaluate(LIGHTS, body, np.column_stack([places[:, :3], turn]).astype(np.float32), lights.light_uniforms(lamp))
    offset, weight = lights.ring_sample(lamp, places[:, :3].astype(float), turn)
    told = weight > 1e-6 * weight.max()
    np.testing.assert_allclose(got[told, :3], offset[told], atol=5e-5)
    np.testing.assert_allclose(got[:, 3], weight, atol=5e-5 * weight.max())
