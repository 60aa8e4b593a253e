"""One material for many texels: what it predicts, and how it is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.data import Coat
from irpso_addon.core.evaluation.coat_search import APART, METAL, PLAIN, CoatSearch
from irpso_addon.core.evaluation.descent import COSINES, AmongCosines
from irpso_addon.core.evaluation.joint_material import LEVELS, PLAIN_ALONE, ROUGHNESS, JointSearch
from irpso_addon.core.evaluation.sampled_texels import (
    SampledTexels,
    common_base,
    energy_of,
    one_lobe,
    parts,
    predicted,
)
from irpso_addon.core.shading import brdf
from tests.support.random_texels import RNG, sampled

pytestmark = pytest.mark.usefixtures("same_draws")


def test_predictions_of_the_true_material_are_exact() -> None:
    rough = RNG.uniform(0.15, 0.8, 40)
    for level in (0.5, 0.1):
        texels, _ = sampled(40, 8, 2, rough, level)
        known = texels.lamps % 4 != 0
        got = predicted(texels, one_lobe(rough, level), known)
        np.testing.assert_allclose(got, texels.reflected, rtol=2e-3)  # the table of energies is coarser than Cycles'


def test_predictions_of_a_true_metal_are_exact() -> None:
    rough = RNG.uniform(0.15, 0.8, 40)
    texels, _ = sampled(40, 8, 2, rough, 0.5, metallic=0.7)
    got = predicted(texels, one_lobe(rough, 0.5, 0.7), texels.lamps % 4 != 0)
    np.testing.assert_allclose(got, texels.reflected, rtol=4e-3)


def test_predictions_of_a_true_rough_diffuse_are_exact() -> None:
    rough = RNG.uniform(0.15, 0.8, 40)
    texels, _ = sampled(40, 8, 2, rough, 0.3, diffuse=0.7)
    known = texels.lamps % 4 != 0
    got = predicted(texels, one_lobe(rough, 0.3, diffuse=0.7), known)
    np.testing.assert_allclose(got, texels.reflected, rtol=3e-3)
    smooth = predicted(texels, one_lobe(rough, 0.3), known)
    assert np.quantile(np.abs(smooth / texels.reflected - 1), 0.9) > 0.02


@pytest.mark.parametrize(("rough", "level"), [(0.18, 0.1), (0.4, 0.5), (0.7, 0.9)])
def test_a_material_of_one_value_is_found(rough: float, level: float) -> None:
    texels, _ = sampled(120, 10, 2, np.full(120, rough), level, noise=0.01)
    joint = JointSearch(texels).fit(np.ones(20, bool))
    assert joint.specular.roughness == pytest.approx(rough, rel=0.1)
    assert joint.specular.level == pytest.approx(level, rel=0.3)
    assert joint.metal.metallic < 0.05


@pytest.mark.parametrize(("rough", "level", "metallic"), [
    (0.21, 0.5, 0.0), (0.37, 0.37, 0.0), (0.47, 0.65, 0.0), (0.64, 0.5, 0.0), (0.47, 0.5, 0.43), (0.62, 0.5, 1.0)])
def test_one_value_is_found_between_the_nodes(rough: float, level: float, metallic: float) -> None:
    """Observations are exact."""
    texels, _ = sampled(200, 10, 2, np.full(200, rough), level, metallic=metallic)
    joint = JointSearch(texels).fit(np.ones(20, bool))
    found = joint.metal if metallic else joint.specular
    allowed = 0.0005
    assert found.roughness == pytest.approx(rough, abs=allowed)
    assert found.metallic == pytest.approx(metallic, abs=3 * allowed)
    if metallic < 1:
        assert found.level == pytest.approx(level, abs=3 * allowed)


def one_paint(rough: float, level: float, metallic: float) -> SampledTexels:
    """Of one base colour, each observation brighter or darker by up to a half, as bumps make it."""
    base, count = np.array([0.5, 0.2, 0.1]), 150
    texels, _ = sampled(count, 10, 2, np.full(count, rough), level, metallic=metallic)
    lobes = one_lobe(np.full(count, rough), level, metallic)
    white, rest = parts(texels, lobes, np.broadcast_to(base, (count, 3)))
    shown = (base * white + rest) * np.exp(0.4 * RNG.standard_normal((*texels.cos_v.shape, 1)))
    return replace(texels, reflected=shown)


@pytest.mark.parametrize(("rough", "level", "metallic"), [(0.2, 0.12, 0.0), (0.49, 0.5, 0.0), (0.35, 0.25, 0.6)])
def test_a_constant_material_is_the_least_squares_fit(rough: float, level: float, metallic: float) -> None:
    """As brute force finds it over all nodes, with `numpy.linalg.lstsq` for each channel's base colour."""
    texels = one_paint(rough, level, metallic)
    search, known = JointSearch(texels), np.ones(20, bool)
    plain, metal = search.with_constant(search.fit(known), known).constant
    assert metal.roughness == pytest.approx(rough, rel=0.25) and metal.metallic == pytest.approx(metallic, abs=0.2)
    if metallic:
        return
    weight = np.sqrt(np.where(texels.usable(), texels.quality, 0.0))[..., None] * texels.irradiance
    costs = {}
    for r in ROUGHNESS:
        for at in LEVELS:
            white, rest = parts(texels, one_lobe(np.full(len(texels.cos_v), r), at))
            left = 0.0
            for c in range(3):
                a, b = (weight[..., 0] * x for x in (white[..., 0], texels.reflected[..., c] - rest[..., 0]))
                left += float(np.linalg.lstsq(a.reshape(-1, 1), b.ravel(), rcond=None)[1][0])
            costs[r, at] = left
    best, at = min(costs, key=costs.__getitem__)
    assert plain.roughness == pytest.approx(best, rel=0.1)  # half a node
    levels = list(LEVELS)
    low, high = (levels[min(max(levels.index(at) + step, 0), len(levels) - 1)] for step in (-1, 1))
    assert low <= plain.level <= high


