"""Rigs: cameras and lamps around an object, as people shoot, each picture with a place in the list of views."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import bpy
from mathutils import Matrix, Vector

from ...core.errors import BadInput

GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))
SAME_SIDE = math.radians(100)  # a lamp farther than that from its camera, seen from the object, lights nothing it sees
ROOM = 1.1  # around the object in the picture
POWER = 25.0  # W per square metre of distance: white paper comes out at about 0.8 W/(m^2 sr)
SPREAD = math.radians(60)  # of a turntable's lamps to either side of the camera
KINDS = {
    "FLASH": ("Flash Photo Set", "Photographs from all around, each lit by the flash beside its camera alone"),
    "DOME": ("Light Dome", "Cameras and lamps that stand still; one lamp shines in each picture"),
    "TURNTABLE": ("Turntable", "The camera and the lamps stand still and the object turns; in the scene they go around "
                               "the object"),
}


@dataclass(frozen=True)
class Plan:
    """What the user chooses of a rig.  Angles in radians; distances as multiples of that which fills the picture."""

    kind: str  # of KINDS
    cameras: int = 16  # of a turntable: turns
    lamps: int = 1  # of a dome: all; of a turntable: for each camera
    low: float = math.radians(-10)  # elevation of the lowest ...
    high: float = math.radians(60)  # ... and the highest camera; of a dome also lamps
    distance: float = 1.0
    offset: float = math.radians(10)  # between flash and camera, seen from the object


@dataclass
class Rig:
    """What was made."""

    collection: bpy.types.Collection
    cameras: list[bpy.types.Object] = field(default_factory=list)
    lamps: list[bpy.types.Object] = field(default_factory=list)
    shots: list[tuple[bpy.types.Object, bpy.types.Object, str]] = field(default_factory=list)  # camera, lamp, file


def build(scene: bpy.types.Scene, obj: bpy.types.Object, plan: Plan) -> Rig:
    """The rig around ``obj``, in a collection of its own, with its views at the end of the list.

    Raises BadInput for an object without size.
    """
    centre, radius = bounds(obj)
    if not radius > 0:
        raise BadInput(f"{obj.name}: has no size; a rig cannot be fitted to it")
    name = KINDS[plan.kind][0]
    rig = Rig(bpy.data.collections.new(name))
    scene.collection.children.link(rig.collection)
    maker = _Maker(scene, rig, centre, radius, plan)
    {"FLASH": maker.flash, "DOME": maker.dome, "TURNTABLE": maker.turntable}[plan.kind]()
    for camera, lamp, file in rig.shots:
        view = scene.irpso.views.add()
        view.image, view.camera = f"//{rig.collection.name}/{file}.exr", camera
        view.lights.add().light = lamp
    scene.irpso.active_view = max(len(scene.irpso.views) - len(rig.shots), 0)
    if scene.camera is None and rig.cameras:
        scene.camera = rig.cameras[0]
    return rig


def bounds(obj: bpy.types.Object) -> tuple[Vector, float]:
    """Centre and radius of a sphere around the object's bounding box, in world space."""
    corners = [obj.matrix_world @ Vector(corner) for corner in obj.bound_box]
    centre = sum(corners, Vector()) / len(corners)
    return centre, max((corner - centre).length for corner in corners)


def directions(count: int, low: float, high: float) -> Iterator[Vector]:
    """Unit vectors spread evenly over the zone between two elevations: a spiral of golden angles."""
    bottom, top = math.sin(low), math.sin(high)
    for i in range(count):
        z = top - (top - bottom) * (i + 0.5) / count
        ring = math.sqrt(1 - z * z)
        yield Vector((ring * math.cos(i * GOLDEN_ANGLE), ring * math.sin(i * GOLDEN_ANGLE), z))


def filling(camera: bpy.types.Camera, scene: bpy.types.Scene, radius: float) -> float:
    """Distance at which a sphere fills the picture's shorter side."""
    sides = (scene.render.resolution_x * scene.render.pixel_aspect_x,
             scene.render.resolution_y * scene.render.pixel_aspect_y)
    half = math.atan(math.tan(camera.angle / 2) * min(sides) / max(sides))  # the angle is that of the longer side
    return ROOM * radius / math.sin(half)


