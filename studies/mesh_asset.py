"""A mesh file as an asset of studies/intervals: its own shape and UVs, its image as base colour, our roughness."""

from __future__ import annotations

from pathlib import Path

import addon_utils
import bpy
import numpy as np

from irpso_addon.core.data import F64
from irpso_addon.core.errors import BadInput
from irpso_addon.core.images.colour import srgb_to_linear
from studies.intervals.assets import Asset, Paint, Sheet, waves

DARKEST, BRIGHTEST = 0.02, 0.9  # of base colours
UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # Blender's front, -Y, is to face the cameras at +Z


def asset_of(path: Path, image: Path | None, pixels: int) -> Asset:
    """``image``: of base colours; None: that of the mesh's material, else clouds.  Raises BadInput.

    ``pixels``: of the pictures, and texels of the maps, on a side.
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    mesh = _imported(path)
    if not mesh.uv_layers:
        raise BadInput(f"{path}: has no UV map; unwrap the mesh, and export it again")
    mesh.calc_loop_triangles()
    count = len(mesh.loop_triangles)
    vertices, corners, loops, uvs = (np.empty(n, kind) for n, kind in (
        (3 * len(mesh.vertices), np.float32), (3 * count, np.int32), (3 * count, np.int32),
        (2 * len(mesh.loops), np.float32)))
    mesh.vertices.foreach_get("co", vertices)
    mesh.loop_triangles.foreach_get("vertices", corners)
    mesh.loop_triangles.foreach_get("loops", loops)
    mesh.uv_layers.active.data.foreach_get("uv", uvs)
    part = Sheet(vertices.reshape(-1, 3).astype(np.float64) @ UP.T, corners.reshape(-1, 3),
                 uvs.reshape(-1, 2).astype(np.float64)[loops.reshape(-1, 3)], 0)
    return Asset(path.stem, f"the mesh {path.name}", (part,), _paint(_image(path, image)), pixels=pixels,
                 samples=16, texels=pixels)


def _imported(path: Path) -> bpy.types.Mesh:
    """All meshes of a file as one, in Blender's axes."""
    suffix = path.suffix.lower()
    if not path.is_file():
        raise BadInput(f"{path}: is no file; give a mesh with UVs")
    if suffix == ".obj":
        bpy.ops.wm.obj_import(filepath=str(path))
    elif suffix in (".glb", ".gltf"):
        addon_utils.enable("io_scene_gltf2")
        bpy.ops.import_scene.gltf(filepath=str(path))
    else:
        raise BadInput(f"{path}: is of no format that this study reads; export it as .obj, .glb or .gltf")
    found = [obj for obj in bpy.data.objects if obj.type == "MESH"]
    if not found:
        raise BadInput(f"{path}: holds no mesh; export an object with faces")
    with bpy.context.temp_override(active_object=found[0], object=found[0], selected_objects=found,
                                   selected_editable_objects=found):
        if len(found) > 1:
            bpy.ops.object.join()
    mesh = found[0].data
    mesh.transform(found[0].matrix_world)
    return mesh


def _image(path: Path, image: Path | None) -> F64 | None:
    """(h, w, 3) base colours, linear, row 0 at the bottom."""
    if image is not None:
        try:
            shown = bpy.data.images.load(str(image.resolve()))
        except RuntimeError:
            raise BadInput(f"{image}: cannot be read as an image; give the base colours of {path.name}") from None
    else:
        shown = next((each for each in bpy.data.images if each.has_data or each.filepath), None)
    if shown is None or not shown.size[0]:
        return None
    pixels = np.empty(len(shown.pixels), np.float32)
    shown.pixels.foreach_get(pixels)
    values = pixels.reshape(shown.size[1], shown.size[0], -1)[..., :3].astype(np.float64)
    return np.asarray(values if shown.is_float else srgb_to_linear(values), np.float64)


def _paint(image: F64 | None) -> Paint:
    def paint(u: F64, v: F64) -> tuple[F64, F64]:
        if image is None:
            base = np.array([0.5, 0.35, 0.25]) * (1 + 0.2 * waves(u, v, 51, 20))[..., None]
        else:
            height, width = image.shape[:2]
            base = image[np.clip(v * height, 0, height - 1).astype(int), np.clip(u * width, 0, width - 1).astype(int)]
        rough = 0.425 + 0.175 * np.sin(6 * np.pi * u) * np.sin(4 * np.pi * v)
        return np.clip(base, DARKEST, BRIGHTEST), rough
    return paint