@pytest.mark.parametrize("drawn", [2.0, 8.0])
def test_drawn_base_colours_count_observations(drawn: float) -> None:
    """A texel's own least-squares base colour and that of all texels, whose observations count by their irradiance."""
    texels = one_paint(0.4, 0.5, 0.0)
    lobes, known = one_lobe(np.full(150, 0.4), 0.5), texels.lamps % 4 != 0
    white, rest = parts(texels, lobes)
    usable = (texels.usable() & known)[..., None]
    alike = np.where(usable, texels.quality[..., None] * np.cbrt(texels.irradiance) ** 2, 0.0)
    off = texels.reflected - rest
    common = (alike * white * off).sum((0, 1)) / (alike * white**2).sum((0, 1))
    relative = np.where(usable, texels.quality[..., None] / np.maximum(texels.reflected, texels.typical()) ** 2, 0.0)
    same = replace(texels, camera=np.zeros_like(texels.camera))
    own = np.clip((relative * white * off).sum(1) / (relative * white**2).sum(1), 0, 1)
    count = usable.sum(1)
    base = (count * own + drawn * np.clip(common, 0, 1)) / (count + drawn)
    np.testing.assert_allclose(predicted(same, lobes, known, drawn=drawn), base[:, None] * white + rest, rtol=1e-9)
    np.testing.assert_allclose(common_base(texels.part(np.arange(150)), lobes), [0.5, 0.2, 0.1], rtol=0.15)


