"""Scene in: the open file as plain arrays.  Reads ``bpy.data``, changes nothing in it.

What a render would show is what is read: evaluated meshes, world matrices, active-render UV map.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.capture.captures import read_captures
from ...core.data import F64, Camera, Emitter, Environment, Light, MeshArrays, SceneData, View
from ...core.errors import BadInput
from ...core.images.reference_image import with_one_white_balance
from ...core.shading.emitters import counts
from ...core.shading.wide_lamps import NO_WORLD
from ..oiio import ensure_openimageio
from .scene_emitters import name_instances, read_emitter
from .scene_material import read_normal_maps
from .scene_mesh import read_mesh, read_occluders
from .scene_objects import changes, moves, names_of, read_camera, read_light, rendered_objects
from .scene_views import NamedView, SceneViews, alike_line
from .scene_world import lighting, read_environment, unmodelled

_DISPLAY_SUFFIXES = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp", ".tga"}


def read_scene(context: Any | None, object_name: str | None, captures: Path | None) -> SceneData:
    """The object to solve, its views and what stands around it.

    ``object_name`` None: the active object if it is a mesh, else the only renderable mesh.  ``captures`` None:
    the views of the scene's own list, else the cameras' background images under all renderable lights.
    Raises BadInput, one line, naming the object or file.
    """
    ensure_openimageio()
    context = bpy.context if context is None else context
    if not bpy.data.filepath:
        raise BadInput("the scene was never saved; save it first (File > Save)")
    depsgraph = context.evaluated_depsgraph_get()
    _check_working_space()
    subject = subject_of(context, object_name)
    if sum(obj.name == subject.name for obj in context.scene.objects) > 1:
        raise BadInput(alike_line(subject.name))
    reader = _Reader(context.scene, depsgraph, subject)
    reader.name_unmodelled()
    maps = read_normal_maps(subject, reader.warn)
    mesh = read_mesh(subject, depsgraph, maps, reader.warn)
    reader.sphere = _sphere(mesh)
    views = reader.views(captures)
    reader.name_moving(views)
    reader.name_display_images(views)
    name_instances(depsgraph, reader.warn)
    occluders, unseen = read_occluders(subject, depsgraph, reader.warn)
    return SceneData(
        name=Path(bpy.data.filepath).stem, mesh=mesh, occluders=occluders, views=views,
        pixel_filter=_pixel_filter(context.scene), warnings=tuple(dict.fromkeys(reader.warnings)),
        skipped=tuple(reader.skipped), scale_known=reader.scale_known, unseen=unseen,
    )


def _sphere(mesh: MeshArrays) -> tuple[F64, float]:
    """Centre and radius of a sphere about all corners."""
    points = mesh.positions.reshape(-1, 3).astype(np.float64)
    center = (points.min(0) + points.max(0)) / 2
    return center, float(np.linalg.norm(points - center, axis=1).max())


def _check_working_space() -> None:
    """Blender 5 can work in other spaces than linear Rec.709; the solver does not."""
    space = getattr(getattr(bpy.data, "colorspace", None), "working_space", "Linear Rec.709")
    if space != "Linear Rec.709":
        raise BadInput(f"the file's working colour space is {space}; "
                       "set it to Linear Rec.709 (Scene > Color Management)")


def subject_of(context: Any, name: str | None) -> Any:
    """The mesh that is solved: the one of that name, the active one, or the only one.  Raises BadInput."""
    if name is not None:
        obj = context.scene.objects.get(name)
        if obj is None:
            raise BadInput(f"object '{name}': is not in scene '{context.scene.name}'; "
                           f"it has {names_of(o for o in context.scene.objects if o.type == 'MESH') or 'no mesh'}")
        if obj.type != "MESH":
            raise BadInput(f"object '{name}': is a {obj.type.lower()}, not a mesh; choose a mesh")
        return obj
    active = context.view_layer.objects.active
    if active is not None and active.type == "MESH":
        return active
    meshes = [o for o in rendered_objects(context.view_layer).values() if o.type == "MESH"]
    if len(meshes) != 1:
        raise BadInput(f"which object to solve? the scene has {names_of(meshes)}; choose one" if meshes
                       else f"scene '{context.scene.name}': has no mesh to solve; add one")
    return meshes[0]


class _Reader:
    """Collects views, each camera and light read once, and warnings."""

    def __init__(self, scene: Any, depsgraph: Any, subject: Any) -> None:
        self.scene, self.depsgraph, self.subject = scene, depsgraph, subject
        self.warnings: list[str] = []
        self.skipped: list[tuple[str, str]] = []
        self._cameras: dict[str, Camera] = {}
        self._lights: dict[str, Light] = {}
        self._worlds: dict[tuple[str, float], Environment | None] = {}
        self._emitters: dict[str, Emitter | None] = {}
        self._environments: dict[tuple[str, float, tuple[str, ...]], Environment] = {}
        self.scale_known = bool(getattr(getattr(scene, "irpso", None), "scale_known", True))
        if not self.scale_known:
            self.warn("the lamps' power is not known (Shoot): Specular IOR Level is free, and base colours are right "
                      "up to one common factor; measure a grey card for absolute values")
        self.gain = film_gain(scene)
        self.sphere = np.zeros(3), 0.0  # about the subject: centre and radius

    def warn(self, text: str) -> None:
        self.warnings.append(text)

    def name_unmodelled(self) -> None:
        """Warns of what lights or shapes the references but not the solver's model."""
        subject = self.subject
        for modifier in subject.modifiers:
            if modifier.show_viewport != modifier.show_render or (
                modifier.show_render and getattr(modifier, "levels", 0) != getattr(modifier, "render_levels", 0)
            ):
                self.warn(f"object '{subject.name}': modifier '{modifier.name}' differs between viewport and render; "
                          "the viewport's shape is used")

    def name_display_images(self, views: Sequence[View]) -> None:
        """Warns when images that may have gone through a view transform would be read as sRGB."""
        transform = self.scene.view_settings.view_transform
        suspects = [v for v in views if v.colorspace in {None, "sRGB"} and v.image.suffix.lower() in _DISPLAY_SUFFIXES]
        rendered = self.scene.render.engine == "CYCLES" and not are_photographs(self.scene)
        if suspects and rendered and transform not in {"Standard", "Raw"}:
            self.warn(f"{suspects[0].image.name}: is read as plain sRGB; if Blender rendered it under this scene's "
                      "view "
                      f"transform {transform}, render to EXR instead")

    def name_moving(self, views: Sequence[View]) -> None:
        """Warns of what differs from frame to frame: all views are read at the scene's present one."""
        if len(views) < 2:
            return
        objects, read = self.scene.objects, f"but all views are read at frame {self.scene.frame_current}"
        if moves(self.subject):
            self.warn(f"object '{self.subject.name}': keyframes or a driver move it, {read}; for pictures of several "
                      "frames keep it still, make a camera for each picture, and set each view's World Turn")
        for kind, shown in (("camera", Counter(view.camera.name for view in views)),
                            ("light", Counter(light.name for view in views for light in view.lights))):
            for name in sorted(name for name, count in shown.items() if count > 1 and moves(objects[name])):
                self.warn(f"{kind} '{name}': keyframes or a driver move it, {read}; for pictures of several frames "
                          f"make a {kind} for each place")
        for name in sorted({view.environment.name for view in views if view.environment is not None} - {""}):
            world = bpy.data.worlds[name]
            if changes(world, ("color",)) or changes(world.node_tree, ("nodes",)):
                self.warn(f"world '{name}': keyframes or a driver change it, {read}; for pictures of several frames "
                          "set each view's World Turn, or give it a world of its own")

    def views(self, captures: Path | None) -> tuple[View, ...]:
        """Those of a capture file, else of the scene."""
        source = SceneViews(self.scene, self.depsgraph.view_layer)
        named = source.from_scene() if captures is None else source.from_captures(read_captures(captures), captures)
        if named.fault is not None:
            raise BadInput(named.fault.error)
        found = []
        for view in named.views:
            if not view.enabled:
                self.skipped.append((view.title, "switched off"))
                continue
            if view.faults:
                raise BadInput(view.faults[0].error)
            if self.subject.name in named.lights.intersection(view.emitters):
                raise BadInput(f"object '{self.subject.name}': is to be solved, but views name it as their light; "
                               "choose another object (make it active, or --object), or take it out of Lights")
            found.append(View(
                image=Path(view.image), camera=self._camera(view.camera), lights=tuple(map(self._light, view.lights)),
                exposure=view.exposure, mask=_path(view.mask), colorspace=view.colorspace, gain=self.gain,
                ambient=_path(view.ambient), flat=_path(view.flat), vignetting=view.vignetting,
                environment=self._environment(view), response=view.response, shoulder=view.shoulder,
                ambient_radiance=view.ambient_radiance, black_level=view.black_level, tint=view.tint,
            ))
        return with_one_white_balance(found)

    def _environment(self, view: NamedView) -> Environment | None:
        """The light of the world and of meshes that glow in a view; views with the same share one."""
        lights = [self._light(name) for name in view.lights]
        emitters = tuple(found for name in view.emitters if (found := self._emitter(name)) is not None
                         and counts(found, lights, *self.sphere))
        world = self._world(view, alone=not view.lights and not emitters)
        if not emitters:
            return world
        made = replace(world or NO_WORLD, emitters=emitters)
        return self._environments.setdefault(made.key, made)

    def _world(self, view: NamedView, alone: bool) -> Environment | None:
        world = self.scene.world if view.world is None else bpy.data.worlds[view.world]
        if world is not None:
            for line in unmodelled(world, self.depsgraph.view_layer, alone):
                self.warn(line)
        if not lighting(world, alone):
            return None
        key = world.name, view.turn
        if key not in self._worlds:
            self._worlds[key] = read_environment(world, math.radians(view.turn), self.warn)
        return self._worlds[key]

    def _emitter(self, name: str) -> Emitter | None:
        """A mesh that glows; that which is solved shines on nothing."""
        obj = self.scene.objects[name]
        if obj == self.subject:
            return None
        if name not in self._emitters:
            self._emitters[name] = read_emitter(obj, self.depsgraph, self.warn)
        return self._emitters[name]

    def _camera(self, name: str) -> Camera:
        if name not in self._cameras:
            obj = self.scene.objects[name]
            if obj.data.dof.use_dof:
                self.warn(f"camera '{name}': depth of field is not modelled; switch it off for the pictures")
            self._cameras[name] = read_camera(obj, self.scene, self.depsgraph)
        return self._cameras[name]

    def _light(self, name: str) -> Light:
        if name not in self._lights:
            self._lights[name] = read_light(self.scene.objects[name], self.depsgraph, self.warn)
        return self._lights[name]