class _Maker:
    """Objects of one rig; all cameras share one camera datablock, all lamps one light."""

    def __init__(self, scene: bpy.types.Scene, rig: Rig, centre: Vector, radius: float, plan: Plan) -> None:
        self.rig, self.centre, self.plan = rig, centre, plan
        name = rig.collection.name
        self.camera, self.light = bpy.data.cameras.new(name), bpy.data.lights.new(name, "POINT")
        self.distance = plan.distance * filling(self.camera, scene, radius)
        self.camera.clip_start, self.camera.clip_end = self.distance / 100, self.distance * 100
        self.camera.display_size = radius / 4
        self.light.energy, self.light.shadow_soft_size = POWER * self.distance**2, 0.0

    def flash(self) -> None:
        """A camera each with its flash."""
        up = self.distance * math.tan(self.plan.offset)
        for i, direction in enumerate(directions(self.plan.cameras, self.plan.low, self.plan.high), 1):
            camera = self._camera(f"Photo {i:02d}", direction)
            flash = self._lamp(f"Flash {i:02d}")
            flash.parent, flash.location = camera, (0.0, up, 0.0)
            self.rig.shots.append((camera, flash, camera.name))

    def dome(self) -> None:
        """Every camera with every lamp on its side."""
        plan = self.plan
        cameras = [self._camera(f"Dome Camera {i}", direction)
                   for i, direction in enumerate(_ring(plan.cameras, plan.low, plan.high), 1)]
        lamps = []
        for i, direction in enumerate(directions(plan.lamps, plan.low, math.radians(85)), 1):
            lamps.append(self._lamp(f"Dome Lamp {i:02d}"))
            lamps[-1].location = self.centre + direction * self.distance
        self.rig.shots += [
            (camera, lamp, f"{camera.name}, {lamp.name}") for camera in cameras for lamp in lamps
            if (camera.location - self.centre).angle(lamp.location - self.centre) < SAME_SIDE]

    def turntable(self) -> None:
        """The camera and its lamps, once for each turn."""
        plan = self.plan
        for turn in range(plan.cameras):
            azimuth = 2 * math.pi * turn / plan.cameras
            camera = self._camera(f"Turn {turn + 1:02d}", _towards(azimuth, plan.high))
            for i in range(plan.lamps):
                side = SPREAD * (2 * (i + 0.5) / plan.lamps - 1)
                lamp = self._lamp(f"Lamp {chr(ord('A') + i)} {turn + 1:02d}")
                lamp.location = self.centre + self.distance * _towards(azimuth + side, plan.low if i % 2 else plan.high)
                self.rig.shots.append((camera, lamp, f"{camera.name}, {lamp.name}"))

    def _camera(self, name: str, direction: Vector) -> bpy.types.Object:
        """Looks at the object from a direction."""
        camera = self._add(name, self.camera)
        place = self.centre + direction * self.distance
        camera.matrix_world = Matrix.LocRotScale(place, (-direction).to_track_quat("-Z", "Y"), None)
        self.rig.cameras.append(camera)
        return camera

    def _lamp(self, name: str) -> bpy.types.Object:
        lamp = self._add(name, self.light)
        self.rig.lamps.append(lamp)
        return lamp

    def _add(self, name: str, data: bpy.types.ID) -> bpy.types.Object:
        obj = bpy.data.objects.new(name, data)
        self.rig.collection.objects.link(obj)
        return obj


def _ring(count: int, low: float, high: float) -> Iterator[Vector]:
    """Around the object, high and low in turn; a single one in the middle."""
    for i in range(count):
        yield _towards(2 * math.pi * i / count, (low + high) / 2 if count == 1 else low if i % 2 else high)


def _towards(azimuth: float, elevation: float) -> Vector:
    """Unit vector; azimuth 0 is Blender's front, -Y."""
    return Vector((math.sin(azimuth) * math.cos(elevation), -math.cos(azimuth) * math.cos(elevation),
                   math.sin(elevation)))
