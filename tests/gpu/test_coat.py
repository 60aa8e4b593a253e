"""A coat above a material: solved for at given values, found by `auto`, kept by parts, in what views should show."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.data import Coat, Solution
from irpso_addon.core.errors import BadInput
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading import brdf
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.solve.solver import Solver
from tests.support import shoots
from tests.support import synthetic as syn
from tests.support.texels import Texels, as_metal, by_channel, exact, finish

COAT = Coat(0.6, 0.25)
solve = partial(shoots.run, size=32)


def under(texels: Texels, coat: Coat) -> Texels:
    """The same below a coat, from the observations' own geometry: one light each."""
    sin2h, spread, cos_l, _ = np.moveaxis(texels.lobes[..., 0, :].astype(np.float64), -1, 0)
    cos_v = texels.cos_v.astype(np.float64)
    cos_vh = np.minimum((cos_l + cos_v) / (2 * np.sqrt(1 - sin2h)), 1)
    clear = brdf.specular_principled(coat.roughness, sin2h, spread, cos_l, cos_v, cos_vh)
    left = 1 - coat.weight * brdf.principled_energy(coat.roughness, cos_v)[..., 1]
    rgb = left[..., None] * texels.rgb + coat.weight * clear[..., None]
    return replace(texels, rgb=np.where(texels.quality[..., None] > 0, rgb, 0).astype(np.float32))


def solved(on_gl: Any, texels: Texels, metallic: float) -> tuple[np.ndarray, np.ndarray]:
    """(roughness (h, w), base colour (h, w, 3)) of one lobe below the coat."""
    shape = texels.quality.shape[:2]

    def run(device: Device) -> tuple[np.ndarray, np.ndarray]:
        solver = Solver(device, texels.source(device), SolveSettings(size=max(16, shape[0])))
        solver.use_metallic(metallic)
        solver.use_coat(COAT)
        maps = finish(solver.solve())
        base = finish(solver.albedo(maps.roughness))
        found = device.read(maps.roughness)[..., 0].copy(), device.read(base)[..., :3].copy()
        for thing in (maps.roughness, maps.detail, base, solver, solver.source):
            thing.release()
        return found

    return on_gl(run)


@pytest.mark.parametrize("separate", [False, True], ids=["grey", "channels"])
@pytest.mark.parametrize(("metallic", "cameras"), [(0.0, 1), (0.0, 3), (0.4, 1)])
def test_what_lies_below_comes_out(on_gl, metallic, cameras, separate):
    problem, texels = exact(cameras=cameras)
    texels = under(as_metal(problem, metallic) if metallic else texels, COAT)
    rough, base = solved(on_gl, by_channel(texels) if separate else texels, metallic)
    off, colour = np.abs(rough - problem.truth.roughness), np.abs(base - problem.truth.base).max(-1)
    exactly = separate or not metallic  # else a metal's multiple scattering is approximated
    assert np.quantile(off, 0.98) < (5e-5 if exactly else 1e-3)
    assert np.quantile(colour, 0.98) < (5e-4 if exactly else 2e-3)


@pytest.fixture(scope="module")
def shoot() -> syn.Shoot:
    return syn.shoot(replace(syn.PATCHES, reflect=partial(brdf.principled, coat=COAT)), shoots.rig(lamps=10), (56, 56))


def given(shoot: syn.Shoot, **values: Any) -> Solution:
    """Solved at what an earlier result gives."""
    earlier = replace(solve(shoot, model="one-lobe", loss="squares"), coats={"Paint": COAT}, **values)
    return solve(replace(shoot, scene=replace(shoot.scene, start=earlier)), start="last")


@pytest.fixture(scope="module")
def found(shoot: syn.Shoot) -> Solution:
    return given(shoot, model={"Paint": "one-lobe-specular"}, levels={"Paint": 0.5})


def test_maps_below_a_coat_come_out(shoot, found):
    off = shoots.errors(found, shoot.truth)
    assert off.share > 0.98
    assert (found.model, found.coats, found.levels) == (
        {"Paint": "one-lobe-specular"}, {"Paint": COAT}, {"Paint": 0.5})
    assert np.median(off.rough) < 1e-3 and np.quantile(off.rough, 0.9) < 0.01
    assert np.median(off.base) < 1e-3 and np.quantile(off.base, 0.9) < 0.01


