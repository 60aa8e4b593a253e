"""The size of lamps that are all alike, told from what they light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.calibration.calibrate import calibrate
from irpso_addon.core.calibration.lamp_size import LampSize, lamp_size, sized
from irpso_addon.core.calibration.rig_fit import fit_rig
from irpso_addon.core.calibration.rig_numbers import Free
from irpso_addon.core.calibration.rig_sample import RigSample
from irpso_addon.core.data import Light
from irpso_addon.core.evaluation.folds import split
from irpso_addon.core.job import run_to_end
from irpso_addon.core.shading import brdf
from irpso_addon.core.shading.lights import extent_of, light_irradiance, with_extent
from tests.support import tilted_sphere as balls
from tests.support.ball_in_room import ball as ball_in_room
from tests.support.tilted_sphere import Reflect

POINTS = 200  # of a sun


def silent(progress: object) -> None:
    """Nobody looks."""


def disc(way: np.ndarray, half_angle: float) -> np.ndarray:
    """(POINTS, 3) directions that fill a cone evenly: a Fibonacci spiral."""
    z = 1 - (1 - np.cos(half_angle)) * (np.arange(POINTS) + 0.5) / POINTS
    turn, ring = 2.39996 * np.arange(POINTS), np.sqrt(1 - z * z)
    across = balls.unit(np.cross([0.1, 0.2, 1.0], way))
    return z[:, None] * way + ring[:, None] * (
        np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * np.cross(way, across))


def wide(reflect: Reflect, half_angle: float) -> Reflect:
    """What a sun of that size shows, over the cosine to its middle; its irradiance at right angles stays."""
    def shown(way: np.ndarray, normal: np.ndarray) -> np.ndarray:
        total, across = np.zeros_like(normal), 0.0
        for part in disc(way, half_angle):
            total += reflect(part, normal) * np.maximum(normal @ part, 0.0)[:, None]
            across += float(part @ way)
        return total / across / np.maximum(normal @ way, 1e-9)[:, None]
    return shown


def glossy(normal: np.ndarray) -> np.ndarray:
    """Roughnesses of patches."""
    return np.where(np.sin(9 * normal[:, 0]) * np.sin(9 * normal[:, 1]) > 0, 0.25, 0.5)


def patches(way: np.ndarray, normal: np.ndarray) -> np.ndarray:
    value = [np.broadcast_to(v, normal.shape) for v in (balls.BASE, way, balls.TOWARD)]
    return np.asarray(brdf.principled(value[0], glossy(normal), value[1], value[2], normal))


def ball(half_angle: float, reflect: Reflect = patches, **settings: float) -> RigSample:
    """Under suns of that size that are believed to be points."""
    return balls.sphere(wide(reflect, half_angle) if half_angle else reflect, **settings)[0].rig  # type: ignore[arg-type]


def found(sample: RigSample) -> LampSize | None:
    folds = split(sample.texels)
    assert folds is not None
    first = run_to_end(fit_rig(sample, Free(False, False), rounds=1), silent)
    return run_to_end(lamp_size(sample, folds, first), silent)


def with_lamps(sample: RigSample, change: Callable[[int, Light], Light]) -> RigSample:
    views = tuple(replace(view, lights=tuple(change(n, light) for light in view.lights))
                  for n, view in enumerate(sample.rig.views))
    return replace(sample, rig=replace(sample.rig, views=views))


@pytest.mark.parametrize(("half_angle", "slope"), [(0.15, 0.0), (0.2, 0.01), (0.3, 0.01), (0.3, 0.02)])
def test_suns_that_are_believed_to_be_points(half_angle: float, slope: float) -> None:
    """2 % noise, normals off by up to a degree: within 15 %, which the standard error covers."""
    size = found(ball(half_angle, noise=0.02, slope=slope))
    assert size is not None
    assert size.extent == pytest.approx(half_angle, rel=0.15)
    assert abs(size.extent - half_angle) < 3 * size.error and size.error < 0.2 * half_angle
    assert size.changed.lightness < size.given.lightness


def test_suns_that_are_smaller_than_believed() -> None:
    """Points that are believed to be wide."""
    size = found(sized(ball(0.0, noise=0.01), 0.3)[0])
    assert size is not None and size.extent < 0.06


@pytest.mark.parametrize("reflect", [balls.principled(0.4), patches, balls.rough_diffuse, balls.dielectric_diffuse])
@pytest.mark.parametrize("settings", [{}, {"noise": 0.03}, {"slope": 0.05}, {"turned": 0.03}])
def test_points_stay_points(reflect: Reflect, settings: dict[str, float]) -> None:
    """Noise, bumps, suns that stand elsewhere, and a diffuse that is not Lambert's are no size."""
    assert found(ball(0.0, reflect, **settings)) is None


