"""A solve as it converges: its maps on the object, tile by tile, and what is kept of them when it is stopped.

Looks arrive on threads that read what workers tell; there they become maps at full size and pixels as Blender takes
them, so that the main thread only hands them over.
"""

from __future__ import annotations

import itertools
import os
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from math import isfinite

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...core.data import F32, Maps, SceneData, Solution
from ...core.errors import BadInput
from ...core.live_maps import ROLES, Canvas, Live
from ...core.maps import region
from ...core.observation_quality import HALF_SURE
from ...core.params import SolveSettings
from ...core.resampling import block_means, nearest
from ..material import material
from ..material.tags import maps_of
from . import stored_result
from .running_time import RunningTime

SO_FAR = "irpso_so_far"  # custom property of an object in the undo step of `LiveMaps._link`: the solve's token
SHOWN = 1024  # texels: larger maps are shown reduced until they are done
SHOW_SECONDS = 0.18  # between two pictures, at least; ...
IDLE_SHARE = 3.0  # ... and so many times what drawing the last one took: a software renderer has other work
TICK = 0.05  # seconds between two calls of `LiveMaps.show`
JUDGED = 512  # texels of the maps that the preview's worker judges, ...
JUDGE_SECONDS = 1.5  # ... at most so often
UNKNOWN = {"base_color": 0.18, "roughness": 0.5, "confidence": 0.0, "error": 0.0}
UNKNOWN_SIGMA = 0.5  # standard error of what nobody knows
PARTIAL = "stopped early: the maps found so far, coarse where no tile was finished"
COARSE = "stopped early: the roughness found so far; base colour is still coarse"
KEPT = "stopped early: the last result stays where no tile was finished"
UNCHANGED = "stopped early: the last result is unchanged"

_numbers = itertools.count()


