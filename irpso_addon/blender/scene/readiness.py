"""What keeps the open scene from being solved, said before anybody presses the button.

Only what is in memory is read, so that panels may ask on every redraw: files are known from ``thumbnails``.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import bpy

from ...core.capture.file_preview import ImagePreview, same_file
from ...core.images.colour import known_space
from ...core.images.mask import ASPECT
from ..panel_common import letters, wrapped
from . import thumbnails
from .scene_views import NamedView, SceneViews
from .scene_world import lighting

FRESH = 0.05  # seconds: panels that are drawn together share one survey
SHOWN = 3  # lines beside the button

Faults = list[str]


@dataclass
class ViewState:
    """A view, and what is wrong with it."""

    image: str  # absolute path, "" where there is none
    camera: str = ""
    lights: int = 0  # how many lamps
    light: str = ""  # the one, or how many, in words
    emitters: int = 0  # how many meshes glow in it
    environment: str = ""  # the world that lights it and its turn, and what glows; "" where nothing does
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


def draw(layout: bpy.types.UILayout, context: bpy.types.Context, more: Sequence[str] = ()) -> None:
    """What is missing, beside the button that needs it, the first of it in red; ``more``: what else is."""
    problems = [*recent(context).problems(), *more]
    if not problems:
        return
    column = layout.column(align=True)
    for number, problem in enumerate(problems[:SHOWN]):
        lines = column.column(align=True)
        lines.alert = number == 0
        wrapped(lines, problem, letters(context))
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
    views, faults = _views(context)
    if not bpy.data.filepath:  # after what a new file lacks: whoever opens the sample scene need not save
        faults.append("Save the file first")
    meshes = solve_objects(context)
    faults += [f"{obj.name}: is in Edit Mode; leave it first" for obj in meshes if obj.mode == "EDIT"]
    faults += [fault for obj in meshes for fault in _mesh_faults(obj)] if meshes else ["No mesh object is active"]
    return Survey(views, faults)


def _mesh_faults(obj: bpy.types.Object) -> Faults:
    if obj.modifiers:  # they may give what the mesh lacks
        return []
    if not len(obj.data.polygons) and obj.mode != "EDIT":
        return [f"{obj.name}: has no faces"]
    return [] if len(obj.data.uv_layers) else [f"{obj.name}: has no UV map; unwrap it"]


def _views(context: bpy.types.Context) -> tuple[list[ViewState], Faults]:
    """From the capture file, the list, or the cameras' background images; and what is wrong with the source."""
    source, captures = SceneViews(context.scene, context.view_layer), context.scene.irpso.captures
    if captures:
        path = bpy.path.abspath(captures)
        known = thumbnails.captures(path)
        if known is None:
            return [], []
        if known.problem:
            return [], [f"{Path(path).name}: {known.problem[:1].lower()}{known.problem[1:]}"]
        named = source.from_captures(known.views, Path(path))
    else:
        named = source.from_scene()
    render = context.scene.render
    aspect = (render.resolution_x / render.resolution_y) if render.resolution_y else 1.0
    subject = context.active_object.name if context.active_object else ""  # it shines on nothing
    taken = [replace(view, emitters=tuple(name for name in view.emitters if name != subject))
             if subject in view.emitters else view for view in named.views]
    views = [_state(view, _aspect(context.scene, view.camera) or aspect) for view in taken]
    for view, state in zip(taken, views, strict=True):
        world = context.scene.world if view.world is None else bpy.data.worlds.get(view.world)
        lit = [f"{world.name} {view.turn}"] if lighting(world, alone=not view.lights and not view.emitters) else []
        state.environment = " ".join([*lit, *view.emitters])
    if not captures and context.scene.irpso.views:
        _mark_duplicates(views)
    return views, [] if named.fault is None else [named.fault.line]


def _aspect(scene: bpy.types.Scene, camera: str) -> float | None:
    """Of the pictures of a photographed camera's lens."""
    obj = scene.objects.get(camera)
    lens = getattr(obj.data, "irpso_lens", None) if obj is not None and obj.type == "CAMERA" else None
    return lens.width / lens.height if lens is not None and lens.use and lens.height else None


def _state(named: NamedView, aspect: float) -> ViewState:
    """A view with what its files say; ``aspect``: of its camera's pictures."""
    lit = named.lights + named.emitters
    light = "World" if not lit else "All lights" if named.every_light else _light(lit)
    view = ViewState(
        named.image, named.camera, len(named.lights), light,
        len(named.emitters), used=named.enabled, faults=[fault.line for fault in named.faults])
    if named.colorspace and known_space(named.colorspace) is None:
        view.faults.append(f"Color space '{named.colorspace}' is not known")
    if view.image:
        view.file = thumbnails.image(view.image)
        _check_file(view, named.colorspace, aspect)
    for what, path in (("Mask", named.mask), ("Ambient", named.ambient), ("Flat field", named.flat)):
        if path and (found := thumbnails.image(path)) and found.problem:
            view.faults.append(f"{what}: {found.problem[:1].lower()}{found.problem[1:]}")
    return view


def _check_file(view: ViewState, colorspace: str | None, aspect: float) -> None:
    found = view.file
    if found is None:
        return
    if found.problem:
        view.faults.append(found.problem)
        return
    if abs(found.width / found.height / aspect - 1) > ASPECT:
        view.faults.append(f"Is {found.width} x {found.height}, which is not the aspect of its camera's pictures")
    if found.bits <= 8:
        view.notes.append("8 bits per channel: use EXR or 16 bits for exact maps")
    elif found.integer and not (colorspace or found.colorspace):
        view.notes.append("Read as sRGB: set the colour space if its values are linear")


def _mark_duplicates(views: Sequence[ViewState]) -> None:
    """Notes a view whose image an earlier one has."""
    first: dict[str, int] = {}
    for number, view in enumerate(views, 1):
        if view.image and view.used and (earlier := first.setdefault(same_file(view.image), number)) != number:
            view.notes.append(f"Same image as view {earlier}")


def _light(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{len(names)} lights"


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
