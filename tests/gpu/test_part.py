"""A part solved alone, against the whole solve; a start at the last result, against a start anew."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.data import Region, Solution
from irpso_addon.core.errors import BadInput
from irpso_addon.core.params import choice_name
from tests.support import shoots
from tests.support import synthetic as syn

SIZE = 96
AT = (np.arange(SIZE) + 0.5) / SIZE
U, V = np.meshgrid(AT, AT)
MIDDLE = (0.45, 0.55)
OFF = 0.1  # what the maps that are kept are spoilt by, to be told from what is new


def disc(shoot: syn.Shoot, radius: float = 0.2, **more: Any) -> syn.Shoot:
    """The shoot with a round region, by weights at the mesh's corners: a half at the radius."""
    far = np.hypot(*(np.moveaxis(shoot.scene.mesh.uvs, -1, 0) - np.reshape(MIDDLE, (2, 1, 1))))
    weights = np.clip(0.5 + (radius - far) / 0.1, 0, 1).astype(np.float32)
    return replace(shoot, scene=replace(shoot.scene, region=Region(corners=weights), **more))


def spoilt(solution: Solution) -> Solution:
    maps = solution.maps
    return replace(solution, maps=replace(maps, roughness=maps.roughness + np.float32(OFF),
                                          base_color=maps.base_color * np.float32(1 - OFF),
                                          confidence=np.where(maps.filled, np.float32(0), np.float32(0.123))))


@pytest.fixture(scope="module")
def whole(patches: syn.Shoot) -> Solution:
    return shoots.run(patches, size=SIZE)


FAR = np.hypot(U - MIDDLE[0], V - MIDDLE[1])
INSIDE, OUTSIDE = FAR < 0.19, FAR > 0.21 + 6 / SIZE  # beyond any seam


@pytest.mark.one_python
def test_inside_as_the_whole_solve_outside_as_before(patches: syn.Shoot, whole: Solution) -> None:
    before = spoilt(whole)
    part = shoots.run(disc(patches, start=before), size=SIZE)
    own = whole.maps.coverage & ~whole.maps.filled
    off = np.abs(part.maps.roughness - whole.maps.roughness)[own & INSIDE]
    assert off.max() < 1e-3 and np.median(off) < 1e-5
    # Sharpened base colour leans on the texels around: on these, at the borders between quarters, most.
    off = np.abs(part.maps.base_color - whole.maps.base_color).max(-1)[own & INSIDE]
    assert np.median(off) < 1e-4 and np.quantile(off, 0.9) < 0.01
    np.testing.assert_array_equal(part.maps.confidence[own & INSIDE] == np.float32(0.123), False)
    covered = whole.maps.coverage & OUTSIDE
    for name in ("roughness", "base_color", "confidence", "error", "roughness_sigma", "filled"):
        np.testing.assert_allclose(getattr(part.maps, name)[covered], getattr(before.maps, name)[covered], atol=1e-6)
    texels = part.texels
    assert texels["solved"] + texels["kept"] + texels["filled"] == texels["covered"] == whole.texels["covered"]
    assert INSIDE.sum() < texels["solved"] < (~OUTSIDE).sum()
    assert part.model == whole.model and part.why == {"Paint": "as in the last result"}


