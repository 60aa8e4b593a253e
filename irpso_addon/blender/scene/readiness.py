"""What keeps the open scene from being solved, said before anybody presses the button.

Only what is in memory is read, so that panels may ask on every redraw: files are known from ``thumbnails``.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import bpy

from ...core.capture.file_preview import ImagePreview, same_file
from ...core.images.colour import known_space
from ..panel_common import letters, wrapped
from . import thumbnails
from .scene_objects import rendered_objects

FRESH = 0.05  # seconds: panels that are drawn together share one survey
SHOWN = 3  # lines beside the button
ASPECT = 0.01  # as core/images/reference_image.py

Faults = list[str]


@dataclass
class ViewState:
    """A view, and what is wrong with it."""

    image: str  # absolute path, "" where there is none
    camera: str = ""
    lights: int = 0  # how many
    light: str = ""  # the one, or how many, in words
    used: bool = True  # not switched off
    file: ImagePreview | None = None
    faults: Faults = field(default_factory=list)  # with these it cannot be used
    notes: Faults = field(default_factory=list)  # with these it can

    @property
    def name(self) -> str:
        """File name."""
        return Path(self.image.replace("\\", "/")).name


@dataclass
class Survey:
    """The scene, and what is wrong with it."""

    views: list[ViewState]
    faults: Faults  # of anything but a view

    @cached_property
    def shortened(self) -> list[tuple[str, str]]:
        """Camera and light of each view, without what all of them begin with."""
        camera = _prefix(view.camera for view in self.views)
        light = _prefix(view.light for view in self.views if not view.light.endswith(" lights"))
        return [(view.camera.removeprefix(camera), view.light.replace("All lights", "All").removeprefix(light))
                for view in self.views]

    def problems(self) -> list[str]:
        """A line for each thing that must be put right; of views with the same fault, one."""
        by_fault: dict[str, list[str]] = {}
        for number, view in enumerate(self.views, 1):
            for fault in view.faults if view.used else ():
                by_fault.setdefault(fault, []).append(view.name or f"View {number}")
        return self.faults + [f"{_some(names)}: {fault[:1].lower()}{fault[1:]}" for fault, names in by_fault.items()]


_last: tuple[float, int, Survey] | None = None  # when, of which scene


def recent(context: bpy.types.Context, renew: bool = False) -> Survey:
    """The survey of this redraw; ``renew``: which begins."""
    global _last
    now = time.monotonic()
    scene = context.scene.session_uid
    if renew or _last is None or now - _last[0] > FRESH or _last[1] != scene:
        _last = now, scene, survey(context)
    return _last[2]


def why_not(context: bpy.types.Context) -> str | None:
    """Why a solve cannot start, in one line; None: nothing is known against it."""
    problems = recent(context).problems()
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return problems[0] + more if problems else None


def draw(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """What is missing, beside the button that needs it."""
    problems = recent(context).problems()
    if not problems:
        return
    column = layout.column(align=True)
    for problem in problems[:SHOWN]:
        wrapped(column, problem, letters(context))
    if len(problems) > SHOWN:
        column.label(text=f"And {len(problems) - SHOWN} more", icon="BLANK1")


def solve_objects(context: bpy.types.Context) -> list[bpy.types.Object]:
    """What `irpso.solve` solves: the active mesh, and the other meshes that are selected."""
    active = context.active_object
    if active is None or active.type != "MESH":
        return []
    return [active, *(obj for obj in context.selected_objects if obj.type == "MESH" and obj != active)]


def survey(context: bpy.types.Context) -> Survey:
    """Everything about the scene that a solve of the active object needs."""
    scene = context.scene
    objects = {obj.name: obj for obj in scene.objects}
    reader = _Reader(context, objects)
    views, faults = reader.views(scene.irpso)
    if not bpy.data.filepath:
        faults.insert(0, "The file was never saved; save it first")
    meshes = solve_objects(context)
    faults += [fault for obj in meshes for fault in _mesh_faults(obj)] if meshes else ["No mesh object is active"]
    return Survey(views, faults)


def _mesh_faults(obj: bpy.types.Object) -> Faults:
    if obj.modifiers:  # they may give what the mesh lacks
        return []
    if not len(obj.data.polygons) and obj.mode != "EDIT":
        return [f"{obj.name}: has no faces"]
    return [] if len(obj.data.uv_layers) else [f"{obj.name}: has no UV map; unwrap it"]


class _Reader:
    """Views of the scene, wherever they are named."""

    def __init__(self, context: bpy.types.Context, objects: dict[str, bpy.types.Object]) -> None:
        self.context, self.objects = context, objects
        render = context.scene.render
        self.aspect = (render.resolution_x / render.resolution_y) if render.resolution_y else 1.0
        self._all_lights: int | None = None

    def views(self, settings: Any) -> tuple[list[ViewState], Faults]:
        """From the capture file, the list, or the cameras' background images; and what is wrong with the source."""
        if settings.captures:
            return self._from_file(bpy.path.abspath(settings.captures))
        if len(settings.views):
            views = [self._entry(entry) for entry in settings.views]
            _mark_duplicates(views)
            return views, [] if any(view.used for view in views) else ["Every view is switched off"]
        views = [self._background(obj, slot) for obj in self.objects.values() if obj.type == "CAMERA"
                 for slot in obj.data.background_images if slot.source == "IMAGE" and slot.image]
        return views, [] if views else ["No views; add them under Capture"]

    def _from_file(self, path: str) -> tuple[list[ViewState], Faults]:
        found = thumbnails.captures(path)
        if found is None:
            return [], []
        if found.problem:
            return [], [f"{Path(path).name}: {found.problem[:1].lower()}{found.problem[1:]}"]
        views = []
        for entry in found.views:
            camera, faults = self.objects.get(entry.camera), []
            if camera is None or camera.type != "CAMERA":
                faults.append(f"Camera '{entry.camera}' is not in the scene")
            lamps = [self.objects.get(name) for name in entry.lights]
            faults += [f"Light '{name}' is not in the scene" for name, lamp in zip(entry.lights, lamps, strict=True)
                       if lamp is None or lamp.type != "LIGHT"]
            state = ViewState(str(entry.image), entry.camera, len(lamps), _light(entry.lights), faults=faults)
            views.append(self._checked(state, camera, str(entry.mask or ""), entry.colorspace or ""))
        return views, []

    def _entry(self, entry: Any) -> ViewState:
        camera, lamps = entry.camera, [item.light for item in entry.lights]
        view = ViewState(bpy.path.abspath(entry.image), camera.name if camera else "", len(lamps),
                         _light([lamp.name if lamp else "" for lamp in lamps]), entry.enabled)
        if not entry.image:
            view.faults.append("No image")
        if camera is None:
            view.faults.append("No camera")
        elif self.objects.get(camera.name) != camera:
            view.faults.append(f"Camera '{camera.name}' was deleted")
        for lamp in lamps:
            if lamp is None:
                view.faults.append("No light")
            elif self.objects.get(lamp.name) != lamp:
                view.faults.append(f"Light '{lamp.name}' was deleted")
        return self._checked(view, camera, bpy.path.abspath(entry.mask), entry.colorspace)

    def _background(self, camera: bpy.types.Object, slot: Any) -> ViewState:
        image = slot.image
        view = ViewState(bpy.path.abspath(image.filepath, library=image.library), camera.name, 0, _light([]))
        if image.packed_file is not None or image.source != "FILE":
            view.faults.append("Is not a single file on disk; unpack it (File > External Data)")
        return self._checked(view, camera, "", image.colorspace_settings.name)

    def _checked(
        self, view: ViewState, camera: bpy.types.Object | None, mask: str, colorspace: str,
    ) -> ViewState:
        """With what its camera, lights and files say."""
        if not view.lights:
            view.lights = self._rendered_lights()
            if not view.lights:
                view.faults.append("No light in the scene renders")
        if camera is not None and camera.type == "CAMERA" and camera.data.type == "PANO":
            view.faults.append(f"Camera '{camera.name}' is panoramic")
        if colorspace and known_space(colorspace) is None:
            view.faults.append(f"Color space '{colorspace}' is not known")
        if view.image:
            view.file = thumbnails.image(view.image)
            self._check_file(view, colorspace)
        if mask and (found := thumbnails.image(mask)) and found.problem:
            view.faults.append(f"Mask: {found.problem[:1].lower()}{found.problem[1:]}")
        return view

    def _check_file(self, view: ViewState, colorspace: str) -> None:
        found = view.file
        if found is None:
            return
        if found.problem:
            view.faults.append(found.problem)
            return
        aspect = found.width / found.height
        if abs(aspect / self.aspect - 1) > ASPECT:
            view.faults.append(f"Is {found.width} x {found.height}, the render resolution has another aspect")
        if found.bits <= 8:
            view.notes.append("8 bits a channel: use EXR or 16 bits for exact maps")
        elif found.integer and not (colorspace or found.colorspace):
            view.notes.append("Read as sRGB: set the color space if its values are linear")

    def _rendered_lights(self) -> int:
        if self._all_lights is None:
            found = rendered_objects(self.context.view_layer).values()
            self._all_lights = sum(obj.type == "LIGHT" for obj in found)
        return self._all_lights


def _mark_duplicates(views: Sequence[ViewState]) -> None:
    """Notes a view whose image an earlier one has."""
    first: dict[str, int] = {}
    for number, view in enumerate(views, 1):
        if view.image and view.used and (earlier := first.setdefault(same_file(view.image), number)) != number:
            view.notes.append(f"Same image as view {earlier}")


def _light(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{len(names)} lights" if names else "All lights"


def _prefix(names: Iterable[str]) -> str:
    """What all names begin with, up to the last whole word: "Camera " of "Camera 1, 2"; all of it where it is alone."""
    different = sorted({name for name in names if name})
    if len(different) < 2:
        return different[0] if different else ""
    first, last = different[0], different[-1]
    same = next((i for i, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), len(first))
    return re.sub(r"[^\W_]+$", "", first[:same])


def _some(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
