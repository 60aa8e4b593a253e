"""The float64 lamps against brute-force integrals over the emitter and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.checks.light_checks import four_sided, light_slopes
from irpso_addon.core.data import Light
from irpso_addon.core.shading import lights

TURN = np.linalg.qr(np.array([[0.9, 0.3, -0.2], [-0.4, 0.8, 0.5], [0.3, -0.35, 0.9]]))[0]
MATRIX = np.eye(4)
MATRIX[:3, :3] = TURN * np.array([1.3, 0.8, 1.1])
MATRIX[:3, 3] = 0.4, -0.3, 1.7
BASE = Light(name="lamp", kind="POINT", power=np.ones(3), matrix=MATRIX)
AREA = replace(BASE, kind="AREA", shape="RECTANGLE", size=(1.2, 0.5))


def places(count: int, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Points before the lamp at 0.6 to 3 m, normals within 100 degrees of it: some horizons cut the emitter."""
    rng = np.random.default_rng(seed)
    away = rng.normal(size=(count, 3)) * 0.6 - TURN[:, 2]
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    across = np.cross(away, rng.normal(size=(count, 3)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    tilt = np.radians(rng.uniform(0, 100, (count, 1)))
    return MATRIX[:3, 3] + away * rng.uniform(0.6, 3, (count, 1)), -away * np.cos(tilt) + across * np.sin(tilt)


def brute_area(light: Light, P: np.ndarray, N: np.ndarray, count: int) -> np.ndarray:
    """Radiance times cosines over distance^2, summed over count^2 cells of the emitter (radiance per watt)."""
    scale = np.linalg.norm(MATRIX[:3, :3], axis=0)
    hx, hy = np.array([light.size[0], light.size[1]]) * scale[:2] / 2
    cells = (np.arange(count) + 0.5) / count * 2 - 1
    x, y = np.meshgrid(cells, cells)
    if light.shape in ("DISK", "ELLIPSE"):
        radius, phi = np.sqrt((x + 1) / 2), np.pi * y
        x, y, area = radius * np.cos(phi), radius * np.sin(phi), np.pi * hx * hy
    else:
        area = 4 * hx * hy
    points = MATRIX[:3, 3] + (x * hx)[..., None] * TURN[:, 0] + (y * hy)[..., None] * TURN[:, 1]
    out = []
    for p, n in zip(P, N, strict=True):
        offset = points - p
        d = np.linalg.norm(offset, axis=-1)
        cos_e, cos_l = np.maximum(offset @ TURN[:, 2] / d, 0), np.maximum(offset @ n / d, 0)
        radiance = 1 / (np.pi * area)
        if light.spread < np.pi:
            b = light.spread / 2
            radiance = radiance * np.maximum(np.tan(b) - np.tan(np.arccos(cos_e)), 0) / (np.tan(b) - b)
        out.append((radiance * cos_e * cos_l / d**2).mean() * area)
    return np.array(out)


@pytest.mark.parametrize(("light", "tolerance"), [
    (AREA, 1e-4),  # the sum's own error where a horizon cuts the cells
    (replace(AREA, shape="ELLIPSE"), 3e-3),  # a polygon of 32 sides
], ids=["rectangle", "ellipse"])
def test_area_irradiance_equals_the_integral_over_the_emitter(light, tolerance):
    P, N = places(60)
    got, truth = lights.light_irradiance(light, P, N), brute_area(light, P, N, 500)
    assert (truth > 0).sum() > 40
    np.testing.assert_allclose(got, truth, rtol=tolerance, atol=tolerance * truth.max() / 10)


@pytest.mark.parametrize("shape", ["RECTANGLE", "ELLIPSE"])
@pytest.mark.parametrize(("degrees", "tolerance"), [(150, 3e-3), (90, 3e-3), (40, 3e-3)])
def test_spread_equals_the_integral_over_the_emitter(shape, degrees, tolerance):
    light = replace(AREA, shape=shape, spread=np.radians(degrees))
    P, N = places(60)
    got, truth = lights.light_irradiance(light, P, N), brute_area(light, P, N, 500)
    np.testing.assert_allclose(got, truth, rtol=tolerance, atol=tolerance * truth.max())


def test_a_wide_spread_approaches_no_limit():
    P, N = places(50)
    np.testing.assert_allclose(lights.light_irradiance(replace(AREA, spread=np.pi - 1e-3), P, N),
                               lights.light_irradiance(AREA, P, N), rtol=0.02, atol=1e-4)


def test_an_area_emits_only_forward():
    P, N = MATRIX[:3, 3] + TURN[:, 2], -TURN[:, 2]
    assert lights.light_irradiance(AREA, P, N) == 0
    assert lights.light_irradiance(replace(AREA, spread=1.0), P, N) == 0
    assert lights.light_sample(AREA, P, 0, 1)[1] == 0


def test_a_tiny_area_is_a_point_and_the_change_over_is_smooth():
    P = MATRIX[:3, 3] + TURN @ [0.6, 0.4, -2.0]
    N, lamp = TURN[:, 2], replace(AREA, matrix=np.block([[TURN, MATRIX[:3, 3:]], [np.zeros((1, 3)), np.ones((1, 1))]]))
    change = 2 * lights.POINT_SIZE * np.linalg.norm(P - MATRIX[:3, 3])
    below, above = (lights.light_irradiance(replace(lamp, shape="SQUARE", size=(s, s)), P, N)
                    for s in (change * 0.999, change * 1.001))
    point = lights.light_sample(lamp, P, 0, 1)[1] * 2.0 / np.linalg.norm([0.6, 0.4, 2.0])
    assert below == pytest.approx(point, rel=1e-12)
    assert below != above and below == pytest.approx(above, rel=5e-5)
    assert lights.light_irradiance(replace(lamp, size=(0.0, 0.0)), P, N) == pytest.approx(below, rel=1e-12)


@pytest.mark.parametrize("sigma", [0.02, 0.3, 1.0])
def test_cone_cosine_equals_the_integral_over_the_cone(sigma):
    count = 600
    sin2 = (np.arange(count) + 0.5) / count * np.sin(sigma) ** 2  # even in projected solid angle about the axis
    phi = (np.arange(count) + 0.5) / count * 2 * np.pi
    sin2, phi = np.meshgrid(sin2, phi)
    for cos_n in np.linspace(-1, 1, 21) * min(1, 1.5 * np.sin(sigma)):
        sin_n = np.sqrt(1 - cos_n**2)
        cosine = np.sqrt(1 - sin2) * cos_n + np.sqrt(sin2) * np.cos(phi) * sin_n
        truth = (np.maximum(cosine, 0) / np.sqrt(1 - sin2)).mean()
        assert lights.cone_cosine(cos_n, np.sin(sigma)) == pytest.approx(truth, abs=2e-5)


def test_inverse_square_and_lambert_of_a_point():
    P = MATRIX[:3, 3] + np.array([[0, 0, -2.0], [0, 0, -4.0]])
    up, tilted = np.array([0, 0, 1.0]), np.array([0.8, 0, 0.6])
    facing = 1 / (4 * np.pi * np.array([4, 16]))
    np.testing.assert_allclose(lights.light_irradiance(BASE, P, up), facing, rtol=1e-12)
    np.testing.assert_allclose(lights.light_irradiance(BASE, P, tilted), 0.6 * facing, rtol=1e-12)
    soft = lights.light_irradiance(replace(BASE, radius=0.5), P, up)
    np.testing.assert_allclose(soft, 1 / (4 * np.pi * (np.array([4, 16]) + 0.25)), rtol=1e-12)


def test_sun_shines_along_its_local_minus_z_at_any_distance():
    sun = replace(BASE, kind="SUN", radius=0.01)
    for P in ([0, 0, 0], [50.0, -20, 3]):
        assert lights.light_irradiance(sun, np.array(P), TURN[:, 2]) == pytest.approx(1, rel=1e-12)


def test_spot_is_a_point_in_its_cone_and_nothing_outside():
    spot = replace(BASE, kind="SPOT", spot_angle=np.radians(60), spot_blend=0.5, matrix=np.eye(4))
    angles = np.radians([0, 10, 29, 31, 80])
    P = -np.stack([np.sin(angles), 0 * angles, np.cos(angles)], 1)
    share = lights.light_irradiance(spot, P, -P) * 4 * np.pi
    x = (np.cos(angles) - np.cos(np.radians(30))) / ((1 - np.cos(np.radians(30))) * 0.5)
    t = np.clip(x, 0, 1)
    np.testing.assert_allclose(share, t * t * (3 - 2 * t), atol=1e-12)
    assert share[0] == 1 and 0 < share[2] < 0.2 and share[3] == 0
    # Stretched along X the cone is wider there.
    wide = replace(spot, matrix=np.diag([2.0, 1, 1, 1]))
    assert lights.light_irradiance(wide, P[3], -P[3]) > 0


def test_a_soft_spot_keeps_the_energy_and_blurs_the_rim():
    spot = replace(BASE, kind="SPOT", spot_angle=np.radians(60), spot_blend=0.0, matrix=np.eye(4), radius=0.1)
    angles = np.radians([0, 29, 31, 45])
    P = -np.stack([np.sin(angles), 0 * angles, np.cos(angles)], 1)
    share = lights.light_irradiance(spot, P, -P) * 4 * np.pi * (1 + 0.01)
    assert share[0] == pytest.approx(1, rel=1e-3)
    assert 0.5 < share[1] < 0.9 and 0.1 < share[2] < 0.5 and share[3] == 0


KINDS = {
    "point": replace(BASE, radius=0.3), "sphere": replace(BASE, radius=0.3, soft_falloff=False),
    "sun": replace(BASE, kind="SUN", radius=0.4), "rectangle": AREA, "ellipse": replace(AREA, shape="ELLIPSE"),
    "spread": replace(AREA, spread=1.5),
}


@pytest.mark.parametrize("name", KINDS)
def test_samples_sum_to_the_irradiance(name):
    light = KINDS[name]
    P, N = places(40)
    count = 2000
    offset, weight = lights.light_sample(light, P, np.arange(count)[:, None], count)
    cosine = np.maximum((offset * N).sum(-1) / np.linalg.norm(offset, axis=-1), 0)
    truth = lights.light_irradiance(light, P, N)
    np.testing.assert_allclose((weight * cosine).sum(0), truth, rtol=5e-3, atol=2e-3 * truth.max())


@pytest.mark.parametrize("name", sorted(KINDS.keys() - {"spread"}))  # whose middle is that of the part that P sees
def test_one_sample_is_the_centre(name):
    light = KINDS[name]
    offset, _ = lights.light_sample(light, np.zeros(3), 0, 1)
    np.testing.assert_allclose(offset, TURN[:, 2] if light.kind == "SUN" else MATRIX[:3, 3], atol=1e-12)


SOFT_SPOT = replace(BASE, kind="SPOT", radius=0.2, spot_angle=1.2, spot_blend=0.3)


def test_well_inside_its_cone_a_soft_spot_is_a_point_of_its_size():
    """There is a formula for that: no sum over points of the emitter is needed."""
    rng = np.random.default_rng(2)
    P = MATRIX[:3, 3] + TURN @ np.array([0, 0, -2.0]) + rng.uniform(-0.2, 0.2, (50, 3))
    N = TURN[:, 2] + rng.uniform(-0.4, 0.4, (50, 3))
    N /= np.linalg.norm(N, axis=1, keepdims=True)
    point = replace(SOFT_SPOT, kind="POINT")
    truth = lights.light_irradiance(point, P, N)
    assert (truth > 0).all()
    np.testing.assert_allclose(lights.light_irradiance(SOFT_SPOT, P, N), truth, rtol=1e-12)


@pytest.mark.parametrize("soft", [True, False])
@pytest.mark.parametrize(("angle", "blend"), [(1.2, 0.3), (0.5, 0.0), (2.8, 1.0)])
def test_a_cone_cuts_a_disc_that_it_lets_through_in_part(angle, blend, soft):
    """By 600 points of the disc: of the others it lets all through alike."""
    light = replace(SOFT_SPOT, spot_angle=angle, spot_blend=blend, soft_falloff=soft)
    P = np.concatenate([places(400)[0], MATRIX[:3, 3] + np.random.default_rng(1).normal(0, 0.15, (50, 3))])
    uniforms = lights.light_uniforms(light)
    offset, sin_sigma, _ = lights.light_round(light, P)
    reach = np.linalg.norm(offset, axis=-1) * sin_sigma / np.sqrt(np.maximum(1 - sin_sigma**2, 1e-4))
    cut, share = lights.spot_cuts(uniforms, offset, reach)
    through = lights.spot_attenuation(uniforms, lights.light_sample(light, P, np.arange(600)[:, None], 600)[0])
    low, high = through.min(0), through.max(0)
    assert cut[low < high].all()
    assert ((low == share) & (high == share))[~cut].all()
    assert cut.any() and not cut.all()
    assert (cut & (low == high)).mean() < 0.15  # an uneven scale is taken to stretch the disc all around


# ---- how irradiance changes as a lamp moves

def test_slopes_of_a_point_are_those_of_its_formula():
    light = replace(BASE, radius=0.0)
    P, N = places(60)
    offset = MATRIX[:3, 3] - P
    want = N / (N * offset).sum(-1, keepdims=True) - 3 * offset / (offset * offset).sum(-1, keepdims=True)
    slopes, fine = light_slopes(light, P, N)
    assert fine.sum() > 30
    reach = np.linalg.norm(MATRIX[:3, 3] - P.mean(0))
    np.testing.assert_allclose(slopes[fine], reach * want[fine], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("shape", ["RECTANGLE", "ELLIPSE"])
def test_slopes_of_an_area_are_those_of_one_that_moves(shape):
    """Against irradiance summed over cells of the emitter, for places that move and a lamp that stays."""
    light = replace(AREA, shape=shape, size=(0.3, 0.2))
    P, N = places(40)
    slopes, fine = light_slopes(light, P, N)
    reach, step = np.linalg.norm(MATRIX[:3, 3] - P.mean(0)), 1e-3
    assert fine.sum() > 20
    for axis in range(3):
        by = step * reach * np.eye(3)[axis]
        near, far = (brute_area(light, P[fine] + sign * by, N[fine], 60) for sign in (-1, 1))
        np.testing.assert_allclose(slopes[fine, axis], np.log(near / far) / (2 * step), rtol=0.01, atol=0.02)


def test_a_sun_turns():
    light = replace(BASE, kind="SUN", radius=0.0)
    P, N = places(60)
    slopes, fine = light_slopes(light, P, N)
    toward = TURN[:, 2]
    want = N / (N @ toward)[:, None] - toward  # of a unit direction, whose length stays
    np.testing.assert_allclose(slopes[fine], want[fine], rtol=1e-5, atol=1e-6)


def test_a_disc_is_nearly_the_rectangle_of_its_second_moments():
    light = replace(AREA, shape="DISK", size=(0.3, 0.3))
    P, N = places(60)
    fine = light_slopes(light, P, N)[1]  # not those whose horizon may cut the lamp
    disc, four = (lights.light_irradiance(one, P[fine], N[fine]) for one in (light, four_sided(light)))
    assert fine.sum() > 30
    np.testing.assert_allclose(four, disc, rtol=1e-3)


def test_a_soft_spot_that_moves_is_nearly_a_sharp_one():
    """Within its cone, beside the sum over its points: what counts is the ratio to the spot as it was."""
    spot = replace(BASE, kind="SPOT", radius=0.05, spot_angle=1.6, spot_blend=0.3)
    matrix = spot.matrix.copy()
    matrix[:3, 3] += 0.01, -0.02, 0.015
    P, N = places(2000)
    fine = light_slopes(spot, P, N)[1]
    way = (P - MATRIX[:3, 3]) @ -TURN[:, 2] / np.linalg.norm(P - MATRIX[:3, 3], axis=1)
    fine &= way > np.cos(0.45)
    assert fine.sum() > 100 and four_sided(spot).radius == 0
    soft, sharp = (
        lights.light_irradiance(make(replace(spot, matrix=matrix)), P[fine], N[fine])
        / lights.light_irradiance(make(spot), P[fine], N[fine]) for make in (lambda light: light, four_sided))
    np.testing.assert_allclose(sharp, soft, rtol=2e-3)
