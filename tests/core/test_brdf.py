"""The float64 BRDF against integrals and identities that it must satisfy."""

from __future__ import annotations

import importlib.util
import itertools
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.shading import brdf, tables

ROUGHNESSES = [0.1, 0.3, 0.6, 1.0]
LEVELS = [0.01, 0.2, 0.8, 1.0]


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


@pytest.mark.parametrize("D", [brdf.D_ggx, brdf.D_beckmann])
@pytest.mark.parametrize("roughness", ROUGHNESSES)
def test_normal_distribution_projects_onto_the_whole_surface(D, roughness):
    """int D cos dw = 1 over the half sphere; in u = sin^2, dw cos = pi du, substituted to resolve the peak."""
    alpha2 = roughness**4
    t, w = gauss(np.log(1e-9), 0, 150)
    u = np.exp(t)
    total = (np.pi * D(alpha2, u) * u * w).sum() + np.pi * D(alpha2, 0.0) * 1e-9
    assert total == pytest.approx(1, abs=2e-5)  # the last term takes D as constant up to 1e-9


@pytest.mark.parametrize("roughness", [0.3, 0.6, 0.8])
@pytest.mark.parametrize("cos_v", [0.2, 0.5, 0.9])
def test_beckmann_masks_so_that_the_visible_area_is_the_projected_one(roughness, cos_v):
    """int D(h) max(V.h, 0) dw / (1 + Lambda(V)) = N.V (Heitz 2014, eq. 14), to the 0.35 % of Walter's rational fit."""
    cos_h, w_h = gauss(0, 1, 400)
    phi, w_phi = gauss(0, np.pi, 400)
    visible = np.maximum(cos_v * cos_h[:, None] + np.sqrt((1 - cos_v**2) * (1 - cos_h[:, None] ** 2)) * np.cos(phi), 0)
    area = 2 * (brdf.D_beckmann(roughness**4, 1 - cos_h**2) * w_h * (visible @ w_phi)).sum()
    masked = area / (1 + brdf.lambda_beckmann_d(roughness**4, 1 / cos_v**2 - 1)[0])
    assert masked == pytest.approx(cos_v, rel=0.0035)


def test_beckmann_is_finite_and_vanishes_where_it_should():
    alpha2 = np.array([0, 1e-12, 6.25e-6, 0.1, 1])[:, None]
    sin2h = np.array([0, 1e-9, 0.5, 1 - 1e-7, 1])
    for radius2 in (0.0, 0.3, 2.0):
        assert np.isfinite(brdf.D_beckmann_disc_d(alpha2, sin2h, radius2)).all()
    assert (brdf.D_beckmann(alpha2, 1.0) == 0).all() and (brdf.D_beckmann(alpha2[:3], 0.5) == 0).all()
    assert np.isfinite(brdf.lambda_beckmann_d(alpha2, np.array([0, 1, 1e12]))).all()


def test_beckmann_over_a_disc_has_the_mean_and_variance_of_its_sin2h():
    sin2h, radius2 = np.array([0.01, 0.0, 0.02]), np.array([0.0, 0.004, 0.01])
    mean, half = sin2h + radius2 / 2, np.sqrt(sin2h * radius2 + radius2**2 / 12)
    expected = (brdf.D_beckmann(0.01, mean - half) + brdf.D_beckmann(0.01, mean + half)) / 2
    np.testing.assert_allclose(brdf.D_beckmann_disc(0.01, sin2h, radius2), expected, rtol=1e-13)


@pytest.mark.parametrize("roughness", [0.05, 0.1, 0.3, 0.8])
@pytest.mark.parametrize(("middle", "radius"), [
    (0.0, 0.02), (0.01, 0.02), (0.03, 0.02), (0.3, 0.05), (0.2, 0.2), (0.5, 1e-4)])
