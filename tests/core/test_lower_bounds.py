"""Clipped pixels as lower bounds: what is predicted darker costs, what is predicted brighter costs nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.data import Coat
from irpso_addon.core.evaluation.coat_search import PLAIN, CoatSearch
from irpso_addon.core.evaluation.descent import METAL_BASE
from irpso_addon.core.evaluation.folds import Judge, lightness, split
from irpso_addon.core.evaluation.joint_material import LEVELS, ROUGHNESS, JointSearch, Nodes
from irpso_addon.core.evaluation.lower_bounds import NodeBounds, bound_weight
from irpso_addon.core.evaluation.sampled_texels import SampledTexels, one_lobe, parts
from tests.support.random_texels import RNG, sampled

pytestmark = pytest.mark.usefixtures("same_draws")

ALL = np.ones(20, bool)


def clipped(texels: SampledTexels, white: float) -> SampledTexels:
    """As a camera shows them that clips at a radiance."""
    over = (texels.reflected * texels.irradiance > white).any(-1)
    reflected = np.where(over[..., None], white / texels.irradiance, texels.reflected)
    return replace(texels, reflected=reflected, quality=np.where(over, 0.0, texels.quality), clipped=1.0 * over)


def left_out(texels: SampledTexels) -> SampledTexels:
    """Without what clipped pixels say."""
    return replace(texels, clipped=None)


def numbers(texels: SampledTexels) -> list[float]:
    """All that a search finds, between the nodes."""
    search = JointSearch(texels)
    joint = search.settled(search.fit(ALL), ALL)
    return [number for one in (joint.plain, joint.specular, joint.metal, joint.apart, joint.apart_metal, *joint.parts)
            for number in (one.roughness, one.level, one.metallic, *one.others)]


def cost(texels: SampledTexels, roughness: float, level: float) -> float:
    """Of cube roots of radiance, texel by texel; base colour is that of the pixels that are not clipped."""
    white, rest = parts(texels, one_lobe(np.full(len(texels.cos_v), roughness), level))
    total = 0.0
    for t, over in enumerate(texels.clipped > 0):
        f, a, s = texels.reflected[t, :, 0], white[t, :, 0], rest[t, :, 0]
        unit = np.maximum(f, np.median(f[~over]))
        w = texels.irradiance[t, :, 0] ** (2 / 3) / unit ** (4 / 3)
        own = w[~over]
        base = np.clip((own * a[~over] * (f - s)[~over]).sum() / (own * a[~over] ** 2).sum(), 0, 1)
        left = f - s - base * a
        total += (w * np.where(over, np.maximum(left, 0), left) ** 2).sum()
    return float(total)


def test_the_search_ends_at_the_least_cost() -> None:
    """Of texels under a narrow coat, which one lobe does not explain, by brute force in its two numbers."""
    texels = clipped(sampled(200, 10, 2, np.full(200, 0.4), coat=Coat(0.6, 0.12))[0], 0.4)
    assert 0.001 < (texels.clipped > 0).mean() < 0.1
    one = JointSearch(texels, metals=False).fit(ALL).specular
    least = cost(texels, one.roughness, one.level)
    for roughness in one.roughness * np.array([0.9, 0.97, 1.0, 1.03, 1.1]):
        for level in one.level * np.array([0.85, 0.95, 1.0, 1.05, 1.15]):
            assert cost(texels, roughness, level) >= least * (1 - 1e-3)
    without = JointSearch(left_out(texels), metals=False).fit(ALL).specular
    assert cost(texels, without.roughness, without.level) > 1.1 * least


@pytest.mark.parametrize(("metallic", "diffuse"), [(0.0, 0.0), (0.4, 0.0), (0.0, 0.6)])
def test_nodes_cost_what_is_missing_there(metallic: float, diffuse: float) -> None:
    """Of two channels, each by itself: an observation by its formula, at nodes that are drawn."""
    texels = clipped(sampled(40, 10, 2, np.full(40, 0.3), coat=Coat(0.6, 0.12))[0], 0.15)
    texels = replace(texels, channel=np.repeat([0, 1], 10).astype(np.int32))
    weight = bound_weight(texels, ALL)
    assert weight is not None
    base = RNG.uniform(0, 0.6, (len(LEVELS), len(ROUGHNESS), 40, 1))
    if metallic:
        base[:] = METAL_BASE  # for which nodes have a metal's multiple scattering
    gain = texels.diffuse_gain(diffuse) if diffuse else np.ones((1, 1, 1))
    for nodes in Nodes.of(texels, metals=True, levels=slice(None)):
        bounds = NodeBounds.of(texels, weight, nodes.layers, nodes.products, gain)
        assert bounds is not None and len(bounds.texel) > 10
        costs = bounds.costs(base, metallic)
        for level, rough in RNG.integers(0, (len(LEVELS), len(ROUGHNESS)), (6, 2)):
            lobes = one_lobe(np.full(40, ROUGHNESS[rough]), LEVELS[level], metallic)
            white, rest = parts(texels, lobes, base[level, rough])
            missing = np.maximum(texels.reflected - rest - white * gain * base[level, rough][:, None], 0)
            wanted = (weight * missing**2)[:, nodes.layers].sum((1, 2))
            assert wanted.any()
            np.testing.assert_allclose(costs[level, rough], wanted, rtol=0.02, atol=1e-6)  # energies by interpolation


@pytest.mark.parametrize(("level", "metallic"), [(0.3, 0.0), (0.5, 0.6)])
def test_a_true_material_is_found_all_the_same(level: float, metallic: float) -> None:
    """Bounds that the truth keeps pull nothing aside."""
    texels = clipped(sampled(200, 10, 2, np.full(200, 0.35), level, metallic=metallic)[0], 0.18)
    assert (texels.clipped > 0).mean() > 0.01
    one = JointSearch(texels).fit(ALL).metal
    assert one.roughness == pytest.approx(0.35, abs=0.0005)
    assert (one.level, one.metallic) == pytest.approx((level, metallic), abs=0.0015)


def test_highlights_that_are_all_clipped_make_no_material_dull() -> None:
    """A metal's, whose unclipped pixels alone suit a rougher surface without Metallic."""
    texels = clipped(sampled(200, 10, 2, np.full(200, 0.35), metallic=0.6)[0], 0.5)
    with_bounds, without = (JointSearch(each, metals=False).fit(ALL).plain for each in (texels, left_out(texels)))
    assert with_bounds.roughness < 0.9 * without.roughness
    over = texels.clipped > 0

    def missing(roughness: float) -> float:
        _, rest = parts(texels, one_lobe(np.full(200, roughness), 0.5))
        return float(np.maximum(texels.reflected - rest, 0)[over].mean())

    assert missing(with_bounds.roughness) < 0.9 * missing(without.roughness)


