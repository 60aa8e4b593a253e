"""Each warning fires when it should, with its name and number, and is silent when it should be.

Exact pictures of a plane (synthetic.py), solved with something wrong in the scene or in the pictures.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.check_records import Checks
from irpso_addon.core.checks.warnings import warnings
from irpso_addon.core.data import Light, Solution, View
from irpso_addon.gpu.maps.finish_maps import FinishedMaps
from tests.support import shoots
from tests.support import synthetic as syn

PIXELS = (96, 96)
CAUSES = ("non-linear", "pixels off", "appear", "check its power", "exposure", "shadows are", "are clipped",
          "unexplained", "highlights are off")


@pytest.fixture(scope="module")
def plane() -> syn.Shoot:
    """Two cameras, eight lamps each, all in front: a pixel sees most highlights pass."""
    return syn.shoot(syn.PATCHES, shoots.rig(), PIXELS)


def solve(shoot: syn.Shoot, **settings: Any) -> Solution:
    return shoots.run(shoot, model="one-lobe", registration="given", indirect="off", **settings)


def causes(solution: Solution) -> list[str]:
    """The lines that say what is wrong with scene or pictures."""
    assert solution.checks is not None
    lines = warnings(solution.checks)
    assert all("\n" not in line and set(lines) <= set(solution.warnings) for line in lines)
    return [line for line in lines if any(cause in line for cause in CAUSES)]


def only(solution: Solution, cause: str) -> str:
    """The one cause that is told."""
    lines = causes(solution)
    assert len(lines) == 1 and cause in lines[0], lines
    return lines[0]


def percent(line: str) -> float:
    """The first figure in per cent."""
    found = re.search(r"([-+]?[\d.]+) ?%", line)
    assert found, line
    return float(found[1])


def relit(shoot: syn.Shoot, change: Callable[[Light], Light], name: str = "Light 3") -> syn.Shoot:
    """The scene says something else of a lamp than what the pictures show."""
    views = [replace(v, lights=tuple(change(x) if x.name == name else x for x in v.lights)) for v in shoot.scene.views]
    return replace(shoot, scene=replace(shoot.scene, views=tuple(views)))


def shown(shoot: syn.Shoot, change: Callable[[np.ndarray, str], np.ndarray], names: Sequence[str] = ()) -> syn.Shoot:
    """Pictures changed: all, or those named."""
    images = {name: replace(image, rgb=change(image.rgb, name).astype(np.float32)) if not names or name in names else
              image for name, image in shoot.images.items()}
    return replace(shoot, images=images)


def checked(solution: Solution) -> Checks:
    assert solution.checks is not None
    return solution.checks


def test_silent_where_all_is_well(plane) -> None:
    solution = solve(plane)
    assert causes(solution) == [] and warnings(checked(solution)) == ()
    checks = checked(solution)
    assert checks.structure < 0.002 and checks.clipped == 0 and checks.no_highlight < 0.15
    assert max(abs(v.residual.gain - 1) for v in checks.views) < 1e-3
    assert max(light.offset_share for light in checks.lights) < 0.003


def test_faces_outside_the_square_say_nothing(plane) -> None:
    """Half of the plane lies in the next square, which is not solved: its pixels show nothing that the maps hold."""
    mesh = plane.scene.mesh
    half = replace(plane, scene=replace(plane.scene, mesh=replace(mesh, uvs=mesh.uvs * np.array([2, 1], np.float32))))
    solution = solve(half)
    assert any("50.0 % of its faces are outside the 0-1 UV square" in line for line in solution.warnings)
    assert causes(solution) == []
    checks = checked(solution)
    assert checks.structure < 0.002
    assert max(abs(v.residual.gain - 1) for v in checks.views) < 1e-3


@pytest.mark.parametrize("noise", [0.01, 0.05])
def test_silent_in_noise(noise) -> None:
    """Noise is no fault of scene or pictures, and its size is found."""
    noisy = syn.shoot(syn.PATCHES, shoots.rig(), PIXELS, noise=noise)
    solution = solve(noisy)
    assert causes(solution) == []
    assert checked(solution).noise == pytest.approx(noise, rel=0.15)  # 12 % and 4 % more here


def test_a_lamp_of_wrong_power(plane) -> None:
    """The scene says 10 % more watts than there were: its views show 1 / 1.1 of the light."""
    line = only(solve(relit(plane, lambda x: replace(x, power=1.1 * x.power))), "check its power")
    assert "'Light 3'" in line and "darker" in line and percent(line) == pytest.approx(9.1, abs=0.6)  # 8.7 here


def test_a_lamp_in_the_wrong_place(plane) -> None:
    """Moved by 0.2 m across its distance of 3.1 m: named, and by how much and whither."""
    def moved(light: Light) -> Light:
        matrix = light.matrix.copy()
        aside = np.cross(matrix[:3, 3], (0, 0, 1.0))
        matrix[:3, 3] += 0.2 * aside / np.linalg.norm(aside)
        return replace(light, matrix=matrix)

    solution = solve(relit(plane, moved))
    line = only(solution, "check its place")
    light = next(x for x in checked(solution).lights if x.name == "Light 3")
    assert "'Light 3'" in line and percent(line) == round(100 * light.offset_share)
    assert light.offset_share == pytest.approx(0.2 / 3.1, rel=0.10)  # 6.9 % less here
    true = plane.scene.views[3].lights[0].matrix[:3, 3]
    wrong = moved(plane.scene.views[3].lights[0]).matrix[:3, 3]
    back = np.array(light.offset)
    assert back @ (true - wrong) / np.linalg.norm(back) / np.linalg.norm(true - wrong) > 0.94  # 0.958 here


def test_one_exposure_off(plane) -> None:
    line = only(solve(shown(plane, lambda rgb, _: 1.05 * rgb, ["view_05.exr"])), "exposure")
    assert "'view_05.exr'" in line and percent(line) == pytest.approx(5, abs=0.5)  # 4.7 here


def test_drifting_exposures(plane) -> None:
    """Sixteen views, each off by some per cent: one line, not sixteen, with their robust spread and the worst."""
    rng = np.random.default_rng(2)
    gains = {name: 1 + 0.04 * rng.standard_normal() for name in plane.images}
    line = only(solve(shown(plane, lambda rgb, name: gains[name] * rgb)), "exposure drifts")
    logs = np.log(list(gains.values()))
    spread = 1.4826 * np.median(np.abs(logs - np.median(logs)))  # 2.6 % of these draws
    assert percent(line) == pytest.approx(100 * spread, abs=0.4)  # 2.4 here
    worst = max(gains, key=lambda name: abs(np.log(gains[name])))
    told = re.search(r"\(([-+][\d.]+) % in '(.+)'\)", line)
    assert told and told[2] == worst and float(told[1]) == pytest.approx(100 * (gains[worst] - 1), abs=0.3)


def srgb(value: np.ndarray) -> np.ndarray:
    return np.where(value <= 0.0031308, 12.92 * value, 1.055 * np.maximum(value, 1e-9) ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize("curve", [srgb, lambda v: v**0.9, lambda v: 1 - np.exp(-8 * v)], ids=["sRGB", "gamma", "film"])
def test_pictures_that_are_not_linear(plane, curve) -> None:
    """Read as linear they are too flat; the exponent is below 1, and about that of a gamma curve."""
    line = only(solve(shown(plane, lambda rgb, _: curve(rgb))), "all views: look non-linear")
    power = float(re.search(r"exponent ([\d.]+)", line)[1])
    assert power < 0.97
    if curve(4.0) == pytest.approx(4**0.9):
        assert power == pytest.approx(0.9, abs=0.025)  # lobes take a part of it


def test_one_picture_that_is_not_linear(plane) -> None:
    line = only(solve(shown(plane, lambda rgb, _: srgb(rgb), ["view_02.exr"])), "non-linear")
    assert line.startswith("'view_02.exr': ")


def test_clipped_pictures(plane) -> None:
    """The brightest 5 % of each picture left out, as core/images/reference_image.py does with clipped pixels."""
    def cut(view: View):
        image = plane.images[view.image.name]
        bright = image.rgb.max(-1)
        valid = bright < np.quantile(bright[image.coverage > 0.5], 0.95)
        return replace(image, valid=valid, rgb=np.where(valid[..., None], image.rgb, 0))

    cutting = replace(plane, images={v.image.name: cut(v) for v in plane.scene.views})
    assert percent(only(solve(cutting), "are clipped")) == pytest.approx(5, abs=0.6)


def test_light_where_there_is_none() -> None:
    """A box throws shadows; 5 % of the light fills them."""
    block = ((-0.35, -0.35, 0.25), (0.35, 0.35, 0.6))
    shaded = syn.shoot(syn.PATCHES, shoots.rig(), PIXELS, blocks=[block])
    assert causes(solve(shaded)) == []
    level = float(np.median([np.median(i.rgb[i.coverage > 0.5]) for i in shaded.images.values()]))
    filled = shown(shaded, lambda rgb, _: rgb + 0.05 * level * (rgb.any(-1, keepdims=True) | True))
    solution = solve(filled)
    line = causes(solution)[0]
    assert "shadows are" in line and percent(line) == pytest.approx(5, abs=1.2)  # 4.2 here


def test_few_views() -> None:
    """Two lamps give each texel two observations; and with no highlight near, roughness is a guess."""
    two = syn.shoot(syn.PATCHES, shoots.rig(cameras=1, lamps=2), PIXELS, noise=0.01)
    lines = warnings(checked(solve(two)))
    assert any("have fewer than 3 good observations (median 2)" in line for line in lines), lines


def test_no_highlight() -> None:
    """Lamps all at one side, cameras above: no half vector comes near the normals."""
    aside = [syn.lamp((3.0 * np.cos(t), 3.0 * np.sin(t), 1.0), name=f"Light {i}")
             for i, t in enumerate(np.linspace(-0.3, 0.3, 8))]
    rig = [(camera, [light]) for camera in syn.cameras(1) for light in aside]
    matt = replace(syn.PATCHES, roughness=syn.quarters([0.2, 0.2, 0.2, 0.2]))
    solution = solve(syn.shoot(matt, rig, PIXELS, noise=0.01))
    assert causes(solution) == []
    line = next(x for x in warnings(checked(solution)) if "no highlight came near" in x)
    assert percent(line) > 8
    assert checked(solution).no_highlight > 0.9


def test_places_that_are_black_in_all_pictures_do_not_fill_the_residual() -> None:
    """As behind the edge of an object that is smaller than its mesh: what is predicted there is far too bright."""
    relative = np.full((10, 10), 0.05, np.float32)
    relative[0], relative[5, 5] = 1400.0, 7.0
    made: Any = SimpleNamespace(relative=relative)
    squared = FinishedMaps.squared_residuals(made, relative < 100)
    assert len(squared) == 90 and squared.mean() == pytest.approx((89 * 0.05**2 + 1) / 90)
    assert FinishedMaps.squared_residuals(made, relative > 0).mean() < 0.12
