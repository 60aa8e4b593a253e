"""What the IRPSO tab of the Image Editor shows: of the window, not of the file, so nothing of it is saved or undone."""

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty
from bpy.types import PropertyGroup

from . import editors

SHOWS = (
    ("MAPS", "Maps", "Maps of the material"),
    ("VIEWS", "Views", "References beside what the maps predict"),
    ("RESULTS", "Results", "Two results of the object beside each other"),
    ("CHART", "Chart", "Every method's error against its time"),
)
MAPS = (
    ("base_color", "Base Color", "What the surface reflects diffusely"),
    ("roughness", "Roughness", "Black is a mirror, white is matt"),
    ("confidence", "Confidence", "White is sure, black is filled from neighbours"),
    ("error", "Error", "Relative difference between the views and what the maps predict, RMS over a texel's views"),
)
PICTURES = (
    ("WIPE", "Wipe", "Reference left of the line, prediction right of it; drag the line"),
    ("REFERENCE", "Reference", "The picture that was taken"),
    ("PREDICTED", "Prediction", "What the maps predict"),
    ("ERROR", "Error", "Difference between prediction and reference, in per cent of the reference"),
)


def _redraw(_group: PropertyGroup, _context: bpy.types.Context) -> None:
    editors.refresh()


class IRPSO_PG_views(PropertyGroup):
    """``window_manager.irpso_views``."""

    show: EnumProperty(name="Show", items=SHOWS, update=_redraw, description="What the Image Editor shows")
    map: EnumProperty(name="Map", items=MAPS, update=_redraw, description="Map that is shown")
    picture: EnumProperty(name="Picture", items=PICTURES, update=_redraw, description="What is shown of the view")
    view: IntProperty(name="View", min=0, update=_redraw, description="View that is shown, counted from 0")
    wipe: FloatProperty(
        name="Wipe", subtype="FACTOR", default=0.5, min=0.0, max=1.0, update=_redraw,
        description="Where the line stands; it can be dragged in the editor too")
    exposure: FloatProperty(
        name="Exposure", default=0.0, soft_min=-10.0, soft_max=10.0, update=_redraw,
        description="Brightness of the display in EV; the maps are not changed")
    scale: FloatProperty(
        name="Error Scale", subtype="PERCENTAGE", default=20.0, min=0.1, soft_max=100.0, max=1000.0, precision=1,
        update=_redraw, description="Error that the brightest colour of the heat map stands for")
    curve: BoolProperty(
        name="Convergence", default=True, update=_redraw,
        description="Draw the error against the seconds of the solve")
    first: IntProperty(
        name="A", default=1, min=0, update=_redraw, description="Result left of the line; 0 is the newest")
    second: IntProperty(
        name="B", default=0, min=0, update=_redraw, description="Result right of the line; 0 is the newest")
    compared: EnumProperty(name="Map", items=MAPS[:2], update=_redraw, description="Map of both results")
    contrast: EnumProperty(
        name="Contrast", update=_redraw, description="How the two are shown",
        items=(("WIPE", "Wipe", "A left of the line, B right of it; drag the line"),
               ("DIFFERENCE", "Difference", "How far they are apart, in per cent of the full range")))
    compare_size: IntProperty(
        name="Map Size", default=256, min=16, max=4096,
        description="Texels along a side that the methods are compared at")
    compare_paper: BoolProperty(
        name="Published Algorithm", default=False,
        description="Run the algorithm as published too, with 100, 400 and 1600 passes; takes minutes")
    compare_save: BoolProperty(
        name="Save Report", default=False, description="Write compare.json into the export folder")


def register() -> None:
    """Adds ``window_manager.irpso_views``."""
    bpy.utils.register_class(IRPSO_PG_views)
    bpy.types.WindowManager.irpso_views = PointerProperty(type=IRPSO_PG_views)


def unregister() -> None:
    """Removes it; the property goes before its class."""
    del bpy.types.WindowManager.irpso_views
    bpy.utils.unregister_class(IRPSO_PG_views)