class LiveMaps:
    """The maps of one running solve."""

    def __init__(self, scene: SceneData, settings: SolveSettings, share: bool | None = None) -> None:
        """``share``: as in `material.wire_maps`."""
        self.share = share
        used = (scene.mesh.slot_names[slot] for slot in np.unique(scene.mesh.slots))  # others need not take maps
        self.model = dict.fromkeys(used, "lambert" if settings.model == "lambert" else "one-lobe")
        self.views = tuple(view.image.name for view in scene.views)
        self.start = scene.start  # what is there already, and shown until there is better
        self.canvas = Canvas(settings.size)
        if self.start is not None:
            self.model |= self.start.model
        self.outline = self._outline()
        self.shown = min(settings.size, SHOWN)
        self.curve: list[tuple[float, float]] = []
        self.latest: Live | None = None
        self.feed: Callable[[object], None] | None = None  # of the preview's worker
        self._judged = self._showed = 0.0  # when last
        self._judged_pictures = 0  # that the points of the curve are of
        self.time = RunningTime()
        self._drawing, self._wait = False, SHOW_SECONDS
        self._merging, self._handing = threading.Lock(), threading.Lock()  # the second is never held for long
        self._pixels: dict[str, F32] = {}  # role -> flat RGBA, not handed over yet
        self._uids: dict[str, int] = {}  # role -> session_uid of the image made here
        self._linked = False  # the images were put on the object
        self.undone = 0  # steps of undo that the file is before that
        self.token = f"{os.getpid()} {next(_numbers)}"

    def _outline(self) -> Solution | None:
        """What wiring needs to know before there are maps; None: looks tell less than what is on the material."""
        if self.start is not None and any(
                extra is not None for extra in (self.start.maps.lobes, self.start.maps.specular,
                                                self.start.maps.metallic)):
            return None
        none = np.zeros((1, 1), np.float32)
        maps = Maps(np.zeros((1, 1, 3), np.float32), none, none, none, none > 0, none > 0, none, none)
        if self.start is None:
            return Solution.of_maps(maps, self.model)
        return Solution.of_maps(maps, self.model, self.start.levels, metallic=self.start.metallic,
                                 coats=self.start.coats, diffuse_roughness=self.start.diffuse_roughness)

    @property
    def seconds(self) -> float:
        """Since it began, pauses left out."""
        return self.time.seconds

    def take(self, live: Live, preview: bool = False) -> Live:
        """On a thread that reads: the look with maps that are whole."""
        with self._merging:
            if self.start is not None and not self.canvas.maps:  # here, because it takes a while
                last = region.resized(self.start.maps, self.canvas.size)
                self.start = replace(self.start, maps=last)
                self.canvas.add(Live({role: getattr(last, role) for role in ROLES}, last.coverage))
            maps = dict(self.canvas.add(live, preview))
            pixels = {role: _rgba(nearest(maps[role], self.shown), UNKNOWN[role]) for role in live.maps}
            before = self.latest
            self.latest = live = replace(
                live, maps=maps, coverage=self.canvas.coverage, model=self.model,
                pictures=live.pictures or (before.pictures if before else ()),
                error=live.error if live.pictures else (before.error if before else float("nan")))
            self._judge(maps)
        if pixels:
            with self._handing:
                self._pixels |= pixels
        if preview and live.pictures and (before is None or live.pictures is not before.pictures):
            self._note(len(live.pictures), live.error)
        return live

    def _note(self, pictures: int, error: float) -> None:
        """A point of the curve: the best error so far, of the same reduced pictures."""
        if pictures > self._judged_pictures:  # the first look was at a few of them
            self.curve.clear()
        if pictures >= self._judged_pictures and isfinite(error):
            self._judged_pictures = pictures
            self.curve.append((self.seconds, min(error, self.curve[-1][1]) if self.curve else error))

    def take_preview(self, live: Live) -> Live:
        """The same of the coarse maps that come first: where there is a last result, it is better than they are."""
        return self.take(live if self.start is None else replace(live, maps={}, coverage=None), preview=True)

    def _judge(self, maps: Mapping[str, F32]) -> None:
        """Have `preview` say how well the maps explain the pictures now."""
        now = time.monotonic()
        if self.feed is None or now - self._judged < JUDGE_SECONDS or not {"base_color", "roughness"} <= maps.keys():
            return
        self._judged = now
        size = min(JUDGED, self.canvas.size)
        self.feed({role: block_means(maps[role], size) for role in ("base_color", "roughness")})

    def show(self, obj: bpy.types.Object) -> bool:
        """Hand new pixels to Blender, not too often: each time the window is drawn anew.  True: it is.

        On the main thread, some milliseconds: an image made, the maps' pixels, or the images put on the materials.
        """
        now = time.monotonic()
        if self._drawing:  # the first call since then: as late as drawing took
            self._drawing, self._wait = False, max(SHOW_SECONDS, IDLE_SHARE * (now - self._showed - TICK))
        if self._linked and now - self._showed < self._wait:
            return False
        images = self.images()
        if len(images) < len(ROLES):
            if not self._linked:  # else the user has undone it: the result will come all the same
                role = next(role for role in ROLES if role not in images)
                self._uids[role] = material.loose_image(obj, role, self.shown).session_uid
            return False
        with self._handing:
            pixels, self._pixels = self._pixels, {}
        cycles = _cycles_is_on_show()
        for role, values in pixels.items():
            images[role].pixels.foreach_set(values)
            images[role].update()
            if cycles:
                images[role].update_tag()  # its viewport hears of nothing else; costs a tenth of a second without a GPU
            self._showed, self._drawing = now, True
        if pixels:
            _wake_solid(obj)
        if not self._linked and "base_color" in self.canvas.maps:
            self._link(obj, images)
        return bool(pixels)

    def images(self) -> dict[str, bpy.types.Image]:
        """Those made here that still exist, by role."""
        found = {image.session_uid: image for image in bpy.data.images}
        return {role: found[uid] for role, uid in self._uids.items() if uid in found}

    def _link(self, obj: bpy.types.Object, images: Mapping[str, bpy.types.Image]) -> None:
        """Put the images on the object and its materials.

        With an undo step of its own: without one Blender would keep an object that it takes for unchanged, and free the
        images that it points to.  `on_undo` steps over it once the result is there.
        """
        self._linked = True
        if self.outline is None:
            return
        _display.maps = self
        with suppress(BadInput):  # is reported when the result is there; the Image Editor shows the maps until then
            material.check(obj, self.outline)
            stored_result.detach(obj)  # whoever opens a file that is saved now must not take these maps for that result
            material.adopt(obj, images, self.share)
            material.wire_maps(obj, self.outline, images, self.share)
        obj[SO_FAR] = self.token
        bpy.ops.ed.undo_push(message="Solve: Maps so Far")
        del obj[SO_FAR]  # no other step has it

    @property
    def on_object(self) -> bool:
        """Whether an object has its images."""
        uids = set(self._uids.values())
        return any(image.session_uid in uids for obj in bpy.data.objects for image in maps_of(obj).values())

    def drop(self) -> None:
        """The solve is over: take away what nothing points to."""
        _display.maps = None
        _display.over.add(self.token)
        for image in self.images().values():
            if image.users == 0:
                bpy.data.images.remove(image)
            elif image.is_dirty:  # no result has come; unpacked they would not be in the file
                image.pack()

    def solution(self) -> Solution | None:
        """What is there now, as the result of a solve that was stopped; None before the first base colour."""
        with self._merging:
            if "base_color" not in self.canvas.maps or self.canvas.coverage is None:
                return None
            if self.outline is None and self.start is not None:
                return replace(self.start, cancelled=True, warnings=(UNCHANGED,))  # looks do not tell of these
            size, why = self.canvas.size, KEPT if self.start else PARTIAL
            found = {role: self.canvas.maps.get(role, np.full((size, size), np.nan, np.float32)) for role in ROLES}
            known = np.isfinite(found["roughness"]) & np.isfinite(found["base_color"][..., 0]) & self.canvas.coverage
            known &= self.canvas.finest("roughness")  # coarse looks and drafts count as filled
            if self.start is not None:
                known &= ~self.start.maps.filled | (found["confidence"] > 0)  # it holds what was filled before as well
            maps = {role: np.nan_to_num(values, nan=UNKNOWN[role]) for role, values in found.items()}
            for role in ("confidence", "error"):
                maps[role] = np.where(known, maps[role], np.float32(0))
            # the inverse of gpu.look.confidence, which is all that was told; of base colour nothing was
            sigma = HALF_SURE * np.sqrt(np.maximum(1.0 / np.maximum(maps["confidence"], 1e-2) - 1.0, 0.0))
            covered, solved, kept = int(self.canvas.coverage.sum()), int(known.sum()), {}
            if self.start is not None:
                found_now = int((known & (maps["roughness"] != self.start.maps.roughness)).sum())
                solved, kept = found_now, {"kept": solved - found_now}
            elif not (self.canvas.finest("base_color") & known).any():
                why = COARSE
            return Solution(
                maps=Maps(**maps, filled=~known, coverage=self.canvas.coverage.copy(),
                          metallic=self.start.maps.metallic if self.start is not None else None,
                          roughness_sigma=np.where(known, sigma, 0).astype(np.float32),
                          base_sigma=np.where(known, UNKNOWN_SIGMA, 0).astype(np.float32)),
                model=self.model, why=dict.fromkeys(self.model, "stopped early"), seconds={}, device={},
                metallic=self.start.metallic if self.start is not None else {},
                paint=self.start.paint if self.start is not None else {},
                coats=self.start.coats if self.start is not None else {},
                diffuse_roughness=self.start.diffuse_roughness if self.start is not None else {},
                texels={"covered": covered, "observed": solved, "solved": solved, **kept,
                        "filled": covered - int(known.sum())},
                residual=float(np.sqrt(np.mean(maps["error"][known] ** 2))) if known.any() else 0.0,
                views_used=self.views, views_skipped=(), warnings=(why,), cancelled=True,
                pictures=self.latest.pictures if self.latest else ())


