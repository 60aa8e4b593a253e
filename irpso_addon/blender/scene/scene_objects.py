"""Blender's cameras and lights as the solver's records (``docs/brdf.md`` has the formulas)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import bpy
import numpy as np

from ...core.data import F64, Camera, Light
from ...core.errors import BadInput
from .camera_lens import read_lens

Warn = Callable[[str], None]
FAR = 1e12  # metres: whose square single precision still holds
BRIGHTEST = 1e30  # watts
NARROWEST = math.radians(0.1)  # spread of an area lamp
PLACE = "location", "rotation", "delta_location", "delta_rotation"  # starts of animated paths


def world_matrix(obj: Any, depsgraph: Any) -> F64:
    """(4, 4) object to world.  Of an object that is not evaluated (disabled in viewports), by its parents."""
    if _is_placed(obj, depsgraph):
        return np.array(obj.evaluated_get(depsgraph).matrix_world, np.float64)
    own = np.array(obj.matrix_basis, np.float64)
    if obj.parent is None or obj.parent_type != "OBJECT":
        return own
    return np.asarray(world_matrix(obj.parent, depsgraph) @ np.array(obj.matrix_parent_inverse, np.float64) @ own)


def _is_placed(obj: Any, depsgraph: Any) -> bool:
    """Whether Blender has evaluated it."""
    # What a property alone refers to counts as evaluated, too, but was never placed.
    return bool(obj.evaluated_get(depsgraph).is_evaluated) and depsgraph.objects.get(obj.name) is not None


def require_metres(scene: Any) -> None:
    """Raises BadInput where lengths in metres and millimetres would become others in this scene."""
    units = scene.unit_settings
    if units.system != "NONE" and not math.isclose(units.scale_length, 1.0, rel_tol=1e-6):
        raise BadInput(f"scene '{scene.name}': its Unit Scale is {units.scale_length:g}, so its unit is not a metre; "
                       "set Unit Scale to 1 (Scene Properties > Units)")


def require_whole(obj: Any, depsgraph: Any) -> None:
    """Raises BadInput where `ignored` names something."""
    line = ignored(obj, depsgraph)
    if line:
        raise BadInput(line)


def ignored(obj: Any, depsgraph: Any) -> str:
    """A line on what Blender has not evaluated of an object's shape or place, which is then read wrongly; "": none."""
    if _is_placed(obj, depsgraph):
        return ""
    if len(obj.modifiers) or getattr(obj.data, "shape_keys", None) is not None:
        return _ignored_line(obj, depsgraph, "its modifiers and shape keys")
    while obj is not None and not _is_placed(obj, depsgraph):
        if any(constraint.enabled and constraint.influence for constraint in obj.constraints):
            return _ignored_line(obj, depsgraph, "its constraints")
        if animated(obj, PLACE):
            return _ignored_line(obj, depsgraph, "its keyframes and drivers")
        if obj.parent is not None and obj.parent_type != "OBJECT":
            return _ignored_line(obj, depsgraph, "the bones or vertices that it is parented to")
        obj = obj.parent
    return ""


def _ignored_line(obj: Any, depsgraph: Any, what: str) -> str:
    kind, scene = obj.type.lower() if obj.type in {"LIGHT", "CAMERA"} else "object", depsgraph.scene.original
    if obj not in scene.objects.values():
        return f"{kind} '{obj.name}': is not in scene '{scene.name}', so {what} are ignored; open a scene that has it"
    return f"{kind} '{obj.name}': is disabled in viewports or excluded, so {what} are ignored; enable it"


def animated(block: Any, paths: tuple[str, ...]) -> bool:
    """Whether keyframes or drivers set a property whose path begins like one of these."""
    return any(curve.data_path.startswith(paths) for curve in _curves(block))


def changes(block: Any, paths: tuple[str, ...]) -> bool:
    """Whether such a property differs from frame to frame: by keyframes of several values, or a driver of the frame."""
    return any(curve.data_path.startswith(paths) and (
        "frame" in curve.driver.expression if curve.driver is not None
        else len({key.co[1] for key in curve.keyframe_points}) > 1) for curve in _curves(block))


