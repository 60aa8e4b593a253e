"""Tilts of normals: the model against the BRDF itself, what is found, what is refused, smoothing, tangent maps."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.cpu_solver import rasterise
from irpso_addon.core.data import MeshArrays
from irpso_addon.core.evaluation.sampled_texels import SampledTexels, one_lobe
from irpso_addon.core.normals import judge, tangent_map, texel_tilts
from irpso_addon.core.normals.judge import NormalsJudged, judge_normals
from irpso_addon.core.normals.low_pass import common
from irpso_addon.core.normals.texel_tilts import TexelTilts
from irpso_addon.core.normals.tilt_fit import TiltModel, fit_tilts
from irpso_addon.core.normals.tilt_sample import TiltSample
from irpso_addon.core.shading.lights import light_basis
from tests.support import synthetic as syn
from tests.support import tilted_sphere as balls

ROUGHNESS = 0.4


def verdict(sample: TiltSample) -> NormalsJudged | str:
    return result_of(judge_normals(sample))


def result_of(steps: Generator[Any, None, Any]) -> Any:
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


def lobes(sample: TiltSample) -> Any:
    return one_lobe(np.full(len(sample.first), ROUGHNESS), 0.5)


# ---- the model


@pytest.mark.parametrize(("tilt", "off"), [((0.0, 0.0), 1e-6), ((0.05, -0.02), 0.015), ((-0.2, 0.15), 0.05)])
def test_the_model_is_the_brdf_under_tilted_normals(tilt, off) -> None:
    """Radiance over the irradiance of the given normals; the energy that the lobe takes is that of the given ones."""
    sample, _ = balls.sphere(balls.principled(ROUGHNESS), texels=200)
    tilts = np.broadcast_to(tilt, (200, 2))
    normal = balls.unit(sample.rig.normal + sample.offset(tilts))
    white, rest = TiltModel(sample, lobes(sample)).at(tilts)
    toward = np.array([view.lights[0].matrix[:3, 2] for view in sample.rig.rig.views])
    expected = np.stack([balls.principled(ROUGHNESS)(way, normal) * np.maximum(normal @ way, 0)[:, None]
                         for way in toward], 1) / sample.texels.lobes[:, :, 0, 2][..., None]
    shown = balls.BASE * white[..., None] + rest[..., None]
    seen = (sample.texels.quality > 0) & (normal @ balls.TOWARD > 0.2)[:, None]
    error = np.abs(shown - expected)[seen] / np.maximum(expected[seen].max(-1, keepdims=True), 0.02)
    assert np.quantile(error, 0.95) < off


def test_observations_under_tilted_normals_are_those_of_a_mesh_that_has_them() -> None:
    sample, true = balls.sphere(balls.principled(ROUGHNESS), texels=300, slope=0.05)
    other, _ = balls.sphere(balls.principled(ROUGHNESS), texels=300)
    offset = true / (true * sample.rig.normal).sum(-1, keepdims=True) - sample.rig.normal
    seen, brighter = sample.tilted(sample.in_plane(offset))
    assert np.allclose(seen.cos_v, np.repeat((true @ balls.TOWARD)[:, None], seen.cos_v.shape[1], 1), atol=1e-9)
    exact = balls.principled(ROUGHNESS)
    toward = np.array([view.lights[0].matrix[:3, 2] for view in other.rig.rig.views])
    reflected = np.stack([exact(way, true) for way in toward], 1)
    lit = (sample.texels.quality > 0) & (true @ toward.T > 0.1)
    assert np.allclose(seen.reflected[lit], reflected[lit], rtol=1e-6)
    assert np.allclose(brighter[lit], (true @ toward.T / sample.texels.lobes[:, :, 0, 2])[lit], rtol=1e-6)


def test_bases_are_orthonormal() -> None:
    normal = balls.unit(np.random.default_rng(0).standard_normal((500, 3)))
    normal[:2] = [0, 0, -1], [0, 0, 1]
    frame = np.stack([*light_basis(normal), normal], 1)
    assert np.allclose(frame @ np.swapaxes(frame, 1, 2), np.eye(3), atol=1e-12)


# ---- what is found


def test_tilts_are_found() -> None:
    """Bumps of 2.9 degrees that the mesh does not have, under 1 % noise."""
    sample, true = balls.sphere(balls.principled(ROUGHNESS), noise=0.01, slope=0.05)
    found = fit_tilts(sample, lobes(sample))
    tilt, covariance = found.under(found.deviation())
    error = balls.degrees_between(sample.rig.normal + sample.offset(tilt), true)
    assert balls.degrees_between(sample.rig.normal, true).mean() > 2.5
    assert np.median(error) < 0.3 and error.mean() < 0.5
    told = np.degrees(np.sqrt(np.trace(covariance, axis1=1, axis2=2)))
    assert 0.5 < np.median(told) / np.median(error) < 2


def test_shadows_that_the_mesh_does_not_cast_pull_no_normal() -> None:
    """A fifth of the observations are dimmed to a half, some to nothing."""
    sample, true = balls.sphere(balls.principled(ROUGHNESS), noise=0.01, slope=0.05)
    rng = np.random.default_rng(2)
    texels = sample.texels
    dim = np.where(rng.uniform(size=texels.cos_v.shape) < 0.2, rng.choice([0.0, 0.5], texels.cos_v.shape), 1.0)
    shadowed = replace(sample, rig=replace(sample.rig, texels=replace(
        texels, reflected=texels.reflected * dim[..., None])))
    found = fit_tilts(shadowed, lobes(sample))
    error = balls.degrees_between(sample.rig.normal + sample.offset(found.under(found.deviation())[0]), true)
    assert np.median(error) < 0.6 and np.quantile(error, 0.9) < 2.5


def test_tilts_do_not_take_up_what_roughness_is() -> None:
    """Two paints, of which the material has one roughness between theirs: each texel's is found beside its tilt."""
    glossy = np.random.default_rng(5).uniform(size=600) < 0.5

    def two_paints(toward_light: np.ndarray, normal: np.ndarray) -> np.ndarray:
        each = [balls.principled(roughness)(toward_light, normal) for roughness in (0.3, 0.55)]
        return np.where(glossy[:, None], *each)

    sample, true = balls.sphere(two_paints, noise=0.01, slope=0.025)

    def error(roughness: np.ndarray) -> float:
        found = fit_tilts(sample, one_lobe(roughness, 0.5))
        tilt = found.under(found.deviation())[0]
        return float(balls.degrees_between(sample.rig.normal + sample.offset(tilt), true).mean())

    # 0.15 and 0.13 degrees; 0.31 where all texels keep the roughness that they are given
    assert error(np.full(600, ROUGHNESS)) < 1.3 * error(np.where(glossy, 0.3, 0.55))


