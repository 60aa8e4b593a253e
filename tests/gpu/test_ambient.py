"""Light from all around beside the lamps, and files that are not linear: found, and then taken for what they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.change_records import Calibration
from irpso_addon.core.data import Camera, Solution
from irpso_addon.core.shading import brdf
from tests.support import shoots
from tests.support import synthetic as syn

PIXELS = (96, 96)
AUTO = {"model": "one-lobe", "registration": "given", "indirect": "off", "lamps": "auto", "exposures": "auto",
        "size": 32}
GIVEN = {"lamps": "given", "exposures": "given"}


@pytest.fixture(scope="module")
def plane() -> syn.Shoot:
    """Two cameras, eight lamps each."""
    return syn.shoot(syn.PATCHES, shoots.rig(), PIXELS)


def surrounded(shoot: syn.Shoot, radiance: tuple[float, float, float]) -> syn.Shoot:
    """The pictures with light from everywhere."""
    cameras = {view.camera.name: view.camera for view in shoot.scene.views}
    height, width = next(iter(shoot.images.values())).rgb.shape[:2]
    light = {name: (_from_everywhere(shoot.truth, camera, width, height) * np.array(radiance)).astype(np.float32)
             for name, camera in cameras.items()}
    images = {}
    for view in shoot.scene.views:
        picture = shoot.images[view.image.name]
        images[view.image.name] = replace(picture, rgb=picture.rgb + light[view.camera.name])
    return replace(shoot, images=images)


known: dict[tuple[bytes, int, int], np.ndarray] = {}  # light from everywhere, by camera: several tests have the same


def _from_everywhere(truth: syn.Truth, camera: Camera, width: int, height: int) -> np.ndarray:
    """(h, w, 3) radiance under 1 from each direction above the plane, which hides those below: their sum."""
    assert truth is syn.PATCHES
    key = camera.world_to_camera.tobytes(), width, height
    if key not in known:
        known[key] = _sum_from_everywhere(truth, camera, width, height)
    return known[key]


def _sum_from_everywhere(truth: syn.Truth, camera: Camera, width: int, height: int) -> np.ndarray:
    count = 400
    i = np.arange(count) + 0.5
    z, turn = i / count, i * np.pi * (3 - 5**0.5)
    ways = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], -1)
    origin, direction = syn.pixel_rays(camera, width, height)
    points = np.nan_to_num(syn.meet_plane(origin, direction))
    shown = (np.abs(points[..., :2]) <= 1).all(-1)
    points, direction = points[shown], direction[shown]
    uv, normal = syn.plane_uv(points), syn.plane_normal(points)
    base, rough = (f(uv[..., 0], uv[..., 1]) for f in (truth.base, truth.roughness))
    total = np.zeros((height, width, 3))
    for way in ways:
        cosine = np.maximum(normal @ way, 0)
        total[shown] += cosine[..., None] * brdf.principled(
            base, rough, np.broadcast_to(way, points.shape), -direction, normal)
    return total * (2 * np.pi / count)


def bent(shoot: syn.Shoot, power: float) -> syn.Shoot:
    """Files that hold radiance to a power."""
    return replace(shoot, images={name: replace(picture, rgb=picture.rgb**np.float32(power))
                                  for name, picture in shoot.images.items()})


def told(shoot: syn.Shoot, **more: object) -> syn.Shoot:
    """Views that are known to be so."""
    return replace(shoot, scene=replace(shoot.scene, views=tuple(
        replace(view, **more) for view in shoot.scene.views)))


def found(solution: Solution) -> Calibration:
    assert solution.calibration is not None
    return solution.calibration


def rough_error(shoot: syn.Shoot, solution: Solution) -> float:
    return float(np.mean(shoots.errors(solution, shoot.truth).rough))


RADIANCE = 0.04, 0.05, 0.07  # W/(m^2 sr); a white surface below a lamp shows 1.6


@pytest.fixture(scope="module")
def room(plane: syn.Shoot) -> syn.Shoot:
    return surrounded(plane, RADIANCE)


@pytest.mark.one_python
def test_known_light_from_everywhere(plane: syn.Shoot, room: syn.Shoot) -> None:
    """Where views have it, maps are nearly those without: what surfaces hide of it is found by shadows."""
    ignored = rough_error(plane, shoots.run(room, **AUTO | GIVEN))
    known = rough_error(plane, shoots.run(told(room, ambient_radiance=RADIANCE), **AUTO | GIVEN))
    assert ignored > 0.05 and known < 0.1 * ignored


def test_light_from_everywhere_is_found(plane: syn.Shoot, room: syn.Shoot) -> None:
    solution = shoots.run(room, **AUTO)
    ambient = found(solution).ambient
    assert ambient is not None
    np.testing.assert_allclose(ambient.radiance, RADIANCE, rtol=0.05)
    assert rough_error(plane, solution) < 0.15 * rough_error(plane, shoots.run(room, **AUTO | GIVEN))


@pytest.mark.one_python
@pytest.mark.parametrize("power", [0.8, 0.95, 1.2])
def test_a_response_is_found(plane: syn.Shoot, power: float) -> None:
    wrong = bent(plane, power)
    solution = shoots.run(wrong, **AUTO)
    response = found(solution).response
    assert response is not None and response.exponent == pytest.approx(power, rel=0.004)
    assert rough_error(plane, solution) < 0.15 * rough_error(plane, shoots.run(wrong, **AUTO | GIVEN))


@pytest.mark.one_python
def test_both_at_once(plane: syn.Shoot) -> None:
    radiance = 0.01, 0.012, 0.015
    wrong = bent(surrounded(plane, radiance), 0.9)
    solution = shoots.run(wrong, **AUTO)
    calibration = found(solution)
    assert calibration.response is not None and calibration.ambient is not None
    assert calibration.response.exponent == pytest.approx(0.9, rel=0.002)
    np.testing.assert_allclose(calibration.ambient.radiance, radiance, rtol=0.04)  # 2.4 % of red here
    assert rough_error(plane, solution) < 0.1 * rough_error(plane, shoots.run(wrong, **AUTO | GIVEN))


@pytest.mark.one_python
def test_faint_light_in_noisy_pictures(plane: syn.Shoot) -> None:
    """About as strong as the noise of 1 %: less than half of the error is nothing to ask for."""
    radiance = 0.008, 0.01, 0.012
    rng = np.random.default_rng(3)
    faint = surrounded(plane, radiance)
    noisy = replace(faint, images={name: replace(picture, rgb=np.float32(
        picture.rgb * (1 + 0.01 * rng.standard_normal(picture.rgb.shape)))) for name, picture in faint.images.items()})
    solution = shoots.run(noisy, **AUTO)
    calibration = found(solution)
    assert calibration.ambient is not None and not calibration.lamps and calibration.response is None
    np.testing.assert_allclose(calibration.ambient.radiance, radiance, rtol=0.1)
    assert rough_error(plane, solution) < 0.5 * rough_error(plane, shoots.run(noisy, **AUTO | GIVEN))


def finds_light_alone(shoot: syn.Shoot, radiance: tuple[float, float, float], share: float) -> None:
    """Of pictures with that light a solve finds nothing else, and leaves less than a share of the roughness' error."""
    faint = surrounded(shoot, radiance)
    solution = shoots.run(faint, **AUTO)
    calibration = found(solution)
    assert calibration.ambient is not None and calibration.response is None and not calibration.lamps
    np.testing.assert_allclose(calibration.ambient.radiance, radiance, rtol=0.15)
    assert rough_error(shoot, solution) < share * rough_error(shoot, shoots.run(faint, **AUTO | GIVEN))


@pytest.mark.one_python
@pytest.mark.parametrize("count", [16, 20])
def test_light_from_everywhere_beside_a_carried_flash(count: int) -> None:
    """A response bends brightness alike, so that a fit of both runs away; light from everywhere alone does not."""
    shoot = shoots.carried_flash(count)
    finds_light_alone(shoot, (0.0024, 0.003, 0.0036), 0.2)
    assert shoots.put_right(shoot, **AUTO).calibration is None


@pytest.mark.one_python
def test_faint_light_from_everywhere_beside_a_carried_flash() -> None:
    """1.6 % of the flash's.  No camera has two views: a base colour for each of them would explain any light."""
    finds_light_alone(shoots.carried_flash(20), (0.0007, 0.0009, 0.0011), 0.5)
