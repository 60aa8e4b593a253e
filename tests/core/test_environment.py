"""Light from all around: values between nodes of roughness, and directions without parts."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.data import Environment
from irpso_addon.core.shading import brdf, environment
from irpso_addon.gpu.observe.picture_memory import mean_radiance
from tests.support import skies

NODES, LOGS = environment.NODES, np.log(environment.NODE_ROUGHNESS)


def between(values: np.ndarray, roughness: float) -> float:
    """Catmull and Rom's cubic through values at the nodes; beyond the ends lies a straight line."""
    line = np.concatenate([[2 * values[0] - values[1]], values, [2 * values[-1] - values[-2]]])
    place = np.log(np.clip(roughness, brdf.ROUGHNESS_MIN, 1.0) / brdf.ROUGHNESS_MIN) / (LOGS[1] - LOGS[0])
    k = min(int(place), NODES - 2)
    t, (p, q, r, s) = place - k, line[k:k + 4]
    return float(0.5 * np.array([1, t, t**2, t**3]) @ [2 * q, r - p, 2 * p - 5 * q + 4 * r - s, 3 * q - p - 3 * r + s])


@pytest.mark.parametrize("roughness", [0.02, 0.05, 0.06, 0.1, 0.3, 0.55, 0.9, 0.99, 1.0])
def test_values_between_nodes_are_those_of_the_cubic(roughness):
    nodes = np.exp(np.random.default_rng(0).standard_normal((5, 2, NODES)))
    expected = [[np.exp(between(np.log(place), roughness)) for place in texel] for texel in nodes]
    each = np.full((5, 1), roughness)
    assert np.allclose(environment.at_roughness(nodes, roughness), expected, rtol=1e-9)
    assert np.allclose(environment.at_roughness(nodes, each), expected, rtol=1e-9)
    assert np.allclose(environment.at_roughness_of_logs(np.log(nodes), each), expected, rtol=1e-9)


def test_nodes_are_met():
    nodes = np.random.default_rng(1).uniform(0.1, 2, (NODES, NODES))
    at = np.array(environment.NODE_ROUGHNESS)
    assert np.allclose(environment.at_roughness(nodes, at), np.diag(nodes))
    assert np.allclose(environment.cosine_at(np.clip(nodes, 0, 1), at), np.diag(np.clip(nodes, 0, 1)))


def test_directions_without_parts_light_as_those_with_them():
    sky = skies.sky(256, sun=60.0, width=0.03, window=8.0)
    normal = np.random.default_rng(2).standard_normal((50, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    whole, plain = (environment.environment_irradiance(environment.directions(sky, 256, divides), normal)
                    for divides in (True, False))
    assert environment.directions(sky, 256, divides=False).parts is None
    assert np.abs(plain / whole - 1).max() < 0.01


def test_the_mean_radiance_is_that_of_all_directions():
    picture = np.random.default_rng(3).uniform(0, 5, (40, 80, 3)).astype(np.float32)
    solid = environment.texel_directions(40, 80)[1]
    assert np.isclose(80 * solid.sum(), 4 * np.pi)
    expected = (picture * solid[..., None]).sum((0, 1), dtype=np.float64) / (4 * np.pi)
    assert np.allclose(mean_radiance(Environment("world", picture, np.eye(3))), expected, rtol=1e-6)
