"""A rough diffuse: solved for at given values, found by `auto`, kept by parts, in what views should show."""

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
from tests.support.texel_problem import Problem
from tests.support.texels import Texels, by_channel, exact, finish

ROUGH = 0.6
REFLECT = partial(brdf.principled, diffuse_roughness=ROUGH)
solve = partial(shoots.run, size=32)


def roughened(problem: Problem) -> Texels:
    """What one lobe of the problem's roughness and base colour reflects above a rough diffuse; one light each."""
    sin2h, radius2, cos_l, _ = np.moveaxis(problem.lobes[..., 0, :].astype(np.float64), -1, 0)
    cos_v, r = problem.cos_v.astype(np.float64), problem.truth.roughness[..., None]
    between = (cos_l + cos_v) ** 2 / (2 * (1 - sin2h)) - 1
    lobe = brdf.specular_principled(r, sin2h, radius2, cos_l, cos_v, np.minimum(np.sqrt((1 + between) / 2), 1))
    below = 1 - brdf.principled_energy(r, cos_v)[..., 1]
    base = problem.truth.base[:, :, None]
    rgb = brdf.diffuse_rough(base, cos_l, cos_v, between, ROUGH) * below[..., None] + lobe[..., None]
    rgb = np.where(problem.quality[..., None] > 0, rgb, 0).astype(np.float32)
    return Texels(rgb, problem.quality, problem.cos_v, problem.lobes, problem.groups)


def solved(on_gl: Any, texels: Texels, roughness: float) -> tuple[np.ndarray, np.ndarray]:
    """(roughness (h, w), base colour (h, w, 3)) of one lobe above a diffuse of that Diffuse Roughness."""
    shape = texels.quality.shape[:2]

    def run(device: Device) -> tuple[np.ndarray, np.ndarray]:
        solver = Solver(device, texels.source(device), SolveSettings(size=max(16, shape[0])))
        solver.use_diffuse_roughness(roughness)
        maps = finish(solver.solve())
        base = finish(solver.albedo(maps.roughness))
        found = device.read(maps.roughness)[..., 0].copy(), device.read(base)[..., :3].copy()
        for thing in (maps.roughness, maps.detail, base, solver, solver.source):
            thing.release()
        return found

    return on_gl(run)


@pytest.mark.parametrize("separate", [False, True], ids=["grey", "channels"])
@pytest.mark.parametrize("cameras", [1, 3])
def test_what_is_above_a_rough_diffuse_comes_out(on_gl, cameras, separate):
    """Base colour, of which multiple scattering is made, is that of what a texel shows in the mean: about right."""
    problem, _ = exact(cameras=cameras)
    texels = roughened(problem)
    rough, base = solved(on_gl, by_channel(texels) if separate else texels, ROUGH)
    off, colour = np.abs(rough - problem.truth.roughness), np.abs(base - problem.truth.base).max(-1)
    assert np.median(off) < 5e-3 and np.quantile(off, 0.9) < 0.035
    assert np.median(colour) < 3e-3 and np.quantile(colour, 0.9) < 6e-3
    smooth, _ = solved(on_gl, texels, 0.0)
    assert np.median(np.abs(smooth - problem.truth.roughness)) > 0.05


@pytest.fixture(scope="module")
def shoot() -> syn.Shoot:
    return syn.shoot(replace(syn.PATCHES, reflect=REFLECT), shoots.rig(lamps=10), (56, 56))


@pytest.fixture(scope="module")
def found(shoot: syn.Shoot) -> Solution:
    """Solved at what an earlier result gives."""
    earlier = replace(solve(shoot, model="one-lobe", loss="squares"), model={"Paint": "one-lobe-specular"},
                      levels={"Paint": 0.5}, diffuse_roughness={"Paint": ROUGH})
    return solve(replace(shoot, scene=replace(shoot.scene, start=earlier)), start="last")


def test_maps_above_a_rough_diffuse_come_out(shoot, found):
    off = shoots.errors(found, shoot.truth)
    assert off.share > 0.98
    assert (found.model, found.diffuse_roughness, found.levels, found.coats) == (
        {"Paint": "one-lobe-specular"}, {"Paint": ROUGH}, {"Paint": 0.5}, {})
    assert np.median(off.rough) < 1e-3 and np.quantile(off.rough, 0.9) < 0.01
    assert np.median(off.base) < 1e-3 and np.quantile(off.base, 0.9) < 0.01