# ---- what is judged


def test_bumps_that_the_mesh_lacks_are_worth_refining() -> None:
    judged = verdict(balls.sphere(balls.principled(ROUGHNESS), noise=0.01, slope=0.05)[0])
    assert isinstance(judged, NormalsJudged)
    assert judged.refined < 0.5 * judged.given
    assert 1.0 < np.degrees(judged.deviation) < 4.0


@pytest.mark.parametrize("noise", [0.03, 0.06])
def test_bumps_under_noise_are_seen_in_what_neighbours_have_in_common(noise) -> None:
    """Noise is most of what predictions are off by, which hardly falls; neighbours do not share it."""
    noisy = {"noise": noise, "lamps": 12, "beside": 0.01}
    assert isinstance(verdict(balls.sphere(balls.principled(ROUGHNESS), slope=0.025, **noisy)[0]), NormalsJudged)
    assert isinstance(verdict(balls.sphere(balls.principled(ROUGHNESS), **noisy)[0]), str)
    assert isinstance(verdict(balls.sphere(balls.rough_diffuse, **noisy)[0]), str)
    assert isinstance(verdict(balls.sphere(balls.dielectric_diffuse, **noisy)[0]), str)


@pytest.mark.parametrize("seed", [3, 35])
def test_one_texel_that_flashes_does_not_decide(seed) -> None:
    """A bright one, which six suns of one side tell badly: its L* without two of them is off by more than all gain."""
    sample, _ = balls.sphere(balls.principled(ROUGHNESS), lamps=12, texels=200, noise=0.06, slope=0.03, beside=0.01,
                             seed=seed)
    texels, views = sample.texels, sample.rig.rig.views
    seen = np.flatnonzero(texels.quality[0] > 0)
    toward = np.array([view.lights[0].matrix[:3, 2] for view in views])[seen]
    hidden = seen[np.argsort(toward @ [1, 0.3, 0])[6:]]
    quality, reflected = texels.quality.copy(), texels.reflected.copy()
    quality[0, hidden] = 0
    reflected[0] *= 2.5 * np.exp(0.4 * np.random.default_rng(seed).standard_normal((len(views), 1)))
    odd = replace(sample, rig=replace(sample.rig, texels=replace(texels, quality=quality, reflected=reflected)))
    assert isinstance(verdict(sample), NormalsJudged)
    assert isinstance(verdict(odd), NormalsJudged)


