"""What the panel edits and the .blend stores: ``scene.irpso``.

The solve's settings are made from the table in ``core/params.py``; the rest says where the views come
from and where the maps go.
"""

import atexit
from dataclasses import Field, fields
from typing import Any

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)
from bpy.types import PropertyGroup

from ..core.params import SolveSettings

WORDS = {"ggx": "GGX", "opengl": "OpenGL", "numpy": "NumPy"}  # choices that are names
RELATIVE = {"PATH_SUPPORTS_BLEND_RELATIVE"}  # of paths: "//" is the .blend's folder
FORMATS = (
    ("exr", "OpenEXR", "32-bit float, linear"),
    ("png", "PNG", "16-bit; base colour sRGB-encoded"),
    ("tiff", "TIFF", "16-bit; base colour sRGB-encoded"),
)


def _is_camera(_: PropertyGroup, obj: bpy.types.Object) -> bool:
    return obj.type == "CAMERA"


def _is_light(_: PropertyGroup, obj: bpy.types.Object) -> bool:
    return obj.type == "LIGHT"


REGIONS = (
    ("ALL", "All", "The whole object"),
    ("GROUP", "Vertex Group", "Where the weight of a vertex group is above 0.5"),
    ("IMAGE", "Image", "Where an image over the UV map is white"),
    ("FACES", "Selected Faces", "The faces that are selected in Edit Mode"),
)


class IRPSO_PG_light(PropertyGroup):
    """One light that was on."""

    light: PointerProperty(type=bpy.types.Object, name="Light", poll=_is_light)


class IRPSO_PG_view(PropertyGroup):
    """One reference image with the camera and the lights it was taken under."""

    enabled: BoolProperty(name="Use", description="Use this view in the solve", default=True)
    image: StringProperty(
        name="Image", subtype="FILE_PATH", options=RELATIVE,
        description="Reference image: EXR, HDR, 16-bit PNG or TIFF")
    camera: PointerProperty(
        type=bpy.types.Object, name="Camera", poll=_is_camera, description="Camera that took the image")
    lights: CollectionProperty(
        type=IRPSO_PG_light, name="Lights", description="Lights that were on; none: every light that renders")
    exposure: FloatProperty(
        name="Exposure", default=0.0, soft_min=-10.0, soft_max=10.0,
        description="Exposure of the image in EV: its values are radiance times 2 to this power")
    mask: StringProperty(
        name="Mask", subtype="FILE_PATH", options=RELATIVE,
        description="Image that is white where the object may be trusted (optional)")
    colorspace: StringProperty(
        name="Color Space", description="Color space of the image's values; empty: linear in float files, else sRGB")


class IRPSO_PG_scene(PropertyGroup):
    """IRPSO's settings of a scene.  The fields of `SolveSettings` are added below."""

    captures: StringProperty(
        name="Captures", subtype="FILE_PATH", options=RELATIVE,
        description="captures.json that names the views; empty: the list below, or else the cameras' background images")
    views: CollectionProperty(type=IRPSO_PG_view, name="Views")
    active_view: IntProperty(name="Active View", default=0, min=0)
    region: EnumProperty(
        name="Part", items=REGIONS,
        description="Part of the object that is solved; the last result is kept elsewhere, with a soft seam")
    region_group: StringProperty(name="Vertex Group", description="Vertex group whose weight marks the part to solve")
    region_image: PointerProperty(
        type=bpy.types.Image, name="Image", description="Image over the UV map that is white in the part to solve")
    out: StringProperty(
        name="Folder", subtype="DIR_PATH", options=RELATIVE, default="//irpso",
        description="Folder that the maps are exported to")
    format: EnumProperty(name="Format", description="File format of exported maps", items=FORMATS)


def rna(field: Field[Any]) -> Any:
    """The RNA property of one row of the parameter table."""
    meta = field.metadata
    common = {"name": meta["label"], "description": meta["doc"], "default": field.default}
    if meta["choices"]:
        items = tuple((key, WORDS.get(key, key.replace("-", " ").title()), doc) for key, doc in meta["choices"])
        return EnumProperty(items=items, **common)
    if field.type is bool:
        return BoolProperty(**common)
    limits = {end: meta[key] for end, key in (("min", "low"), ("max", "high")) if meta[key] is not None}
    if field.type is int:
        return IntProperty(**common, **limits)
    return FloatProperty(precision=3, **common, **limits)


IRPSO_PG_scene.__annotations__.update({field.name: rna(field) for field in fields(SolveSettings)})


def settings(group: IRPSO_PG_scene) -> SolveSettings:
    """The solve's settings as the panel shows them."""
    return SolveSettings(**{field.name: getattr(group, field.name) for field in fields(SolveSettings)})


CLASSES = (IRPSO_PG_light, IRPSO_PG_view, IRPSO_PG_scene)


def register() -> None:
    """Adds ``scene.irpso``.  Enough by itself to read a scene's view list without the add-on."""
    for cls in CLASSES:
        if not cls.is_registered:  # a second copy of this module may have removed the property alone
            bpy.utils.register_class(cls)
    bpy.types.Scene.irpso = PointerProperty(type=IRPSO_PG_scene)
    if bpy.app.module:
        atexit.register(unregister)  # the bpy module of 4.5 hangs or crashes at exit on classes left registered


def unregister() -> None:
    """Removes ``scene.irpso``; the property goes before its classes."""
    atexit.unregister(unregister)
    if hasattr(bpy.types.Scene, "irpso"):  # a second copy of this module may have removed it already
        del bpy.types.Scene.irpso
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
