"""Each function of brdf.glsl against its float64 twin, on random arguments.

Tolerance 2e-5 relative: some ten float32 roundings of 6e-8, and room for the two ulp that GLSL grants
division and square root.  Where cancellation needs more, the reason stands beside it.
"""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.data import Coat
from irpso_addon.core.evaluation.lobe_values import diffuse_parts
from irpso_addon.core.shading import brdf
from irpso_addon.core.shading.tables import F0, SIZE

BRDF = "include/brdf.glsl"
RTOL = 2e-5
COUNT = 20_000


@pytest.fixture(scope="module")
def arguments() -> dict[str, np.ndarray]:
    """float32 arguments that both sides get: roughness 0.05-1, half of the sin2h near the peak, cosines 0.03-1."""
    rng = np.random.default_rng(7)
    roughness = rng.uniform(0.05, 1, COUNT)
    near_peak = roughness**4 * 10 ** rng.uniform(-3, 1.5, COUNT)
    sin2h = np.where(rng.random(COUNT) < 0.5, np.minimum(near_peak, 1), rng.random(COUNT))
    columns = {
        "roughness": roughness, "alpha2": roughness**4, "sin2h": sin2h, "radius2": sin2h * rng.uniform(0, 1.5, COUNT),
        "cos_l": rng.uniform(0.03, 1, COUNT), "cos_v": rng.uniform(0.03, 1, COUNT),
        "cos_vh": rng.uniform(0.01, 1, COUNT), "tan2": 10 ** rng.uniform(-3, 3, COUNT),
        "level": rng.uniform(0.005, 1, COUNT), "base": rng.uniform(0, 1, COUNT),
    }
    return {name: values.astype(np.float32) for name, values in columns.items()}


def columns(arguments: dict[str, np.ndarray], *names: str) -> tuple[np.ndarray, list[np.ndarray]]:
    chosen = [arguments[name] for name in names]
    return np.stack(chosen, axis=1), [values.astype(np.float64) for values in chosen]


@pytest.mark.parametrize(("name", "names"), [
    ("D_ggx", ("alpha2", "sin2h")),
    ("D_ggx_disc", ("alpha2", "sin2h", "radius2")),
    ("lambda_root", ("alpha2", "tan2")),
    ("lambda_root_beckmann", ("alpha2", "tan2")),
    ("F_dielectric", ("cos_vh",)),
    ("F_level_ratio", ("cos_vh", "level")),
    ("F_schlick", ("cos_vh",)),
    ("diffuse_principled", ("roughness", "cos_v")),
    ("specular_principled", ("roughness", "sin2h", "radius2", "cos_l", "cos_v", "cos_vh")),
])
def test_function_equals_its_twin(evaluate, arguments, name, names):
    packed, exact = columns(arguments, *names)
    places = ["a.x", "a.y", "a.z", "a.w", "b.x", "b.y"][: len(names)]
    got = evaluate(BRDF, f"o = vec4({name}({', '.join(places)}));", packed)[:, 0]
    np.testing.assert_allclose(got, getattr(brdf, name)(*exact), rtol=RTOL)


def test_what_a_coat_leaves_equals_its_twin(evaluate, arguments):
    packed, (weight, roughness, cos_v) = columns(arguments, "level", "roughness", "cos_v")
    got = evaluate(BRDF, "o = vec4(left_by_coat(a.xy, a.z));", packed)[:, 0]
    want = [brdf.left_by_coat(Coat(*of), cos) for *of, cos in zip(weight, roughness, cos_v, strict=True)]
    np.testing.assert_allclose(got, want, rtol=RTOL)


def test_disc_derivative_equals_its_twin(evaluate, arguments):
    packed, exact = columns(arguments, "alpha2", "sin2h", "radius2")
    got = evaluate(BRDF, "D_ggx_disc_d(a.x, a.y, a.z, o.x, o.y);", packed)
    value, derivative = brdf.D_ggx_disc_d(*exact)
    np.testing.assert_allclose(got[:, 0], value, rtol=RTOL)
    # The derivative changes sign within the range: relative to value / alpha2, the scale of its two terms.
    np.testing.assert_array_less(np.abs(got[:, 1] - derivative) / (value / exact[0]), RTOL)


