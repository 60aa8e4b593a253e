"""Errors between maps of any size, and what maps predict of a view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.data import Coat, Maps, Solution
from irpso_addon.core.evaluation import folds, prediction
from irpso_addon.core.evaluation.metrics import map_errors, prediction_error, psnr
from irpso_addon.core.evaluation.prediction import Pixels, PlaceView, Surface, predict, shown
from irpso_addon.core.evaluation.sampled_texels import SampledTexels
from irpso_addon.core.resampling import at_size
from irpso_addon.core.shading import brdf


def test_coarser_by_a_whole_number_is_the_mean_of_blocks():
    array = np.arange(32.0, dtype=np.float32).reshape(4, 8)
    small = at_size(array, 2)[..., 0]
    assert small[0, 0] == array[:2, :4].mean() and small[1, 1] == array[2:, 4:].mean()


@pytest.mark.parametrize("size", [5, 16, 48, 97])
def test_a_ramp_stays_a_ramp_at_any_size(size):
    """Texel centres: v = (row + 1/2) / n, whatever n; the outermost half texels are clamped."""
    v = (np.arange(24) + 0.5) / 24
    array = np.repeat(v[:, None], 24, 1).astype(np.float32)
    want = np.clip((np.arange(size) + 0.5) / size, v[0], v[-1])
    assert np.abs(at_size(array, size)[..., 0] - want[:, None]).max() < 1e-6


def test_errors_are_those_that_were_put_in():
    base, rough = np.full((8, 8, 3), 0.4), np.full((8, 8), 0.5)
    where = np.zeros((8, 8), bool)
    where[:4] = True
    off = rough + np.where(np.arange(8) < 2, 0.2, 0.02)[None]  # a quarter fails
    found = map_errors(base + 0.1, off, base, rough, where)
    assert found.albedo_rmse == pytest.approx(0.1) and found.albedo_psnr == pytest.approx(20.0)
    assert found.rough_mae == pytest.approx(0.25 * 0.2 + 0.75 * 0.02) and found.rough_fail == 0.25
    assert psnr(0.01) == pytest.approx(20.0)


def test_no_number_is_the_worst_number():
    base, rough = at_size(np.full((4, 4, 3), np.nan, np.float32), 2), at_size(np.full((4, 4), np.inf, np.float32), 2)
    found = map_errors(base, rough[..., 0], np.full((2, 2, 3), 0.2), np.full((2, 2), 0.7), np.ones((2, 2), bool))
    assert found.albedo_rmse == pytest.approx(0.8) and found.rough_mae == pytest.approx(0.7)


def test_views_held_out_are_judged_as_lamps_left_out_are():
    """The same radiances and predictions give the error that the solve's own folds give."""
    rng = np.random.default_rng(5)
    texels, layers = 40, 6
    seen = rng.uniform(0.5, 1.0, (texels, layers, 3))
    light = rng.uniform(1.0, 4.0, (texels, layers, 3))
    told = seen * rng.normal(1.0, 0.1, seen.shape)
    ones = np.ones((texels, layers))
    sampled = SampledTexels(seen, ones, ones, np.ones((texels, layers, 1, 4)), light, np.zeros(layers, np.int32),
                            np.zeros(layers, np.int32), np.arange(layers, dtype=np.int32))
    parted = folds.split(sampled)
    judge = folds.Judge(sampled, parted)
    assert judge.judged.all()
    judge.add("it", [told] * len(parted.left_out))
    want = judge.error("it")
    found = prediction_error((seen * light).reshape(-1, 3), (told * light).reshape(-1, 3))
    assert found.relative_rms == pytest.approx(want.relative_rms) and found.lightness == pytest.approx(want.lightness)
    assert 0.08 < found.relative_rms < 0.12 and prediction_error(np.zeros((0, 3)), np.zeros((0, 3))) is None


# ---- prediction


def directions(count, rng):
    """Unit vectors in the upper half (Z is the normal), not grazing."""
    v = rng.normal(size=(count, 3))
    v[:, 2] = np.abs(v[:, 2]) + 0.3
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def one_light(count=200):
    """A view under one point light, with the directions it was made from."""
    rng = np.random.default_rng(1)
    light, view = directions(count, rng), directions(count, rng)
    normal = np.tile([0.0, 0.0, 1.0], (count, 1))
    at = brdf.angles(light, view, normal)
    factor = brdf.F_dielectric(at.cos_vh) / (2 * at.cos_l * at.cos_v)
    lobe = np.stack([at.sin2h, np.zeros(count), at.cos_l, factor], -1).astype(np.float32)
    lobes = np.repeat(lobe[:, None, None], 3, axis=1)
    return PlaceView(np.zeros((count, 3), np.float32), np.ones((count, 3), np.float32), at.cos_v.astype(np.float32),
                     lobes), (light, view, normal)