@pytest.mark.parametrize(("factor", "refined"), [(1.0, True), (1.5, False)])
def test_normals_under_which_bright_places_flash_are_not_refined(factor: float, refined: bool, monkeypatch) -> None:
    """L* hardly shows it, and falls by far elsewhere: what is translucent looks like that."""
    sample, _ = balls.sphere(balls.principled(ROUGHNESS), noise=0.01, slope=0.05)
    given = judge.predicted

    def flashing(texels: SampledTexels, *known: Any) -> np.ndarray:
        shown = given(texels, *known)
        if not np.array_equal(texels.cos_v, sample.texels.cos_v):  # under tilted normals
            shown = np.where(shown > np.quantile(shown, 0.97), factor * shown, shown)
        return shown

    monkeypatch.setattr(judge, "predicted", flashing)
    assert isinstance(verdict(sample), NormalsJudged) == refined


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_exact_normals_stay(noise) -> None:
    assert isinstance(verdict(balls.sphere(balls.principled(ROUGHNESS), noise=noise)[0]), str)


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_reflection_that_no_lambert_has_is_not_mistaken_for_normals(noise) -> None:
    """Tilted normals explain it better: the fit alone would tilt them by degrees."""
    sample, true = balls.sphere(balls.rough_diffuse, noise=noise)
    found = fit_tilts(sample, lobes(sample))
    assert balls.degrees_between(true + sample.offset(found.under(0.2)[0]), true).mean() > 1.5
    assert isinstance(verdict(sample), str)


def test_few_lamps_say_nothing() -> None:
    assert "too few" in str(verdict(balls.sphere(balls.principled(ROUGHNESS), lamps=4, slope=0.05)[0]))


# ---- the large shape


def test_what_regions_have_in_common_is_told_from_detail() -> None:
    rng = np.random.default_rng(3)
    normal = balls.unit(rng.standard_normal((4000, 3)))
    drift = np.stack([0.05 * normal[:, 1], 0 * normal[:, 0], 0.03 * normal[:, 0] ** 2], -1)
    drift -= normal * (drift * normal).sum(-1, keepdims=True)
    detail = balls.bumps(normal, 0.05)
    detail -= normal * (detail * normal).sum(-1, keepdims=True)
    low = common(normal, normal, drift + detail, np.ones(4000))
    left = drift + detail - low - detail
    assert np.sqrt((left**2).mean()) < 0.4 * np.sqrt((drift**2).mean())
    assert np.abs((low * normal).sum(-1)).max() < 1e-12


def grid(size: int) -> tuple[np.ndarray, np.ndarray]:
    at = np.arange(size) / size
    x, y = np.meshgrid(at, at)
    position = np.stack([x, y, 0 * x], -1).astype(np.float32)
    return position, np.broadcast_to(np.float32([0, 0, 1]), position.shape).copy()


def test_texels_without_data_follow_their_neighbours() -> None:
    """Fine waves, of which every third texel knows nothing."""
    size, deviation = 96, 0.05
    position, normal = grid(size)
    wave = deviation * np.stack([np.sin(60 * position[..., 0]), np.cos(60 * position[..., 1])], -1)
    known = np.random.default_rng(1).uniform(size=(size, size)) > 0.33
    found = TexelTilts(position, normal, np.ones((size, size), bool))
    information = np.where(known[..., None, None], np.eye(2) / 0.005**2, 0.0)
    row, column = (index.ravel().astype(np.int32) for index in np.indices((size, size)))
    found.add((row, column), information.reshape(-1, 2, 2), np.einsum(
        "hwij,hwj->hwi", information, wave).reshape(-1, 2))
    offset = found.offsets(deviation)
    assert np.abs(offset[..., 2]).max() < 1e-6
    error = np.linalg.norm(offset[..., :2] - wave, axis=-1)
    assert np.sqrt((error[known] ** 2).mean()) < 0.25 * deviation
    assert np.sqrt((error[~known] ** 2).mean()) < 0.45 * deviation