def test_energy_and_its_derivative_equal_their_twin(evaluate, arguments):
    packed, exact = columns(arguments, "roughness", "cos_v")
    value, slope = brdf.principled_energy_d(*exact)
    np.testing.assert_allclose(evaluate(BRDF, "o.xy = principled_energy(a.x, a.y);", packed)[:, :2], value, rtol=RTOL)
    got = evaluate(BRDF, "vec2 v, d; principled_energy_d(a.x, a.y, v, d); o = vec4(v, d);", packed)
    np.testing.assert_allclose(got[:, :2], value, rtol=RTOL)
    # The slope jumps at the nodes, where float32 may choose the other cell: compare where both are inside one.
    last = SIZE - 1
    inside = np.abs((exact[0] * last + 0.5) % 1 - 0.5) > 1e-3
    # A difference of two float32 values near 1 that lie 1/465 apart: 465 * 2 * 6e-8.
    np.testing.assert_allclose(got[inside, 2:], slope[inside], rtol=RTOL, atol=1e-4)


@pytest.mark.parametrize("name", ["D_beckmann_disc", "specular_beckmann"])
def test_beckmann_equals_its_twin(evaluate, arguments, name):
    """exp(-x) magnifies the rounding of x by x, so the tolerance grows with it; beyond x = 40 it is 1e-17 or less."""
    geometry = ("roughness", "sin2h", "radius2", "cos_l", "cos_v", "cos_vh")
    names = geometry if name == "specular_beckmann" else ("alpha2", "sin2h", "radius2")
    packed, exact = columns(arguments, *names)
    places = ["a.x", "a.y", "a.z", "a.w", "b.x", "b.y"][: len(names)]
    got = evaluate(BRDF, f"o = vec4({name}({', '.join(places)}));", packed)[:, 0]
    expected = getattr(brdf, name)(*exact)
    alpha2, sin2h, radius2 = (arguments[k].astype(np.float64) for k in ("alpha2", "sin2h", "radius2"))
    low = sin2h + radius2 / 2 - np.sqrt(sin2h * radius2 + radius2**2 / 12)
    x = low / np.maximum(1 - low, 1e-9) / alpha2
    near = x < 40
    assert near.mean() > 0.4
    np.testing.assert_array_less(np.abs(got - expected)[near], (RTOL * (1 + 0.25 * x) * expected)[near])
    if name != "specular_beckmann":  # which divides by the cosines
        peak = brdf.D_beckmann(alpha2, 0.0) / np.maximum(1 - low, 1e-9) ** 2
        np.testing.assert_array_less(got[~near], 1e-16 * peak[~near])


def test_beckmann_derivatives_equal_their_twins(evaluate, arguments):
    packed, exact = columns(arguments, "alpha2", "sin2h", "radius2")
    got = evaluate(BRDF, "D_beckmann_disc_d(a.x, a.y, a.z, o.x, o.y);", packed)
    value, derivative = brdf.D_beckmann_disc_d(*exact)
    # Its two terms (x - 1) D / alpha2 have opposite signs: relative to the peak's slope.
    scale = brdf.D_beckmann(exact[0], 0.0)
    np.testing.assert_array_less(np.abs(got[:, 0] - value) / scale, RTOL)
    np.testing.assert_array_less(np.abs(got[:, 1] - derivative) * exact[0] / scale, RTOL)
    packed, exact = columns(arguments, "alpha2", "tan2")
    smooth = np.abs(exact[0] * exact[1] / 0.39 - 1) > 1e-5
    got = evaluate(BRDF, "lambda_root_beckmann_d(a.x, a.y, o.x, o.y); lambda_beckmann_d(a.x, a.y, o.z, o.w);", packed)
    root, slope = brdf.lambda_root_beckmann_d(*exact)
    # Near the cut the fit's numerator cancels (its value is 1e-4 of its terms).
    np.testing.assert_allclose(got[smooth, 0], root[smooth], rtol=RTOL)
    np.testing.assert_allclose(got[smooth, 1], slope[smooth], rtol=RTOL, atol=1e-6)
    np.testing.assert_allclose(got[smooth, 2], (root[smooth] - 1) / 2, rtol=RTOL, atol=1e-6)
    np.testing.assert_allclose(2 * got[:, 3], got[:, 1], rtol=1e-6)


def test_beckmann_is_finite_in_float32(evaluate):
    alpha2, sin2h, radius2 = (x.ravel() for x in np.meshgrid(
        [0, 1e-12, 6.25e-6, 0.1, 1], [0, 1e-12, 0.5, 1 - 6e-8, 1], [0, 1e-3, 3.0]))
    packed = np.stack([alpha2, sin2h, radius2], 1).astype(np.float32)
    got = evaluate(BRDF, "D_beckmann_disc_d(a.x, a.y, a.z, o.x, o.y); "
                         "lambda_beckmann_d(a.x, a.y < 0.1 ? 0.0 : a.y * 1e12, o.z, o.w);", packed)
    assert np.isfinite(got).all()