def test_blenders_level_alone_gives_the_roughness_at_it() -> None:
    """What a search of all levels finds there, from a part of the layers."""
    texels, _ = sampled(200, 8, 2, np.full(200, 0.37), noise=0.01)
    known = texels.lamps % 4 != 0
    alone = JointSearch(texels, metals=False, levels=PLAIN_ALONE).plain(known)
    assert alone == JointSearch(texels).fit(known).plain
    assert alone.roughness == pytest.approx(0.37, abs=0.01)


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize(("lamps", "cameras"), [(8, 1), (10, 2)])
@pytest.mark.parametrize(("level", "metallic"), [(0.2, 0.0), (0.5, 0.0), (0.8, 0.0), (0.5, 0.6)])
def test_a_level_is_found_where_roughness_differs(
    level: float, metallic: float, lamps: int, cameras: int, noise: float,
) -> None:
    """From texels of which each has its own roughness; nodes alone are off by 0.06 and more."""
    texels, _ = sampled(300, lamps, cameras, RNG.uniform(0.2, 0.7, 300), level, noise=noise, metallic=metallic)
    search, known = JointSearch(texels), np.ones(lamps * cameras, bool)
    found = search.settled(search.fit(known), known).apart_metal
    assert found.level == pytest.approx(level, abs=(0.08 if metallic else 0.02) if noise else 0.003)
    assert found.metallic == pytest.approx(metallic, abs=0.01)


@pytest.mark.parametrize("metals", [False, True])
@pytest.mark.parametrize("metallic", [0.0, 0.6])
def test_what_is_found_where_roughness_differs_is_found_alone(metallic: float, metals: bool) -> None:
    texels, _ = sampled(300, 8, 1, RNG.uniform(0.2, 0.7, 300), 0.8, noise=0.02, metallic=metallic)
    search, known = JointSearch(texels, metals), texels.lamps % 4 != 0
    joint = search.settled(search.fit(known), known)
    assert search.apart(known) == (joint.apart_metal if metals else joint.apart)


def test_curves_between_cosines_are_those_of_interp() -> None:
    cosines = np.concatenate([RNG.uniform(-0.1, 1.1, 60), [0.0, 0.5, 1.0, 1 / 64]]).reshape(4, 16)
    curves = RNG.uniform(size=(3, len(COSINES)))
    among = AmongCosines(cosines)
    np.testing.assert_array_equal(among.values(curves[1]), np.interp(cosines, COSINES, curves[1]))
    each = np.array([2, 0, 1, 2], np.int32)
    wanted = [np.interp(row, COSINES, curves[k]) for row, k in zip(cosines, each, strict=True)]
    np.testing.assert_array_equal(among.values(curves, each[:, None]), wanted)


# --- metals


@pytest.mark.parametrize("metallic", [0.3, 0.8, 1.0])
def test_a_metal_is_found(metallic: float) -> None:
    texels, _ = sampled(120, 10, 2, np.full(120, 0.4), 0.5, noise=0.01, metallic=metallic)
    joint = JointSearch(texels).fit(np.ones(20, bool))
    assert joint.metal.metallic == pytest.approx(metallic, abs=0.06)
    assert joint.metal.roughness == pytest.approx(0.4, rel=0.05)


def test_a_metal_is_found_where_roughness_differs_from_texel_to_texel() -> None:
    rough = RNG.uniform(0.25, 0.6, 120)
    texels, _ = sampled(120, 10, 2, rough, 0.5, metallic=0.5)
    assert JointSearch(texels).fit(np.ones(20, bool)).apart_metal.metallic == pytest.approx(0.5, abs=0.1)
    texels, _ = sampled(120, 10, 2, rough, 0.5)
    assert JointSearch(texels).fit(np.ones(20, bool)).apart_metal.metallic < 0.05


# --- parts


def test_two_parts_are_told_apart() -> None:
    rough = np.where(np.arange(120) % 3 == 0, 0.35, 0.75)
    texels, _ = sampled(120, 16, 2, rough, 0.5, noise=0.01)
    two, _ = JointSearch(texels).fit(np.ones(32, bool)).parts
    assert sorted((two.roughness, *two.others)) == pytest.approx([0.35, 0.75], rel=0.15)
    assert two.level == pytest.approx(0.5, abs=0.15)