@dataclass
class _Display:
    """What the handlers of Undo, Redo and saving go by."""

    maps: LiveMaps | None = None  # what is on an object while its solve runs
    over: set[str] = field(default_factory=set)  # tokens of solves whose result is there


_display = _Display()


@persistent
def on_undo(*_: object) -> None:
    """undo_post handler: a step at which maps were so far is none that a user has made; one more goes to theirs."""
    if _landed():
        _soon(bpy.ops.ed.undo)
    elif (maps := _display.maps) is not None and not maps.on_object:
        maps.undone += 1
        if maps.undone == 1:
            _soon(bpy.ops.ed.undo)


@persistent
def on_redo(*_: object) -> None:
    """redo_post handler: as `on_undo`; the last step that a user has made has the maps so far behind it."""
    if _landed():
        _soon(bpy.ops.ed.redo)
    elif (maps := _display.maps) is not None:
        maps.undone = 0 if maps.on_object else maps.undone - 1
        if maps.undone == 1:
            _soon(bpy.ops.ed.redo)


def _landed() -> bool:
    """Whether the step that was gone to is one of maps so far, of a solve that is over; takes the mark off."""
    marked = [obj for obj in bpy.data.objects if SO_FAR in obj]
    tokens = {obj[SO_FAR] for obj in marked}
    for obj in marked:
        if obj.is_editable:
            del obj[SO_FAR]
    return bool(tokens & _display.over)


def _soon(operator: Callable[[], object]) -> None:
    """Call Undo or Redo, but not from within the other one."""
    def call() -> None:
        with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
            if operator.poll():  # type: ignore[attr-defined]
                operator()

    bpy.app.timers.register(call, first_interval=0.0)


@persistent
def on_save(*_: object) -> None:
    """save_pre handler: maps that are still on their way go into the file as they are; unpacked they would be lost."""
    for image in _display.maps.images().values() if _display.maps is not None else ():
        if image.is_dirty:
            image.pack()


def _cycles_is_on_show() -> bool:
    """Whether some viewport renders with Cycles."""
    return any(area.type == "VIEW_3D" and area.spaces.active.shading.type == "RENDERED"
               and window.scene.render.engine == "CYCLES"
               for window in bpy.context.window_manager.windows for area in window.screen.areas)


def _wake_solid(obj: bpy.types.Object) -> None:
    """Has Solid and Texture viewports draw anew: once their smoothing is done they keep the picture that they have."""
    areas = [area for window in bpy.context.window_manager.windows for area in window.screen.areas
             if area.type == "VIEW_3D" and area.spaces.active.shading.type == "SOLID"]
    if areas:
        obj.update_tag(refresh={"OBJECT"})
    for area in areas:
        area.tag_redraw()


def _rgba(values: F32, unknown: float) -> F32:
    """Flat RGBA of an (n, n) or (n, n, 3) map."""
    pixels = np.ones((*values.shape[:2], 4), np.float32)
    pixels[..., :3] = np.nan_to_num(values, nan=unknown) if values.ndim == 3 else np.nan_to_num(
        values, nan=unknown)[..., None]
    return pixels.ravel()
