"""Add the images of a folder to the list of views, each with the camera and lights that its name contains."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy

from ..irpso_addon.blender import properties
from ..irpso_addon.core.capture.file_preview import same_file
from ..irpso_addon.core.capture.matching import Match, match
from ..irpso_addon.core.errors import BadInput
from ..irpso_addon.core.images.oiio_reader import JPEG, SUFFIXES
from ..irpso_addon.core.images.raw_reader import is_raw
from ..irpso_addon.core.maps.own_files import is_own
from ..irpso_addon.core.phrases import counted, some
from .helpers.paths import absolute, stored

MOST = 2000  # images of one folder


class IRPSO_OT_add_folder(bpy.types.Operator):
    """Add a view for each image in a folder and its sub-folders. Files whose names contain a camera or lamp name are \
matched by name; the rest are assigned in order if the counts fit"""

    bl_idname = "irpso.add_folder"
    bl_label = "Add Folder of Images"
    bl_options = {"REGISTER", "UNDO"}

    directory: bpy.props.StringProperty(
        name="Folder", subtype="DIR_PATH", description="Folder of the reference images",
        options={"SKIP_SAVE", *properties.RELATIVE})
    filter_folder: bpy.props.BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})
    filter_image: bpy.props.BoolProperty(default=True, options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Opens the file browser beside the .blend."""
        if bpy.data.filepath:
            self.directory = bpy.path.abspath("//")
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Fills views that wait for an image, appends the others, and says what was matched and what not."""
        scene = context.scene
        try:
            folder = Path(absolute(self.directory))
            files = _images(folder)
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        cameras, lights = ([obj for obj in scene.objects if obj.type == kind] for kind in ("CAMERA", "LIGHT"))
        flashes = {light.parent.name: [x.name for x in lights if x.parent == light.parent] for light in lights
                   if light.parent in cameras}
        found = match(files, [camera.name for camera in cameras], [light.name for light in lights], flashes)
        have = {same_file(bpy.path.abspath(view.image)) for view in scene.irpso.views}
        fresh = [m for m in found if same_file(str(folder / m.file)) not in have]
        views = scene.irpso.views  # by index: adding one moves the others in memory
        waiting = {_key(views[i]): i for i in reversed(range(len(views))) if _waits(views[i])}
        for entry in fresh:
            _put(scene, folder, entry, waiting)
        kind, text = _summary(fresh, len(found) - len(fresh), len(lights))
        self.report({kind}, text)
        return {"FINISHED"} if fresh else {"CANCELLED"}


def _images(folder: Path) -> list[Path]:
    """Relative paths of the images in ``folder`` and the folders in it.  Raises BadInput."""
    try:
        inside = [folder, *(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))]
        found = [path.relative_to(folder) for place in inside for path in place.iterdir()
                 if (path.suffix.lower() in SUFFIXES or is_raw(path)) and path.is_file()
                 and not path.name.startswith(".")]
    except OSError as error:
        raise BadInput(f"{folder}: cannot be read ({error.strerror}); choose a folder of images") from None
    raw = {path.with_suffix("") for path in found if is_raw(path)}  # a camera may write a JPEG of the same picture
    found = [path for path in found if path.suffix.lower() not in JPEG or path.with_suffix("") not in raw]
    pictures = [path for path in found if not is_own(folder / path)] if len(found) <= MOST else found
    maps, found = len(found) - len(pictures), pictures
    if maps and not found:
        raise BadInput(f"{folder}: holds no image but {counted(maps, 'exported map')}; choose the folder of the "
                       "reference images")
    if not found:
        raise BadInput(f"{folder}: has no image; choose the folder of the reference images")
    if len(found) > MOST:
        raise BadInput(f"{folder}: has {len(found)} images; choose a folder of at most {MOST}")
    return found


def _waits(view: Any) -> bool:
    """Whether its image is not there: a rig's, before the pictures are taken."""
    return not os.path.exists(bpy.path.abspath(view.image))


def _key(view: Any) -> tuple[Any, frozenset[Any]]:
    """What a view is of."""
    return view.camera, frozenset(item.light for item in view.lights)


def _put(scene: bpy.types.Scene, folder: Path, entry: Match, waiting: dict[tuple[Any, frozenset[Any]], int]) -> None:
    """Into the view that waits for this camera and these lights, else into one of its own."""
    camera = scene.objects[entry.camera] if entry.camera else None
    lights = [scene.objects[name] for name in entry.lights]
    at = waiting.pop((camera, frozenset(lights)), None) if camera else None
    if at is not None:
        view = scene.irpso.views[at]
    else:
        view = scene.irpso.views.add()
        view.camera = camera
        for light in lights:
            view.lights.add().light = light
        scene.irpso.active_view = len(scene.irpso.views) - 1
    view.image = stored(folder / entry.file)
    view.mask = stored(folder / entry.mask) if entry.mask else ""


def _summary(fresh: Sequence[Match], known: int, lights: int) -> tuple[str, str]:
    """Kind and text of the report."""
    lost = [m for m in fresh if m.camera is None]
    counts = [
        ("camera by name", sum(m.camera is not None and not m.camera_by_order for m in fresh)),
        ("camera by order", sum(m.camera_by_order for m in fresh)),
        ("lights by name", sum(bool(m.lights) and not m.lights_by_order for m in fresh)),
        ("lights by order", sum(m.lights_by_order for m in fresh)),
        ("all lights", sum(not m.lights for m in fresh) if lights > 1 else 0),
        ("mask", sum(m.mask is not None for m in fresh)),
        ("already in the list", known),
    ]
    text = f"Added {counted(len(fresh), 'view')}" + "".join(f"; {what}: {count}" for what, count in counts if count)
    if not lost:
        return "INFO", text
    names = some([match.file.name for match in lost], mark="")
    return "WARNING", f"{text}; no camera for {names}: choose it in the list"