@pytest.mark.parametrize("level", [0.25, 0.5])
def test_parts_are_found_between_the_nodes(level: float) -> None:
    """Two of one roughness each, and three."""
    for rough in ((0.32, 0.75), (0.27, 0.43, 0.8)):
        truth = np.array(rough)[np.arange(240) % len(rough)]
        texels, _ = sampled(240, 16, 2, truth, level, noise=0.01)
        search, known = JointSearch(texels), np.ones(32, bool)
        found = search.settled(search.fit(known), known).parts[len(rough) - 2]
        assert sorted((found.roughness, *found.others)) == pytest.approx(rough, rel=0.02)
        assert found.level == pytest.approx(level, abs=0.02)


# --- coats


COAT = Coat(0.6, 0.2)


@pytest.mark.parametrize(("kind", "metallic", "different"), [
    (PLAIN, 0.0, False), (METAL, 0.6, False), (APART, 0.0, True)])
def test_a_coat_is_found(kind: str, metallic: float, different: bool) -> None:
    """Above one roughness, above one with Metallic, and above a roughness of its own for each texel; 1 % noise."""
    rough = RNG.uniform(0.45, 0.8, 200) if different else np.full(200, 0.6)
    texels, _ = sampled(200, 16, 2, rough, 0.5, noise=0.01, metallic=metallic, coat=COAT)
    search, known = JointSearch(texels), np.ones(32, bool)
    found = CoatSearch(search, texels).fit(kind, known, search.fit(known), 0.5)
    assert found.coat is not None
    assert found.coat.weight == pytest.approx(COAT.weight, abs=0.1)
    assert found.coat.roughness == pytest.approx(COAT.roughness, abs=0.03)
    if not different:
        assert found.roughness == pytest.approx(0.6, abs=0.06) and found.metallic == pytest.approx(metallic, abs=0.1)


@pytest.mark.parametrize(("count", "lamps", "cameras"), [(600, 6, 6), (600, 8, 2), (400, 12, 3)])
def test_a_coat_is_smoother_than_what_it_covers(count: int, lamps: int, cameras: int) -> None:
    """A rough coat above a smooth body would show nearly the same; few half vectors come near the narrow lobe."""
    texels, _ = sampled(count, lamps, cameras, np.full(count, 0.37), 0.5, noise=0.01, coat=Coat(1.0, 0.1))
    search, known = JointSearch(texels), np.ones(lamps * cameras, bool)
    found = CoatSearch(search, texels).fit(PLAIN, known, search.fit(known), 0.5)
    assert found.roughness == pytest.approx(0.37, abs=0.01) and found.level == pytest.approx(0.5, abs=0.02)
    assert found.coat is not None and found.coat.roughness == pytest.approx(0.1, abs=0.005)
    assert found.coat.weight == pytest.approx(1.0, abs=0.02)


def test_the_texels_that_see_a_narrow_coat_say_its_weight() -> None:
    """Of 2000 texels a search takes 277.  If any, few of them see the highlight, and the luck of each decides."""
    weights = []
    for _ in range(4):
        texels, _ = sampled(2000, 36, 1, np.full(2000, 0.4), 0.5, noise=0.02, coat=Coat(0.7, 0.06))
        search, known = JointSearch(texels, metals=False), np.ones(36, bool)
        found = CoatSearch(search, texels).fit(PLAIN, known, search.fit(known), 0.5)
        assert found.coat is not None
        weights.append(found.coat.weight)
    assert np.abs(np.array(weights) - 0.7).max() < 0.015  # 0.02 to 0.05 where any texels say it


