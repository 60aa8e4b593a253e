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
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)
from bpy.types import PropertyGroup

from ..core.capture.captures import MOST_TINT, MOST_TURN, MOST_VIGNETTING
from ..core.images.response import LEAST_RESPONSE, LEAST_SHOULDER, MOST_BLACK, MOST_RESPONSE, MOST_SHOULDER
from ..core.params import ExportSettings, ShootSettings, SolveSettings, choice_name
from .glow import is_light

UNITS = {"mm": "DISTANCE_CAMERA", "W": "POWER"}  # Blender shows these beside the number
RELATIVE = {"PATH_SUPPORTS_BLEND_RELATIVE"}  # of paths: "//" is the .blend's folder
FORMATS = (
    ("exr", "OpenEXR", "32-bit float, linear"),
    ("png", "PNG", "16-bit; base colour sRGB-encoded"),
    ("tiff", "TIFF", "16-bit; base colour sRGB-encoded"),
)


def _is_camera(_: PropertyGroup, obj: bpy.types.Object) -> bool:
    return obj.type == "CAMERA"


def _is_light(_: PropertyGroup, obj: bpy.types.Object) -> bool:
    return is_light(obj)


REGIONS = (
    ("ALL", "Whole Object", "The whole object"),
    ("GROUP", "Vertex Group", "Where the weight of a vertex group is above 0.5"),
    ("IMAGE", "Image", "Where an image over the UV map is white"),
    ("FACES", "Selected Faces", "Faces selected in Edit Mode"),
)


SHARED = (
    ("COPY", "Copy", "The solved object gets a copy of the material; the others keep theirs"),
    ("SHARE", "Share", "The maps go onto the material itself, and all objects that use it show them"),
)


class IRPSO_PG_light(PropertyGroup):
    """One light that was on."""

    light: PointerProperty(
        type=bpy.types.Object, name="Light", poll=_is_light, description="Light that was on")


class IRPSO_PG_looked_lamp(PropertyGroup):
    """A lamp as it was before Look Through View."""

    light: PointerProperty(type=bpy.types.Object, name="Light", poll=_is_light, description="The lamp")
    hide_render: BoolProperty(name="Hidden in Renders", description="Whether it was hidden in renders")
    hide_viewport: BoolProperty(name="Hidden in Viewports", description="Whether it was hidden in viewports")


class IRPSO_PG_view(PropertyGroup):
    """One reference image with the camera and the lights it was taken under."""

    enabled: BoolProperty(name="Use", description="Use this view in the solve", default=True)
    image: StringProperty(
        name="Image", subtype="FILE_PATH", options=RELATIVE,
        description="Reference image: EXR, HDR, RAW, 16-bit PNG or TIFF")
    camera: PointerProperty(
        type=bpy.types.Object, name="Camera", poll=_is_camera, description="Camera that took the image")
    lights: CollectionProperty(
        type=IRPSO_PG_light, name="Lights", description="Lights that were on; empty: every light that renders")
    exposure: FloatProperty(
        name="Exposure", default=0.0, soft_min=-10.0, soft_max=10.0,
        description="Exposure of the image in EV; its values are radiance times 2 to this power")
    tint: FloatVectorProperty(
        name="White Balance", size=3, default=(1.0, 1.0, 1.0), min=1 / MOST_TINT, max=MOST_TINT, precision=3,
        description="Factors by which the image's white balance makes red, green and blue brighter; they are divided "
                    "out, linear RGB. 1: that of the scene's lights")
    vignetting: FloatProperty(
        name="Vignetting", default=0.0, soft_min=0.0, soft_max=8.0, min=-MOST_VIGNETTING, max=MOST_VIGNETTING,
        description="How much darker the image is towards its edges: the power of the cosine of the angle to the "
                    "camera's axis. 0: even; 4: a plain lens without correction")
    response: FloatProperty(
        name="Response", default=1.0, min=LEAST_RESPONSE, max=MOST_RESPONSE, precision=3,
        description="Exponent of the camera's or developer's tone curve: the file holds radiance to this power. 1: the "
                    "file is linear once its colour space is undone")
    shoulder: FloatProperty(
        name="Shoulder", default=1.0, min=LEAST_SHOULDER, max=MOST_SHOULDER, soft_max=50.0, precision=2,
        description="How many times flatter the tone curve is at white than in the dark. 1: no flatter; cameras' JPEG "
                    "files: 5 to 15")
    black_level: FloatVectorProperty(
        name="Black Level", size=3, default=(0.0, 0.0, 0.0), min=-MOST_BLACK, max=MOST_BLACK, precision=4,
        description="Values of the file where no light falls, which are subtracted, linear RGB. 0: none, or the "
                    "reader of the file has subtracted it")
    ambient_radiance: FloatVectorProperty(
        name="Ambient Light", size=3, default=(0.0, 0.0, 0.0), min=0.0, precision=4,
        description="Radiance of light that is equal from all directions and adds to the lights, in W/(m² sr), "
                    "linear RGB")
    turn: FloatProperty(
        name="World Turn", default=0.0, min=-MOST_TURN, max=MOST_TURN, soft_min=-180.0, soft_max=180.0, precision=2,
        description="Degrees about Z by which the world is turned in this view, counter-clockwise seen from above, as "
                    "on a turntable")
    mask: StringProperty(
        name="Mask", subtype="FILE_PATH", options=RELATIVE,
        description="Image that is white where the object can be trusted (optional)")
    ambient: StringProperty(
        name="Ambient", subtype="FILE_PATH", options=RELATIVE,
        description="Same picture with these lights off, which is subtracted (optional)")
    flat: StringProperty(
        name="Flat Field", subtype="FILE_PATH", options=RELATIVE,
        description="Picture of an evenly lit surface through the same lens, which is divided out (optional)")
    colorspace: StringProperty(
        name="Color Space", description="Color space of the image's values; empty: linear for float files, sRGB for "
                                        "others")