@pytest.mark.parametrize("metallic", [0.0, 0.5])
def test_bounds_that_are_kept_change_nothing(metallic: float) -> None:
    texels = clipped(sampled(120, 10, 2, RNG.uniform(0.2, 0.6, 120), noise=0.01, metallic=metallic)[0], 0.3)
    over = texels.clipped > 0
    assert over.any()
    low = replace(texels, reflected=np.where(over[..., None], 1e-3, texels.reflected))
    assert numbers(low) == pytest.approx(numbers(left_out(low)), rel=1e-6)
    joint = JointSearch(low).fit(ALL)
    one, other = (CoatSearch(JointSearch(each), each).fit(PLAIN, ALL, joint, 0.5) for each in (low, left_out(low)))
    assert one.coat is not None and other.coat is not None
    assert (one.coat.weight, one.coat.roughness) == pytest.approx((other.coat.weight, other.coat.roughness), rel=1e-6)


def test_texels_whose_base_colour_nothing_says_bound_nothing() -> None:
    """Overexposed white paint is no highlight."""
    texels, _ = sampled(120, 10, 2, np.full(120, 0.5), noise=0.01)
    over = np.zeros((120, 20), bool)
    over[:30, 1:] = True  # one good pixel is left of 30 texels
    bright = np.where(over[..., None], 20.0, texels.reflected)
    burnt = replace(texels, reflected=bright, quality=np.where(over, 0.0, 1.0), clipped=1.0 * over)
    assert numbers(burnt) == pytest.approx(numbers(left_out(burnt)), rel=1e-6)


def test_only_what_is_predicted_too_dark_is_an_error() -> None:
    texels = clipped(sampled(60, 8, 1, np.full(60, 0.3))[0], 0.2)
    over = texels.clipped > 0
    folds = split(texels)
    assert folds is not None and over.sum() > 8
    judge = Judge(texels, folds)
    radiance, bounded = texels.reflected * texels.irradiance, judge.bounded
    assert bounded.sum() > 8 and not (bounded & ~over).any() and not (bounded & judge.judged).any()
    for name, factor in (("brighter", 3.0), ("darker", 0.8)):
        judge.add(name, [np.where(over[..., None], factor, 1.0) * texels.reflected] * len(folds.left_out))
    assert judge.error("brighter").relative_rms == judge.error("brighter").lightness == 0
    counted = bounded | judge.judged
    squares = (0.2 * radiance[bounded]) ** 2
    assert judge.error("darker").relative_rms == pytest.approx(
        np.sqrt(squares.sum() / (radiance[counted] ** 2).sum()), rel=1e-9)
    white = np.percentile(radiance[~over], 99.5)
    off = lightness(0.8 * radiance[bounded] / white) - lightness(radiance[bounded] / white)
    assert judge.error("darker").lightness == pytest.approx(np.sqrt((off**2).sum() / counted.sum()), rel=1e-9)


def test_without_clipped_pixels_the_judge_is_as_before() -> None:
    texels, _ = sampled(60, 8, 1, np.full(60, 0.3), noise=0.02)
    none = replace(texels, clipped=np.zeros_like(texels.quality))
    errors = []
    for each in (texels, none):
        folds = split(each)
        assert folds is not None
        judge = Judge(each, folds)
        judge.add("some", [0.9 * each.reflected] * len(folds.left_out))
        errors.append(judge.error("some"))
    assert errors[0] == errors[1]
    known = np.ones(8, bool)
    assert JointSearch(texels).fit(known) == JointSearch(none).fit(known)
