"""The Capture panel: where the pictures are, and what is missing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
from bpy.types import Menu, Panel, UIList

from ..panel_common import Tab, letters, split, wrapped
from ..sample import sample
from ..scene import look_through, readiness, thumbnails, view_exposures
from ..scene.readiness import Survey, ViewState

NO_PICTURE = bpy.types.UILayout.bl_rna.functions["label"].parameters["icon"].enum_items["IMAGE_DATA"].value
WIDE = 45  # letters of the sidebar from which whole names have room in a line of the list
BUTTONS = 13  # letters that switch and picture take, the scroll bar, and the buttons beside the list
PADDING = 3  # letters between columns
FAULTY = 0.45  # of a line with a fault: the name
LARGE = 4.0  # height of the active view's picture, in buttons


class IRPSO_UL_views(UIList):
    """Views: on or off, picture, file, camera, light and exposure; or what is wrong."""

    def draw_item(self, context, layout, _data, view, _icon, _active_data, _active_property, index=0, _flag=0):
        """One line of the list."""
        layout.use_property_split = False  # the panel's; it would leave half of the line empty
        states = readiness.recent(context).views
        state = states[index] if index < len(states) else ViewState("")
        row = layout.row(align=True)
        row.prop(view, "enabled", text="")
        row.label(text="", icon_value=_picture(view, state))
        if state.faults:
            room = int(FAULTY * (letters(context) - BUTTONS)) - 2
            parts = row.split(factor=FAULTY)
            parts.active = view.enabled
            parts.label(text=_end(Path(state.name).stem, room) or "No image")
            parts.alert = True
            parts.label(text=state.faults[0])
        else:
            _draw_taken(row, _columns_of(context), view, index)

    def filter_items(self, _context, data, name):
        """By the names of file, camera and lights."""
        views, wanted = getattr(data, name), self.filter_name.lower()
        order = bpy.types.UI_UL_list.sort_items_helper(
            [(i, view.image.lower()) for i, view in enumerate(views)], lambda item: item[1]
        ) if self.use_filter_sort_alpha else []
        return [self.bitflag_filter_item * (wanted in _searched(view)) for view in views] if wanted else [], order


def _searched(view: Any) -> str:
    objects = [view.camera, *(item.light for item in view.lights)]
    return "\n".join([view.image, *(obj.name for obj in objects if obj)]).lower()


def _picture(view: Any, state: ViewState) -> int:
    """The view's picture, or a sign in its place."""
    found = thumbnails.icon(state.image, view.exposure, view.colorspace) if state.image else 0
    return found or NO_PICTURE


class _Columns:
    """What stands in the list's columns, and how wide they are.

    Where the sidebar is too narrow for all, camera and light go, which the panel of the active view tells; names that
    have no room even then lose what all begin with.
    """

    def __init__(self, found: Survey, room: int) -> None:
        """``room``: letters of a line."""
        self.found, self.room = found, room
        self.taken = [(v.camera, v.light) for v in found.views] if room > WIDE else found.shortened
        names = [Path(view.name).stem for view in found.views]
        widths = [max((len(text) for text in column), default=0) for column in (
            names, [camera for camera, _ in self.taken], [light for _, light in self.taken])]
        name, camera, light = (width + PADDING for width in widths)
        self.narrow = name + camera + light > room - BUTTONS
        self.name = 1.0 if self.narrow else name / (name + camera + light)
        self.camera = camera / (camera + light)
        self.names = [_end(text, room - BUTTONS) for text in names]


def _end(text: str, room: int) -> str:
    """The end of a name, which tells pictures apart."""
    return text if len(text) <= room else f"…{text[1 - room:]}"


_columns: _Columns | None = None  # of the last survey


def _columns_of(context: bpy.types.Context) -> _Columns:
    global _columns
    found, room = readiness.recent(context), letters(context)
    if _columns is None or _columns.found is not found or _columns.room != room:
        _columns = _Columns(found, room)
    return _columns


def _draw_taken(layout: bpy.types.UILayout, columns: _Columns, view: Any, index: int) -> None:
    """Which picture, and where there is room, by which camera, under which light."""
    if index >= len(columns.taken):
        return
    state, (camera, light) = columns.found.views[index], columns.taken[index]
    parts = layout.row(align=True) if columns.narrow else layout.split(factor=columns.name)
    parts.active = view.enabled
    parts.label(text=columns.names[index])
    last = parts
    if not columns.narrow:
        rest = parts.split(factor=columns.camera)
        rest.label(text=camera)
        last = rest.row(align=True)
        last.label(text=light)
    if state.notes:
        last.label(text="", icon="INFO")


def _draw_heads(layout: bpy.types.UILayout, columns: _Columns) -> None:
    """What stands in the list's columns."""
    row = layout.row(align=True)
    row.active = False
    for _ in range(2):
        row.label(text="", icon="BLANK1")
    if columns.narrow:
        row.label(text="Image")
        return
    parts = row.split(factor=0.87 * columns.name)  # the list's lines are shorter by its scroll bar
    parts.label(text="Image")
    rest = parts.split(factor=0.87 * columns.camera)
    rest.label(text="", icon="CAMERA_DATA")
    rest.label(text="", icon="LIGHT")


class IRPSO_MT_views(Menu):
    """Changes to the whole list."""

    bl_label = "List Specials"

    def draw(self, _context: bpy.types.Context) -> None:
        """Seldom used; the buttons have the rest."""
        layout = self.layout
        layout.operator("irpso.edit_views", icon="COLOR")
        layout.operator("irpso.exposures_by_exif", icon="CAMERA_DATA")
        layout.separator()
        layout.operator("irpso.sort_views", icon="SORTALPHA")
        layout.operator("irpso.remove_duplicate_views", icon="DUPLICATE")
        layout.separator()
        layout.operator("irpso.remove_view", text="Remove All Views", icon="X").all = True


