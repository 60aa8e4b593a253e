"""Under few highlights, texels know their roughness from neighbours that squares of a sample lack: the map is asked."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading import brdf
from irpso_addon.core.shading.tables import principled_table
from irpso_addon.core.tiled.tiled_plan import PriorKnowledge
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.observe.observation_atlas import ArraySource, ObservedTexels
from irpso_addon.gpu.solve.map_around import MapAround
from irpso_addon.gpu.solve.material_sample import ArraySample, Squares, Thinned, packed, spread_squares
from irpso_addon.gpu.solve.model_prediction import Decision, ModelPrediction
from irpso_addon.gpu.solve.prediction_trials import Fitted
from irpso_addon.gpu.solve.solver import Solver
from tests.support.texels import finish

SIDE = 128  # texels
LAMPS = 20
BESIDE = 0.026  # of the flash's distance, beside the lens


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def ball() -> np.ndarray:
    """(h, w, 3) normals, all around and 53 degrees up and down."""
    at = (np.arange(SIDE) + 0.5) / SIDE
    turn, z = np.meshgrid(2 * np.pi * at, 1.6 * at - 0.8)
    side = np.sqrt(1 - z**2)
    return np.stack([side * np.cos(turn), side * np.sin(turn), z], -1)


def carried_flash(roughness: np.ndarray, noise: float) -> ObservedTexels:
    """Each of LAMPS distant cameras carries a flash.  ``noise``: relative."""
    n = ball()
    k = np.arange(LAMPS)
    turn, up = 2.39996 * k, 1 - 2 * (k + 0.5) / LAMPS
    side = np.sqrt(1 - up**2)
    toward = np.stack([side * np.cos(turn), side * np.sin(turn), up], -1)
    lamp = unit(toward + BESIDE * unit(np.cross(toward, [0.0, 1.0, 0.3])))
    base = np.broadcast_to([0.5, 0.3, 0.2], (SIDE, SIDE, 3))
    rng = np.random.default_rng(1)
    rgb, cos_v, cos_l, lobes = [], [], [], []
    for v, light in zip(toward, lamp, strict=True):
        value = brdf.principled(base, roughness, np.broadcast_to(light, n.shape), np.broadcast_to(v, n.shape), n)
        rgb.append(value * (1 + noise * rng.standard_normal(value.shape)))
        cos_v.append(n @ v)
        cos_l.append(n @ light)
        half = unit(v + light)
        factor = brdf.F_dielectric(float(half @ v)) / (2 * np.maximum(cos_l[-1] * cos_v[-1], 1e-6))
        lobes.append(np.stack([1 - (n @ half) ** 2, np.zeros_like(factor), cos_l[-1], factor], -1))
    facing, lit = (np.stack(of, -1).astype(np.float32) for of in (cos_v, cos_l))
    return ObservedTexels(np.stack(rgb, 2).astype(np.float32), np.where(np.minimum(facing, lit) > 0.3, facing, 0.0),
                          facing, np.stack(lobes, 2)[..., None, :].astype(np.float32), tuple(range(LAMPS)),
                          lit.clip(0), tuple(range(LAMPS)))


def waves(mean: float) -> np.ndarray:
    """(h, w) roughness that changes slowly."""
    u, v = np.meshgrid(*[(np.arange(SIDE) + 0.5) / SIDE] * 2)
    return mean + 0.15 * np.sin(2 * np.pi * u) * np.cos(5 * v)


@dataclass(frozen=True)
class Found:
    """Roughness of the packed squares, where a quarter of the lamps is left out."""

    alone: np.ndarray
    around: np.ndarray  # each square knows what the rest of the map says of it
    changed: np.ndarray  # the same after what is said of all squares but the first has changed
    squares: Squares


@pytest.fixture(scope="module")
def found(on_gl: Any) -> Found:
    observed = carried_flash(waves(0.3), 0.04)

    def solved(device: Device) -> Found:
        with device.scope():
            source, every = ArraySource(device, observed, principled_table()), np.ones((SIDE, SIDE), bool)
            squares = spread_squares(every, 60, 1)
            settings = SolveSettings(size=SIDE, loss="squares")
            sample = packed(device, source, every, squares)
            sample.left_out = np.arange(LAMPS) % 4 == 0
            solver = Solver(device, sample, settings)
            around = finish(MapAround(device, source, every, squares, settings).without(sample.left_out, 0.5))
            others = around.roughness.copy()
            others[0, 1:, 0] = others[1:, :, 0] = 0.9
            results = []
            for before in (PriorKnowledge(), around, replace(around, roughness=others)):
                solver.before = before
                results += finish(solver.under_priors([None]))
            return Found(*results, squares)

    return on_gl(solved)


def test_squares_learn_roughness_from_the_map(found: Found) -> None:
    right = found.squares.pack(waves(0.3))
    alone, around = (np.abs(of - right)[right > 0] for of in (found.alone, found.around))
    assert around.mean() < 0.7 * alone.mean()  # 0.029 and 0.052


def test_squares_say_nothing_of_each_other(found: Found) -> None:
    np.testing.assert_array_equal(found.changed[:8, :8], found.around[:8, :8])
    assert np.abs(found.changed - found.around)[:8, 8:].max() > 0.01


@pytest.mark.one_python
def test_texels_that_know_roughness_from_neighbours_are_not_drawn_to_one(on_gl: Any) -> None:
    """By squares alone a roughness per texel predicts worse (0.068 of the radiance) than one that is drawn (0.059)."""
    def decided(device: Device) -> Decision:
        with device.scope():
            source = ArraySource(device, carried_flash(waves(0.35), 0.01), principled_table())
            every = np.ones((SIDE, SIDE), bool)
            return finish(ModelPrediction(device, source, SolveSettings(size=SIDE)).decide(every, Fitted("one-lobe")))

    decision = on_gl(decided)
    assert decision.model == "one-lobe" and decision.prior is None
    assert decision.prediction.taken == "a value a texel"
    assert decision.prediction.error.relative_rms < 0.05  # 0.039


@pytest.mark.parametrize("stride", [1, 2])
def test_a_sample_leaves_what_it_was_made_from(on_gl: Any, stride: int) -> None:
    """Of half of the texels: the others' observations are hidden in the sample alone."""
    observed = carried_flash(waves(0.35), 0.01)
    before = observed.quality.copy()
    texels = np.zeros(before.shape[:2], bool)
    texels[:, ::4] = True

    def job(device: Device) -> None:
        with device.scope():
            source = ArraySource(device, observed, principled_table())
            sample = packed(device, source, texels, Thinned(stride))
            assert isinstance(sample, ArraySample)
            assert not sample.texels.quality[~texels[stride // 2::stride, stride // 2::stride]].any()

    on_gl(job)
    assert np.array_equal(observed.quality, before)
