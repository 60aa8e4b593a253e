"""What EXIF states of the exposures of the listed views, beside what the list has."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import bpy

from ...core.errors import BadInput
from ...core.images.image_file import open_image
from ...core.images.shot_settings import LEAST_DIFFERENCE, NOTHING_SAID, ShotSettings, exposures_by_exif
from . import thumbnails


def stated(scene: bpy.types.Scene, shot_of: Callable[[str], ShotSettings]) -> dict[int, float]:
    """By its place the Exposure of each view in use, as EXIF states it beside the others.

    ``shot_of``: of the picture at an absolute path.
    """
    used = {at: view for at, view in enumerate(scene.irpso.views) if view.enabled and view.image}
    found = exposures_by_exif([(shot_of(bpy.path.abspath(view.image)), view.exposure) for view in used.values()])
    return dict(zip(used, found, strict=True))


def known_shot(path: str) -> ShotSettings:
    """Of a picture that the list has looked at; of others nothing."""
    found = thumbnails.image(path)
    return NOTHING_SAID if found is None else found.shot


def read_shot(path: str) -> ShotSettings:
    """The same, of others from the file, which may be missing."""
    if (found := known_shot(path)) != NOTHING_SAID:
        return found
    try:
        return open_image(Path(path)).shot
    except BadInput:
        return NOTHING_SAID


def line(scene: bpy.types.Scene) -> str:
    """What the panel states where EXIF differs from the list; nothing where it does not, as far as is known."""
    views = scene.irpso.views
    off = {at: value - views[at].exposure for at, value in stated(scene, known_shot).items()}
    off = {at: by for at, by in off.items() if abs(by) > LEAST_DIFFERENCE}
    if not off:
        return ""
    worst = max(off, key=lambda at: abs(off[at]))
    name = Path(views[worst].image.replace("\\", "/")).name
    return (f"{len(off)} of {len(views)} views: EXIF states another Exposure, {off[worst]:+.2f} EV beside that of "
            f"'{name}'; set it, unless a flash shorter than the exposure time lit them")