def moves(obj: Any) -> bool:
    """Whether an object's place, or that of a parent, differs from frame to frame."""
    while obj is not None:
        if changes(obj, PLACE):
            return True
        obj = obj.parent
    return False


def _curves(block: Any) -> Iterator[Any]:
    """Of a block's drivers and of the action that it follows; none of None."""
    animation = None if block is None else block.animation_data
    if animation is None:
        return
    yield from animation.drivers
    for layer in animation.action.layers if animation.action is not None else ():
        for strip in layer.strips:
            for bag in strip.channelbags:
                if bag.slot_handle == animation.action_slot_handle:
                    yield from bag.fcurves


def rendered_objects(view_layer: Any) -> dict[str, Any]:
    """The objects of ``view_layer`` that a render shows, by full name, whatever the viewport hides."""
    found: dict[str, Any] = {}

    def walk(layer: Any) -> None:
        if layer.collection.hide_render:
            return
        if not layer.exclude:
            found.update((o.name_full, o) for o in layer.collection.objects if not o.hide_render)
        for child in layer.children:
            walk(child)

    walk(view_layer.layer_collection)
    return found


def names_of(objects: Iterable[Any]) -> str:
    """Their names as a list, shortened; "" of none."""
    names = [f"'{o.name}'" for o in objects]
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")


def read_camera(obj: Any, scene: Any, depsgraph: Any) -> Camera:
    """``obj``, perspective or orthographic, with the scene's render resolution and pixel aspect, or its own lens.

    Raises BadInput.
    """
    require_whole(obj, depsgraph)
    render, lens = scene.render, read_lens(obj.data)
    width = max(1, render.resolution_x * render.resolution_percentage // 100)
    height = max(1, render.resolution_y * render.resolution_percentage // 100)
    projection = obj.evaluated_get(depsgraph).calc_matrix_camera(
        depsgraph, x=width, y=height, scale_x=render.pixel_aspect_x, scale_y=render.pixel_aspect_y)
    matrix = world_matrix(obj, depsgraph)
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if not np.isfinite(matrix).all() or lengths.min() < 1e-9:
        raise BadInput(f"camera '{obj.name}': its scale is 0 or its matrix not finite; clear its scale")
    projection = np.array(projection, np.float64) if lens is None else lens.matrix
    finite = (np.abs(matrix) <= FAR).all() and (np.abs(projection) <= FAR).all()
    if not finite or not np.linalg.det(projection):
        raise BadInput(f"camera '{obj.name}': its position, lens or shift is not a usable number; reset it")
    matrix[:3, :3] /= lengths  # Blender ignores a camera's scale
    return Camera(
        name=obj.name, world_to_camera=np.linalg.inv(matrix), projection=projection,
        position=matrix[:3, 3].copy(), forward=-matrix[:3, 2], orthographic=obj.data.type == "ORTHO",
        aspect=width / height if lens is None else lens.width / lens.height, lens=lens,
        kept=bool(getattr(obj, "irpso_keep", False)),
    )


def read_light(obj: Any, depsgraph: Any, warn: Warn) -> Light:
    """``obj`` with its power in watts (sun: W/m^2): colour, exposure and temperature multiplied in.

    Raises BadInput for numbers that no lamp can have.
    """
    with np.errstate(all="ignore"):  # which are found out at the end
        light = _read_light(obj, depsgraph, warn)
    sizes = [light.radius, light.spot_angle, light.spot_blend, *light.size, light.spread, *light.matrix.ravel()]
    if not (np.abs(sizes) <= FAR).all() or not (np.abs(light.power) <= BRIGHTEST).all():
        raise BadInput(f"light '{obj.name}': its power, size or position is not finite or too large; set it again")
    if (light.power < 0).any():
        raise BadInput(f"light '{obj.name}': its power or colour is negative; set it again")
    if light.kind == "AREA" and light.spread < NARROWEST:
        raise BadInput(f"light '{obj.name}': its spread is below 0.1 degrees, which is not modelled; widen it")
    return light


def _read_light(obj: Any, depsgraph: Any, warn: Warn) -> Light:
    require_whole(obj, depsgraph)
    lamp, matrix = obj.data, world_matrix(obj, depsgraph)
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:3, :3])) < 1e-20:
        raise BadInput(f"light '{obj.name}': its scale is 0 or its matrix not finite; clear its scale")
    power = lamp.energy * np.exp2(lamp.exposure) * np.array(lamp.color, np.float64)
    if lamp.use_temperature:
        power = power * np.array(lamp.temperature_color, np.float64)
    power = power * _emission(obj, warn)
    if obj.light_linking.receiver_collection or obj.light_linking.blocker_collection:
        warn(f"light '{obj.name}': light linking is not modelled; unlink it for the pictures")
    if not (obj.visible_diffuse and obj.visible_glossy):
        warn(f"light '{obj.name}': is hidden from diffuse or glossy rays, which is not modelled; make it visible to "
             "both")
    if getattr(lamp.cycles, "is_portal", False):
        warn(f"light '{obj.name}': is a portal, which gives no light; remove it from the views")
    common = {"name": obj.name, "kind": lamp.type, "matrix": matrix, "cast_shadow": bool(lamp.use_shadow),
              "kept": bool(getattr(obj, "irpso_keep", False))}
    if lamp.type in {"POINT", "SPOT"}:
        radius = float(lamp.shadow_soft_size)
        if not lamp.normalize:
            power = power * (4 * math.pi * radius**2 if radius > 0 else 4.0)
        if lamp.type == "SPOT":
            common |= {"spot_angle": float(lamp.spot_size), "spot_blend": float(lamp.spot_blend)}
        return Light(**common, power=power, radius=radius, soft_falloff=bool(lamp.use_soft_falloff))
    if lamp.type == "SUN":
        half = float(lamp.angle) / 2
        if not lamp.normalize and half > 0:
            power = power * math.pi * math.sin(half) ** 2
        return Light(**common, power=power, radius=half)
    one_size = lamp.shape in {"SQUARE", "DISK"}
    size = (float(lamp.size), float(lamp.size if one_size else lamp.size_y))
    if not lamp.normalize:
        power = power * _area(size, lamp.shape, matrix)
    return Light(**common, power=power, shape=lamp.shape, size=size, spread=float(lamp.spread))