def test_the_seam_is_soft(patches: syn.Shoot, whole: Solution) -> None:
    """Along a row through one material, no step is as high as the difference of the two results."""
    row = int(0.7 * SIZE)
    part = shoots.run(disc(patches, start=spoilt(whole)), size=SIZE)
    for name, height in (("roughness", OFF), ("base_color", OFF * 0.8)):
        across = getattr(part.maps, name)[row, 4:SIZE // 2 - 2].reshape(SIZE // 2 - 6, -1)[:, 0]
        assert np.ptp(across) > 0.9 * height  # from the one to the other
        assert np.abs(np.diff(across)).max() < 0.6 * height


def test_an_image_marks_texels(patches: syn.Shoot, whole: Solution) -> None:
    white = np.zeros((16, 32), np.float32)
    white[4:10, 8:20] = 1  # u 0.25 to 0.625, v 0.25 to 0.625
    scene = replace(patches.scene, region=Region(image=white))
    part = shoots.run(replace(patches, scene=scene), size=SIZE)
    marked = (U > 0.25) & (U < 0.625) & (V > 0.25) & (V < 0.625)
    solved_ones = ~part.maps.filled
    corners = (np.abs(U - 0.4375) > 0.17) & (np.abs(V - 0.4375) > 0.17)  # less than half white, bilinear
    np.testing.assert_array_equal(solved_ones[~corners], marked[~corners])  # nothing is kept: no seam
    off = np.abs(part.maps.roughness - whole.maps.roughness)[marked]
    assert np.median(off) < 1e-5
    assert part.texels["kept"] == 0
    nothing = replace(patches.scene, region=Region(image=np.zeros((4, 4), np.float32)))
    with pytest.raises(BadInput, match="region to solve covers no texel"):
        shoots.run(replace(patches, scene=nothing))


@pytest.mark.parametrize("model", ["lambert", "two-lobe"])
def test_a_material_has_one_model(patches: syn.Shoot, whole: Solution, model: str) -> None:
    with pytest.raises(BadInput, match=f"'Paint': its other region was solved as Roughness, not {choice_name(model)}"):
        shoots.run(disc(patches, start=whole), model=model)
    assert shoots.run(disc(patches), model=model).model == {"Paint": model}  # nothing is kept


@pytest.mark.one_python
def test_two_materials_each_keep_their_own(patches: syn.Shoot) -> None:
    """A region that ends where a material does: that one may get another model."""
    mesh = syn.plane_mesh(lambda u, v: u > 0.5, ("Left", "Right"))
    shoot = replace(patches, scene=replace(patches.scene, mesh=mesh))
    whole = shoots.run(shoot)
    right = np.repeat((mesh.slots == 1)[:, None], 3, 1).astype(np.float32)
    scene = replace(shoot.scene, region=Region(corners=right), start=whole)
    part = shoots.run(replace(shoot, scene=replace(scene, start=replace(whole, model={"Left": "one-lobe"}))),
                      model="lambert")
    assert part.model["Right"] == "lambert"


@pytest.mark.parametrize("given", [{"specular": "texel", "model": "one-lobe-specular"}, {"model": "two-lobe"}])
def test_what_larger_models_have_more_is_kept_too(patches: syn.Shoot, given: dict[str, str]) -> None:
    whole = shoots.run(patches, **given)
    name = "specular" if "specular" in given else "lobes"
    before = getattr(whole.maps, name)
    part = shoots.run(disc(patches, start=whole))  # auto: as it was
    assert part.model == {"Paint": given["model"]} and part.levels == whole.levels == {}
    at = (np.arange(shoots.SIZE) + 0.5) / shoots.SIZE
    far = np.hypot(*(np.moveaxis(np.stack(np.meshgrid(at, at), -1), -1, 0) - np.reshape(MIDDLE, (2, 1, 1))))
    after, covered = getattr(part.maps, name), whole.maps.coverage
    np.testing.assert_allclose(after[covered & (far > 0.3)], before[covered & (far > 0.3)], atol=1e-6)
    assert np.median(np.abs(after - before)[covered & (far < 0.18)]) < 0.01
    assert part.texels["solved"] > 100 and part.texels["kept"] > 1000


@pytest.mark.one_python
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_start_at_a_draft_is_no_worse_than_one_anew(patches: syn.Shoot, noise: float) -> None:
    shoot = patches if noise == 0 else syn.shoot(syn.PATCHES, shoots.rig(), noise=noise)
    anew, draft = shoots.run(shoot), shoots.run(shoot, method="draft")
    again = shoots.run(replace(shoot, scene=replace(shoot.scene, start=draft)), start="last")
    best, found = shoots.errors(anew, shoot.truth), shoots.errors(again, shoot.truth)
    assert found.share == best.share
    for part in (0.5, 0.9, 0.99):
        assert np.quantile(found.rough, part) < 1.02 * np.quantile(best.rough, part) + 1e-6
        assert np.quantile(found.base, part) < 1.02 * np.quantile(best.base, part) + 1e-5
    assert again.why == {"Paint": "as in the last result"}


def test_a_start_at_another_size(patches: syn.Shoot) -> None:
    small = shoots.run(patches, size=32, method="draft")
    again = shoots.run(replace(patches, scene=replace(patches.scene, start=small)), start="last")
    off = shoots.errors(again, patches.truth)
    assert again.maps.roughness.shape == (shoots.SIZE, shoots.SIZE)
    assert np.median(off.rough) < 1e-5 and np.quantile(off.rough, 0.98) < 0.01


def test_a_wrong_start_is_left(patches: syn.Shoot, whole: Solution) -> None:
    """The particles that begin elsewhere find what the one that begins at the last result misses."""
    wrong = replace(whole, maps=replace(whole.maps, roughness=np.full_like(whole.maps.roughness, 0.95)))
    again = shoots.run(replace(patches, scene=replace(patches.scene, start=wrong)), start="last")
    off = shoots.errors(again, patches.truth)
    assert np.median(off.rough) < 1e-5 and np.quantile(off.rough, 0.98) < 0.01