def test_the_mean_over_a_disc_is_that_of_quadrature(roughness, middle, radius):
    """In rings about the normal: the arc that lies in the disc has a closed form, the ring's width is integrated."""
    low, high = max(middle - radius, 0.0), middle + radius
    within = np.unique(np.clip([0.0, low, abs(radius - middle), *np.geomspace(1e-5, 1, 40), high], 0, high))
    total = 0.0
    for a, b in itertools.pairwise(within):
        t, w = gauss(0, np.pi, 60)  # dense at both ends, where the arc has roots
        rho, w = (a + b) / 2 - (b - a) / 2 * np.cos(t), w * (b - a) / 2 * np.sin(t)
        cosine = (rho**2 + middle**2 - radius**2) / np.maximum(2 * rho * middle, 1e-30)
        arc = 2 * np.arccos(np.clip(cosine, -1, 1)) if middle else np.where(rho < radius, 2 * np.pi, 0.0)
        total += (brdf.D_ggx(roughness**4, rho**2) * arc * rho * w).sum()
    assert brdf.D_ggx_disc(roughness**4, middle**2, radius**2) == pytest.approx(total / (np.pi * radius**2), rel=1e-4)


def test_a_metals_derivatives_equal_central_differences():
    rng = np.random.default_rng(2)
    r, cos_v, base = (np.floor(rng.uniform(0.1, 0.9, 200) * 31) + 0.5) / 31, rng.uniform(0.1, 1, 200), rng.random(200)
    energy, slope = brdf.metal_energy_d(r, cos_v)
    _, by_r, by_base = brdf.metal_gain_d(base, energy, slope)
    h = 1e-5
    low, high = (brdf.metal_gain(base, brdf.metal_energy(r + d, cos_v)) for d in (-h, h))
    np.testing.assert_allclose(by_r, (high - low) / (2 * h), rtol=1e-6, atol=1e-8)
    low, high = (brdf.metal_gain(base + d, energy) for d in (-h, h))
    np.testing.assert_allclose(by_base, (high - low) / (2 * h), rtol=1e-6)


@pytest.mark.parametrize("roughness", ROUGHNESSES)
def test_a_white_metal_reflects_all_light(roughness):
    """The gain by multiple scattering returns what the lobe loses, to the nodes' own error."""
    (x, w_x), (phi, w_phi) = gauss(0, 1, 400), gauss(0, 2 * np.pi, 200)
    u = 2 * x - x**2  # denser near the normal's tangent plane, du = 2 (1 - x) dx
    for cos_v in (0.3, 0.8):
        sin_h, cos_h = np.sqrt(1 - u**2)[:, None], u[:, None]  # over half vectors: dw_l = 4 V.H dw_h
        cos_vh = sin_h * np.cos(phi) * np.sqrt(1 - cos_v**2) + cos_h * cos_v
        cos_l = 2 * cos_vh * cos_h - cos_v
        seen = (cos_l > 0) & (cos_vh > 0)
        f = brdf.metal(np.ones((1, 1, 1)), roughness, np.broadcast_to(sin_h**2, cos_l.shape), 0.0,
                       np.where(seen, cos_l, 1.0), cos_v, np.where(seen, cos_vh, 1.0))[..., 0]
        weights = (w_x * 2 * (1 - x))[:, None] * w_phi
        assert (np.where(seen, f * cos_l * 4 * cos_vh, 0.0) * weights).sum() == pytest.approx(1, abs=0.01)


def test_derivatives_equal_central_differences():
    rng = np.random.default_rng(1)
    a2, s = rng.uniform(0.01, 0.9, 500), rng.uniform(0, 1, 500)
    radius2, step = s * rng.uniform(0, 1.5, 500), 1e-6
    value, slope = brdf.D_ggx_disc_d(a2, s, radius2)
    numeric = (brdf.D_ggx_disc(a2 + step, s, radius2) - brdf.D_ggx_disc(a2 - step, s, radius2)) / (2 * step)
    np.testing.assert_allclose(slope, numeric, rtol=1e-6, atol=1e-6 * value.max())
    cos_v = rng.uniform(0.05, 1, 500)
    roughness = (rng.integers(30, tables.SIZE - 2, 500) + rng.uniform(0.1, 0.9, 500)) / (tables.SIZE - 1)
    _, slope = brdf.principled_energy_d(roughness, cos_v)
    step = 1e-5
    numeric = (brdf.principled_energy(roughness + step, cos_v) - brdf.principled_energy(roughness - step, cos_v))
    np.testing.assert_allclose(slope, numeric / (2 * step), rtol=1e-7, atol=1e-9)