def _area(size: tuple[float, float], shape: str, matrix: F64) -> float:
    """World area of an area light, m^2."""
    scale = np.linalg.norm(matrix[:3, :2], axis=0)
    rectangle = size[0] * size[1] * scale[0] * scale[1]
    return float(rectangle * (math.pi / 4 if shape in {"DISK", "ELLIPSE"} else 1.0))


def _emission(obj: Any, warn: Warn) -> F64:
    """(3,) factor of the light's node tree: that of one Emission node with constant inputs."""
    one = np.ones(3)
    tree = obj.data.node_tree
    if tree is None or (bpy.app.version < (5, 0, 0) and not obj.data.use_nodes):
        return one
    output = tree.get_output_node("CYCLES")
    node = None if output is None else _source(output.inputs["Surface"])
    if node is None:  # it is dark
        return np.zeros(3)
    if node.type == "EMISSION" and not node.mute and not any(i.is_linked for i in node.inputs if i.name != "Weight"):
        return np.array(node.inputs["Color"].default_value[:3]) * node.inputs["Strength"].default_value
    what = "an IES profile" if any(n.type == "TEX_IES" for n in tree.nodes) else "nodes"
    warn(f"light '{obj.name}': {what} in it not modelled; its plain power is used")
    return one


def _source(socket: Any) -> Any:
    """The node behind a socket, past reroutes; None: none."""
    while links := [link for link in socket.links if not link.is_muted]:
        if links[0].from_node.type != "REROUTE":
            return links[0].from_node
        socket = links[0].from_node.inputs[0]
    return None
