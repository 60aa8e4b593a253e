"""A scene whose cameras and exposures are put right by what `Registration` found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..check_records import Misfit
from ..data import Camera, SceneData, View
from ..projection import lens_for, pixels_of, rays_of

NEAR = 0.05  # pixels that a camera may be off: less is not worth another solve
LIKELY = 2.0  # a shift so many standard errors off is likely


def corrected(scene: SceneData, misfits: Sequence[Misfit], shifts: bool, gains: bool) -> SceneData:
    """The scene with cameras and exposures put right; the scene itself where none is off beyond doubt.

    Where a camera is, the others are put right as well, by what is likely (two standard errors): the round comes
    anyway.  Not so gains: those of views lit from behind run away with the roughness that explains them as well.
    Views of a camera that share their shift go on sharing it; one that departs gets a camera of its own.  Cameras that
    are kept stay.
    """
    found = {(m.image, m.camera): m for m in misfits}
    kept = _kept(scene)
    shifts = shifts and any((m.shifted or m.warped) and m.camera not in kept for m in misfits)
    gains = gains and any(m.drifted for m in misfits)
    cameras: dict[str, Camera] = {}
    views = []
    for view in scene.views:
        misfit = found.get((view.image, view.camera.name))
        if misfit is not None and shifts and not view.camera.kept and _likely(misfit):
            name = name_alone(view) if misfit.alone else view.camera.name
            if name not in cameras:
                cameras[name] = replace(_mended(view.camera, misfit), name=name)
            view = replace(view, camera=cameras[name])
        if misfit is not None and gains and misfit.drifted:
            view = replace(view, gain=view.gain * misfit.gain)
        views.append(view)
    return replace(scene, views=tuple(views)) if shifts or gains else scene


def near(scene: SceneData, misfits: Sequence[Misfit], gains: bool) -> bool:
    """Whether cameras (``gains``: and exposures) need no further solve; kept cameras do not count."""
    kept = _kept(scene)
    return not any((gains and misfit.drifted) or (misfit.camera not in kept and (misfit.warped or misfit.pixels > NEAR))
                   for misfit in misfits)


def _kept(scene: SceneData) -> set[str]:
    return {view.camera.name for view in scene.views if view.camera.kept}


def name_alone(view: View) -> str:
    """Of the camera of a view that departs from the others of its camera."""
    return f"{view.camera.name}{_departs(view)}"


def given_name(view: View) -> str:
    """Of its camera in the scene, whether or not the view has got one of its own."""
    return view.camera.name.removesuffix(_departs(view))


def _departs(view: View) -> str:
    return f" ({'/'.join(view.image.parts[-2:])})"  # one folder for each lamp may hold the same names


def _likely(misfit: Misfit) -> bool:
    return misfit.warped or misfit.pixels > LIKELY * misfit.shift_error


def moved(camera: Camera, shift: tuple[float, float], size: tuple[int, int]) -> Camera:
    """The camera whose image lies ``shift`` pixels (right, up) from that of ``camera``; ``size``: width, height."""
    if camera.lens is not None:
        across, up = (pixels * whole / count for pixels, whole, count in zip(
            shift, (camera.lens.width, camera.lens.height), size, strict=True))
        lens = replace(camera.lens, cx=camera.lens.cx + across, cy=camera.lens.cy - up)
        return replace(camera, lens=lens, projection=lens.matrix)
    projection = camera.projection.copy()
    for axis in (0, 1):
        projection[axis] += 2 * shift[axis] / size[axis] * projection[3]
    return replace(camera, projection=projection)


def _mended(camera: Camera, misfit: Misfit) -> Camera:
    """The camera with its focal length, turn and lens put right where they are beyond doubt, and shifted."""
    changed = camera
    if misfit.grown:
        changed = grown(changed, misfit.growth)
    if misfit.rolled:
        changed = rolled(changed, misfit.roll)
    if misfit.bend:
        changed = bent(changed, misfit.bend, misfit.size)
    shift = np.array(misfit.shift)
    if changed is not camera:  # all of it but the bend is about the object
        centre = np.array([misfit.centre]) + np.array(misfit.size) / 2
        origin, direction = rays_of(camera, centre, misfit.size)
        shift = shift - (pixels_of(changed, origin + direction, misfit.size) - centre)[0]
    return moved(changed, (float(shift[0]), float(shift[1])), misfit.size)


def grown(camera: Camera, by: float) -> Camera:
    """The camera whose image is larger by this factor less 1, about its middle: a longer focal length."""
    if by == 0:
        return camera
    if camera.lens is not None:
        lens = camera.lens
        middle = lens.width / 2, lens.height / 2
        lens = replace(lens, fx=lens.fx * (1 + by), fy=lens.fy * (1 + by),
                       cx=middle[0] + (lens.cx - middle[0]) * (1 + by), cy=middle[1] + (lens.cy - middle[1]) * (1 + by))
        return replace(camera, lens=lens, projection=lens.matrix)
    projection = camera.projection.copy()
    projection[:2] *= 1 + by
    return replace(camera, projection=projection)


def rolled(camera: Camera, angle: float) -> Camera:
    """The camera whose image is turned counter-clockwise by ``angle`` (radians) about its axis."""
    turn = np.eye(4)
    turn[:2, :2] = (np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))
    return replace(camera, world_to_camera=turn @ camera.world_to_camera)


def bent(camera: Camera, by: float, size: tuple[int, int]) -> Camera:
    """The perspective camera whose lens has so much more k1; ``size``: width and height of pictures."""
    lens = camera.lens if camera.lens is not None else lens_for(camera, size)
    lens = replace(lens, radial=(lens.radial[0] + by, *lens.radial[1:]))
    return replace(camera, lens=lens, projection=lens.matrix)