def test_views_show_what_maps_with_a_rough_diffuse_predict(found):
    """Gain of each view, and what is left: the prediction that checks go by has the rough diffuse of each view."""
    shoots.check_views(found)


def test_a_part_keeps_the_diffuse_roughness(shoot, found):
    again = shoots.half_again(shoot, found)
    part = solve(again)
    assert (part.model, part.diffuse_roughness, part.levels) == (found.model, found.diffuse_roughness, found.levels)
    off = np.abs(part.maps.roughness - found.maps.roughness)[part.maps.coverage & ~part.maps.filled]
    assert np.median(off) < 1e-5
    with pytest.raises(BadInput, match="'Paint': its other region has a Diffuse Roughness, for which only model Auto"):
        solve(again, model="one-lobe-specular")


ONE = replace(syn.PATCHES, roughness=lambda u, v: np.full_like(np.asarray(u, np.float64), 0.4))


@pytest.mark.one_python
@pytest.mark.parametrize("roughness", [0.25, 0.8])
def test_a_rough_diffuse_is_found(roughness):
    """Of a material of one roughness, and nothing else is taken for it."""
    shoot = syn.shoot(replace(ONE, reflect=partial(brdf.principled, diffuse_roughness=roughness)),
                      shoots.rig(1, 24), (56, 56), noise=0.003)
    solution = solve(shoot, model="auto")
    assert solution.predictions["Paint"].taken.endswith("rough diffuse")
    assert solution.diffuse_roughness["Paint"] == pytest.approx(roughness, abs=0.02)
    assert (solution.metallic, solution.coats) == ({}, {})
    off = shoots.errors(solution, shoot.truth)
    assert np.median(off.rough) < 0.01 and np.median(off.base) < 0.01


@pytest.mark.one_python
def test_it_is_found_where_a_metal_leaves_little():
    """Under a flash that cameras above the plane carry: a Metallic of 0.98 predicts left-out views to 1.6 %."""
    views = []
    for n in range(8):
        turn, tilt = 2.2 * n + 0.3, np.radians(5 + 30 * n / 7)
        place = 4.4 * np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
        camera = syn.camera(place, name=f"Camera {n}")
        axes = camera.world_to_camera[:3, :3].T
        views.append((camera, [syn.lamp(place + axes @ (0.6, 0.1, 0.0), name=f"Flash {n}")]))
    matt = syn.Truth(
        base=lambda u, v: np.stack([0.35 + 0.1 * np.sin(9 * u), 0.25 + 0.1 * np.sin(7 * v), 0.3 + 0 * u], -1),
        roughness=lambda u, v: np.full_like(u, 0.9),
        reflect=partial(brdf.principled, diffuse_roughness=0.35, level=0.2))
    shoot = syn.shoot(matt, views, (56, 56), noise=0.01)
    solution = solve(shoot, model="auto", lamps="given", exposures="given")
    assert solution.metallic == {}
    assert solution.diffuse_roughness["Paint"] == pytest.approx(0.35, abs=0.02)
    assert np.median(shoots.errors(solution, shoot.truth).base) < 0.01


@pytest.mark.one_python
def test_it_is_found_below_texels_that_differ():
    """Of four roughnesses, which no one value explains."""
    shoot = syn.shoot(replace(syn.PATCHES, reflect=REFLECT), shoots.rig(1, 24), (56, 56), noise=0.003)
    solution = solve(shoot, model="auto")
    assert solution.predictions["Paint"].taken.startswith("a value a texel")
    assert solution.diffuse_roughness["Paint"] == pytest.approx(ROUGH, abs=0.03)
    off = shoots.errors(solution, shoot.truth)
    assert np.median(off.rough) < 0.02 and np.median(off.base) < 0.01


@pytest.mark.one_python
@pytest.mark.parametrize("reflect", [brdf.principled, partial(brdf.principled, metallic=1.0),
                                     partial(brdf.principled, coat=Coat(0.6, 0.25))], ids=["paint", "metal", "coat"])
def test_none_is_found_where_there_is_none(reflect):
    shoot = syn.shoot(replace(ONE, reflect=reflect), shoots.rig(1, 24), (56, 56), noise=0.003)
    solution = solve(shoot, model="auto")
    assert solution.diffuse_roughness == {}