def test_long_waves_are_found_on_large_grids(monkeypatch) -> None:
    """Tilts that change along one axis only do not circulate: the most likely ones are those of a line of texels."""
    size, deviation, stiffness = 256, 0.02, 400.0  # the last times 1 / deviation^2
    position, normal = grid(size)
    rng = np.random.default_rng(3)
    told = 0.01 * np.cos(7 * np.arange(size) / size) + 0.02 * rng.standard_normal(size)
    sure = np.where(np.arange(size) % 64 < 32, 1.0, 0.02)  # times 1 / deviation^2
    step = np.diff(np.eye(size), axis=0)
    right = np.linalg.solve(np.diag(sure + 1) + stiffness * step.T @ step, sure * told)
    found = TexelTilts(position, normal, np.ones((size, size), bool))
    found.information[:] = (sure / deviation**2)[:, None, None] * np.eye(2)
    found.pull[..., 0] = sure / deviation**2 * told
    monkeypatch.setattr(texel_tilts._Field, "_stiffness", lambda field: stiffness / deviation**2)
    offset = found.offsets(deviation, large=True)
    off = np.sqrt(np.mean((offset - right[:, None] * np.array([1.0, 0, 0])) ** 2) * 3)
    assert off < 0.02 * np.sqrt(np.mean(right**2))  # 0.014; 200 rounds from no tilts leave 0.025


