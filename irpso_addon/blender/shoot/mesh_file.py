"""A mesh file into the scene, by Blender's own importers."""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from contextlib import redirect_stderr
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.errors import BadInput
from ..scene.mesh_noise import take_out_noise
from . import rollback


def _usd(path: str) -> Any:
    return bpy.ops.wm.usd_import(filepath=path, import_cameras=False, import_lights=False, set_frame_range=False)


def _alembic(path: str) -> Any:
    return bpy.ops.wm.alembic_import(filepath=path, set_frame_range=False, as_background_job=False)


SCAN = 10_000  # faces from which on a mesh is a scan: its edges are roughness, ...
SHARP = math.radians(60)  # ... and those of smaller meshes are meant from here on
IMPORTERS: dict[str, Callable[[str], Any]] = {
    # In the project's own axes: photogrammetry programs write meshes in the coordinates of their cameras.
    ".obj": lambda path: bpy.ops.wm.obj_import(filepath=path, forward_axis="Y", up_axis="Z"),
    ".ply": lambda path: bpy.ops.wm.ply_import(filepath=path, forward_axis="Y", up_axis="Z"),
    ".stl": lambda path: bpy.ops.wm.stl_import(filepath=path, forward_axis="Y", up_axis="Z"),
    ".fbx": lambda path: bpy.ops.import_scene.fbx(filepath=path, use_manual_orientation=True, axis_forward="Y",
                                                  axis_up="Z", use_anim=False),
    ".glb": lambda path: bpy.ops.import_scene.gltf(filepath=path),
    ".gltf": lambda path: bpy.ops.import_scene.gltf(filepath=path),
    ".abc": _alembic, ".usd": _usd, ".usda": _usd, ".usdc": _usd, ".usdz": _usd,
}


def import_mesh(path: Path) -> bpy.types.Object:
    """The mesh of a file as one object in the scene's own collection; what else the file holds is removed again.

    Raises BadInput, and may leave something behind then: see rollback.py.
    """
    importer = IMPORTERS.get(path.suffix.lower())
    if importer is None:
        raise BadInput(f"{path}: is not a mesh file that can be read; export the mesh as OBJ, PLY, FBX, glTF, USD or "
                       "Alembic")
    if not path.is_file():
        raise BadInput(f"{path}: file not found; choose the mesh that the photogrammetry program exported")
    before, world = rollback.blocks(), bpy.context.scene.world
    deselect()
    try:
        with redirect_stderr(io.StringIO()):  # importers in Python print where they failed
            importer(str(path.resolve()))
    except (RuntimeError, AttributeError) as error:
        raise BadInput(f"{path}: Blender cannot read it ({_reason(error)}); export the mesh again") from None
    bpy.context.scene.world = world  # the file's may light the scene
    added = [block for block in rollback.blocks() - before if isinstance(block, bpy.types.Object)]
    meshes = [obj for obj in added if obj.type == "MESH" and len(obj.data.polygons)]
    if not meshes:
        points = sum(len(obj.data.vertices) for obj in added if obj.type == "MESH")
        what = f"has {points} points and no face" if points else "has no mesh"
        raise BadInput(f"{path}: {what}; export the textured mesh, not the point cloud")
    bpy.context.view_layer.update()  # which places what hangs on something else
    whole = _joined(meshes)
    _free(whole)
    rollback.remove({obj for obj in rollback.blocks() - before if isinstance(obj, bpy.types.Object) and obj != whole})
    while unused := {block for block in rollback.blocks() - before if not block.users or _is_empty(block)}:
        rollback.remove(unused)
    bpy.context.view_layer.update()  # which otherwise lists None where an object was removed
    whole.name = path.stem
    return whole


def shade(mesh: bpy.types.Object) -> list[str]:
    """A mesh whose file has no normals is shaded smooth, because Blender reads it flat; lines for the user.

    Facets of a scan are rough.  Its corners' mean normals are several times as near to those of the surface, and nearer
    still without the noise of the corners, which is taken out of the normals of a file too.
    """
    data, smooth = mesh.data, np.empty(len(mesh.data.polygons), np.bool_)
    data.polygons.foreach_get("use_smooth", smooth)
    lines = []
    if not smooth.any() and not data.has_custom_normals:
        data.shade_smooth()
        lines = [f"'{mesh.name}': its file has no normals, so it was shaded smooth"]
        if len(smooth) < SCAN:
            data.set_sharp_from_angle(angle=SHARP)
    if len(smooth) >= SCAN and take_out_noise(data):
        lines.append(f"'{mesh.name}': the noise of its corners was taken out of its normals (now custom normals)")
    return lines


def _reason(error: Exception) -> str:
    """What went wrong, of what Blender says: its last line is where in Python it was called, and tracebacks are cut."""
    if "Traceback" in str(error):
        return "its importer failed"
    lines = [line for line in str(error).splitlines() if line.strip() and not line.startswith("Location:")]
    return (lines or ["unknown error"])[-1].removeprefix("Error: ")


def deselect() -> None:
    """All objects of the view layer."""
    for obj in bpy.context.view_layer.objects:
        obj.select_set(False)


def _joined(meshes: list[bpy.types.Object]) -> bpy.types.Object:
    """One object of all, in the place of the largest."""
    if len(meshes) == 1:
        return meshes[0]
    largest = max(meshes, key=lambda obj: len(obj.data.polygons))
    with bpy.context.temp_override(active_object=largest, object=largest, selected_objects=meshes,
                                   selected_editable_objects=meshes):
        bpy.ops.object.join()
    return largest


def _free(obj: bpy.types.Object) -> None:
    """From parents, animation and the file's collections: the scene's own is always shown."""
    matrix = obj.matrix_world.copy()
    obj.parent = None
    obj.animation_data_clear()
    obj.constraints.clear()  # Alembic and USD move objects by these, and bend them by a modifier
    for modifier in [each for each in obj.modifiers if each.type == "MESH_SEQUENCE_CACHE"]:
        obj.modifiers.remove(modifier)
    obj.matrix_world = matrix
    for collection in obj.users_collection:
        collection.objects.unlink(obj)
    bpy.context.scene.collection.objects.link(obj)
    obj.hide_viewport = obj.hide_render = False
    obj.hide_set(False)


def _is_empty(block: Any) -> bool:
    return isinstance(block, bpy.types.Collection) and not block.all_objects
