"""Lamps where chrome balls mirror them: lights of the views that have one, new lights for views that have none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...core.data import F64
from ...core.errors import BadInput
from ...core.shoot.ball_highlight import Ray
from ...core.shoot.lamp_position import direction_scatter, lamp_position
from ..scene.scene_objects import names_of, require_metres, world_matrix
from .ball_list import keep_circles, read_balls
from .ball_pictures import ChromeBall, FoundBall, find_balls, pictures_of, world_rays
from .view_pictures import ListedView, listed_views

RADIUS = 0.015  # metres, of a new lamp
SHOWN = 1.0  # metres at which a light is drawn whose direction alone is known

Key = bpy.types.Object | int  # a light of the scene, or the number of a new one, from 0


@dataclass(frozen=True)
class FoundLamp:
    """What the balls say of a lamp."""

    name: str
    position: F64 | None  # (3,) world, metres; None: distant
    direction: F64  # (3,) unit, from the balls to the lamp
    near: F64  # (3,) world: where a distant one is drawn
    line: str  # for the user


@dataclass(frozen=True)
class PlacedLamps:
    """What was done."""

    lamps: dict[str, FoundLamp]  # by the light object's name
    balls: tuple[FoundBall, ...]
    messages: tuple[str, ...]  # for the user


def place_lamps(context: bpy.types.Context, balls: Sequence[ChromeBall]) -> PlacedLamps:
    """Puts a light where each lamp is, or a sun where only its direction is known.

    A view with one light tells of that; the k-th view without lights of each camera is of the k-th new lamp, and gets
    it.  New lights share one data block, so they have one power.  Raises BadInput, and changes nothing then.
    """
    require_metres(context.scene)
    views = listed_views(context)
    found = find_balls(views, balls)
    rays = _rays(views, found)
    lamps = {key: _lamp(f"Lamp {key + 1:03d}" if isinstance(key, int) else key.name, own) for key, own in rays.items()}
    _refuse_linked([key for key in lamps if not isinstance(key, int)])
    blocks = _Blocks()
    objects = {key: _place(context, key, lamp, blocks) for key, lamp in lamps.items()}
    numbers = _numbers(views)
    for at, view in enumerate(views):
        if numbers.get(at) in objects:
            view.entry.lights.add().light = objects[numbers[at]]
    if blocks.made:
        context.scene.irpso.scale_known = False
    lines = (*(ball.line for ball in found), *(lamp.line for lamp in lamps.values()), *blocks.lines())
    return PlacedLamps({objects[key].name: lamp for key, lamp in lamps.items()}, tuple(found), lines)


def place_lamps_of_scene(given: Sequence[tuple[str, tuple[float, ...]]]) -> PlacedLamps:
    """`place_lamps` in the open file, of balls by their camera's name with x, y, radius (pixels) and radius (mm).

    A circle's radius of 0: it is to be found.  They become the scene's list.  Raises BadInput.
    """
    scene = bpy.context.scene
    scene.irpso.shoot.balls.clear()
    for name, (x, y, circle, millimetres) in given:
        camera = scene.objects.get(name)
        if camera is None or camera.type != "CAMERA":
            have = names_of(obj for obj in scene.objects if obj.type == "CAMERA") or "no camera"
            raise BadInput(f"camera '{name}': is not in scene '{scene.name}'; it has {have}")
        ball = scene.irpso.shoot.balls.add()
        ball.camera, ball.x, ball.y, ball.circle, ball.radius = camera, x, y, circle, millimetres
    placed = place_lamps(bpy.context, read_balls(scene.irpso.shoot.balls))
    keep_circles(scene.irpso.shoot.balls, placed.balls)
    return placed


def _rays(views: Sequence[ListedView], balls: Sequence[FoundBall]) -> dict[Key, list[Ray]]:
    """Those of each lamp, in the world.  Raises BadInput."""
    cameras = {ball.camera: None for ball in balls}
    numbers = _numbers(views)
    bare = {view.entry.camera for at, view in enumerate(views) if at in numbers}
    if bare & set(cameras):
        _refuse_uneven(views, bare)
    rays: dict[Key, dict[int, list[Ray]]] = {}  # of each ball, by its place in the list
    for at, view in enumerate(views):
        key = numbers.get(at, _only_light(view))
        if key is not None and view.entry.camera in cameras:
            shown = [number for number, ball in enumerate(balls) if ball.camera == view.entry.camera]
            for number, ray in zip(shown, world_rays(view, [balls[number] for number in shown]), strict=True):
                rays.setdefault(key, {}).setdefault(number, []).append(ray)
    if not rays:
        raise BadInput(f"camera '{next(iter(cameras)).name}': every view of it has several lights; a chrome ball "
                       "needs one lamp per picture")
    return {key: [_mean_ray(own) for own in by_ball.values()] for key, by_ball in rays.items()}


def _mean_ray(rays: Sequence[Ray]) -> Ray:
    """Of one ball in several pictures with one lamp: they tell of one direction, since they share the ball's circle."""
    direction = np.sum([ray.direction for ray in rays], axis=0)
    return Ray(np.mean([ray.origin for ray in rays], axis=0), direction / np.linalg.norm(direction))