def _path(name: str) -> Path | None:
    return Path(name) if name else None


def film_gain(scene: Any) -> float:
    """The factor from radiance to the pictures of a scene that Cycles rendered; 1 for photographs.  Raises BadInput."""
    rendered = scene.render.engine == "CYCLES" and not are_photographs(scene)
    gain = float(scene.cycles.film_exposure) if rendered else 1.0
    if not 0 < gain < math.inf:
        raise BadInput(f"scene '{scene.name}': its film exposure is {gain:g}; set it to 1 (Render > Film)")
    return gain


def are_photographs(scene: Any) -> bool:
    """Whether the scene's render settings say nothing of its pictures."""
    return bool(getattr(getattr(scene, "irpso", None), "photographs", False))


# Blackman-Harris window (Harris 1978): coefficients of its cosine series
_BLACKMAN_HARRIS = (0.35875, 0.48829, 0.14128, 0.01168)


def _pixel_filter(scene: Any) -> float:
    """Width in pixels of the box with the standard deviation of the scene's render filter.

    Measured on a line rendered by Cycles (the test shows it): Box is 1 pixel whatever the width says, the
    Gaussian's table reaches over 3 widths, Blackman-Harris' over 2, and the first sample of every pixel is
    its centre, so a render of one sample has no filter at all.
    """
    if scene.render.engine != "CYCLES" or are_photographs(scene):
        return 1.0
    if scene.cycles.samples == 1:
        return 0.01
    width = float(scene.cycles.filter_width)
    if not 0 < width < math.inf:
        raise BadInput(f"scene '{scene.name}': its pixel filter's width is {width:g}; set it to 1.5 (Render > Film)")
    if scene.cycles.pixel_filter_type == "BOX":
        return 1.0
    if scene.cycles.pixel_filter_type == "GAUSSIAN":  # exp(-2 (6 x / reach)^2): sigma = reach / 12
        return 3 * width / 12 * math.sqrt(12)
    a0, *rest = _BLACKMAN_HARRIS
    variance = 1 / 12 + sum((-1) ** k * a / (2 * math.pi**2 * k**2) for k, a in enumerate(rest, 1)) / a0
    return 2 * width * math.sqrt(12 * variance)