def assert_slope(slope, function, x, step):
    """Central differences, which lose about step^2 and 1e-16 / step of the function's size."""
    numeric = (function(x + step) - function(x - step)) / (2 * step)
    scale = np.abs(function(x)).max() + np.abs(numeric).max()
    np.testing.assert_allclose(slope, numeric, rtol=2e-6, atol=2e-8 * scale)


def test_derivatives_of_beckmann_equal_central_differences():
    rng = np.random.default_rng(2)
    a2, s, tan2 = rng.uniform(0.05, 0.9, 500), rng.uniform(0, 1, 500), 10 ** rng.uniform(-2, 3, 500)
    radius2 = s * rng.uniform(0, 1.5, 500)
    assert_slope(brdf.D_beckmann_disc_d(a2, s, radius2)[1], lambda x: brdf.D_beckmann_disc(x, s, radius2), a2, 1e-6)
    smooth = np.abs(a2 * tan2 - 0.39) > 1e-2  # the fit jumps by 1e-4 where Cycles cuts it
    root, slope = brdf.lambda_root_beckmann_d(a2, tan2)
    assert_slope(slope[smooth], lambda x: brdf.lambda_root_beckmann(x, tan2[smooth]), a2[smooth], 1e-6)
    np.testing.assert_array_equal(root, 1 + 2 * brdf.lambda_beckmann_d(a2, tan2)[0])


def test_derivatives_of_the_level_equal_central_differences():
    rng = np.random.default_rng(3)
    cosine = rng.uniform(0.05, 1, 500)
    z = (rng.integers(2, 7, 500) + rng.uniform(0.1, 0.9, 500)) / 15  # inside Cycles' slices; levels 4e-3 to 0.59
    level = z**4 / (2 * tables.F0)
    assert_slope(brdf.F_level_ratio_d(cosine, level)[1], lambda x: brdf.F_level_ratio(cosine, x), level, 1e-6)
    roughness = (rng.integers(1, 30, 500) + rng.uniform(0.1, 0.9, 500)) / 31
    roughness[np.abs(roughness * 15 - np.round(roughness * 15)) < 1e-2] += 0.01
    value, by_r, by_level = brdf.principled_energy_level_d(roughness, cosine, level)
    assert_slope(by_r, lambda x: brdf.principled_energy_level(x, cosine, level), roughness, 1e-6)
    assert_slope(by_level, lambda x: brdf.principled_energy_level(roughness, cosine, x), level, 1e-6)
    np.testing.assert_array_equal(value, brdf.principled_energy_level(roughness, cosine, level))


def test_fresnel_of_a_level_is_that_of_its_ior():
    cosine, level = np.meshgrid(np.linspace(0.01, 1, 50), LEVELS)
    n = tables.level_ior(level)
    np.testing.assert_allclose(((n - 1) / (n + 1)) ** 2, 2 * level * 0.04, rtol=1e-12)
    refracted = np.sqrt(1 - (1 - cosine**2) / n**2)  # cosine beyond the surface, by Snell
    s = (cosine - n * refracted) / (cosine + n * refracted)
    p = (n * cosine - refracted) / (n * cosine + refracted)
    np.testing.assert_allclose(brdf.F_level(cosine, level), (s * s + p * p) / 2, rtol=1e-9)
    np.testing.assert_allclose(brdf.F_level_ratio(cosine, 0.5), 1, rtol=1e-13)


def test_level_zero_is_lambert_exactly():
    rng = np.random.default_rng(4)
    roughness, cosine = rng.uniform(0, 1, (2, 200))
    assert (brdf.F_level_ratio(cosine, 0.0) == 0).all()
    value, by_r, by_level = brdf.principled_energy_level_d(roughness, cosine, 0.0)
    assert (value == [1, 0]).all() and (by_r == 0).all() and np.isfinite(by_level).all()
    vectors = rng.normal(size=(3, 200, 3))
    vectors[..., 2] = np.abs(vectors[..., 2])
    vectors /= np.linalg.norm(vectors, axis=-1, keepdims=True)
    f = brdf.principled(np.array([0.5]), roughness, vectors[0], vectors[1], np.array([0.0, 0, 1]), level=0.0)
    assert (f == 0.5 / np.pi).all()


