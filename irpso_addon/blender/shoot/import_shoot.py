"""A photogrammetry project, its pictures and its mesh become cameras, lights, views and an object of the scene."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy

from ...core.errors import BadInput
from ...core.job import Progress, Steps, retold
from ...core.params import ShootSettings
from ...core.phrases import some
from ...core.shoot.picture_files import PictureFolder
from ...core.shoot.project import Project
from ...core.shoot.project_file import read_project
from ...core.shoot.scene_cameras import SUFFIXES as SCENE_SUFFIXES
from ...core.shoot.scene_cameras import project_of
from ..scene.scene_objects import require_metres
from .flash_power import Shown, flash_pictures, flash_power
from .grey_card import GreyCard, set_power_by_grey_card
from .grey_chart import GreyChart, read_chart
from .mesh_facing import face_cameras
from .mesh_file import import_mesh, shade
from .mesh_place import place
from .rollback import all_or_nothing
from .scene_file import read_scene_file
from .shoot_objects import add_cameras, add_flashes, add_views, show_mesh
from .shoot_pictures import Headers, ShootPictures, already_there, check_path, read_pictures
from .uv_unwrap import unwrap

Stored = Callable[[Path], str]
READ, MADE = 0.7, 0.85  # of the whole time: until pictures are read, until there are objects


@dataclass(frozen=True)
class Shoot:
    """The files of a shoot, and the greys in its pictures."""

    project: Path
    images: Path  # folder
    mesh: Path | None = None  # None: the only one that lies beside the project
    card: GreyCard | None = None  # sets the power of the flash
    chart: GreyChart | None = None  # sets the tone curve of the views, and the power of the flash


@dataclass(frozen=True)
class Imported:
    """What came in."""

    mesh: bpy.types.Object
    views: int
    messages: tuple[str, ...]  # for the user, a sentence or two each


@dataclass(frozen=True)
class ReadShoot:
    """What the files say, all of it checked: nothing is in the scene yet."""

    shoot: Shoot
    project: Project
    mesh: Path
    pictures: ShootPictures
    shown: Shown | None = None  # pictures by which the flash's power is found; None: it is not looked for


def import_shoot(shoot: Shoot, settings: ShootSettings, stored: Stored) -> Steps[Imported]:
    """`read_shoot` and then `add_shoot`: a job that raises what they raise."""
    read = yield from retold(
        read_shoot(shoot, settings), lambda step: replace(step, fraction=READ * step.fraction))
    return (yield from add_shoot(read, settings, stored))


def read_shoot(shoot: Shoot, settings: ShootSettings) -> Steps[ReadShoot]:
    """A job that looks at nothing of Blender's after its first step, so that a window can go on meanwhile.

    Raises BadInput.
    """
    require_metres(bpy.context.scene)  # the offset of a flash is in millimetres, a project's scale in metres
    yield Progress(0.0, "project")
    folder = PictureFolder(shoot.images)
    scene_file = read_scene_file(shoot.project, folder.stems()) if _is_scene_file(shoot.project) else None
    with Headers(folder) as headers:
        def work() -> Project:
            if scene_file is not None:
                return project_of(scene_file, folder.stems(), headers.size)
            return read_project(shoot.project, headers.size)

        project = yield from headers.while_working(work, "project")
        mesh = shoot.mesh or _only_mesh(project)
        check_path(mesh)
        pictures = yield from read_pictures(project, folder, headers)
    shown = None
    if settings.rig == "flash" and not settings.flash_power and shoot.card is None:
        shown = yield from flash_pictures(pictures, settings.colors)
    return ReadShoot(shoot, project, mesh, pictures, shown)


def add_shoot(read: ReadShoot, settings: ShootSettings, stored: Stored) -> Steps[Imported]:
    """Adds the shoot to the open scene.  ``stored``: how the .blend keeps the path of a picture.

    A job.  Raises BadInput; then, and when it is closed before its end, it leaves the file as it was.
    """
    project, pictures = read.project, read.pictures
    with all_or_nothing(bpy.context):
        yield Progress(READ, "mesh")
        mesh = import_mesh(read.mesh)
        lines = place(mesh, pictures.cameras, _scale(settings, project))
        lines += face_cameras(mesh, pictures.cameras, _scale(settings, project))
        lines += shade(mesh) + unwrap(mesh)
        yield Progress(MADE, "light")
        lines += _add(mesh, read, settings)
        views = list(bpy.context.scene.irpso.views)[-len(pictures.cameras):]
        for view in views:
            view.image, view.mask = (stored(Path(path)) if path else "" for path in (view.image, view.mask))
    return Imported(mesh, len(pictures.cameras), (*project.warnings, *pictures.messages, *lines))


def _is_scene_file(path: Path) -> bool:
    return path.suffix.lower() in SCENE_SUFFIXES and not path.is_dir()


def _scale(settings: ShootSettings, project: Project) -> float:
    return settings.scale or project.metres_per_unit or 1.0


def _add(mesh: bpy.types.Object, read: ReadShoot, settings: ShootSettings) -> list[str]:
    """Cameras, flashes and views, with absolute paths; lines for the user.  Raises BadInput."""
    project, pictures = read.project, read.pictures
    scene, flash = bpy.context.scene, settings.rig == "flash"
    before = [bpy.path.abspath(view.image) for view in scene.irpso.views if view.image]
    lines = [*_scale_line(settings, project), *already_there(pictures.files, before), *_other_lines(scene)]
    objects = add_cameras(pictures.cameras, _scale(settings, project))
    show_mesh(objects, mesh)
    flashes = add_flashes(pictures.cameras, objects, settings) if flash else {}
    first = not len(scene.irpso.views)
    views = add_views(scene, objects, flashes, pictures.files, pictures.exposures, settings.colors)
    _set_scene(scene, pictures, known=flash and settings.flash_power > 0, first=first)
    bpy.context.view_layer.update()
    card, chart, scaled = read.shoot.card, read.shoot.chart, False
    if chart is not None:  # first: it straightens what the power is found from
        found = read_chart(bpy.context, mesh, chart)
        lines += [found.response, *found.messages]
        scaled = found.scaled
    if card is not None:
        lines += set_power_by_grey_card(bpy.context, mesh, card)
    elif not scaled:
        lines += _light_line(mesh, views, flashes, settings, read.shown)
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj == mesh)
    bpy.context.view_layer.objects.active = mesh
    return lines


def _set_scene(scene: bpy.types.Scene, pictures: ShootPictures, *, known: bool, first: bool) -> None:
    """``first``: the scene had no views, so nothing hangs on its settings."""
    scene.irpso.photographs = True
    scene.irpso.scale_known = known and (first or scene.irpso.scale_known)
    if first:  # cameras without a lens of their own have the render's aspect
        sizes = Counter((camera.lens.width, camera.lens.height) for camera in pictures.cameras)
        scene.render.resolution_x, scene.render.resolution_y = sizes.most_common(1)[0][0]
        scene.render.resolution_percentage = 100


def _scale_line(settings: ShootSettings, project: Project) -> list[str]:
    if settings.scale or project.metres_per_unit or settings.rig != "flash":
        return []
    return [f"{project.path.name}: has no scale, so 1 unit is taken as 1 m; the flash's offset depends on it: set "
            "Scale"]


def _other_lines(scene: bpy.types.Scene) -> list[str]:
    """What in an open scene keeps the views from counting, or makes earlier ones count otherwise."""
    lines = []
    if scene.irpso.captures:
        lines.append(f"Captures is '{scene.irpso.captures}', so Solve uses its views and not those of the shoot; "
                     "clear that field")
    if scene.irpso.views and not scene.irpso.photographs:
        lines.append(f"scene '{scene.name}': had views before; all views are now treated as photographs, to which the "
                     "scene's film exposure and pixel filter do not apply")
    return lines


def _only_mesh(project: Project) -> Path:
    """Raises BadInput unless there is one."""
    if len(project.meshes) == 1:
        return project.meshes[0]
    names = some([path.name for path in project.meshes], mark="")
    what = f"has several meshes beside it: {names}" if names else "has no mesh beside it"
    raise BadInput(f"{project.path}: {what}; choose the mesh that the program exported")


def _light_line(
    mesh: bpy.types.Object, views: Sequence[Any], flashes: dict[str, bpy.types.Object], settings: ShootSettings,
    shown: Shown | None,
) -> list[str]:
    """Sets the flash's power where it is to be found; what the brightness of the maps rests on."""
    if not flashes:
        return ["no lamp was imported: place the lamps of the shoot in the scene; every lamp that renders lights "
                "every view. "
                "Their power is treated as unknown: where you have measured it, tick Known Power (Shoot)"]
    if settings.flash_power:
        return []
    light = next(iter(flashes.values())).data
    light.energy = flash_power(bpy.context, mesh, views, light.energy, shown)
    return [f"light '{light.name}': its power is not known; {light.energy:.3g} W make the brightest 2 % of the surface "
            "nearly white. Base colours are right up to one common factor, and Specular IOR Level is solved for: set "
            "the power, or use a grey card, for absolute values"]