def surface(count=200, level=0.5, second=False, beckmann=False):
    rng = np.random.default_rng(2)
    r1 = rng.uniform(0.15, 0.5, count)
    lobes = np.stack([r1, r1 + 0.3, rng.uniform(0.2, 0.8, count)], -1) if second else np.stack(
        [r1, r1, np.ones(count)], -1)
    return Surface(rng.uniform(0.1, 0.9, (count, 3)), lobes, np.full(count, level), np.full(count, beckmann))


@pytest.mark.parametrize("level", [0.5, 0.2, 0.9])
def test_one_lobe_is_the_principled_model(level):
    view, (L, V, N) = one_light()
    at = surface(level=level)
    want = brdf.principled(at.base, at.lobes[:, 0], L, V, N, level)
    assert np.abs(predict(at, view) / want - 1).max() < 2e-4


@pytest.mark.parametrize("level", [0.5, 0.8])
def test_metallic_is_the_principled_model(level):
    """Of each texel its own, from none to all."""
    view, (L, V, N) = one_light()
    metallic = np.random.default_rng(3).uniform(0, 1, 200)
    metallic[:20], metallic[20:40] = 0.0, 1.0
    at = replace(surface(level=level), metallic=metallic)
    want = brdf.principled(at.base, at.lobes[:, 0], L, V, N, level, metallic)
    assert np.abs(predict(at, view) / want - 1).max() < 2e-4


def test_a_solutions_metallic_is_its_materials():
    """By slot; texels of no slot count as the first's, pixels show what their texel has."""
    grid = np.full((4, 4), 0.5, np.float32)
    none = np.zeros((4, 4), bool)
    found = Solution.of_maps(
        Maps(np.full((4, 4, 3), 0.5, np.float32), grid, grid, grid, none, none, grid, grid),
        {"Brass": "one-lobe-metallic", "Paint": "one-lobe"}, metallic={"Brass": 0.75})
    slots = np.array([[1, 1, 0, 0]] * 4, np.int32)
    whole = prediction.surface(found, "ggx", slots, ("Paint", "Brass"))
    assert np.array_equal(whole.metallic.reshape(4, 4), np.where(slots == 1, 0.75, 0.0))
    uv = np.array([[0.1, 0.5], [0.9, 0.5]], np.float32)
    pixels = Pixels(uv, np.zeros((2, 4), np.float32), 1.0)
    assert list(shown(whole, pixels).metallic) == [0.75, 0.0]
    flakes = np.where(np.arange(4)[:, None] > 1, np.float32(0.75), np.float32(0)) + np.zeros((4, 4), np.float32)
    beside = replace(found, maps=replace(found.maps, metallic=flakes), paint={"Brass": 0.5})
    whole = prediction.surface(beside, "ggx", slots, ("Paint", "Brass"))
    assert np.array_equal(whole.metallic.reshape(4, 4), np.where(slots == 1, flakes, 0.0))


def test_coats_are_those_of_the_principled_model():
    """Two of them, and places without."""
    view, (L, V, N) = one_light()
    coats, which = (Coat(0.3, 0.4), Coat(1.0, 0.2)), np.arange(200, dtype=np.int32) % 3 - 1
    at = replace(surface(), coat=which, coats=coats)
    want = np.stack([brdf.principled(at.base[i], at.lobes[i, 0], L[i], V[i], N[i],
                                     coat=None if k < 0 else coats[k]) for i, k in enumerate(which)])
    assert np.abs(predict(at, view) / want - 1).max() < 2e-4


def test_a_solutions_coats_are_its_materials():
    grid, none = np.full((4, 4), 0.5, np.float32), np.zeros((4, 4), bool)
    found = Solution.of_maps(
        Maps(np.full((4, 4, 3), 0.5, np.float32), grid, grid, grid, none, none, grid, grid),
        {"Wood": "one-lobe-specular", "Paint": "one-lobe"}, coats={"Wood": Coat(0.5, 0.1)})
    slots = np.array([[1, 1, 0, 0]] * 4, np.int32)
    whole = prediction.surface(found, "ggx", slots, ("Paint", "Wood"))
    assert np.array_equal(whole.coat.reshape(4, 4), np.where(slots == 1, 0, -1)) and whole.coats == (Coat(0.5, 0.1),)
    pixels = Pixels(np.array([[0.1, 0.5], [0.9, 0.5]], np.float32), np.zeros((2, 4), np.float32), 1.0)
    assert list(shown(whole, pixels).coat) == [0, -1]


