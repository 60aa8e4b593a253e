"""The float64 BRDF against integrals and identities that it must satisfy."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core import brdf, tables

ROUGHNESSES = [0.1, 0.3, 0.6, 1.0]


@pytest.fixture(scope="module")
def make_tables():
    path = Path(__file__).resolve().parents[2] / "tools" / "make_tables.py"
    spec = importlib.util.spec_from_file_location("make_tables", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def gauss(low: float, high: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    x, w = np.polynomial.legendre.leggauss(count)
    return low + (high - low) * (x + 1) / 2, w * (high - low) / 2


@pytest.mark.parametrize("roughness", ROUGHNESSES)
def test_normal_distribution_projects_onto_the_whole_surface(roughness):
    """int D cos dw = 1 over the half sphere; in u = sin^2, dw cos = pi du, substituted to resolve the peak."""
    alpha2 = roughness**4
    t, w = gauss(np.log(1e-9), 0, 150)
    u = np.exp(t)
    total = (np.pi * brdf.D_ggx(alpha2, u) * u * w).sum() + np.pi * brdf.D_ggx(alpha2, 0.0) * 1e-9
    assert total == pytest.approx(1, abs=2e-5)  # the last term takes D as constant up to 1e-9


def test_spread_is_the_mean_of_two_points_and_keeps_the_mean_of_sin2h():
    sin2h, spread = np.array([0.01, 0.01, 0.02]), np.array([0.0, 0.004, 0.5])
    two = [(0.01, 0.01), (0.006, 0.014), (0.0, 0.04)]
    expected = [(brdf.D_ggx(0.01, a) + brdf.D_ggx(0.01, b)) / 2 for a, b in two]
    np.testing.assert_allclose(brdf.D_ggx_spread(0.01, sin2h, spread), expected, rtol=1e-13)


def test_spread_approaches_the_mean_over_a_narrow_distribution():
    """Against quadrature over sin2h uniform in an interval whose width is small beside the peak's."""
    alpha2, middle, half = 0.01, 0.008, 0.004
    s, w = gauss(middle - half, middle + half, 20)
    mean = (brdf.D_ggx(alpha2, s) * w).sum() / (2 * half)
    got = brdf.D_ggx_spread(alpha2, middle, half / np.sqrt(3))
    assert abs(got / mean - 1) < 0.1 * abs(brdf.D_ggx(alpha2, middle) / mean - 1)


def test_derivatives_equal_central_differences():
    rng = np.random.default_rng(1)
    a2, s = rng.uniform(0.01, 0.9, 500), rng.uniform(0, 1, 500)
    spread, step = s * rng.uniform(0, 1.5, 500), 1e-6
    value, slope = brdf.D_ggx_spread_d(a2, s, spread)
    numeric = (brdf.D_ggx_spread(a2 + step, s, spread) - brdf.D_ggx_spread(a2 - step, s, spread)) / (2 * step)
    np.testing.assert_allclose(slope, numeric, rtol=1e-6, atol=1e-6 * value.max())
    cos_v = rng.uniform(0.05, 1, 500)
    roughness = (rng.integers(30, tables.SIZE - 2, 500) + rng.uniform(0.1, 0.9, 500)) / (tables.SIZE - 1)
    _, slope = brdf.principled_energy_d(roughness, cos_v)
    step = 1e-5
    numeric = (brdf.principled_energy(roughness + step, cos_v) - brdf.principled_energy(roughness - step, cos_v))
    np.testing.assert_allclose(slope, numeric / (2 * step), rtol=1e-7, atol=1e-9)


def test_fresnel_known_values_and_mean():
    assert brdf.F_dielectric(1.0) == pytest.approx(0.04, rel=1e-14)
    assert brdf.F_dielectric(0.0) == pytest.approx(1.0, rel=1e-14)
    mu, w = gauss(0, 1, 64)
    # Egan and Hilgeman 1973 give the hemispherical mean in closed form; 0.09178 for n = 1.5.
    assert 2 * (mu * brdf.F_dielectric(mu) * w).sum() == pytest.approx(0.09178, abs=5e-6)


def half_vector(theta_l: np.ndarray, phi: np.ndarray, theta_v: float) -> tuple[np.ndarray, ...]:
    light = np.stack([np.sin(theta_l) * np.cos(phi), np.sin(theta_l) * np.sin(phi), np.cos(theta_l)], -1)
    view = np.array([np.sin(theta_v), 0, np.cos(theta_v)])
    return light, np.broadcast_to(view, light.shape), np.broadcast_to([0.0, 0, 1], light.shape)


def directional_albedo(base: float, roughness: float, theta_v: float) -> float:
    """int f cos_l dw over the half sphere, nodes packed around the mirror direction."""
    theta, w_theta = (np.concatenate(parts) for parts in zip(
        gauss(0, theta_v, 160), gauss(theta_v, np.pi / 2, 160), strict=True))
    side, w_side = gauss(0, 1, 160)
    phi, w_phi = np.pi * (1 - side**3), 3 * np.pi * side**2 * w_side  # dense at phi = pi
    light, view, normal = half_vector(*np.meshgrid(theta, phi, indexing="ij"), theta_v)
    f = brdf.principled(np.array([base]), np.array(roughness), light, view, normal)[..., 0]
    measure = (w_theta * np.sin(theta) * np.cos(theta))[:, None] * w_phi
    return float(2 * (f * measure).sum())


