"""The views that a scene or a capture file names, and what keeps them from being used.

`scene` stops at the first fault; the panels, by `readiness`, show them all.  Files are not opened here.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from ...core.capture.captures import MOST_EXPOSURE, CaptureView
from ..glow import glows
from .scene_objects import names_of, rendered_objects
from .scene_world import is_black

PROJECTIONS = {"PERSP", "ORTHO"}  # types of the cameras that are modelled


@dataclass(frozen=True)
class Fault:
    """What keeps a view, or the whole scene, from being used."""

    line: str  # for a panel, beside the view's name
    error: str  # for BadInput: which view, what, and the cure


@dataclass(frozen=True)
class NamedView:
    """A view by the names of its files and objects."""

    title: str  # the image as the user named it, else which view it is
    image: str  # absolute path, "" where there is none
    camera: str
    lights: tuple[str, ...]  # lamps
    every_light: bool = False  # the view names none, and these are all that render
    exposure: float = 0.0  # EV
    mask: str = ""  # absolute path, "" where there is none
    colorspace: str | None = None
    enabled: bool = True
    faults: tuple[Fault, ...] = ()
    ambient: str = ""  # absolute path, "" where there is none
    flat: str = ""
    vignetting: float = 0.0
    world: str | None = None  # of that name; None: the scene's
    turn: float = 0.0  # degrees about Z
    response: float = 1.0
    shoulder: float = 1.0
    ambient_radiance: tuple[float, float, float] = (0.0, 0.0, 0.0)
    black_level: tuple[float, float, float] = (0.0, 0.0, 0.0)
    emitters: tuple[str, ...] = ()  # meshes that glow in it
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class NamedViews:
    """The views of one source."""

    views: tuple[NamedView, ...]
    fault: Fault | None = None  # why there is no view to use
    lights: frozenset[str] = frozenset()  # that some view names, lamps and meshes that glow


def alike_line(name: str) -> str:
    """For BadInput: which object is meant is not clear."""
    return f"'{name}': is the name of two objects in the scene, one of them linked from a library; rename the other"


class SceneViews:
    """Lists the views of a scene and judges each of them."""

    def __init__(self, scene: Any, view_layer: Any) -> None:
        self._scene, self._view_layer = scene, view_layer
        self._objects: dict[str, Any] = {}
        self._alike: set[str] = set()  # names that two objects have, one of which is linked
        for obj in scene.objects:
            if self._objects.setdefault(obj.name, obj) != obj:
                self._alike.add(obj.name)
        self._all_lights: tuple[str, ...] | None = None
        self._all_glowing: tuple[str, ...] | None = None
        self._named: set[str] = set()  # lights that some view names
        self._glow: dict[Any, bool] = {}  # of materials
        self._choices: dict[str, str] = {}

    def from_captures(self, entries: Iterable[CaptureView], path: Path) -> NamedViews:
        """Those of a capture file."""
        found = tuple(entries)
        self._named = {name for entry in found for name in entry.lights}
        return NamedViews(tuple(self._captured(entry, f"{path}: view {index}") for index, entry in enumerate(found)),
                          lights=frozenset(self._named))

    def from_scene(self) -> NamedViews:
        """Those of the scene's own list, else the cameras' background images under every light that renders."""
        entries = getattr(getattr(self._scene, "irpso", None), "views", None)
        name, cure = self._scene.name, ("has no view; add views in the IRPSO tab, give the cameras background images, "
                                        "or pass a captures.json")
        if entries:
            self._named = {item.light.name for entry in entries for item in entry.lights if item.light is not None}
            views = tuple(self._entry(entry, f"view {i} of scene '{name}'") for i, entry in enumerate(entries))
            used = any(view.enabled for view in views)
            return NamedViews(views, None if used else Fault("Every view is switched off", f"scene '{name}': {cure}"),
                              frozenset(self._named))
        views = tuple(self._backgrounds())
        if not self._of_type("CAMERA"):
            cure = "has no camera; add one for each reference image"
        none = Fault("No views; add them under Capture", f"scene '{name}': {cure}")
        return NamedViews(views, None if views else none)

    def _captured(self, entry: CaptureView, where: str) -> NamedView:
        faults = self._camera_faults(entry.camera, where, "is not in the scene")
        faults += self._light_faults(entry.lights, where, "is not in the scene")
        faults += self._world_faults(entry, where)
        image = str(entry.image)
        return NamedView(image, image, entry.camera, self._lamps(entry.lights), emitters=self._emitters(entry.lights),
                         exposure=entry.exposure, mask=str(entry.mask or ""),
                         colorspace=entry.colorspace, faults=tuple(faults), ambient=str(entry.ambient or ""),
                         flat=str(entry.flat or ""), vignetting=entry.vignetting, world=entry.world,
                         turn=entry.turn, response=entry.response, shoulder=entry.shoulder,
                         ambient_radiance=entry.ambient_radiance, black_level=entry.black_level, tint=entry.tint)

    def _entry(self, entry: Any, where: str) -> NamedView:
        camera = entry.camera.name if entry.camera is not None else ""
        lights = tuple(item.light.name if item.light is not None else "" for item in entry.lights)
        faults = [] if entry.image else [
            Fault("No image", f"{where}: has no image; choose one or switch the view off")]
        faults += self._camera_faults(camera, where, "was deleted")
        faults += self._light_faults(lights, where, "was deleted") if lights else self._dark_faults()
        if not abs(entry.exposure) <= MOST_EXPOSURE:  # so is NaN
            faults.append(Fault(f"Exposure {entry.exposure:g} is out of range",
                                f"{where}: exposure {entry.exposure:g} is out of range; "
                                f"must be between -{MOST_EXPOSURE} and {MOST_EXPOSURE} EV"))
        return NamedView(
            entry.image or where, bpy.path.abspath(entry.image), camera,
            self._lamps(lights) if lights else self._rendered_lights(), not lights,
            float(entry.exposure), bpy.path.abspath(entry.mask), entry.colorspace or None, entry.enabled, tuple(faults),
            bpy.path.abspath(entry.ambient), bpy.path.abspath(entry.flat), float(entry.vignetting),
            turn=float(entry.turn), response=float(entry.response), shoulder=float(entry.shoulder),
            ambient_radiance=tuple(map(float, entry.ambient_radiance)),
            black_level=tuple(map(float, entry.black_level)), tint=tuple(map(float, entry.tint)),
            emitters=self._emitters(lights) if lights else self._glowing())

    def _backgrounds(self) -> Iterable[NamedView]:
        for camera in self._of_type("CAMERA"):
            for slot in camera.data.background_images:
                image = slot.image
                if slot.source != "IMAGE" or image is None:
                    continue
                faults = []
                if image.packed_file is not None or image.source != "FILE":
                    faults.append(Fault(
                        "Is not a single file on disk; unpack it (File > External Data)",
                        f"image '{image.name}' (background of camera '{camera.name}'): is not a single file on disk; "
                        "unpack it (File > External Data)"))
                faults += self._dark_faults() + self._camera_faults(camera.name, "background images", "")
                yield NamedView(image.name, bpy.path.abspath(image.filepath, library=image.library), camera.name,
                                self._rendered_lights(), True, colorspace=image.colorspace_settings.name,
                                faults=tuple(faults), emitters=self._glowing())

    def _camera_faults(self, name: str, where: str, absent: str) -> list[Fault]:
        if not name:
            return [Fault("No camera", f"{where}: has no camera; choose one or switch the view off")]
        faults = self._absence(name, "CAMERA", where, absent)
        if not faults and self._objects[name].data.type not in PROJECTIONS:
            what = "panoramic" if self._objects[name].data.type == "PANO" else "neither perspective nor orthographic"
            return [Fault(f"Camera '{name}' is {what}",
                          f"camera '{name}': is neither perspective nor orthographic; change its type")]
        return faults

    def _light_faults(self, names: Sequence[str], where: str, absent: str) -> list[Fault]:
        faults = []
        for name in names:
            faults += self._absence(name, "LIGHT", where, absent) if name else [
                Fault("No light", f"{where}: has an empty light entry; choose a light or remove the entry")]
        return faults

    def _world_faults(self, entry: CaptureView, where: str) -> list[Fault]:
        """Of a capture file's view: a world that is not there, or no light at all."""
        world = self._scene.world if entry.world is None else bpy.data.worlds.get(entry.world)
        if entry.world is not None and world is None:
            names = ", ".join(f"'{world.name}'" for world in bpy.data.worlds) or "none"
            return [Fault(f"World '{entry.world}' is not in the file",
                          f"{where}: world '{entry.world}' does not exist; there are: {names}")]
        if not entry.lights and not self._emitters(()) and is_black(world):
            return [Fault("No light, and the world is black",
                          f"{where}: has no light and the world is black; name the lights that were on, or give the "
                          "world its environment")]
        return []

    def _dark_faults(self) -> list[Fault]:
        """Of a view that names no light."""
        lights = self._rendered_lights() + self._glowing()
        return self._alike_faults(lights) if lights or not is_black(self._scene.world) else [Fault(
            "No light in the scene renders",
            f"scene '{self._scene.name}': has no light that renders and its world is black; add those of the "
            "references")]

    def _absence(self, name: str, kind: str, where: str, absent: str) -> list[Fault]:
        """What is wrong with an object that is named as a camera or light."""
        obj = self._objects.get(name)
        if obj is not None and (obj.type == kind or (kind == "LIGHT" and glows(obj, self._glow))):
            return self._alike_faults([name])
        if kind not in self._choices:  # once: a long list may name many
            glowing = [self._objects[name] for name in self._glowing()] if kind == "LIGHT" else []
            self._choices[kind] = names_of(self._of_type(kind) + glowing) or "none"
        what = "does not exist in the scene" if obj is None else f"is a {obj.type.lower()}"
        return [Fault(f"{kind.capitalize()} '{name}' {absent}",
                      f"{where}: {kind.lower()} '{name}' {what}; there are: {self._choices[kind]}")]

    def _alike_faults(self, names: Iterable[str]) -> list[Fault]:
        """Of names that do not tell which object is meant."""
        return [Fault(f"'{name}' is the name of two objects", alike_line(name))
                for name in names if name in self._alike]

    def _of_type(self, kind: str) -> list[Any]:
        return [obj for obj in self._scene.objects if obj.type == kind]

    def _rendered_lights(self) -> tuple[str, ...]:
        if self._all_lights is None:
            found = rendered_objects(self._view_layer).values()
            self._all_lights = tuple(obj.name for obj in found if obj.type == "LIGHT")
        return self._all_lights

    def _glowing(self) -> tuple[str, ...]:
        """The meshes that glow and render."""
        if self._all_glowing is None:
            found = rendered_objects(self._view_layer).values()
            self._all_glowing = tuple(dict.fromkeys(obj.name for obj in found if glows(obj, self._glow)))
        return self._all_glowing

    def _lamps(self, names: Sequence[str]) -> tuple[str, ...]:
        """Of a view's lights, those that are no meshes."""
        return tuple(name for name in names if name not in self._objects or not glows(self._objects[name], self._glow))

    def _emitters(self, names: Sequence[str]) -> tuple[str, ...]:
        """The meshes that glow in a view that names lights: those that it names, and those that no view names."""
        lamps = self._lamps(names)
        named = tuple(name for name in names if name not in lamps) if len(lamps) < len(names) else ()
        return named + tuple(name for name in self._glowing() if name not in self._named)