def test_level_ratio_derivative_equals_its_twin(evaluate, arguments):
    packed, exact = columns(arguments, "cos_vh", "level")
    got = evaluate(BRDF, "F_level_ratio_d(a.x, a.y, o.x, o.y);", packed)
    value, slope = brdf.F_level_ratio_d(*exact)
    np.testing.assert_allclose(got[:, 0], value, rtol=RTOL)
    np.testing.assert_allclose(got[:, 1], slope, rtol=RTOL, atol=1e-5)


def test_energy_of_a_level_and_its_derivatives_equal_their_twin(evaluate, arguments):
    packed, exact = columns(arguments, "roughness", "cos_v", "level")
    twin = brdf.principled_energy_level_d(*exact)
    call = "vec2 v, r, l; principled_energy_level_d(a.x, a.y, a.z, v, r, l); "
    got = evaluate(BRDF, call + "o = vec4(v, l);", packed)
    by_r = evaluate(BRDF, call + "o = vec4(r, principled_energy_level(a.x, a.y, a.z));", packed)
    np.testing.assert_allclose(got[:, :2], twin[0], rtol=RTOL)
    np.testing.assert_array_equal(by_r[:, 2:], got[:, :2])
    # Slopes jump at the nodes, where float32 may choose the other cell or slice: compare inside.
    grids = exact[0] * 31, exact[0] * 15, exact[1] * 31, exact[1] * 15, 15 * (2 * F0 * exact[2]) ** 0.25
    inside = np.all([np.abs((x + 0.5) % 1 - 0.5) > 1e-4 for x in grids], axis=0)
    assert inside.mean() > 0.99
    np.testing.assert_allclose(by_r[inside, :2], twin[1][inside], rtol=RTOL, atol=1e-5)
    np.testing.assert_allclose(got[inside, 2:], twin[2][inside], rtol=RTOL, atol=1e-5)


def test_a_metals_gain_and_its_derivatives_equal_their_twin(evaluate, arguments):
    packed, (r, cos_v, base) = columns(arguments, "roughness", "cos_v", "base")
    energy, slope = brdf.metal_energy_d(r, cos_v)
    value, by_r, by_base = brdf.metal_gain_d(base, energy, slope)
    call = "vec2 v, d; metal_energy_d(a.x, a.y, v, d); "
    got = evaluate(BRDF, call + "metal_gain_d(a.z, v, d, o.x, o.y, o.z); o.w = metal_gain(a.z, v);", packed)
    np.testing.assert_allclose(got[:, 0], value, rtol=RTOL)
    np.testing.assert_array_equal(got[:, 3], got[:, 0])
    np.testing.assert_allclose(got[:, 2], by_base, rtol=RTOL, atol=1e-6)  # at no loss it is 0
    inside = np.all([np.abs((31 * x + 0.5) % 1 - 0.5) > 1e-4 for x in (r, cos_v)], axis=0)  # slopes jump at the nodes
    np.testing.assert_allclose(got[inside, 1], by_r[inside], rtol=RTOL, atol=2e-5)
    got = evaluate(BRDF, call + "o = vec4(v, metal_energy(a.x, a.y));", packed)
    np.testing.assert_allclose(got[:, :2], energy, rtol=RTOL)
    np.testing.assert_array_equal(got[:, 2:], got[:, :2])


def test_level_zero_is_lambert_in_the_shader_too(evaluate, arguments):
    packed, _ = columns(arguments, "roughness", "cos_v", "cos_vh")
    call = "vec2 v, r, l; principled_energy_level_d(a.x, a.y, 0.0, v, r, l); o = vec4(v, r); "
    got = evaluate(BRDF, call, packed)
    assert (got == [1, 0, 0, 0]).all()
    got = evaluate(BRDF, call + "o.zw = l; F_level_ratio_d(a.z, 0.0, o.x, o.y);", packed)
    assert (got[:, 0] == 0).all() and np.isfinite(got).all()
    grazing = evaluate(BRDF, "F_level_ratio_d(a.x, a.y, o.x, o.y);", np.zeros((1, 2), np.float32))
    assert grazing[0, 0] == 0 and np.isfinite(grazing).all()


def test_energy_is_clamped_outside_the_table(evaluate):
    outside = np.array([[-0.5, 0.5], [1.5, 0.5], [0.5, -0.2], [0.5, 1.2]], np.float32)
    clamped = np.clip(outside, 0, 1)
    got = evaluate(BRDF, "o.xy = principled_energy(a.x, a.y);", outside)[:, :2]
    np.testing.assert_allclose(got, brdf.principled_energy(clamped[:, 0], clamped[:, 1]), rtol=RTOL)