class IRPSO_PG_lens(PropertyGroup):
    """The lens of a photographed camera, as `core.lens.Lens`."""

    use: BoolProperty(
        name="Photographed Lens", default=False,
        description="Use this lens for the camera's pictures instead of Blender's approximate settings")
    width: IntProperty(name="Width", min=0, subtype="PIXEL", description="Width of the pictures")
    height: IntProperty(name="Height", min=0, subtype="PIXEL", description="Height of the pictures")
    fx: FloatProperty(name="Focal Length X", subtype="PIXEL", description="Horizontal focal length, pixels")
    fy: FloatProperty(name="Focal Length Y", subtype="PIXEL", description="Vertical focal length, pixels")
    cx: FloatProperty(name="Principal Point X", subtype="PIXEL", description="Distance from the left edge, pixels")
    cy: FloatProperty(name="Principal Point Y", subtype="PIXEL", description="Distance from the upper edge, pixels")
    skew: FloatProperty(name="Skew", subtype="PIXEL", description="Skew of the sensor's axes, pixels")
    radial: FloatVectorProperty(name="Radial", size=4, precision=6, description="Brown's coefficients k1 to k4")
    tangential: FloatVectorProperty(name="Tangential", size=2, precision=6, description="Brown's coefficients p1 and "
                                                                                        "p2")
    fisheye: BoolProperty(name="Fisheye", description="Equidistant fisheye instead of a perspective lens")


class IRPSO_PG_ball(PropertyGroup):
    """A chrome ball that the pictures of a camera show."""

    camera: PointerProperty(
        type=bpy.types.Object, name="Camera", poll=_is_camera, description="Camera whose pictures all show the ball")
    x: FloatProperty(
        name="X", description="Middle of a circle around the ball, pixels from the picture's left edge", precision=1)
    y: FloatProperty(
        name="Y", description="Middle of a circle around the ball, pixels from the picture's upper edge", precision=1)
    circle: FloatProperty(
        name="Circle", description="Radius of the circle, pixels; 0: find the ball", min=0.0, precision=1)
    drawn: BoolProperty(
        name="Drawn", default=False,
        description="Keep the circle that you drew unless an outline within 3 % of it is found. Off: the circle is "
                    "rough, and the clearest outline near it replaces it")
    radius: FloatProperty(
        name="Ball's Radius", description="Radius of the ball itself, mm", subtype="DISTANCE_CAMERA", default=25.0,
        min=0.1, soft_max=500.0)
    support: FloatProperty(
        name="Support", description="Share of the outline that shows, set by Find Balls", min=0.0, max=1.0)
    residual: FloatProperty(
        name="Residual", description="Distance of the edges from a sphere's outline in pixels, set by Find Balls",
        min=0.0)


class IRPSO_PG_shoot(PropertyGroup):
    """A shoot to import.  The fields of `ShootSettings` are added below."""

    project: StringProperty(
        name="Project", subtype="FILE_PATH", options=RELATIVE,
        description="Cameras of the photogrammetry program: Metashape XML, RealityScan CSV, COLMAP, Meshroom .sfm, "
                    "transforms.json; or an Alembic or USD file with cameras")
    images: StringProperty(
        name="Pictures", subtype="DIR_PATH", options=RELATIVE,
        description="Folder of the pictures, RAW or developed")
    mesh: StringProperty(
        name="Mesh", subtype="FILE_PATH", options=RELATIVE,
        description="Mesh that the program exported; empty: the one in the Alembic or USD file, or the only one "
                    "beside the project")
    card: FloatProperty(
        name="Card's Reflectance", description="Reflectance of the grey card, as stated by its maker", default=0.18,
        min=0.001, max=1.0)
    chart: StringProperty(
        name="Chart's Picture", subtype="FILE_PATH", options=RELATIVE,
        description="Picture that shows the color chart, whether it has a camera or not; empty: the active view's")
    balls: CollectionProperty(
        type=IRPSO_PG_ball, name="Chrome Balls", description="Chrome balls in the pictures, by which lamps are placed")