def test_texels_twice_as_wide_know_what_theirs_do() -> None:
    """An odd number of rows, texels that are none, and axes that differ from texel to texel."""
    rng = np.random.default_rng(2)
    position = rng.uniform(size=(7, 8, 3)).astype(np.float32)
    normal = (np.array([0, 0, 1]) + 0.3 * rng.standard_normal((7, 8, 3))).astype(np.float32)
    found = TexelTilts(position, normal, rng.uniform(size=(7, 8)) > 0.2)
    root = rng.standard_normal((7, 8, 2, 2))
    found.information[:] = root @ root.swapaxes(2, 3)
    found.pull[:] = rng.standard_normal((7, 8, 2))
    wide = found.halved()
    fine, coarse = (np.stack(light_basis(each.normal.astype(np.float64)), -2) for each in (found, wide))
    for row, column in np.ndindex(4, 4):
        own = [at for at in np.ndindex(7, 8) if found.texels[at] and (at[0] // 2, at[1] // 2) == (row, column)]
        assert wide.texels[row, column] == bool(own)
        tilt = rng.standard_normal(2)
        each = [fine[at] @ (tilt @ coarse[row, column]) for at in own]  # the same turn, about the texels' axes
        assert np.isclose(tilt @ wide.information[row, column] @ tilt,
                          sum(one @ found.information[at] @ one for one, at in zip(each, own, strict=True)), rtol=1e-4)
        assert np.isclose(tilt @ wide.pull[row, column],
                          sum(one @ found.pull[at] for one, at in zip(each, own, strict=True)), rtol=1e-4, atol=1e-5)


def relief(size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As `grid`, and what the waves of a surface add to its normals, (size, size, 2)."""
    position, normal = grid(size)
    x, y = position[..., 0], position[..., 1]
    slope = 0.05 * np.stack([np.cos(20 * x + 12 * y) + np.cos(25 * x - 15 * y),
                             12 / 20 * np.cos(20 * x + 12 * y) - 15 / 25 * np.cos(25 * x - 15 * y)], -1)
    return position, normal, slope


def test_normals_are_those_of_a_surface() -> None:
    """Where texels know their tilt in one direction only, what goes around four of them says the other."""
    size = 96
    position, normal, slope = relief(size)
    found = TexelTilts(position, normal, np.ones((size, size), bool))
    found.information[:] = np.eye(2) / 0.002**2
    half = slice(24, 72)
    found.information[half, half, 1, 1] = 0
    found.pull = np.einsum("hwij,hwj->hwi", found.information, slope).astype(np.float32)
    error = found.offsets(0.05)[..., 1] - slope[..., 1]
    assert np.sqrt((error[half, half] ** 2).mean()) < 0.4 * np.sqrt((slope[half, half, 1] ** 2).mean())


def test_texels_that_share_pixels_share_errors() -> None:
    """Two by two: steps within a pixel show no noise, and the field is not taken to be flat for that."""
    size, noise = 96, 0.02
    position, normal, slope = relief(size)
    found = TexelTilts(position, normal, np.ones((size, size), bool))
    found.information[:] = np.eye(2) / noise**2
    error = noise * np.random.default_rng(3).standard_normal((size // 2, size // 2, 2)).repeat(2, 0).repeat(2, 1)
    found.pull = np.einsum("hwij,hwj->hwi", found.information, slope + error).astype(np.float32)
    left = found.offsets(0.05)[..., :2] - slope
    assert np.sqrt((left**2).mean()) < noise


def test_neighbours_across_a_seam_say_nothing() -> None:
    size = 64
    position, normal = grid(size)
    position[:, size // 2:, 2] += 1.0  # another part of the surface
    found = TexelTilts(position, normal, np.ones((size, size), bool))
    information = np.zeros((size, size, 2, 2))
    information[:, : size // 2] = np.eye(2) / 0.001**2
    stripes = 0.05 * np.sign(np.sin(80 * position[..., 1]))[..., None] * [1.0, 0.0]
    row, column = (index.ravel().astype(np.int32) for index in np.indices((size, size)))
    found.add((row, column), information.reshape(-1, 2, 2),
              np.einsum("hwij,hwj->hwi", information, stripes).reshape(-1, 2))
    offset = found.offsets(0.05)
    assert np.abs(offset[:, size // 2:]).max() == 0
    assert np.abs(offset[:, : size // 2]).max() > 0.03


# ---- tangent maps


def mesh(mirrored: bool = False) -> MeshArrays:
    """The rolling plane of synthetic.py, scaled unevenly and turned; its UVs are a mirror image on one half."""
    plane = syn.plane_mesh()
    linear = np.array([[0.8, 0.3, 0.0], [-0.4, 1.1, 0.2], [0.1, 0.0, 1.4]]) @ np.diag([1, 1, -1.0 if mirrored else 1.0])
    order = [0, 2, 1] if mirrored else [0, 1, 2]
    matrix = np.linalg.inv(linear).T
    uvs = plane.uvs.copy()
    return replace(plane, positions=(plane.positions @ linear.T).astype(np.float32)[:, order],
                   normals=balls.unit(plane.normals @ matrix.T).astype(np.float32)[:, order], uvs=uvs[:, order],
                   normal_matrix=matrix.astype(np.float32), unit_normal=True)


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_tangent_map_says_the_normals_that_it_was_made_of(mirrored) -> None:
    """Read by the twin of the G-buffer, which Cycles holds (tests/blender/test_gbuffer_cycles.py)."""
    subject, size = mesh(mirrored), 128
    owner, weights = rasterise.rasterise(subject.uvs, size)
    known = owner >= 0
    given = rasterise.places(subject, owner[known], weights[known]).normal
    wanted = np.zeros((size, size, 3), np.float32)
    wanted[known] = balls.unit(given + balls.bumps(given * 2, 0.1))
    packed = tangent_map.encoded(subject, wanted, known)
    assert packed.min() >= 0 and packed.max() <= 1
    worn = tangent_map.wearing(subject, packed)
    read = rasterise.places(worn, owner[known], weights[known]).normal
    assert balls.degrees_between(read, wanted[known]).max() < 0.05


def test_given_normals_make_a_flat_map() -> None:
    """But for what normals that are interpolated in the world differ from those of the object, unevenly scaled."""
    subject, size = mesh(), 64
    owner, weights = rasterise.rasterise(subject.uvs, size)
    known = owner >= 0
    normal = np.zeros((size, size, 3), np.float32)
    normal[known] = rasterise.places(subject, owner[known], weights[known]).normal
    assert np.abs(tangent_map.encoded(subject, normal, known) - tangent_map.FLAT).max() < 1e-3


def test_padding_grows_by_means_of_neighbours() -> None:
    known = np.zeros((7, 7), bool)
    known[3, 3] = True
    values = np.where(known[..., None], 2.0, 0.0).astype(np.float32) * np.ones(3, np.float32)
    grown = tangent_map.padded(values, known, 2)
    assert grown[3, 5, 0] == 2 and grown[2, 2, 0] == 2 and grown[1, 1, 0] == 0
