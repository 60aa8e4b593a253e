"""Further sockets: materials that were made with one are found to need it, and the model is Cycles'."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.data import F64
from irpso_addon.core.shading import brdf
from studies.rungs.fit import LEVEL, METALLIC
from studies.rungs.measure import Shoot, measure, samples, shoot
from studies.rungs.model import Geometry, Numbers, principled
from studies.stability.measured import rig

MADE = {
    "coat": Numbers(np.array([0.5, 0.2, 0.1]), roughness=0.6, level=0.5, coat=0.7, coat_roughness=0.2),
    "diffuse roughness": Numbers(np.array([0.5, 0.2, 0.1]), roughness=0.4, level=0.4, diffuse_roughness=0.8),
}


@pytest.fixture(scope="module")
def scene() -> Shoot:
    return shoot(14)


@pytest.mark.parametrize("rung", MADE)
def test_a_rung_that_is_needed_is_found(scene: Shoot, rung: str) -> None:
    """1 % noise: its held-out errors are below a third of the smaller rung's, the other rung's are not."""
    truth = principled(scene.geometry, MADE[rung])
    found = measure(scene, truth, None, 0.01, folds=1, names=(LEVEL, METALLIC, *MADE))
    errors = {name: (f.error.lightness, f.error.relative_rms) for name, f in found.items()}
    other = next(name for name in MADE if name != rung)
    for mine, smaller, wrong in zip(errors[rung], errors[METALLIC], errors[other], strict=True):
        assert mine < smaller / 3
        assert wrong > smaller / 3
    numbers, made = found[rung].numbers[0], MADE[rung]
    np.testing.assert_allclose(numbers.base, made.base, rtol=0.03)
    for name in ("roughness", "coat", "coat_roughness", "diffuse_roughness"):
        if getattr(made, name) != getattr(Numbers(), name):
            assert getattr(numbers, name) == pytest.approx(getattr(made, name), abs=0.05), name


def test_no_rung_is_needed_where_there_is_none(scene: Shoot) -> None:
    """Without noise the smallest model explains its own kind, so that no larger one can be better."""
    truth = principled(scene.geometry, Numbers(np.array([0.5, 0.2, 0.1]), roughness=0.4, level=0.3))
    found = measure(scene, truth, None, 0.0, folds=1, names=(LEVEL, METALLIC))
    assert found[LEVEL].error.lightness < 0.02
    assert found[LEVEL].error.relative_rms < 0.002


@pytest.mark.parametrize("texels", [6, 14])
def test_the_rest_counts_whole(texels: int) -> None:
    """However few observations there are: a fit sees some of those far from highlights, and they stand for all."""
    scene = shoot(texels)
    scene = replace(scene, weight=np.ones_like(scene.weight))
    known = np.arange(len(scene.weight)) < 300 if texels == 6 else np.ones(len(scene.weight), bool)
    seen = samples(scene, np.zeros((len(scene.weight), 3)), known)
    assert seen.weight.sum() == pytest.approx(known.sum())


def test_without_the_further_numbers_it_is_the_products_model(scene: Shoot) -> None:
    """core/shading/brdf.py, whose own tests compare it with Cycles; its table for level 0.5 is resampled."""
    for numbers in (Numbers(roughness=0.3), Numbers(roughness=0.7, level=0.2, metallic=0.4)):
        normal = np.broadcast_to(rig.NORMAL, scene.L.shape)
        f = brdf.principled(numbers.base, numbers.roughness, scene.L, scene.V, normal, numbers.level, numbers.metallic)
        np.testing.assert_allclose(principled(scene.geometry, numbers), f, rtol=2e-5)


@pytest.mark.parametrize("roughness", [0.3, 1.0])
def test_rough_white_diffuse_keeps_all_light(roughness: float) -> None:
    """The furnace, by quadrature over the hemisphere: 1 at any angle, within 0.5 % (the fit of the mean albedo)."""
    z, turn = np.meshgrid((np.arange(400) + 0.5) / 400, (np.arange(200) + 0.5) / 200 * 2 * np.pi, indexing="ij")
    L = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], -1).reshape(-1, 3)
    for degrees in (5, 40, 75):
        V = np.broadcast_to([np.sin(np.radians(degrees)), 0, np.cos(np.radians(degrees))], L.shape)
        g = Geometry.of(L, V, np.broadcast_to(rig.NORMAL, L.shape))
        f = brdf.diffuse_rough(np.ones(3), g.at.cos_l, g.at.cos_v, g.cos_lv, roughness)
        assert float((f[:, 0] * L[:, 2]).mean() * 2 * np.pi) == pytest.approx(1.0, abs=0.005)


def test_the_second_lobe_is_a_mixture(scene: Shoot) -> None:
    one, other = (Numbers(roughness=r, level=0.3) for r in (0.2, 0.6))
    both = replace(one, second=0.3, second_roughness=0.6)
    mixed = 0.7 * principled(scene.geometry, one) + 0.3 * principled(scene.geometry, other)
    np.testing.assert_allclose(principled(scene.geometry, both), mixed, rtol=1e-12)


@pytest.fixture(scope="module")
def cycles() -> Iterator[dict[str, F64]]:
    pytest.importorskip("bpy")
    from studies.rungs.cycles import errors, sheen_table

    yield dict(errors(sheen_table(), 48))


def test_the_model_equals_the_pixels(cycles: dict[str, F64]) -> None:
    """0.02 % at any pixel to 75 degrees, 0.002 % on average: every rung, and all at once."""
    assert len(cycles) == 7
    for name, error in cycles.items():
        assert error.size > 1500, name
        assert error.max() < 2e-4, name
        assert error.mean() < 2e-5, name