def test_one_lobe_beside_beckmann_materials_is_principled(evaluate):
    """A material of one lobe keeps its Principled BSDF where another of the object has Beckmann's two."""
    rng = np.random.default_rng(3)
    a = np.stack([rng.uniform(0.2, 0.9, 500), rng.uniform(0.2, 1, 500), rng.uniform(0.001, 0.4, 500),
                  rng.uniform(0.3, 1, 500)], -1).astype(np.float32)  # roughness, cos_v, sin2h, cos_l
    body = ("Found f = Found(a.xx, {}, 0.5); "
            "o = vec4(diffuse_of(f, a.y), specular_of(f, a.y, vec4(a.z, 0.0, a.w, 1.0)), 0.0, 0.0);")
    one = evaluate("include/lobes.glsl", body.format("1.0"), a, defines={"NDF_BECKMANN": "1"})
    r, cos_v, sin2h, cos_l = a.T.astype(np.float64)
    energy = brdf.principled_energy(r, cos_v)
    roots = brdf.lambda_root(r**4, 1 / cos_l**2 - 1) + brdf.lambda_root(r**4, 1 / cos_v**2 - 1)
    np.testing.assert_allclose(one[:, 0], (1 - energy[:, 1]) / np.pi, rtol=2e-5)
    np.testing.assert_allclose(one[:, 1], energy[:, 0] * brdf.D_ggx(r**4, sin2h) / roots, rtol=2e-5)
    two = evaluate("include/lobes.glsl", body.format("0.5"), a, defines={"NDF_BECKMANN": "1"})
    np.testing.assert_allclose(two[:, 0], 1 / np.pi, rtol=1e-6)


@pytest.mark.parametrize("roughness", [1e-3, 0.3, 1.0])
def test_a_rough_diffuse_equals_its_twin(evaluate, arguments, roughness):
    packed, (cos_l, cos_v, cos_lv, base) = columns(arguments, "cos_l", "cos_v", "cos_vh", "base")
    single, lost = brdf.rough_parts(cos_l, cos_v, cos_lv, roughness)
    got = evaluate(BRDF, f"o.xy = rough_parts(a.x, a.y, a.z, {roughness}); "
                         f"o.z = rough_bounce(vec3(a.w), {roughness}).y;", packed)
    np.testing.assert_allclose(got[:, 0], single, rtol=RTOL)
    # Each factor of what is lost is a difference of numbers near 1.
    np.testing.assert_allclose(got[:, 1], lost, rtol=RTOL, atol=1e-6 * roughness)
    np.testing.assert_allclose(got[:, 2], brdf.rough_bounce(base, roughness), rtol=2e-3 if roughness < 0.1 else RTOL)
    whole = (base / np.pi * (got[:, 0] + got[:, 1] * got[:, 2]))
    want = brdf.diffuse_rough(base[:, None], cos_l, cos_v, cos_lv, roughness)[:, 0]
    np.testing.assert_allclose(whole, want, rtol=RTOL)


def test_a_lamps_part_of_a_rough_diffuse_equals_its_twin(evaluate, arguments):
    """From a lobe's record, of a lamp that has a third of the irradiance."""
    _, (sin2h, cos_l, cos_v) = columns(arguments, "sin2h", "cos_l", "cos_v")
    sin2h = np.minimum(sin2h, 0.9)
    cos_vh = np.minimum((cos_l + cos_v) / (2 * np.sqrt(1 - sin2h)), 1)
    possible = (cos_l + cos_v) ** 2 / (1 - sin2h) < 4
    factor = brdf.F_dielectric(cos_vh) / (2 * cos_l * cos_v) / 3
    packed = np.stack([sin2h, cos_l, factor, cos_v], 1)[possible].astype(np.float32)
    got = evaluate(BRDF, "o.xy = rough_share(vec4(a.x, 0.0, a.y, a.z), a.w, 0.7);", packed)
    single, lost = diffuse_parts(np.stack([sin2h, 0 * sin2h, cos_l, factor], -1)[:, None, None], cos_v[:, None], 0.7)
    np.testing.assert_allclose(1 + got[:, 0], single[possible, 0, 0], rtol=RTOL)
    np.testing.assert_allclose(got[:, 1], lost[possible, 0, 0], rtol=RTOL, atol=1e-6)
    both = brdf.rough_parts(cos_l, cos_v, 2 * cos_vh**2 - 1, 0.7)
    np.testing.assert_allclose(3 * got[:, 0] + 1, both[0][possible], rtol=10 * RTOL)