class IRPSO_PT_capture(Tab, Panel):
    """Pictures, with their cameras and lights."""

    bl_label = "Capture"

    def draw(self, context: bpy.types.Context) -> None:
        """captures.json, or the list of views."""
        layout, settings = split(self.layout), context.scene.irpso
        found = readiness.recent(context, renew=True)
        row = layout.row(align=True)
        row.prop(settings, "captures")
        row.operator("irpso.choose_captures", text="", icon="FILE_FOLDER")
        if look_through.is_looking(context.scene):
            layout.operator("irpso.look_back", icon="LOOP_BACK")
        if settings.captures:
            _draw_file(layout, found.views)
            return
        if settings.views:
            self._draw_list(layout, context)
        else:
            wrapped(layout.column(align=True), "No views yet: add the pictures, import a shoot (above), or open the "
                                               "sample scene", letters(context), "INFO")
        column = layout.column(align=True)
        column.operator("irpso.add_folder", icon="FILE_FOLDER")
        column.operator("irpso.add_views", icon="CAMERA_DATA")
        column.operator_menu_enum("irpso.add_rig", "kind", icon="LIGHT_POINT")
        if not settings.views:
            sample.draw(layout.column(align=True), context)

    @staticmethod
    def _draw_list(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
        settings, row = context.scene.irpso, layout.row()
        column = row.column(align=True)
        _draw_heads(column, _columns_of(context))
        column.template_list("IRPSO_UL_views", "", settings, "views", settings, "active_view", rows=5)
        buttons = row.column(align=True)
        buttons.label(text="", icon="BLANK1")
        buttons.operator("irpso.add_view", text="", icon="ADD")
        buttons.operator("irpso.remove_view", text="", icon="REMOVE")
        buttons.separator()
        buttons.menu("IRPSO_MT_views", text="", icon="DOWNARROW_HLT")
        buttons.separator()
        buttons.operator("irpso.move_view", text="", icon="TRIA_UP").up = True
        buttons.operator("irpso.move_view", text="", icon="TRIA_DOWN").up = False
        if differ := view_exposures.line(context.scene, [state.file for state in readiness.recent(context).views]):
            column = layout.column(align=True)
            wrapped(column, differ, letters(context), "INFO")
            column.operator("irpso.exposures_by_exif", icon="CAMERA_DATA")


def _draw_file(layout: bpy.types.UILayout, views: list[ViewState]) -> None:
    """A capture file: how many views it has."""
    if views:
        layout.label(text=f"{len(views)} views", icon="CAMERA_DATA")
    layout.operator("irpso.load_captures", icon="IMPORT")


class IRPSO_PT_view(Tab, Panel):
    """Picture, problems and settings of the active view."""

    bl_label = ""
    bl_parent_id = "IRPSO_PT_capture"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only of a list."""
        settings = context.scene.irpso
        return not settings.captures and settings.active_view < len(settings.views)

    def draw_header(self, context: bpy.types.Context) -> None:
        """Which one."""
        state = _active(context)
        self.layout.label(text=state.name or "View without Image", icon="ERROR" if state.faults else "NONE")

    def draw(self, context: bpy.types.Context) -> None:
        """Picture and facts, faults and notes, properties."""
        layout, settings, state = split(self.layout), context.scene.irpso, _active(context)
        view = settings.views[settings.active_view]
        picture = _picture(view, state)
        if picture != NO_PICTURE:
            top = layout.split(factor=0.4)
            top.template_icon(icon_value=picture, scale=LARGE)
            facts = top.column(align=True)
            for line in _facts(state):
                facts.label(text=line)
        says = layout.column(align=True)
        for text, icon in ((state.faults, "ERROR"), (state.notes, "INFO")):
            for line in text:
                wrapped(says, line, letters(context) - 2, icon)
        layout.operator("irpso.look_through_view", icon="CAMERA_DATA")
        column = layout.column()
        column.active = view.enabled
        for name in ("image", "camera", "exposure", "tint", "vignetting", "response", "shoulder",
                     "black_level", "ambient_radiance", "turn", "mask", "ambient", "flat", "colorspace"):
            column.prop(view, name)
        _draw_lights(column, view, state)


def _active(context: bpy.types.Context) -> ViewState:
    states, index = readiness.recent(context).views, context.scene.irpso.active_view
    return states[index] if index < len(states) else ViewState("")


def _facts(state: ViewState) -> list[str]:
    """What the file is."""
    found = state.file
    if found is None or found.problem:
        return []
    kind = "" if found.integer else " float"
    return [f"{found.width} x {found.height} pixels", f"{found.bits}-bit{kind}", found.colorspace or ""]


def _draw_lights(layout: bpy.types.UILayout, view: Any, state: ViewState) -> None:
    lights = layout.column(align=True)
    for index, item in enumerate(view.lights):
        row = lights.row(align=True)
        row.prop(item, "light", text=" " if index else "Lights")
        row.operator("irpso.remove_view_light", text="", icon="REMOVE").index = index
    if not view.lights:
        if state.lights + state.emitters:
            lights.label(text=f"Lights: all {state.lights + state.emitters} that render", icon="LIGHT")
        else:
            lights.label(text="Lit by the world", icon="WORLD")
    layout.operator("irpso.set_view_lights", icon="RESTRICT_SELECT_OFF")


CLASSES = (IRPSO_UL_views, IRPSO_MT_views, IRPSO_PT_capture, IRPSO_PT_view)
