"""What the IRPSO tab of the Image Editor and the viewport show: of the window, so nothing of it is saved or undone."""

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty
from bpy.types import PropertyGroup

from . import editors

SHOWS = (
    ("MAPS", "Maps", "Maps of the material"),
    ("VIEWS", "Predictions", "References beside the pictures that the maps predict"),
    ("RESULTS", "Results", "Two results of the object side by side"),
    ("CHART", "Chart", "Error of every method against its time"),
)
MAPS = (
    ("base_color", "Base Color", "Colour that the surface reflects diffusely"),
    ("roughness", "Roughness", "Black is a mirror, white is matt"),
    ("confidence", "Confidence", "White is certain, black is filled from neighbours"),
    ("error", "Error", "Relative difference between the views and their predictions, RMS over a texel's views"),
)
PICTURES = (
    ("WIPE", "Wipe", "Reference left of the line, prediction right of it; drag the line"),
    ("REFERENCE", "Reference", "Picture that was taken"),
    ("PREDICTED", "Prediction", "Picture that the maps predict"),
    ("ERROR", "Error", "Difference between prediction and reference, in % of the reference"),
)


def _redraw(_group: PropertyGroup, _context: bpy.types.Context) -> None:
    editors.refresh()


def _redraw_viewports(_group: PropertyGroup, context: bpy.types.Context) -> None:
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


class IRPSO_PG_views(PropertyGroup):
    """What the viewer shows: ``window_manager.irpso_views``."""

    places: BoolProperty(
        name="Show in Viewport", default=True, update=_redraw_viewports,
        description="Draw where the last solve found lamps beside where the scene has them, and which cameras were off")

    show: EnumProperty(name="Show", items=SHOWS, update=_redraw, description="Content of the Image Editor")
    map: EnumProperty(name="Map", items=MAPS, update=_redraw, description="Map to show")
    picture: EnumProperty(name="Picture", items=PICTURES, update=_redraw, description="Part of the view to show")
    view: IntProperty(name="View", min=0, update=_redraw, description="View to show, counted from 0")
    wipe: FloatProperty(
        name="Wipe", subtype="FACTOR", default=0.5, min=0.0, max=1.0, update=_redraw,
        description="Position of the line, which can also be dragged in the editor")
    exposure: FloatProperty(
        name="Exposure", default=0.0, soft_min=-10.0, soft_max=10.0, update=_redraw,
        description="Brightness of the display in EV; the maps are not changed")
    scale: FloatProperty(
        name="Error Scale", subtype="PERCENTAGE", default=20.0, min=0.1, soft_max=100.0, max=1000.0, precision=1,
        update=_redraw, description="Error shown by the brightest colour of the heat map")
    curve: BoolProperty(
        name="Convergence", default=True, update=_redraw,
        description="Draw the error against the time of the solve")
    first: IntProperty(
        name="A", default=1, min=0, update=_redraw, description="Result left of the line; 0 is the newest")
    second: IntProperty(
        name="B", default=0, min=0, update=_redraw, description="Result right of the line; 0 is the newest")
    compared: EnumProperty(name="Map", items=MAPS[:2], update=_redraw, description="Map of both results")
    contrast: EnumProperty(
        name="Contrast", update=_redraw, description="Way to show the two results",
        items=(("WIPE", "Wipe", "A left of the line, B right of it; drag the line"),
               ("DIFFERENCE", "Difference", "Difference between the results, in % of the full range")))
    compare_size: IntProperty(
        name="Map Size", default=256, min=16, max=4096,
        description="Width and height of the maps for the comparison, texels")
    compare_paper: BoolProperty(
        name="Published Algorithm", default=False,
        description="Also run the published algorithm with 100, 400 and 1600 passes; takes minutes")
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
