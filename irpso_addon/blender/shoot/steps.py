"""What a shoot still lacks, step by step, and the button that mends it.  For panels: only what is in memory is read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from ...core.phrases import counted, some
from ..jobs.session import session
from ..scene import readiness
from ..scene.scene_mesh import SCAN
from ..scene.scene_world import is_black

Operator = tuple[str, str]  # its name, the button's text


@dataclass(frozen=True)
class Step:
    """One of them."""

    text: str  # what there is, or what is missing
    done: bool
    mend: Operator | None = None


def steps(context: bpy.types.Context) -> list[Step]:
    """Of the open scene, in the order in which they are done."""
    found = readiness.recent(context)
    used = [view for view in found.views if view.used]
    return [_file(), _cameras(context, len(used)), _pictures(context, found), _mesh(context, used),
            _lamps(context, used), _scale(context), *([] if used else [_import(context)]), _check(context, used)]


def _file() -> Step:
    if bpy.data.filepath:
        return Step(f"File: {Path(bpy.data.filepath).name}", True)
    return Step("File: save it beside the project", False, ("wm.save_mainfile", "Save"))


def _cameras(context: bpy.types.Context, views: int) -> Step:
    if views:
        return Step(f"Cameras: {counted(views, 'view')}", True)
    project = context.scene.irpso.shoot.project
    if not project:
        return Step("Cameras: choose the project above, or add views under Capture", False)
    return Step(f"Cameras: from {_name(project)}", True)


def _pictures(context: bpy.types.Context, found: readiness.Survey) -> Step:
    used = [view for view in found.views if view.used]
    if not used:
        folder = context.scene.irpso.shoot.images
        return (Step(f"Pictures: from {_name(folder)}", True) if folder else
                Step("Pictures: choose their folder above", False))
    faulty = [view for view in used if view.faults]
    if faulty:
        first = faulty[0]
        return Step(f"Pictures: {len(faulty)} of {len(used)} views cannot be used; {first.name or 'a view'}: "
                    f"{first.faults[0]}", False)
    eight = sum(view.file is not None and not view.file.problem and view.file.bits <= 8 for view in used)
    if eight:
        return Step(f"Pictures: {eight} with 8 bits per channel; use RAW files or 16 bits", False)
    return Step("Pictures: all there", True)


def _name(path: str) -> str:
    return Path(path.replace("\\", "/").rstrip("/")).name or path


def _mesh(context: bpy.types.Context, used: list[readiness.ViewState]) -> Step:
    obj, shoot = context.active_object, context.scene.irpso.shoot
    if not used and shoot.project:
        return Step(f"Mesh: from {_name(shoot.mesh)}" if shoot.mesh else "Mesh: the only one beside the project", True)
    if obj is None or obj.type != "MESH":
        return Step("Mesh: make the mesh active", False)
    if not obj.modifiers and not len(obj.data.uv_layers):
        return Step(f"Mesh: '{obj.name}' has no UV map", False, ("irpso.unwrap", "Make One"))
    others = [other.name for other in context.scene.objects
              if other.type == "MESH" and other != obj and not other.hide_render]
    if others and context.scene.irpso.photographs:
        return Step(f"Mesh: '{obj.name}'; {some(others)} {'are' if len(others) > 1 else 'is'} in the scene too: delete "
                    "what did not stand there", True)
    if len(obj.data.polygons) >= SCAN and not obj.modifiers and obj.data.shape_keys is None:
        return Step(f"Mesh: '{obj.name}'", True, ("irpso.denoise_normals", "Denoise"))
    return Step(f"Mesh: '{obj.name}'", True)


def _lamps(context: bpy.types.Context, used: list[readiness.ViewState]) -> Step:
    world = not is_black(context.scene.world)
    dark = [view for view in used if not view.lights + view.emitters and not world]
    if dark:
        return Step(f"Light: no lamp lights {len(dark)} of {len(used)} views; place the lamps of the shoot", False,
                    ("object.light_add", "Add Lamp"))
    if not used:
        return _planned(context.scene.irpso.shoot)
    if not any(view.lights for view in used):
        if any(view.emitters for view in used):
            return Step("Light: meshes that glow", True)
        return Step(f"Light: lit by the world '{context.scene.world.name}'", True)
    lamps = {item.light for view in context.scene.irpso.views if view.enabled for item in view.lights
             if item.light and item.light.type == "LIGHT"}
    lamps = lamps or {obj for obj in context.scene.objects if obj.type == "LIGHT"}
    flash = lamps and all(obj.parent is not None and obj.parent.type == "CAMERA" for obj in lamps)
    return Step("Light: a flash on the camera" if flash else f"Light: {counted(len(lamps), 'lamp')}", True)


def _planned(shoot: Any) -> Step:
    """What the import will do."""
    if not shoot.project:
        return Step("Light: choose above what lit the pictures", False)
    return Step(f"Light: a flash {shoot.flash_right:g} mm right of the lens and {shoot.flash_above:g} mm above it"
                if shoot.rig == "flash" else "Light: place the lamps after the import", True)


def _import(context: bpy.types.Context) -> Step:
    shoot = context.scene.irpso.shoot
    ready = shoot.project and shoot.images
    return Step("Import: not done yet", False, ("irpso.import_shoot", "Import") if ready else None)


def _scale(context: bpy.types.Context) -> Step:
    if context.scene.irpso.photographs:  # entering a scale changes nothing now
        return Step("Scale: as imported; to change it, undo the import and import again", True)
    shoot = context.scene.irpso.shoot
    if shoot.rig == "flash" and shoot.project and not shoot.scale:
        return Step("Scale: the project's own, or 1 m per unit; measure something and enter the scale above, since "
                    "the flash's offset depends on it", False)
    return Step("Scale: given" if shoot.scale else "Scale: as in the scene", True)


def _check(context: bpy.types.Context, used: list[readiness.ViewState]) -> Step:
    check = session.check_of(context.active_object)
    if check is None:
        return Step("Check: not done yet", False, ("irpso.check_shoot", "Check") if used else None)
    if check.total != len(used):
        return Step("Check: the views have changed since", False, ("irpso.check_shoot", "Again"))
    if check.findings:
        return Step(f"Check: {len(check.findings)} to correct, below", False, ("irpso.check_shoot", "Again"))
    return Step("Check: no problem found; next: Solve", True, ("irpso.check_shoot", "Again"))