@pytest.mark.parametrize("around", [0.01, 0.03, 0.1])
def test_light_from_all_around_is_no_size(around: float) -> None:
    """It reaches what faces away from the lamps too."""
    assert found(ball_in_room(around)) is None


def test_a_size_is_changed_as_pictures_show_it() -> None:
    """By brute force: what points reflect under wide suns, over what the changed sample says of their irradiance."""
    small, large = ball(0.0), ball(0.2)
    changed, brighter = sized(small, 0.2)
    lit = (small.texels.quality > 0) & (small.texels.lobes[..., 0, 2] > 0.3)
    way = np.stack([view.lights[0].matrix[:3, 2] for view in small.rig.views])
    by_points = np.stack([np.maximum(small.normal @ disc(one, 0.2).T, 0.0).sum(-1) / (disc(one, 0.2) @ one).sum()
                          for one in way], -1)
    np.testing.assert_allclose((brighter * small.texels.lobes[..., 0, 2])[lit], by_points[lit], rtol=5e-3)
    whole = np.stack([light_irradiance(view.lights[0], small.position, small.normal) for view in changed.rig.views], -1)
    np.testing.assert_allclose(by_points, whole, atol=5e-3)
    tail = small.texels.lobes[..., 0, 0] > 0.1  # where half vectors are off the normal, sin2h grows by their spread
    mean = np.stack([1 - (small.normal @ balls.unit(disc(one, 0.2) + balls.TOWARD).T).mean(-1) ** 2 for one in way], -1)
    disc_mean = changed.texels.lobes[..., 0, 0] + 0.5 * changed.texels.lobes[..., 0, 1]
    np.testing.assert_allclose(disc_mean[lit & tail], mean[lit & tail], rtol=0.05)
    assert np.median(np.abs(large.texels.reflected / brighter[..., None] - small.texels.reflected)[lit]) < 0.01


def test_lamps_that_are_not_alike_keep_their_sizes() -> None:
    """One number says nothing of several sizes, of a lamp that the user measured, nor of a flash on a camera."""
    sample = ball(0.2, noise=0.02)
    mixed = with_lamps(sample, lambda n, light: with_extent(light, 0.1 * (n % 2)))
    assert found(mixed) is None
    assert found(with_lamps(sample, lambda n, light: replace(light, kept=n == 0))) is None
    group = replace(sample.rig.groups[0], cameras=("Camera",))
    assert found(replace(sample, rig=replace(sample.rig, groups=(group, *sample.rig.groups[1:])))) is None


def test_the_rest_is_found_beside_it() -> None:
    """With lamps left alone, nothing is changed; else the size alone, as nothing else is off."""
    sample = ball(0.2, noise=0.02)
    assert run_to_end(calibrate(sample, False, True), silent) is None
    judged = run_to_end(calibrate(sample, True, True), silent)
    assert judged is not None and judged.found.change.extent == pytest.approx(0.2, rel=0.15)
    assert np.linalg.norm(judged.found.change.offset, axis=1).max() < 0.02
    assert all(extent_of(light) == judged.found.change.extent
               for light in sample.rig.lights(judged.found.change).values())


@pytest.mark.parametrize(("light", "extent"), [
    (Light("Lamp", "POINT", np.ones(3), np.eye(4), radius=0.1), 0.1),
    (Light("Lamp", "SUN", np.ones(3), np.eye(4), radius=0.1), 0.1),
    (Light("Lamp", "AREA", np.ones(3), np.diag([2.0, 3.0, 1.0, 1.0]), shape="RECTANGLE", size=(0.3, 0.1)), 0.3),
    (Light("Lamp", "AREA", np.ones(3), np.diag([2.0, 3.0, 1.0, 1.0]), shape="DISK", size=(0.2, 9.0)), 0.3),
    (Light("Lamp", "AREA", np.ones(3), np.eye(4), size=(0.0, 0.0)), 0.0),
])
def test_extents(light: Light, extent: float) -> None:
    """Half of the width in the world, which a change sets; power stays."""
    assert extent_of(light) == pytest.approx(extent)
    if extent:
        assert extent_of(with_extent(light, 0.4)) == pytest.approx(0.4)
        assert with_extent(light, 0.4).power is light.power
