"""Objects that glow, in the open file."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from mathutils import Vector


def glow(obj: Any, strength: float, color: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Any:
    """Give ``obj`` an Emission shader; returns its node."""
    material = bpy.data.materials.new(f"Glow of {obj.name}")
    if material.node_tree is None:
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    emission, output = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
    emission.inputs["Color"].default_value, emission.inputs["Strength"].default_value = (*color, 1), strength
    tree.links.new(emission.outputs["Emission"], output.inputs["Surface"])
    obj.data.materials.clear()
    obj.data.materials.append(material)
    return emission


def panel(name: str, place: tuple[float, float, float], size: float, strength: float,
          target: tuple[float, float, float] = (0, 0, 0), color: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Any:
    """A square of that size whose back (+Z) looks away from ``target``."""
    half = size / 2
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)], [], [(0, 1, 2, 3)])
    obj = _added(name, mesh)
    obj.location = place
    obj.rotation_euler = (Vector(target) - Vector(place)).to_track_quat("-Z", "Y").to_euler()
    glow(obj, strength, color)
    return obj


def bulb(name: str, place: tuple[float, float, float], radius: float, strength: float) -> Any:
    """A sphere."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=24, radius=radius, location=place)
    obj = bpy.context.object
    obj.name = name
    glow(obj, strength)
    return obj


def tube(name: str, place: tuple[float, float, float], length: float, radius: float, strength: float) -> Any:
    """A neon tube: half a circle of that radius, bent in the plane of X and Z, as a curve with a bevel."""
    curve = bpy.data.curves.new(name, "CURVE")
    curve.dimensions, curve.bevel_depth, curve.bevel_resolution, curve.use_fill_caps = "3D", radius, 6, True
    spline = curve.splines.new("POLY")
    spline.points.add(32)
    around = np.linspace(0, np.pi, 33)
    for point, angle in zip(spline.points, around, strict=True):
        point.co = (length / np.pi * np.cos(angle), 0.0, length / np.pi * np.sin(angle), 1.0)
    obj = _added(name, curve)
    obj.location = place
    glow(obj, strength)
    return obj


def _added(name: str, data: Any) -> Any:
    obj = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(obj)
    return obj