def _numbers(views: Sequence[ListedView]) -> dict[int, int]:
    """Of each view without lights, by its place in the list: which of its camera's it is, from 0."""
    numbers, counts = {}, dict[bpy.types.Object, int]()
    for at, view in enumerate(views):
        if not view.entry.lights:
            camera = view.entry.camera
            numbers[at] = counts.get(camera, 0)
            counts[camera] = numbers[at] + 1
    return numbers


def _only_light(view: ListedView) -> bpy.types.Object | None:
    """The light of a view that has one; None where it has more.  Raises BadInput where it was deleted."""
    if len(view.entry.lights) != 1:
        return None
    light = view.entry.lights[0].light
    if light is None:
        raise BadInput(f"{view.name}: its view has an empty light entry; choose a light or remove the entry")
    if light.type != "LIGHT":
        raise BadInput(f"{view.name}: is lit by '{light.name}', which is not a lamp, and only lamps can be placed; "
                       "switch the view off")
    return light


def _refuse_uneven(views: Sequence[ListedView], cameras: set[bpy.types.Object]) -> None:
    """The k-th picture of each camera shows the k-th lamp: raises BadInput unless there are as many."""
    counts = {camera.name: sum(not view.entry.lights for view in pictures_of(views, camera)) for camera in cameras}
    least, most = min(counts, key=counts.__getitem__), max(counts, key=counts.__getitem__)
    if counts[least] != counts[most]:
        raise BadInput(f"camera '{least}': has {counts[least]} views without lights, camera '{most}' {counts[most]}; "
                       "give each camera one view per lamp, in the same order, or choose the views' lights")


def _lamp(name: str, rays: Sequence[Ray]) -> FoundLamp:
    """Raises BadInput where the rays do not belong together."""
    if len(rays) == 1:
        x, y, z = rays[0].direction
        line = f"{name}: one ball gives a direction only, ({x:.3f}, {y:.3f}, {z:.3f}): it was added as a sun"
        return FoundLamp(name, None, rays[0].direction, rays[0].origin + SHOWN * rays[0].direction, line)
    found = lamp_position(rays, name)
    line = found.summary(name)
    if found.position is None:
        scatter = direction_scatter([ray.direction for ray in rays])
        line += f"; any two rays differ by {scatter:.2f} degrees: it was added as a sun"
    return FoundLamp(name, found.position, found.direction, found.middle + found.distance * found.direction, line)


class _Blocks:
    """The data blocks that new lamps share: one for those with a place, one for distant ones."""

    def __init__(self) -> None:
        self.made: dict[str, Any] = {}  # by type

    def of(self, kind: str) -> Any:
        """POINT or SUN."""
        if kind not in self.made:
            data = bpy.data.lights.new("Lamps" if kind == "POINT" else "Distant Lamps", kind)
            data.energy = 100.0 if kind == "POINT" else 1.0
            if kind == "POINT":
                data.shadow_soft_size = RADIUS
            self.made[kind] = data
        return self.made[kind]

    def lines(self) -> list[str]:
        """That their power is a guess."""
        return [f"light '{data.name}': its power is not known, and {data.energy:g} {unit} is a guess for all lamps "
                "that share it: set the power, or use a grey card"
                for kind, unit in (("POINT", "W"), ("SUN", "W/m^2")) if (data := self.made.get(kind)) is not None]


def _refuse_linked(objects: Sequence[bpy.types.Object]) -> None:
    for obj in objects:
        if obj.library is not None:
            raise BadInput(f"light '{obj.name}': is linked from another file; make it local")


def _place(context: bpy.types.Context, key: Key, lamp: FoundLamp, blocks: _Blocks) -> bpy.types.Object:
    """A light of the scene or a new one, as the balls say."""
    distant = lamp.position is None
    if isinstance(key, int):
        obj = bpy.data.objects.new(lamp.name, blocks.of("SUN" if distant else "POINT"))
        context.scene.collection.objects.link(obj)
    else:
        obj = key
        if (obj.data.type == "SUN") != distant:
            obj.data = blocks.of("SUN" if distant else "POINT")
    matrix = Matrix(world_matrix(obj, context.evaluated_depsgraph_get()))
    if distant:  # it shines along its -Z
        turn = Vector(lamp.direction).to_track_quat("Z", "Y")
        matrix = Matrix.LocRotScale(Vector(lamp.near), turn, Vector((1, 1, 1)))
    else:
        matrix.translation = Vector(np.asarray(lamp.position))
    obj.matrix_world = matrix
    return obj
