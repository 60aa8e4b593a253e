"""What EXIF states of the exposures of the listed views, beside what the list has."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import bpy

from ...core.capture.file_preview import ImagePreview
from ...core.errors import BadInput
from ...core.images.image_file import open_image
from ...core.images.shot_settings import (
    LEAST_DIFFERENCE,
    NOTHING_SAID,
    ShotSettings,
    exposures_by_exif,
    not_compared,
)
from ...core.phrases import some
from . import thumbnails


def stated(scene: bpy.types.Scene, shots: Sequence[ShotSettings]) -> dict[int, float]:
    """By its place the Exposure of each view in use, as EXIF states it beside the others; ``shots``: of all views."""
    used = {at: (shot, view.exposure) for at, (shot, view) in enumerate(zip(shots, scene.irpso.views, strict=False))
            if view.enabled}
    return dict(zip(used, exposures_by_exif(list(used.values())), strict=True))


def read_shot(path: str) -> ShotSettings:
    """Of the picture at an absolute path, which may be missing: what the list knows of it, else the file."""
    known = thumbnails.image(path) if path else None
    if known is not None:
        return known.shot
    try:
        return open_image(Path(path)).shot
    except BadInput:
        return NOTHING_SAID


def line(scene: bpy.types.Scene, known: Sequence[ImagePreview | None]) -> str:
    """What the panel states where EXIF differs from the list; nothing where it does not, as far as files are known."""
    views = scene.irpso.views
    shots = [NOTHING_SAID if file is None else file.shot for file in known]
    found = stated(scene, shots)
    off = {at: value - views[at].exposure for at, value in found.items()}
    off = {at: by for at, by in off.items() if abs(by) > LEAST_DIFFERENCE}
    if not off:
        return ""
    worst = max(off, key=lambda at: abs(off[at]))
    by_exif, listed = (round(value, 2) + 0.0 for value in (found[worst], views[worst].exposure))  # + 0.0: no -0
    return (f"{len(off)} of {len(found)} views: EXIF states another Exposure, most for '{_name(views[worst])}' "
            f"({by_exif:+.2f} EV, not {listed:+.2f} EV); set it, unless a flash shorter than the exposure time lit "
            "them")


def left(scene: bpy.types.Scene, shots: Sequence[ShotSettings]) -> str:
    """A line that names the pictures in use whose Exposure EXIF does not state beside most others; "" of none."""
    used = [(shot, view) for shot, view in zip(shots, scene.irpso.views, strict=False) if view.enabled and view.image]
    names = [_name(used[place][1]) for place in not_compared([shot for shot, _ in used])]
    if not names:
        return ""
    return (f"{some(names)}: EXIF states no exposure to compare with the other views, so Exposure was left; enter it "
            "by hand if it differs")


def _name(view: bpy.types.PropertyGroup) -> str:
    return Path(view.image.replace("\\", "/")).name
