"""Steering: which part of the object is solved, and the last result that a solve starts from or keeps the rest of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.calibration.put_right import applied
from ...core.checks.camera_changes import with_cameras
from ...core.data import F32, Region, SceneData, Solution
from ...core.errors import BadInput
from ...core.images.mask import read_mask
from ...core.normals.tangent_map import wearing
from ..files import read_maps
from ..material.shown_model import shown_solution
from ..material.slot_names import names_of, present_names, renamed
from ..material.tags import maps_of
from ..scene.scene_mesh import evaluated_mesh, integers, triangles
from ..scene.scene_objects import world_matrix
from .session import session

MODES = {  # of the object, in which a part is marked; what the button says
    "GROUP": ("WEIGHT_PAINT", "Paint Weights", "WPAINT_HLT"),
    "IMAGE": ("TEXTURE_PAINT", "Paint Image", "TPAINT_HLT"),
    "FACES": ("EDIT", "Select Faces", "EDITMODE_HLT"),
}


def of_panel(context: Any) -> tuple[str, Any]:
    """Kind and choice, as `with_part` takes them, of the part that the panel asks for."""
    settings = context.scene.irpso
    return settings.region, {"GROUP": settings.region_group, "IMAGE": settings.region_image}.get(settings.region)


def with_part(
    context: Any | None, obj: bpy.types.Object, data: SceneData, start: str, kind: str, chosen: Any = None,
) -> SceneData:
    """``data`` with a part by its ``kind`` in properties.REGIONS: ``chosen`` names a group, or is an image or its path.

    The last result is put in where it is needed: beside a part, or where the search is to ``start`` at it.
    Raises BadInput where the part is nothing.
    """
    region, depsgraph = None, (context or bpy.context).evaluated_depsgraph_get()
    if kind == "GROUP":
        region = group_region(obj, depsgraph, chosen)
    elif kind == "IMAGE":
        region = file_region(chosen) if isinstance(chosen, Path) else image_region(chosen)
    elif kind == "FACES":
        region = faces_region(obj, depsgraph)
    if region is None and start == "anew":
        return data
    last = last_result(obj)
    if last is None and start == "last":
        nothing = f"{obj.name}: has no result to start from; the search started from scratch"
        data = replace(data, warnings=(*data.warnings, nothing))
    if last is not None and last.put_right and region is not None:
        # The part is lit and seen as the rest was, whose cameras, lamps and exposures the solve has put right.
        if session.calibration_state((context or bpy.context).scene, obj) == "open":
            data = with_cameras(data, last.cameras)  # in whose axes a flash has moved
            data = applied(data, last.calibration) if last.calibration is not None else data
        else:  # the scene has them, but for views that depart from their camera
            alone = tuple(change for change in last.cameras if change.image is not None)
            data = with_cameras(data, alone)
            last = replace(last, calibration=None, cameras=alone)
    if region is not None and last is not None and last.maps.normal is not None:  # the part's normals are the rest's
        data = replace(data, mesh=wearing(data.mesh, last.maps.normal))
    return replace(data, region=region, start=last)


# ---- the part


def group_region(obj: bpy.types.Object, depsgraph: Any, name: str) -> Region:
    """Where the weight of a vertex group is above a half.  Raises BadInput."""
    index = obj.vertex_groups.find(name)
    if index < 0:
        have = ", ".join(f"'{group.name}'" for group in obj.vertex_groups) or "none"
        raise BadInput(f"object '{obj.name}': has no vertex group '{name}' (it has {have}); choose one" if name else
                       f"object '{obj.name}': no vertex group is chosen for the region to solve; choose one")

    def weights(mesh: bpy.types.Mesh) -> F32:
        told = np.zeros(len(mesh.vertices), np.float32)
        for vertex in mesh.vertices:
            for group in vertex.groups:
                if group.group == index:
                    told[vertex.index] = group.weight
        return told[triangles(mesh)[1]]

    return _of_mesh(obj, depsgraph, weights, f"vertex group '{name}' has no weight above 0.5; paint its weights")


def faces_region(obj: bpy.types.Object, depsgraph: Any) -> Region:
    """The faces that are selected in Edit Mode.  Raises BadInput when none is."""
    def selected(mesh: bpy.types.Mesh) -> F32:
        chosen = np.zeros(len(mesh.polygons), bool)
        mesh.polygons.foreach_get("select", chosen)
        faces = integers(mesh.loop_triangles, "polygon_index", 1)
        return np.repeat(chosen[faces], 3, axis=1).astype(np.float32)

    return _of_mesh(obj, depsgraph, selected, "no face is selected; select faces in Edit Mode, then leave Edit Mode")


def image_region(image: bpy.types.Image | None) -> Region:
    """Where an image over the UV square is white: mean of its colours times alpha above a half.  Raises BadInput."""
    if image is None:
        raise BadInput("no image is chosen for the region to solve; choose or paint one that is white there")
    width, height = image.size
    if not width or not height:
        raise BadInput(f"image '{image.name}': cannot be read; find its file or choose another image")
    flat = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(flat)
    pixels = flat.reshape(height, width, image.channels)
    colours = min(image.channels, 3)
    white = sum(pixels[..., i] for i in range(colours)) * np.float32(1 / colours)  # mean() would take ten times as long
    if image.channels == 4:
        white *= pixels[..., 3]
    if white.max() <= 0.5:
        raise BadInput(f"image '{image.name}': has no white; paint the region to solve white")
    return Region(image=white)


def file_region(path: Path) -> Region:
    """The same of a file.  Raises BadInput."""
    white = read_mask(path)
    if white.max() <= 0.5:
        raise BadInput(f"{path}: has no white; paint the region to solve white")
    return Region(image=white)


def _of_mesh(obj: bpy.types.Object, depsgraph: Any, weights: Callable[[bpy.types.Mesh], F32], nothing: str) -> Region:
    """A region by weights (T, 3) of the evaluated mesh's corners, in the order of scene_mesh.read_mesh."""
    with evaluated_mesh(obj, depsgraph) as mesh:
        if mesh is None or not mesh.polygons:
            raise BadInput(f"object '{obj.name}': has no faces after its modifiers; add faces or change the modifiers")
        mesh.calc_loop_triangles()
        corners = weights(mesh)
    if not (corners > 0.5).any():
        raise BadInput(f"object '{obj.name}': {nothing}")
    if np.linalg.det(world_matrix(obj, depsgraph)[:3, :3]) < 0:
        corners = corners[:, [0, 2, 1]]
    return Region(corners=np.ascontiguousarray(corners))


