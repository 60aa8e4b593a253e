"""Lights of the scene in another place, or of another power, whatever stands above them or shares their data."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...core.errors import BadInput
from .scene_objects import PLACE, animated, read_light, world_matrix

POWER, SIZE = ("energy", "color"), ("shadow_soft_size", "angle", "size")  # starts of animated paths


def object_named(scene: Any, name: str, kind: str = "LIGHT") -> Any:
    """The light or camera.  Raises BadInput where it is gone, or not to be changed."""
    obj, what = scene.objects.get(name), f"{kind.lower()} '{name}'"
    if obj is None or obj.type != kind:
        raise BadInput(f"{what}: is not in the scene any more; solve again")
    if obj.library is not None:
        raise BadInput(f"{what}: belongs to another file; make it local (Object > Relations > Make Local)")
    return obj


def check_place(obj: Any) -> None:
    """Raises BadInput where the light or camera cannot be moved because something else places it."""
    what = f"{obj.type.lower()} '{obj.name}'"
    if any(constraint.enabled for constraint in obj.constraints):
        raise BadInput(f"{what}: a constraint places it; apply the constraint, then try again")
    if animated(obj, PLACE):
        raise BadInput(f"{what}: keyframes or a driver place it; remove them, then try again")


def check_power(light: Any) -> None:
    """Raises BadInput where the light's power is not its own."""
    if animated(light.data, POWER):
        raise BadInput(f"light '{light.name}': keyframes or a driver set its power or color; remove them, then try "
                       "again")


def check_size(light: Any) -> None:
    """Raises BadInput where the light's size is not its own, or what it sends with a size is not to be read."""
    if animated(light.data, SIZE):
        raise BadInput(f"light '{light.name}': keyframes or a driver set its size; remove them, then try again")
    _power(light)


def moved_matrix(light: Any, offset: Sequence[float]) -> Matrix:
    """Object to world, by metres along the world's axes; a SUN's direction to it is changed by radians."""
    world = Matrix(world_matrix(light, bpy.context.evaluated_depsgraph_get()))
    if light.data.type != "SUN":
        return Matrix.Translation(offset) @ world
    before = world.col[2].xyz.normalized()
    turn = before.rotation_difference(sun_turned(before, offset)).to_matrix().to_4x4()
    place = Matrix.Translation(world.translation)
    return place @ turn @ place.inverted() @ world


def sun_turned(direction: Vector, offset: Sequence[float]) -> Vector:
    """A direction to a SUN, changed by radians along the world's axes."""
    after = direction.copy()
    for axis, by in enumerate(offset):  # one by one, as a solve does it
        after[axis] += by
        after.normalize()
    return after


def place(light: Any, world: Matrix) -> None:
    """Puts it there.  Of what viewports hide, as flashes are, Blender knows no world matrix."""
    now = Matrix(world_matrix(light, bpy.context.evaluated_depsgraph_get()))
    basis = light.matrix_basis.copy()
    above = now @ basis.inverted_safe()  # all that its own place is relative to
    after = above.inverted_safe() @ world
    if light.data.type == "SUN":
        light.matrix_basis = after
    else:  # its rotation and scale stay as they are, to the bit
        basis.translation = after.translation
        light.matrix_basis = basis


def multiply_power(lights: Sequence[Any], factor: float, tint: Sequence[float] = (1.0, 1.0, 1.0)) -> None:
    """Of lights that may share their data with each other; other lights that share it keep their power.

    ``tint``: factors of their red, green and blue beside that.
    """
    for data in _own_data(lights):
        data.energy *= factor
        if any(part != 1.0 for part in tint):
            data.color = tuple(old * part for old, part in zip(data.color, tint, strict=True))


def resize(lights: Sequence[Any], extent: float, given: float) -> None:
    """Gives lights half a width, metres, of SUNs a half angle, radians, in place of ``given``; as `multiply_power`."""
    for data in _own_data(lights):
        one = next(light for light in lights if light.data == data)
        before = _power(one)
        if data.type == "SUN":
            data.angle = 2 * extent
        elif data.type == "AREA":  # its object may be scaled
            data.size, data.size_y = data.size * extent / given, data.size_y * extent / given
        else:
            data.shadow_soft_size = extent
        data.energy *= before / _power(one)  # without Normalize, it grows with the size


def _power(light: Any) -> float:
    power = read_light(light, bpy.context.evaluated_depsgraph_get(), lambda line: None).power
    return max(float(power.mean()), 1e-30)


def _own_data(lights: Sequence[Any]) -> Iterator[Any]:
    """What no other light shares; lights that share it with others get a copy."""
    for data in {light.data for light in lights}:
        own = [light for light in lights if light.data == data]
        changed = data
        if data.library is not None or data.users - data.use_fake_user > len(own):
            changed = data.copy()
            for light in own:
                light.data = changed
        yield changed


def axes_of(scene: Any, camera: str) -> np.ndarray:
    """(3, 3) world from a camera's axes: right, up, backwards.  Raises BadInput where it is gone."""
    obj = scene.objects.get(camera)
    if obj is None or obj.type != "CAMERA":
        raise BadInput(f"camera '{camera}': is not in the scene any more; solve again")
    axes = world_matrix(obj, bpy.context.evaluated_depsgraph_get())[:3, :3]
    return np.asarray(axes / np.linalg.norm(axes, axis=0))