def test_rough_diffuses_are_those_of_the_principled_model():
    """Two of them, and places without."""
    view, (L, V, N) = one_light()
    rough = np.array([0.0, 0.3, 1.0])[np.arange(200) % 3]
    at = replace(surface(level=0.7), diffuse_roughness=rough)
    want = np.stack([brdf.principled(at.base[i], at.lobes[i, 0], L[i], V[i], N[i], 0.7, diffuse_roughness=of)
                     for i, of in enumerate(rough)])
    assert np.abs(predict(at, view) / want - 1).max() < 2e-4


def test_a_solutions_diffuse_roughness_is_its_materials():
    grid, none = np.full((4, 4), 0.5, np.float32), np.zeros((4, 4), bool)
    found = Solution.of_maps(
        Maps(np.full((4, 4, 3), 0.5, np.float32), grid, grid, grid, none, none, grid, grid),
        {"Chalk": "one-lobe", "Paint": "one-lobe"}, diffuse_roughness={"Chalk": 0.75})
    slots = np.array([[1, 1, 0, 0]] * 4, np.int32)
    whole = prediction.surface(found, "ggx", slots, ("Paint", "Chalk"))
    assert np.array_equal(whole.diffuse_roughness.reshape(4, 4), np.where(slots == 1, 0.75, 0.0))
    pixels = Pixels(np.array([[0.1, 0.5], [0.9, 0.5]], np.float32), np.zeros((2, 4), np.float32), 1.0)
    assert list(shown(whole, pixels).diffuse_roughness) == [0.75, 0.0]


def test_level_zero_is_lambert():
    view, _ = one_light()
    at = surface(level=0.0)
    assert np.allclose(predict(at, view), at.base / np.pi, rtol=1e-6)


@pytest.mark.parametrize("ndf", ["ggx", "beckmann"])
def test_two_lobes_are_the_two_lobe_model(ndf):
    view, (L, V, N) = one_light()
    at = surface(second=True, beckmann=ndf == "beckmann")
    want = brdf.two_lobe(at.base, at.lobes.T, L, V, N, ndf)
    assert np.abs(predict(at, view) / want - 1).max() < 2e-4


def test_lights_share_the_irradiance():
    """Two equal lights of half the irradiance each reflect what one of all does."""
    view, _ = one_light()
    half = view.lobes.copy()
    half[..., 3] *= 0.5
    both = PlaceView(view.rgb, view.weight, view.cos_v, np.concatenate([half, half], axis=2))
    assert np.allclose(predict(surface(), both), predict(surface(), view), rtol=1e-6)


def maps(base, rough):
    """A Surface of (n, n, 3) and (n, n)."""
    r = rough.ravel()
    return Surface(base.reshape(-1, 3), np.stack([r, r, np.ones_like(r)], -1), np.full(r.shape, 0.5),
                   np.zeros(r.shape, bool))


def test_a_pixel_shows_its_footprints_mean():
    """A checkerboard of texels under a pixel two texels wide is grey; under a point it is what lies there."""
    rows, columns = np.mgrid[0:32, 0:32]
    checks = np.repeat(((rows + columns) % 2.0)[..., None], 3, -1)
    uv = np.array([[10.5, 20.5], [11.5, 20.5]], np.float32) / 32
    slope = np.tile(np.array([2.0, 0.0, 0.0, 2.0], np.float32) / 32, (2, 1))
    whole = shown(maps(checks, rows / 32), Pixels(uv, slope, 1.0))
    assert np.abs(whole.base - 0.5).max() < 0.02
    point = shown(maps(checks, rows / 32), Pixels(uv, slope, 0.0))
    assert np.allclose(point.base[:, 0], [0.0, 1.0], atol=1e-5)
    assert np.allclose(point.lobes[:, 0], 20 / 32, atol=1e-5)


def test_a_slanted_footprint_averages_along_itself():
    """Where base colour is linear in u and v its mean is the centre's, whatever the footprint."""
    rng = np.random.default_rng(4)
    v, u = (np.mgrid[0:64, 0:64] + 0.5) / 64
    base = np.stack([0.2 + 0.5 * u, 0.1 + 0.6 * v, 0.3 + 0.2 * u + 0.2 * v], -1)
    uv = rng.uniform(0.2, 0.8, (50, 2)).astype(np.float32)
    at = shown(maps(base, v), Pixels(uv, rng.uniform(-0.05, 0.05, (50, 4)).astype(np.float32), 1.0))
    want = np.stack([0.2 + 0.5 * uv[:, 0], 0.1 + 0.6 * uv[:, 1], 0.3 + 0.2 * uv.sum(-1)], -1)
    assert np.abs(at.base - want).max() < 1e-5
