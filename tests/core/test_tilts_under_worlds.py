"""Tilts of normals under light from all around: the model against a sum over directions, and what is found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.calibration.rig import Rig
from irpso_addon.core.calibration.rig_sample import RigSample
from irpso_addon.core.data import Camera, Environment, View
from irpso_addon.core.evaluation.sampled_texels import Lobes, SampledTexels, one_lobe
from irpso_addon.core.normals.tilt_fit import Beside, TiltModel, fit_tilts
from irpso_addon.core.normals.tilt_sample import TiltedWorlds, TiltSample
from irpso_addon.core.shading import brdf, environment
from irpso_addon.core.shading.environment import Directions, about_z, at_roughness, node_values
from irpso_addon.core.shading.lights import light_basis
from tests.support import skies
from tests.support import tilted_sphere as balls

STEP = 0.1  # radians: for slopes
SKY = skies.sky(64, sun=40.0, width=0.15, window=8.0)
TURNS = tuple(replace(SKY, rotation=SKY.rotation @ about_z(turn), turn=turn) for turn in np.arange(6) * np.pi / 3)
LIGHTS = [environment.directions(turned, 64, divides=False) for turned in TURNS]
TOWARD = balls.TOWARD
ROUGHNESS = 0.5


def light_on(light: Directions, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """((T,) mean irradiance, (T, NODES) radiance that the lobe returns)."""
    irradiance, sent, _ = zip(*(node_values(light, N, TOWARD) for N in normals), strict=True)
    return np.mean(irradiance, 1), np.mean(sent, 2)


def radiance(light: Directions, normals: np.ndarray) -> np.ndarray:
    """(T, 3) of a surface of BASE; the energy that the lobe takes is that at the normals."""
    irradiance, sent = light_on(light, normals)
    energy = brdf.principled_energy(ROUGHNESS, normals @ TOWARD)
    lobe = at_roughness(sent, ROUGHNESS) * energy[:, 0]
    return np.asarray((balls.BASE * (1 - energy[:, 1:]) / np.pi * irradiance[:, None]) + lobe[:, None])


def sample_of(normals: np.ndarray, true: np.ndarray) -> TiltSample:
    """Views of one camera under each turn of the sky, of surfaces whose normals are believed to be others."""
    count, shape = len(normals), (len(normals), len(LIGHTS))
    first, second = light_basis(normals)
    placed = [normals, balls.unit(normals + STEP * first), balls.unit(normals + STEP * second)]
    irradiance, sent = (np.stack(values, 2) for values in zip(*(
        [np.stack(value) for value in zip(*(light_on(light, each) for each in placed), strict=True)]
        for light in LIGHTS), strict=True))  # (3, T, V) and (3, T, V, NODES)
    slope = np.log(irradiance[1:] / irradiance[0]) / STEP, np.log(sent[1:] / sent[0]) / STEP
    nodes = np.stack([np.log(sent[0] / irradiance[0][..., None]), np.full_like(sent[0], 0.9)], 2)
    reflected = np.stack([radiance(light, true) for light in LIGHTS], 1) / irradiance[0][..., None]
    camera = Camera("Camera", np.eye(4), np.eye(4), 5 * TOWARD, -TOWARD, True, 1.0)
    views = [View(Path(f"{n}.exr"), camera, (), environment=turned) for n, turned in enumerate(TURNS)]
    number, cos_v = np.arange(len(LIGHTS), dtype=np.int32), np.repeat((normals @ TOWARD)[:, None], shape[1], 1)
    observed = SampledTexels(reflected, cos_v**2, cos_v, np.zeros((*shape, 0, 4)), irradiance[0][..., None],
                             0 * number, 0 * number, number, nodes)
    rig = RigSample(observed, Rig.of(views, normals.mean(0)), number, normals, normals, np.zeros(count, np.int32),
                    np.arange(count, dtype=np.int32))
    return TiltSample.of(rig, TiltedWorlds(np.moveaxis(slope[0], 0, -1), np.moveaxis(slope[1], 0, -1)))


@pytest.fixture(scope="module")
def normals() -> np.ndarray:
    return balls.directions(np.random.default_rng(2), 30, 1)[0]


def lobes(count: int) -> Lobes:
    return one_lobe(np.full(count, ROUGHNESS), 0.5)


@pytest.mark.one_python
@pytest.mark.parametrize(("tilt", "off", "lobe_off"), [
    ((0.0, 0.0), 1e-4, 2e-3), ((0.05, -0.02), 0.015, 0.04), ((-0.2, 0.15), 0.12, 0.5)])
def test_the_model_is_the_sum_over_directions_under_tilted_normals(normals, tilt, off, lobe_off) -> None:
    """Slopes of logarithms lead a tenth of a radian far; what a window's edge does beyond, they do not know."""
    sample = sample_of(normals, normals)
    tilts = np.broadcast_to(tilt, (len(normals), 2))
    tilted = balls.unit(normals + sample.offset(tilts))
    white, rest = TiltModel(sample, lobes(len(normals))).at(tilts)
    expected = np.stack([radiance(light, tilted) for light in LIGHTS], 1).mean(-1) / sample.texels.irradiance[..., 0]
    assert np.quantile(np.abs((balls.BASE.mean() * white + rest) / expected - 1), 0.9) < off
    seen, more = sample.tilted(tilts)
    irradiance = np.stack([light_on(light, tilted)[0] for light in LIGHTS], 1)
    assert np.quantile(np.abs(more * sample.texels.irradiance[..., 0] / irradiance - 1), 0.9) < off
    assert np.allclose(seen.reflected * more[..., None], sample.texels.reflected)
    again, other = TiltModel(sample_of(tilted, tilted), lobes(len(normals))).at(0 * tilts), seen.nodes
    assert other is not None
    assert np.quantile(np.abs(at_roughness(np.exp(other[..., 0, :]), ROUGHNESS) / (again[1] / brdf.principled_energy(
        ROUGHNESS, tilted @ TOWARD)[:, None, 0]) - 1), 0.9) < lobe_off