@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
@pytest.mark.parametrize("degrees", [0.5, 30, 60])
def test_white_furnace(roughness, degrees):
    """A white base gives back all the light, to what Cycles' coarse tables allow; a black one gives back A."""
    theta = np.radians(degrees)
    black = directional_albedo(0.0, roughness, theta)
    dimming = brdf.principled_energy(roughness, np.cos(theta))[1]
    assert black == pytest.approx(dimming, abs=0.006)
    assert directional_albedo(1.0, roughness, theta) == pytest.approx(1 - dimming + black, abs=1e-4)


def test_specular_is_reciprocal_but_for_the_view_dependent_gain_and_the_diffuse_is_not():
    rng = np.random.default_rng(5)
    cos_l, cos_v, roughness = rng.uniform(0.1, 1, (3, 200))
    geometry = rng.uniform(0.1, 1, 200), 0.0
    gain = brdf.principled_energy(roughness, cos_v)[:, 0], brdf.principled_energy(roughness, cos_l)[:, 0]
    one = brdf.specular_principled(roughness, *geometry, cos_l, cos_v, 0.7) / gain[0]
    two = brdf.specular_principled(roughness, *geometry, cos_v, cos_l, 0.7) / gain[1]
    np.testing.assert_allclose(one, two, rtol=1e-12)
    assert brdf.diffuse_principled(0.5, 0.2) < 0.9 * brdf.diffuse_principled(0.5, 1.0)


def test_principled_is_zero_below_the_horizon_and_finite_at_grazing():
    up, down = np.array([0.0, 0, 1]), np.array([0.6, 0, -0.8])
    assert (brdf.principled(np.array([0.5]), np.array(0.4), np.stack([down, up]), np.stack([up, down]), up) == 0).all()
    grazing = np.array([1.0, 0, 1e-4]) / np.hypot(1, 1e-4)
    value = brdf.principled(np.array([0.5]), np.array(0.4), grazing * [-1, 1, 1], grazing, up)
    assert np.isfinite(value).all() and (value > 0).all()


def test_committed_nodes_are_recomputable(make_tables):
    """Stored as float32 of the same quadrature: equal to rounding."""
    with np.load(tables.NODES) as nodes:
        for i, j in [(3, 5), (10, 31), (31, 8)]:
            assert nodes["albedo"][i, j] == pytest.approx(make_tables.lobe_albedo(i / 31, j / 31), rel=1e-6)
        assert nodes["mean"][16] == pytest.approx(make_tables.mean_lobe_albedo(16 / 31), rel=1e-6)
        z = np.array([6, 7]) / 15
        below, above = (make_tables.mean_fresnel(9 / 15, 4 / 15, (1 + q * q) / (1 - q * q)) for q in z)
        share = np.sqrt(0.2) * 15 - 6
        assert nodes["fresnel"][9, 4] == pytest.approx(below * (1 - share) + above * share, rel=1e-6)


def test_nodes_equal_an_independent_integral():
    """E1 by integrating the lobe with Fresnel 1 over light directions instead of over visible normals."""
    with np.load(tables.NODES) as nodes:
        for i, j in [(16, 16), (31, 8), (31, 31)]:
            roughness, cos_v = i / 31, j / 31
            theta, w_theta = gauss(0, np.pi / 2, 200)
            phi, w_phi = gauss(0, np.pi, 200)
            light, view, normal = half_vector(*np.meshgrid(theta, phi, indexing="ij"), np.arccos(cos_v))
            half = light + view
            half /= np.linalg.norm(half, axis=-1, keepdims=True)
            sin2h = (np.cross(normal, half) ** 2).sum(-1)
            a2, tan2_l, tan2_v = roughness**4, np.tan(theta)[:, None] ** 2, 1 / cos_v**2 - 1
            roots = brdf.lambda_root(a2, tan2_l) + brdf.lambda_root(a2, tan2_v)
            lobe = brdf.D_ggx(a2, sin2h) / (2 * cos_v * roots)  # times the cosine of the light
            albedo = 2 * (lobe * (w_theta * np.sin(theta))[:, None] * w_phi).sum()
            assert nodes["albedo"][i, j] == pytest.approx(albedo, abs=1e-4)


def test_table_reproduces_the_nodes_between_the_nodes():
    """SIZE has every node of both grids: what resampling adds stays below 2e-5 of 1 - A and of comp."""
    rng = np.random.default_rng(2)
    roughness, cosine = rng.uniform(0.05, 1, (2, 50_000))
    with np.load(tables.NODES) as nodes:
        direct = tables.energy(*(nodes[k].astype(float) for k in ("albedo", "mean", "fresnel")), roughness, cosine)
    got = brdf.principled_energy(roughness, cosine)
    np.testing.assert_allclose(got[:, 0], direct[:, 0], rtol=2e-5)
    np.testing.assert_allclose(1 - got[:, 1], 1 - direct[:, 1], rtol=2e-5)
