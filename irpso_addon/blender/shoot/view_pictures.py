"""The pictures of the scene's list of views, as tools look at them that measure in pixels: row 0 at the top."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.data import F32, Bool, View
from ...core.errors import BadInput
from ...core.images.image_file import open_image
from ...core.images.reference_image import read_reference, with_one_white_balance
from ..scene.scene import film_gain
from ..scene.scene_objects import read_camera


@dataclass(frozen=True)
class ListedView:
    """A view of the scene's list, with what its picture is read by: camera, exposure, one white balance for all."""

    entry: Any  # IRPSO_PG_view; None: a picture of no view, which no camera of the scene took
    view: View  # without lights, mask, ambient picture and flat field

    @property
    def name(self) -> str:
        """The picture's file name."""
        return self.view.image.name


def listed_views(context: bpy.types.Context) -> list[ListedView]:
    """Those that are in use and have a picture and a camera.  Raises BadInput where there is none."""
    scene, depsgraph = context.scene, context.evaluated_depsgraph_get()
    entries = [entry for entry in scene.irpso.views
               if entry.enabled and entry.image and entry.camera is not None and entry.camera.type == "CAMERA"]
    if not entries:
        raise BadInput(f"scene '{scene.name}': no view has a picture and a camera; add the views first")
    gain = film_gain(scene)
    cameras = {camera: read_camera(camera, scene, depsgraph) for camera in {entry.camera for entry in entries}}
    views = [View(Path(bpy.path.abspath(entry.image)), cameras[entry.camera], (), entry.exposure,
                  colorspace=entry.colorspace or None, gain=gain) for entry in entries]
    return [ListedView(entry, view) for entry, view in zip(entries, with_one_white_balance(views), strict=True)]


def read_picture(view: View) -> tuple[F32, Bool]:
    """Linear radiance (h, w, 3) and validity (h, w), row 0 at the **top**; what is not valid (clipped) is as bright as
    the brightest valid place.

    Raises BadInput as `read_reference`.
    """
    image = read_reference(view)
    rgb = image.rgb[::-1].copy()
    valid = image.valid[::-1]
    if not valid.all() and valid.any():
        rgb[~valid] = rgb[valid].max(0)
    return rgb, np.asarray(valid)


def named_view(views: Sequence[ListedView], name: str) -> ListedView:
    """The view whose picture is called ``name``: a path, or the end of one.  Raises BadInput."""
    wanted = Path(name)
    found = [view for view in views if view.view.image == wanted or view.view.image.resolve() == wanted.resolve()]
    found = found or [view for view in views if view.view.image.parts[-len(wanted.parts):] == wanted.parts]
    different = len({view.view.image for view in found})
    if different != 1:
        what = "no view has this picture" if not found else f"{different} pictures of the views have this name"
        raise BadInput(f"{name}: {what}; give the path of one of the views' pictures")
    return found[0]


def view_or_file(views: Sequence[ListedView], name: str) -> ListedView:
    """The view whose picture is called ``name``, or a file without a camera, as one that photogrammetry did not align.

    Such a file is read as the first view is whose picture is of the same kind.  Raises BadInput.
    """
    path = Path(name)
    try:
        return named_view(views, name)
    except BadInput:
        if not path.is_file():
            raise
    like = next((view for view in views if view.view.image.suffix.lower() == path.suffix.lower()), None)
    if like is None:
        raise BadInput(f"{path.name}: is a {path.suffix} file, and no view has one, so that their curve may be another;"
                       " choose a file of the kind that the views have")
    file, entry = open_image(path), like.entry
    camera = replace(like.view.camera, aspect=file.width / file.height, lens=None)
    return ListedView(None, replace(
        like.view, image=path, camera=camera, exposure=0.0, response=entry.response, shoulder=entry.shoulder,
        black_level=tuple(entry.black_level)))


def active_view(context: bpy.types.Context, camera: bpy.types.Object | None = None) -> ListedView:
    """The view that is active in the list; with ``camera`` the first of its views, unless the active one is of it.

    Raises BadInput where it is switched off, lacks picture or camera, or there is none.
    """
    settings, views = context.scene.irpso, listed_views(context)
    index = min(settings.active_view, len(settings.views) - 1)
    active = [view for view in views if view.entry == settings.views[index]]
    if camera is not None:
        active = [view for view in (*active, *views) if view.entry.camera == camera]
    if active:
        return active[0]
    if camera is not None:
        raise BadInput(f"camera '{camera.name}': no view in use has it; add its pictures as views")
    raise BadInput(f"view {index + 1}: is switched off, or has no picture or no camera; choose another in the list")


def listed_image(context: bpy.types.Context, number: int) -> str:
    """Path of the picture of the view of that number, from 0; -1: of the active one.  Raises BadInput."""
    settings = context.scene.irpso
    index = settings.active_view if number < 0 else number
    if index >= len(settings.views):
        raise BadInput(f"view {index}: the list has {len(settings.views)} views; choose one of them")
    return str(bpy.path.abspath(settings.views[index].image))
