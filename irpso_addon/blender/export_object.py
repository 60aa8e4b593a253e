"""An object of the open file with its maps, out to the files of a target (core/maps/targets.py)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import bpy
import numpy as np

from ..core.data import F32, Maps
from ..core.maps import target_export
from ..core.maps.map_set import MapFiles, MapReader
from ..core.maps.target_export import ExportObject, Surface
from .material.solved_socket import COAT_WEIGHT, DIFFUSE_ROUGHNESS, LEVEL, METALLIC
from .scene.scene_material import SlotNormalMap, differences, find_principled, normal_map_of
from .scene.scene_mesh import read_mesh

Warn = Callable[[str], None]
HERE, UNEVEN = "blender", 0.01  # the target of files for this object itself
EXPORTED = (METALLIC.name, LEVEL.name, COAT_WEIGHT.name, DIFFUSE_ROUGHNESS.name)  # or named by `target_export.losses`


def export_object(
    obj: bpy.types.Object, maps: Maps | MapFiles, surfaces: Sequence[Surface], target: str, out: Path,
) -> tuple[list[Path], list[str]]:
    """Writes the files of ``target`` into the folder ``out``; their paths, and what is lost, one line each.

    ``surfaces``: what the material of each slot says.  Raises BadInput, as `target_export.write_target` and
    `read_mesh` do.
    """
    lost: list[str] = []
    mesh = read_mesh(obj, bpy.context.evaluated_depsgraph_get(), {}, lambda _: None)
    used = [obj.material_slots[slot].material for slot in np.unique(mesh.slots) if slot < len(obj.material_slots)]
    lost += [line for material in dict.fromkeys(used) for line in _left_out(material)]
    if isinstance(maps, MapFiles):
        reader = MapReader.of_files(maps, [layer for layer in target_export.LAYERS if layer in maps.paths])
    else:
        reader = MapReader.of_maps(maps)
    own = "normal" in reader.layers
    normals = None if own else _normals(obj, used, lost.append)
    if (own or normals is not None) and target != HERE and _unevenly_scaled(obj):
        lost.append(f"object '{obj.name}': is scaled unevenly, and Blender bends the normals of its normal map by "
                    "that, as other programs do not; apply the scale (Ctrl A) and solve again")
    found = ExportObject(obj.name, mesh, surfaces, normals)
    written = target_export.write_target(found, reader, target, out)
    lost += target_export.losses(found, target)
    if left := target_export.earlier_files(found, target, written):
        lost.append(f"{out}: an earlier export left {', '.join(left)}; delete these files, or choose another folder")
    return written, lost


def _unevenly_scaled(obj: bpy.types.Object) -> bool:
    """Whether lengths in the world differ by direction; by more than UNEVEN."""
    lengths = np.linalg.svd(np.array(obj.matrix_world)[:3, :3], compute_uv=False)
    return bool(lengths[0] > (1 + UNEVEN) * lengths[-1])


def _left_out(material: bpy.types.Material | None) -> list[str]:
    """A line that names the inputs of its shader that no target takes."""
    principled = None if material is None else find_principled(material)
    if material is None or principled is None:
        return []
    names = [name for name, _ in differences(principled) if name not in EXPORTED]
    if not names:
        return []
    return [f"material '{material.name}': {', '.join(names)} {'are' if len(names) > 1 else 'is'} not exported; set "
            f"{'them' if len(names) > 1 else 'it'} in the other program"]


def _normals(obj: bpy.types.Object, used: Sequence[bpy.types.Material | None], warn: Warn) -> F32 | None:
    """(h, w, 3) the one normal map of all the object's materials, its strength applied."""
    found = [_normal_map(material, warn) for material in used]
    maps = [normal_map for normal_map in found if normal_map is not None]
    if not maps:
        return None
    first = maps[0]
    if len(maps) < len(found) or not all(_alike(first, other) for other in maps[1:]):
        warn(f"object '{obj.name}': its materials have different normal maps; none is exported")
        return None
    layer = next((layer.name for layer in obj.data.uv_layers if layer.active_render), "")
    if first.uv_map not in ("", layer):
        warn(f"object '{obj.name}': its normal map has the UV map '{first.uv_map}', the maps have '{layer}'; it is "
             "not exported")
        return None
    return with_strength(first.pixels, first.strength)


def with_strength(pixels: F32, strength: float) -> F32:
    """(h, w, 3) of a normal map for Strength 1 that shows what ``pixels`` show at ``strength``, both 0..1.

    As Cycles applies it: x and y times the strength, z nearer to 1 by it (docs/brdf.md).
    """
    if strength == 1:
        return pixels
    normal = pixels * 2 - 1
    normal[..., :2] *= strength
    normal[..., 2] = 1 + (normal[..., 2] - 1) * min(max(strength, 0.0), 1.0)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.asarray(normal / np.maximum(length, 1e-12) * 0.5 + 0.5, np.float32)


def _normal_map(material: bpy.types.Material | None, warn: Warn) -> SlotNormalMap | None:
    principled = None if material is None else find_principled(material)
    return None if principled is None else normal_map_of(material, principled, warn)


def _alike(a: SlotNormalMap, b: SlotNormalMap) -> bool:
    return (a.strength, a.uv_map) == (b.strength, b.uv_map) and np.array_equal(a.pixels, b.pixels)