@pytest.mark.one_python
def test_a_metal_below_a_coat_comes_out():
    shoot = syn.shoot(replace(syn.PATCHES, reflect=partial(brdf.principled, metallic=0.7, coat=COAT)),
                      shoots.rig(lamps=10), (56, 56))
    found = given(shoot, model={"Paint": "one-lobe-metallic"}, metallic={"Paint": 0.7}, levels={"Paint": 0.5})
    off = shoots.errors(found, shoot.truth)
    assert (found.metallic, found.coats, found.warnings) == ({"Paint": 0.7}, {"Paint": COAT}, ())
    assert np.median(off.rough) < 1e-3 and np.quantile(off.rough, 0.9) < 0.01
    assert np.median(off.base) < 2e-3 and np.quantile(off.base, 0.9) < 0.02


def test_views_show_what_maps_below_a_coat_predict(found):
    """Gain of each view, and what is left: the prediction that checks go by has the coat's lobe."""
    shoots.check_views(found)


def test_a_part_keeps_the_coat(shoot, found):
    again = shoots.half_again(shoot, found)
    part = solve(again)
    assert (part.model, part.coats, part.levels) == (found.model, found.coats, found.levels)
    off = np.abs(part.maps.roughness - found.maps.roughness)[part.maps.coverage & ~part.maps.filled]
    assert np.median(off) < 1e-5
    with pytest.raises(BadInput, match="'Paint': its other region has a coat, for which only model Auto solves"):
        solve(again, model="one-lobe-specular")


ONE = replace(syn.PATCHES, roughness=lambda u, v: np.full_like(np.asarray(u, np.float64), 0.55))


@pytest.mark.one_python
@pytest.mark.parametrize("metallic", [0.0, 0.6])
def test_a_coat_is_found(metallic):
    """Of a material of one roughness; what it does to pictures that were not taken decides."""
    shoot = syn.shoot(replace(ONE, reflect=partial(brdf.principled, metallic=metallic, coat=COAT)),
                      shoots.rig(1, 24), (56, 56), noise=0.003)
    solution = solve(shoot, model="auto")
    assert solution.predictions["Paint"].taken.endswith("coat")
    coat = solution.coats["Paint"]
    assert coat.weight == pytest.approx(COAT.weight, abs=0.08)
    assert coat.roughness == pytest.approx(COAT.roughness, abs=0.03)
    assert solution.metallic.get("Paint", 0.0) == pytest.approx(metallic, abs=0.1)
    off = shoots.errors(solution, shoot.truth)
    assert np.median(off.rough) < 0.05 and np.median(off.base) < 0.03


def not_lambert(base: np.ndarray, rough: np.ndarray, L: np.ndarray, V: np.ndarray, N: np.ndarray) -> np.ndarray:
    """The diffuse falls with the light's angle by itself: no model has that, and a wide lobe mends a part of it."""
    fall = np.clip((L * N).sum(-1), 0, 1)[..., None] ** 2 - 0.5
    return np.asarray(brdf.principled(base, rough, L, V, N) + 0.5 * base / np.pi * fall)


@pytest.mark.one_python
def test_none_is_found_where_there_is_none():
    """A coat is tried, because nothing explains the material, and not taken."""
    shoot = syn.shoot(replace(ONE, reflect=not_lambert), shoots.rig(1, 24), (56, 56), noise=0.003)
    solution = solve(shoot, model="auto")
    assert solution.coats == {}
    assert any(name.endswith("coat") for name in solution.predictions["Paint"].tried)


@pytest.mark.one_python
def test_a_coat_is_found_above_texels_that_differ():
    """Of four roughnesses; on none of them may the coat's own lobe be taken for the material's."""
    shoot = syn.shoot(replace(syn.PATCHES, reflect=partial(brdf.principled, coat=COAT)), shoots.rig(1, 24), (56, 56),
                      noise=0.003)
    solution = solve(shoot, model="auto")
    coat = solution.coats["Paint"]
    assert coat.weight == pytest.approx(COAT.weight, abs=0.1) and coat.roughness == pytest.approx(0.25, abs=0.04)
    assert {"a value a texel and coat", "one value, level and coat"} <= set(solution.predictions["Paint"].tried)
    assert np.median(shoots.errors(solution, shoot.truth).base) < 0.05
