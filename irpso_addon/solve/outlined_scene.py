"""Cameras put right by the object's outlines in the pictures, before anything is solved.

A solve under wrong cameras takes several times as long as one under right ones, because its models do not fit, and its
maps are thrown away.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass

from ..core.calibration.rig_fit import fit_rig
from ..core.calibration.rig_numbers import Free
from ..core.calibration.rig_sample import RigSample
from ..core.checks.mended_cameras import corrected, near
from ..core.checks.outline_cameras import OutlinedCamera
from ..core.checks.registration import outline_misfits
from ..core.data import Camera, SceneData
from ..core.job import Progress, share_of
from ..gpu.device.context import Device
from ..gpu.gbuffer.drawn_outline import DrawnOutline
from ..gpu.gbuffer.gbuffer import MeshBuffer
from ..gpu.observe.observations import Observations, ObservedCamera
from ..gpu.observe.picture_outlines import outlined_cameras

ROUNDS = 4  # of correcting cameras and drawing outlines again
FIRST = 24  # cameras: of more, at most so many say first whether it is worth looking at all

Observe = Callable[[SceneData], Generator[Progress, None, Observations]]


@dataclass(frozen=True)
class Observed:
    """A scene and what its views show."""

    scene: SceneData
    observations: Observations


def through_right_cameras(
    device: Device, mesh: MeshBuffer, given: Observed, observe: Observe, sample: Callable[[Observations], RigSample],
) -> Generator[Progress, None, Observed]:
    """``given``, or the scene with its cameras put right, observed anew; other observations are released.

    Only what makes the views agree better is taken: outlines of a mesh or mask that is wrong may mislead.  ``sample``:
    texels with what they show, the same ones of each.
    """
    yield Progress(0.0, "cameras")
    scene = yield from _outlined(device, mesh, given)
    if scene is given.scene:
        return given
    before = yield from _left_over(sample(given.observations))
    given.observations.release()
    seen = yield from observe(scene)
    if (yield from _left_over(sample(seen))) < before:
        return Observed(scene, seen)
    seen.release()
    return Observed(given.scene, (yield from observe(given.scene)))


def _outlined(device: Device, mesh: MeshBuffer, given: Observed) -> Generator[Progress, None, SceneData]:
    """The scene whose outlines are those of the pictures; the scene itself where none is off beyond doubt."""
    outline = DrawnOutline(device, mesh, given.scene.occluders, given.scene.pixel_filter)
    seen = given.observations.cameras
    # By the observed camera's id: the cameras through which its outlines were drawn last, and what they showed.
    drawn: dict[int, tuple[list[Camera], list[OutlinedCamera]]] = {}

    def mended(scene: SceneData, cameras: list[ObservedCamera]) -> Generator[Progress, None, tuple[SceneData, bool]]:
        """The scene put right, and whether it was near before."""
        through = {(before.image, before.camera.name): after.camera
                   for before, after in zip(given.scene.views, scene.views, strict=True)}
        found = []
        for n, camera in enumerate(cameras):
            now = [through[view.view.image, view.view.camera.name] for view in camera.views]
            last, outlined = drawn.get(id(camera), ([], []))
            if len(last) != len(now) or any(a is not b for a, b in zip(last, now, strict=True)):
                yield Progress(0.0, "cameras", f"outline {n + 1} of {len(cameras)}")
                outlined = list(outlined_cameras([camera], outline, through))
                drawn[id(camera)] = now, outlined
            found += outlined
        misfits = outline_misfits(found)
        return corrected(scene, misfits, shifts=True, gains=False), near(scene, misfits, gains=False)

    some = seen[:: -(-len(seen) // FIRST)]
    if len(some) < len(seen) and (yield from mended(given.scene, some))[0] is given.scene:
        return given.scene
    scene = given.scene
    for n in range(ROUNDS):
        after, was_near = yield from mended(scene, seen)
        if after is scene or (n > 0 and was_near):
            break
        scene = after
    return scene


def _left_over(sample: RigSample) -> Generator[Progress, None, float]:
    """What views leave over that materials, lamps and exposures do not explain: relative, robust.

    Lamps that are a few percent off leave more than cameras do, and would hide these.
    """
    free = Free(lamps=True, exposures=True, levels=not sample.scale_known)
    return (yield from share_of(fit_rig(sample, free), 1.0, 1.0)).scatter