def test_level_half_is_the_default_model():
    rng = np.random.default_rng(6)
    roughness, cosine = rng.uniform(0.05, 1, (2, 20_000))
    np.testing.assert_allclose(brdf.principled_energy_level(roughness, cosine, 0.5),
                               brdf.principled_energy(roughness, cosine), rtol=2e-5)


@pytest.mark.parametrize("level", LEVELS)
def test_energy_of_a_level_equals_the_nodes(level):
    rng = np.random.default_rng(8)
    roughness, cosine = rng.uniform(0, 1, (2, 2000))
    expected = tables.energy(tables.energy_nodes(), roughness, cosine, level)
    np.testing.assert_allclose(brdf.principled_energy_level(roughness, cosine, level), expected, rtol=1e-6)


def test_two_lobes_of_one_roughness_are_one_lobe():
    light, view, normal = half_vector(np.array([0.3, 1.0]), np.array([0.5, 2.0]), 0.6)
    base = np.array([[0.1, 0.5, 0.9]])
    same = brdf.two_lobe(base, (0.4, 0.4, 0.3), light, view, normal, "ggx")
    np.testing.assert_allclose(same, brdf.principled(base, 0.4, light, view, normal), rtol=1e-14)
    for ndf in ("ggx", "beckmann"):
        mixed = brdf.two_lobe(base, (0.2, 0.7, 0.3), light, view, normal, ndf)
        ends = (brdf.two_lobe(base, (0.2, 0.7, w), light, view, normal, ndf) for w in (1.0, 0.0))
        first, second = ends
        np.testing.assert_allclose(mixed, 0.3 * first + 0.7 * second, rtol=1e-14)
        np.testing.assert_allclose(first, brdf.two_lobe(base, (0.2, 0.2, 0.5), light, view, normal, ndf), rtol=1e-14)
        assert not np.allclose(first, second, rtol=0.05)


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


def directional_albedo(base: float, roughness: float, theta_v: float, level: float = 0.5) -> float:
    """int f cos_l dw over the half sphere, nodes packed around the mirror direction."""
    theta, w_theta = (np.concatenate(parts) for parts in zip(
        gauss(0, theta_v, 160), gauss(theta_v, np.pi / 2, 160), strict=True))
    side, w_side = gauss(0, 1, 160)
    phi, w_phi = np.pi * (1 - side**3), 3 * np.pi * side**2 * w_side  # dense at phi = pi
    light, view, normal = half_vector(*np.meshgrid(theta, phi, indexing="ij"), theta_v)
    f = brdf.principled(np.array([base]), np.array(roughness), light, view, normal, level)[..., 0]
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


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize(("roughness", "degrees"), [(0.3, 0.5), (0.4, 45), (1.0, 60)])
def test_white_furnace_at_a_level(level, roughness, degrees):
    """A is what the lobe gives back by quadrature, to what Cycles' coarse tables allow."""
    theta = np.radians(degrees)
    black = directional_albedo(0.0, roughness, theta, level)
    dimming = brdf.principled_energy_level(roughness, np.cos(theta), level)[1]
    assert black == pytest.approx(dimming, abs=5e-4)
    assert directional_albedo(1.0, roughness, theta, level) == pytest.approx(1 - dimming + black, abs=1e-4)


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
        for k, i, j in [(0, 2, 0), (1, 4, 0), (6, 9, 4), (8, 12, 10)]:
            z2 = (k / 15) ** 2
            expected = make_tables.mean_fresnel(i / 15, j / 15, (1 + z2) / (1 - z2))
            assert nodes["fresnel"][k, i, j] == pytest.approx(expected, rel=1e-9)


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
    direct = tables.energy(tables.energy_nodes(), roughness, cosine)
    got = brdf.principled_energy(roughness, cosine)
    np.testing.assert_allclose(got[:, 0], direct[:, 0], rtol=2e-5)
    np.testing.assert_allclose(1 - got[:, 1], 1 - direct[:, 1], rtol=2e-5)