# ---- the last result


def last_result(obj: bpy.types.Object) -> Solution | None:
    """What was solved of ``obj`` since the file was opened, else the maps on its materials; None: neither."""
    solution, files = session.solution_of(obj), session.files_of(obj)
    if files is not None and files.tiled:  # the solution's maps hold all UDIMs side by side
        return None
    if solution is not None:
        return _as_wired(obj, replace(solution, checks=None, pictures=()))
    if not maps_of(obj):
        return None
    try:
        return shown_solution(obj, read_maps(obj))
    except BadInput:  # an image was deleted
        return None


def _as_wired(obj: bpy.types.Object, solution: Solution) -> Solution:
    """By the names that materials have, also those that were made for the object."""
    return renamed(solution, present_names(obj, names_of(obj, solution.model)))


# ---- the panel's rows


def draw(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Where the search starts, and the part; in a layout with property split."""
    settings, obj = context.scene.irpso, context.active_object
    layout.prop(settings, "region")
    row = layout.row()
    if settings.region == "GROUP" and obj is not None:
        row.alert = settings.region_group not in obj.vertex_groups
        row.prop_search(settings, "region_group", obj, "vertex_groups", text="Group")
    elif settings.region == "IMAGE" and settings.region_image is None:
        row.alert = True
        row.template_ID(settings, "region_image", new="image.new", open="image.open", text="Image")
    elif settings.region == "IMAGE":
        row.prop(settings, "region_image")  # the other's buttons would leave no room for the name
    if settings.region in MODES and obj is not None:
        mode, text, icon = MODES[settings.region]
        layout.operator("irpso.paint_part", text="Done" if obj.mode == mode else text, icon=icon,
                        depress=obj.mode == mode)
    row = layout.row()
    row.active = obj is not None and (session.facts_of(obj) is not None or bool(maps_of(obj)))
    row.prop(settings, "start")
