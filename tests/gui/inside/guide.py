"""The ten pictures of docs/guide.md: the sample scene, from an empty list to maps on the vase."""

from __future__ import annotations

import bpy
import jobs
import robot
from robot import Steps

HEADER = 13  # pixels from the top of a panel to the middle of its header
LIVE = 0.55  # of the solve: the maps are half there


def guide() -> Steps:
    """All of them, in the order of the page."""
    yield from install()
    yield from sample()
    yield from views()
    yield from missing()
    yield from settings()
    yield from live()
    yield from wipe()
    yield from trust()
    yield from twice()
    yield from result()


def install() -> Steps:
    """The preferences, where the viewport was."""
    for kind in ("PROPERTIES", "OUTLINER", "DOPESHEET_EDITOR"):
        with bpy.context.temp_override(window=robot.window(), area=robot.area(kind)):
            bpy.ops.screen.area_close()
        yield 0.3
    bpy.context.preferences.active_section, bpy.context.window_manager.addon_search = "ADDONS", "IRPSO"
    place = robot.area()
    place.type = "PREFERENCES"
    with robot.within(of="PREFERENCES"):
        bpy.ops.preferences.addon_expand(module=robot.PACKAGE)
    yield 2
    detected = robot.addon("irpso_addon.blender.preferences")
    yield from robot.until(lambda: not detected.testing(), 30, step=0.2)
    with robot.within(of="PREFERENCES"):
        bpy.ops.irpso.test_device()
    yield from robot.until(lambda: not detected.testing(), step=0.2)
    yield from robot.look("01_install", 1)
    place.type = "VIEW_3D"
    yield 0.5


def sample() -> Steps:
    """It is made, opened and laid out; then the list is emptied, as a scene of one's own begins."""
    yield from robot.open_tab()
    yield from robot.press("irpso.sample_scene(")
    yield from robot.until(lambda: bpy.data.filepath, 120, step=0.2)
    yield 3
    robot.area().spaces.active.show_region_toolbar = False
    yield from robot.open_tab()
    show("SOLID")
    bpy.context.scene.irpso.views.clear()
    yield from robot.look("02_scene", 1.5)


def views() -> Steps:
    """The list, filled from the folder."""
    with robot.within():
        bpy.ops.irpso.add_folder(directory="//refs")
        bpy.context.scene.irpso.active_view = 2
        bpy.ops.ed.undo_push(message="Views")
    yield from robot.look("03_views", 3)


def missing() -> Steps:
    """A file and a camera are gone."""
    listed = bpy.context.scene.irpso.views
    path, camera = listed[2].image, listed[0].camera
    listed[2].image, listed[0].camera = "//refs/lost.exr", None
    yield from robot.look("04_missing", 3)
    listed[2].image, listed[0].camera = path, camera
    yield 0.5


def settings() -> Steps:
    """The Solve panel, with Advanced unfolded; Capture is folded away."""
    yield from toggle_first()
    yield from robot.look("05_settings", 1)


def live() -> Steps:
    """While it runs."""
    show("TEXTURE")
    yield from jobs.started()
    yield from jobs.far_enough(LIVE)
    yield from robot.look("06_live", 0.3)
    yield from jobs.ended()
    yield 2


def wipe() -> Steps:
    """Reference beside prediction, with a highlight in it."""
    yield from robot.open_tab(of="IMAGE_EDITOR")
    chosen = bpy.context.window_manager.irpso_views
    chosen.show, chosen.picture, chosen.view = "VIEWS", "WIPE", 3
    yield from robot.look("07_wipe", 1)


def trust() -> Steps:
    """Confidence; Checks unfolded below Result; Solve folded away."""
    chosen = bpy.context.window_manager.irpso_views
    chosen.show, chosen.map = "MAPS", "confidence"
    yield from robot.look("08_confidence", 1)


def twice() -> Steps:
    """Solved again by another method: the difference."""
    bpy.context.scene.irpso.method = "draft"
    yield from jobs.started()
    yield from jobs.ended()
    chosen = bpy.context.window_manager.irpso_views
    chosen.show, chosen.compared, chosen.contrast = "RESULTS", "roughness", "WIPE"
    yield from robot.look("09_part", 1)


def result() -> Steps:
    """The maps on the object, and the export."""
    bpy.context.window_manager.irpso_views.show = "MAPS"
    bpy.context.window_manager.irpso_views.map = "base_color"
    show("MATERIAL")
    yield from robot.look("10_export", 15)


def toggle_first() -> Steps:
    """Fold the first panel of the sidebar, or unfold it."""
    side = robot.region("UI")
    yield from robot.click(side.x + 60, side.y + side.height - HEADER)
    yield 0.5


def show(kind: str) -> None:
    """How the viewport draws: TEXTURE is Solid with the maps."""
    shading = robot.area().spaces.active.shading
    shading.type = "MATERIAL" if kind == "MATERIAL" else "SOLID"
    if kind != "MATERIAL":
        shading.color_type = "TEXTURE" if kind == "TEXTURE" else "MATERIAL"
    robot.area().tag_redraw()
