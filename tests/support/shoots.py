"""Runs of the whole pipeline on synthetic pictures (synthetic.py), and how far their maps are from the truth."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.data import Light, Region, Solution
from irpso_addon.core.errors import Cancelled
from irpso_addon.core.job import Progress
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.gbuffer.texel_grid import draw_texels
from irpso_addon.gpu.maps.partial_solve import partial_solve_of
from irpso_addon.solve import pipeline
from irpso_addon.solve.gpu_path import Given, PutRight, put_views_right
from irpso_addon.solve.stages import Clock
from tests.support import synthetic as syn

SIZE = 64
METHODS = ("refined", "swarm")
# To look for what lamps, exposures and normals have wrong takes longer than a solve: for tests of something else.
AS_GIVEN = {"lamps": "given", "exposures": "given", "normals": "mesh"}


def run(shoot: syn.Shoot, **settings: Any) -> Solution:
    """Lamps, exposures and normals as given, where ``settings`` do not say otherwise: what is wrong is to be seen."""
    chosen = SolveSettings(**{"size": SIZE, **AS_GIVEN, **settings})
    return thread.run(lambda: pipeline.solve(shoot.scene, chosen, shoot.read_image))


def put_right(shoot: syn.Shoot, **settings: Any) -> PutRight:
    """As `run`, but ends after what comes before normals, solve and maps: for tests of what is put right alone.

    Cameras are put right by outlines alone.  Textures are freed.
    """
    chosen = SolveSettings(**{"size": SIZE, **AS_GIVEN, **settings})

    def steps() -> Generator[Progress, None, PutRight]:
        device, scene = thread.device(), shoot.scene
        with device.scope():
            grid = draw_texels(device, scene.mesh, chosen.size)
            part = partial_solve_of(device, scene, chosen.size, grid.position, grid.slots)
            return (yield from put_views_right(device, grid, Given(
                scene, chosen, shoot.read_image, part, aligns=chosen.registration == "auto", calibrates=True), Clock()))

    return thread.run(steps)


def rig(cameras: int = 2, lamps: int = 8, **settings: Any) -> list[tuple[Any, list[Light]]]:
    """Each camera with each lamp."""
    return [(camera, [light]) for camera in syn.cameras(cameras) for light in syn.lamps(lamps, **settings)]


def carried_flash(count: int) -> syn.Shoot:
    """Each of the cameras, which see the plane at a slant, carries a flash 60 mm beside its lens, its only light.

    1 % noise.
    """
    views = []
    lamp = syn.lamps(1)[0]
    for n in range(count):
        turn, tilt = 2.39996 * n, np.radians(55 + 25 * (n + 0.5) / count)
        place = 4.4 * np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
        camera = syn.camera(place, name=f"Camera {n}")
        axes = camera.world_to_camera[:3, :3].T
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = axes, camera.position + axes @ np.array([0.06, 0.0, 0.0])
        views.append((camera, [replace(lamp, name=f"Flash {n}", matrix=matrix)]))
    return syn.shoot(syn.PATCHES, views, (64, 64), noise=0.01)


@dataclass(frozen=True)
class Errors:
    """Absolute errors over solved texels away from the borders between quarters."""

    rough: np.ndarray
    base: np.ndarray
    share: float  # solved texels of the covered ones


def errors(solution: Solution, truth: syn.Truth, border: float = 2.5) -> Errors:
    maps = solution.maps
    size = maps.roughness.shape[0]
    at = (np.arange(size) + 0.5) / size
    u, v = np.meshgrid(at, at)
    away = (np.abs(u - 0.5) > border / size) & (np.abs(v - 0.5) > border / size)
    solved = maps.coverage & ~maps.filled
    ok = solved & away
    return Errors(np.abs(maps.roughness - truth.roughness(u, v))[ok],
                  np.abs(maps.base_color - truth.base(u, v)).max(-1)[ok], float(solved.sum() / maps.coverage.sum()))


def check(shoot: syn.Shoot, rough: float = 1e-5, base: float = 1e-4, tail: float = 0.005, **settings: Any) -> Solution:
    found = run(shoot, **settings)
    off = errors(found, shoot.truth)
    assert off.share > 0.98
    assert found.model == {"Paint": "one-lobe"}
    assert np.median(off.rough) < rough
    assert np.quantile(off.rough, 0.9) < tail
    assert np.median(off.base) < base
    return found


def check_views(solution: Solution) -> None:
    """That each view shows what the prediction by which it is checked says: its gain, and what is left."""
    assert solution.warnings == ()
    for view in solution.checks.views:
        assert view.residual is not None
        assert view.residual.gain == pytest.approx(1, abs=1e-3) and view.residual.structure < 2e-3


def half_again(shoot: syn.Shoot, start: Solution) -> syn.Shoot:
    """The half of u > 0.5 is to be solved again, from a solution of the whole."""
    corners = (shoot.scene.mesh.uvs[..., 0] > 0.5).astype(np.float32)
    return replace(shoot, scene=replace(shoot.scene, start=start, region=Region(corners=corners)))


def turned_away(shoot: syn.Shoot, count: int) -> syn.Shoot:
    """The last ``count`` views look at the sky."""
    views = list(shoot.scene.views)
    for i in range(len(views) - count, len(views)):
        camera = views[i].camera
        away = syn.camera(camera.position, 2 * camera.position, name="away")
        views[i] = replace(views[i], camera=away)
    return replace(shoot, scene=replace(shoot.scene, views=tuple(views)))


def stopped(
    steps: Generator[Progress, None, Solution], stage: str, after: int, message: str = "",
) -> Generator[Progress, None, Solution]:
    """Told to stop at the ``after``-th step of a stage whose message begins so; what it answers to Cancelled."""
    seen = 0
    try:
        while True:
            step = next(steps)
            seen += step.stage == stage and step.message.startswith(message)
            if seen == after:
                seen += 1
                step = steps.throw(Cancelled())
            yield step
    except StopIteration as stop:
        return stop.value  # type: ignore[no-any-return]