class IRPSO_PG_scene(PropertyGroup):
    """IRPSO's settings of a scene.  The fields of `SolveSettings` and `ExportSettings` are added below."""

    captures: StringProperty(  # no path by its subtype: Blender's own file browser begins elsewhere, unfiltered
        name="Captures",
        description="captures.json that names the views; empty: the list below, or the cameras' background images")
    views: CollectionProperty(
        type=IRPSO_PG_view, name="Views", description="Pictures with their cameras and lights, as the list shows them")
    active_view: IntProperty(
        name="Active View", default=0, min=0, description="View that is selected in the list, counted from 0")
    photographs: BoolProperty(
        name="Photographs", default=False,
        description="The pictures are photographs, to which the scene's film exposure and pixel filter do not apply")
    scale_known: BoolProperty(
        name="Known Power", default=True,
        description="The lamps have their real power. Off: Specular IOR Level is solved for, and base colours are "
                    "right up to one common factor")
    looked: StringProperty(
        name="Looked Through", options={"HIDDEN"},
        description="Not empty since Look Through View; NO CAMERA: the scene had none")
    looked_camera: PointerProperty(
        type=bpy.types.Object, name="Camera Before", options={"HIDDEN"},
        description="Camera of the scene before Look Through View")
    looked_lamps: CollectionProperty(
        type=IRPSO_PG_looked_lamp, name="Lamps Before", options={"HIDDEN"},
        description="Lamps as they were before Look Through View")
    remedied: StringProperty(
        name="Remedies", options={"HIDDEN"},
        description="Remedies applied since Blender was started")
    shoot: PointerProperty(type=IRPSO_PG_shoot, name="Shoot", description="Files and lighting of a shoot to import")
    region: EnumProperty(
        name="Region", items=REGIONS,
        description="Region of the object to solve; the last result stays elsewhere, with a soft seam")
    region_group: StringProperty(name="Vertex Group", description="Vertex group whose weight marks the region to solve")
    region_image: PointerProperty(
        type=bpy.types.Image, name="Image", description="Image over the UV map that is white in the region to solve")
    shared_material: EnumProperty(
        name="Shared Material", items=SHARED, description="What happens to a material that other objects use too")
    out: StringProperty(
        name="Folder", subtype="DIR_PATH", options=RELATIVE, default="//irpso",
        description="Folder for exported maps")
    format: EnumProperty(name="Format", description="File format of exported maps", items=FORMATS)


def choices(field: Field[Any]) -> tuple[tuple[str, str, str], ...]:
    """The items of a row of the parameter table that is a choice."""
    return tuple((key, choice_name(key), doc) for key, doc in field.metadata["choices"])


def rna(field: Field[Any]) -> Any:
    """The RNA property of one row of the parameter table."""
    meta = field.metadata
    common = {"name": meta["label"], "description": meta["doc"], "default": field.default}
    if meta["choices"]:
        return EnumProperty(items=choices(field), **common)
    if field.type is bool:
        return BoolProperty(**common)
    limits = {end: meta[key] for end, key in (("min", "low"), ("max", "high")) if meta[key] is not None}
    if field.type is int:
        return IntProperty(**common, **limits)
    return FloatProperty(precision=3, subtype=UNITS.get(meta["unit"], "NONE"), **common, **limits)


for _group, _tables in ((IRPSO_PG_scene, (SolveSettings, ExportSettings)), (IRPSO_PG_shoot, (ShootSettings,))):
    _group.__annotations__.update({field.name: rna(field) for table in _tables for field in fields(table)})


def settings(group: IRPSO_PG_scene) -> SolveSettings:
    """The solve's settings as the panel shows them."""
    return SolveSettings(**{field.name: getattr(group, field.name) for field in fields(SolveSettings)})


def shoot_settings(group: IRPSO_PG_shoot) -> ShootSettings:
    """How the shoot was lit and read, as the panel shows it."""
    return ShootSettings(**{field.name: getattr(group, field.name) for field in fields(ShootSettings)})


CLASSES = (IRPSO_PG_light, IRPSO_PG_looked_lamp, IRPSO_PG_view, IRPSO_PG_lens, IRPSO_PG_ball, IRPSO_PG_shoot,
           IRPSO_PG_scene)


def register() -> None:
    """Adds ``scene.irpso``, ``camera.irpso_lens`` and ``object.irpso_keep``: a scene's views are read by them."""
    for cls in CLASSES:
        if not cls.is_registered:  # a second copy of this module may have removed the property alone
            bpy.utils.register_class(cls)
    bpy.types.Scene.irpso = PointerProperty(type=IRPSO_PG_scene)
    bpy.types.Camera.irpso_lens = PointerProperty(type=IRPSO_PG_lens)
    bpy.types.Object.irpso_keep = BoolProperty(
        name="Keep as Given",
        description="Of a lamp or camera: its place, and power or lens, were measured; a solve does not change them")
    if bpy.app.module:
        atexit.register(unregister)  # the bpy module of 4.5 hangs or crashes at exit on classes left registered


def unregister() -> None:
    """Removes them; the properties go before their classes."""
    atexit.unregister(unregister)
    if hasattr(bpy.types.Scene, "irpso"):  # a second copy of this module may have removed it already
        del bpy.types.Scene.irpso
        del bpy.types.Camera.irpso_lens
        del bpy.types.Object.irpso_keep
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
