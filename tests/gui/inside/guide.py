"""The ten pictures of docs/guide.md: the sample scene, from an empty list to maps on the vase."""

from __future__ import annotations

import bpy
import jobs
import numpy as np
import robot
from robot import Steps

STEP = 29  # pixels from the header of a folded panel to the next
CAPTURE = 13 + STEP  # from the top of the sidebar to the header of Capture, which is below Shoot
SLOW = 400  # seconds that a solve may take on a busy machine
SETTINGS = ("size", "model", "method", "indirect")  # that the sample scene has of its own
LIVE = 0.55  # of the solve: the maps are half there


def guide() -> Steps:
    """All of them; the last two in turn, for the page ends with the better maps."""
    yield from install()
    yield from sample()
    yield from views()
    yield from missing()
    yield from settings()
    yield from live()
    yield from wipe()
    yield from trust()
    yield from result()
    yield from twice()


def install() -> Steps:
    """The preferences, where the viewport was."""
    for kind in ("PROPERTIES", "OUTLINER", "DOPESHEET_EDITOR"):
        with bpy.context.temp_override(window=robot.window(), area=robot.area(kind)):
            bpy.ops.screen.area_close()
        yield 0.3
    bpy.context.preferences.system.use_region_overlap = False  # sidebars cover nothing
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
    yield from look("01_install", 1)
    place.type = "VIEW_3D"
    yield 0.5


def sample() -> Steps:
    """It is made, opened and laid out; then the list is emptied, as a scene of one's own begins."""
    yield from robot.open_tab()
    yield from robot.press("irpso.sample_scene(")
    yield from robot.until(lambda: bpy.data.filepath, 120, step=0.2)
    yield 3
    robot.area().spaces.active.show_region_toolbar = False
    robot.area("IMAGE_EDITOR").spaces.active.show_region_ui = False
    yield from robot.open_tab()
    with robot.within():
        bpy.ops.view3d.view_selected()
    show("SOLID")
    bpy.context.scene.irpso.views.clear()
    yield from look("02_scene", 1.5)


def views() -> Steps:
    """The list, filled from the folder."""
    with robot.within():
        bpy.ops.irpso.add_folder(directory="//refs")
        bpy.context.scene.irpso.active_view = 2
        bpy.ops.ed.undo_push(message="Views")
    yield from look("03_views", 3)


def missing() -> Steps:
    """A file and a camera are gone."""
    listed = bpy.context.scene.irpso.views
    path, camera = listed[2].image, listed[0].camera
    listed[2].image, listed[0].camera = "//refs/lost.exr", None
    yield from look("04_missing", 3)
    listed[2].image, listed[0].camera = path, camera
    yield 0.5


def settings() -> Steps:
    """The Solve panel with its defaults; Capture is folded away.  Then the sample scene's own settings again."""
    yield from toggle(robot.region("UI").height - CAPTURE)
    chosen = bpy.context.scene.irpso
    own = {name: getattr(chosen, name) for name in SETTINGS}
    for name in SETTINGS:
        chosen.property_unset(name)
    yield from look("05_settings", 1)
    for name, value in own.items():
        setattr(chosen, name, value)


def live() -> Steps:
    """While it runs."""
    show("TEXTURE")
    robot.area().spaces.active.overlay.show_overlays = False
    yield from jobs.started()
    yield from jobs.far_enough(LIVE)
    yield from look("06_live", 0.3)
    yield from jobs.ended(SLOW)
    yield 2
    robot.tell(blender=bpy.app.version_string, seconds=round(sum(jobs.solution().seconds.values()), 1))


def wipe() -> Steps:
    """Reference beside prediction, with a highlight in it."""
    yield from robot.open_tab(of="IMAGE_EDITOR")
    chosen = bpy.context.window_manager.irpso_views
    pictures = jobs.solution().pictures
    light = [picture.scale * np.nansum(picture.reference, dtype=float) for picture in pictures]
    chosen.show, chosen.picture, chosen.view = "VIEWS", "WIPE", int(np.argmax(light))
    yield from look("07_wipe", 1)


def trust() -> Steps:
    """Confidence; Checks unfolded below Result; Solve folded away."""
    yield from toggle(robot.region("UI").height - CAPTURE - STEP)
    export = yield from robot.find("irpso.export_maps(")
    yield from toggle(export[1] - robot.region("UI").y - STEP)
    chosen = bpy.context.window_manager.irpso_views
    chosen.show, chosen.map = "MAPS", "confidence"
    yield from look("08_confidence", 1)


def twice() -> Steps:
    """Solved again with a model that knows no highlights: what it puts into the base colour instead."""
    yield from toggle(robot.region("UI").height - CAPTURE - STEP)
    bpy.context.scene.irpso.model = "lambert"
    yield from jobs.started()
    yield from jobs.ended(SLOW)
    chosen = bpy.context.window_manager.irpso_views
    chosen.show, chosen.compared, chosen.contrast = "RESULTS", "base_color", "DIFFERENCE"
    yield from look("09_results", 1)


def result() -> Steps:
    """The maps on the object, and the export."""
    bpy.context.window_manager.irpso_views.show = "MAPS"
    bpy.context.window_manager.irpso_views.map = "base_color"
    show("MATERIAL")
    yield from look("10_export", 20)


def look(name: str, settle: float) -> Steps:
    """A screenshot of what scripts have set too, of which the window hears nothing; a panel's height follows later."""
    for pause in (0.5, settle):
        for area in robot.window().screen.areas:
            area.tag_redraw()
            if area.type == "IMAGE_EDITOR":
                with robot.within(of="IMAGE_EDITOR"):
                    bpy.ops.image.view_all(fit_view=True)
        yield pause
    yield from robot.look(name)


def toggle(height: float) -> Steps:
    """Fold the panel of the sidebar whose header is at a height, or unfold it."""
    side = robot.region("UI")
    yield from robot.click(side.x + 60, side.y + height)
    yield 0.5


def show(kind: str) -> None:
    """How the viewport draws: TEXTURE is Solid with the maps."""
    shading = robot.area().spaces.active.shading
    shading.type = "MATERIAL" if kind == "MATERIAL" else "SOLID"
    if kind != "MATERIAL":
        shading.color_type = "TEXTURE" if kind == "TEXTURE" else "MATERIAL"
    robot.area().tag_redraw()
