"""Each function of brdf.glsl against its float64 twin, on random arguments.

Tolerance 2e-5 relative: some ten float32 roundings of 6e-8, and room for the two ulp that GLSL grants
division and square root.  Where cancellation needs more, the reason stands beside it.
"""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core import brdf

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
        "roughness": roughness, "alpha2": roughness**4, "sin2h": sin2h, "spread": sin2h * rng.uniform(0, 1.5, COUNT),
        "cos_l": rng.uniform(0.03, 1, COUNT), "cos_v": rng.uniform(0.03, 1, COUNT),
        "cos_vh": rng.uniform(0.01, 1, COUNT), "tan2": 10 ** rng.uniform(-3, 3, COUNT),
    }
    return {name: values.astype(np.float32) for name, values in columns.items()}


def columns(arguments: dict[str, np.ndarray], *names: str) -> tuple[np.ndarray, list[np.ndarray]]:
    chosen = [arguments[name] for name in names]
    return np.stack(chosen, axis=1), [values.astype(np.float64) for values in chosen]


@pytest.mark.parametrize(("name", "names"), [
    ("D_ggx", ("alpha2", "sin2h")),
    ("D_ggx_spread", ("alpha2", "sin2h", "spread")),
    ("lambda_root", ("alpha2", "tan2")),
    ("F_dielectric", ("cos_vh",)),
    ("diffuse_principled", ("roughness", "cos_v")),
    ("specular_principled", ("roughness", "sin2h", "spread", "cos_l", "cos_v", "cos_vh")),
])
def test_function_equals_its_twin(evaluate, arguments, name, names):
    packed, exact = columns(arguments, *names)
    places = ["a.x", "a.y", "a.z", "a.w", "b.x", "b.y"][: len(names)]
    got = evaluate(BRDF, f"o = vec4({name}({', '.join(places)}));", packed)[:, 0]
    np.testing.assert_allclose(got, getattr(brdf, name)(*exact), rtol=RTOL)


def test_spread_derivative_equals_its_twin(evaluate, arguments):
    packed, exact = columns(arguments, "alpha2", "sin2h", "spread")
    got = evaluate(BRDF, "D_ggx_spread_d(a.x, a.y, a.z, o.x, o.y);", packed)
    value, derivative = brdf.D_ggx_spread_d(*exact)
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
    last = len(brdf.principled_table()) - 1
    inside = np.abs((exact[0] * last + 0.5) % 1 - 0.5) > 1e-3
    # A difference of two float32 values near 1 that lie 1/465 apart: 465 * 2 * 6e-8.
    np.testing.assert_allclose(got[inside, 2:], slope[inside], rtol=RTOL, atol=1e-4)


def test_energy_is_clamped_outside_the_table(evaluate):
    outside = np.array([[-0.5, 0.5], [1.5, 0.5], [0.5, -0.2], [0.5, 1.2]], np.float32)
    clamped = np.clip(outside, 0, 1)
    got = evaluate(BRDF, "o.xy = principled_energy(a.x, a.y);", outside)[:, :2]
    np.testing.assert_allclose(got, brdf.principled_energy(clamped[:, 0], clamped[:, 1]), rtol=RTOL)