def test_a_coat_keeps_most_of_its_weight_where_highlights_lie_beside_their_places() -> None:
    """By as much as bumps that the mesh lacks do: what is predicted bright and is dark may not outweigh the others."""
    weights = []
    for _ in range(4):
        texels, _ = sampled(2000, 36, 1, np.full(2000, 0.4), 0.5, noise=0.02, coat=Coat(0.7, 0.1))
        lobes = texels.lobes.copy()
        off = 0.004 * RNG.standard_normal((2, *lobes.shape[:3]))  # of half vectors: alpha is 0.01
        lobes[..., 0] = np.minimum((np.sqrt(lobes[..., 0]) + off[0]) ** 2 + off[1] ** 2, 1.0)
        texels = replace(texels, lobes=lobes)
        search, known = JointSearch(texels, metals=False), np.ones(36, bool)
        found = CoatSearch(search, texels).fit(PLAIN, known, search.fit(known), 0.5)
        assert found.coat is not None
        weights.append(found.coat.weight)
    assert np.mean(weights) > 0.5  # 0.43 where it costs its square


@pytest.mark.parametrize(("lamps", "cameras"), [(16, 2), (24, 12)])
@pytest.mark.parametrize("grazing", [0.0, 0.05, 0.2])
def test_a_coat_does_not_take_the_place_of_the_only_lobe(grazing: float, lamps: int, cameras: int) -> None:
    """A coat above nothing shines alike; what it takes from a body at grazing angles is what an error may look like."""
    texels, _ = sampled(200, lamps, cameras, np.full(200, 0.4), 0.5, noise=0.01)
    texels = replace(texels, reflected=texels.reflected * texels.cos_v[..., None] ** grazing)
    search, known = JointSearch(texels), np.ones(lamps * cameras, bool)
    found = CoatSearch(search, texels).fit(PLAIN, known, search.fit(known), 0.5)
    assert found.roughness == pytest.approx(0.4, abs=0.08)


# --- a rough diffuse


@pytest.mark.parametrize("different", [False, True])
@pytest.mark.parametrize("diffuse", [0.0, 0.23, 0.77])
def test_a_diffuse_roughness_is_found(diffuse: float, different: bool) -> None:
    """About, by texels that may each have their own roughness; exactly, with one roughness and level."""
    rough = RNG.uniform(0.2, 0.6, 60) if different else np.full(60, 0.42)
    texels, _ = sampled(60, 12, 2, rough, 0.4, diffuse=diffuse)
    search, known = JointSearch(texels), np.ones(24, bool)
    found = search.diffuse_roughness(known)
    assert found == pytest.approx(diffuse, abs=0.1)
    if diffuse and not different:
        one = search.fit(known, found).specular
        assert (one.diffuse, one.roughness, one.level) == (
            pytest.approx(diffuse, abs=0.01), pytest.approx(0.42, abs=2e-3), pytest.approx(0.4, abs=0.02))


def test_a_metal_has_no_diffuse_roughness() -> None:
    texels, _ = sampled(60, 12, 2, np.full(60, 0.42), metallic=1.0)
    assert JointSearch(texels).diffuse_roughness(np.ones(24, bool)) < 0.05


@pytest.mark.parametrize("alike", [True, False])
@pytest.mark.parametrize("level", [0.5, 0.3])
def test_energy_is_that_of_each_view(alike: bool, level: float) -> None:
    """Views of a camera see a texel alike; where they do not, each is looked up by itself."""
    rng = np.random.default_rng(1)
    camera = np.array([3, 1, 3, 1, 1], np.int32)
    texels, roughness = 20, rng.uniform(0.1, 1.0, 20)
    cos_v = rng.uniform(0.0, 1.0, (texels, 4))[:, camera] if alike else rng.uniform(0.0, 1.0, (texels, 5))
    shape = texels, 5
    sample = SampledTexels(np.ones((*shape, 3)), np.ones(shape), cos_v, np.ones((*shape, 1, 4)), np.ones((*shape, 3)),
                           camera, np.zeros(5, np.int32), np.zeros(5, np.int32))
    assert len(sample.views_of[0]) == (2 if alike else 5)
    found = energy_of(sample, roughness, np.full(texels, level))
    right = brdf.principled_energy_level(roughness[:, None], np.clip(cos_v, 1e-3, 1.0), np.full((texels, 1), level))
    assert np.allclose(np.stack(found, -1), right, atol=2e-5)  # at level 0.5 from a table