@pytest.mark.one_python
def test_bumps_are_found_under_turns_of_a_sky(normals) -> None:
    true = balls.unit(normals + balls.bumps(normals, 0.06))
    sample = sample_of(normals, true)
    found = fit_tilts(sample, lobes(len(normals)), beside=Beside.NOTHING)
    tilt = found.under(found.deviation())[0]
    error = balls.degrees_between(normals + sample.offset(tilt), true)
    assert np.median(balls.degrees_between(normals, true)) > 3.0
    assert np.median(error) < 0.5


@pytest.mark.one_python
def test_texels_whose_light_is_wrong_are_not_tilted_far(normals) -> None:
    """Light that the mesh's shadows get wrong is wrong in all views of a texel, and no tilt explains it."""
    sample = sample_of(normals, normals)
    texels, rng = sample.texels, np.random.default_rng(3)
    spoilt = np.arange(len(normals)) < 10
    wrong = np.where(spoilt[:, None], np.exp(0.25 * rng.standard_normal(texels.cos_v.shape)), 1.0)
    wrong = wrong * np.exp(0.005 * rng.standard_normal(wrong.shape))
    sample = replace(sample, rig=replace(sample.rig, texels=replace(
        texels, reflected=texels.reflected * wrong[..., None])))
    found = fit_tilts(sample, lobes(len(normals)), beside=Beside.NOTHING)
    tilts = np.degrees(np.linalg.norm(found.under(np.radians(3.0))[0], axis=1))
    assert np.median(tilts[spoilt]) < 0.5  # else 9.6
    assert np.median(tilts[~spoilt]) < 0.5


def test_a_view_without_an_environment_has_no_share_of_one() -> None:
    sample, _ = balls.sphere(balls.principled(0.4), texels=50)
    assert not sample.around.any() and sample.worlds is None
    with_one = Environment("sky", SKY.radiance, np.eye(3))
    views = [replace(view, environment=with_one if n == 3 else None) for n, view in enumerate(sample.rig.rig.views)]
    lobes = sample.texels.lobes.copy()
    lobes[:, 3, :, 3] *= 0.5  # a lamp that is half of the light
    shoot = replace(sample.rig.rig, views=tuple(views))
    rig = replace(sample.rig, texels=replace(sample.texels, lobes=lobes), rig=shoot)
    around = TiltSample.of(rig).around
    assert np.allclose(around[:, 3], 0.5, atol=1e-6) and not np.delete(around, 3, 1).any()
