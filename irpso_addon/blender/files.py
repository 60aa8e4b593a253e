""".blend files for the command line: open one, say which Blender this is, save a solved copy, read its maps."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np

from ..core.data import F32, Maps
from ..core.errors import BadInput
from ..core.images.image_file import open_image
from ..core.maps.export import share_files
from ..core.maps.map_set import MapFiles
from ..core.storage.text_file import first_bytes
from ..core.tiled.uv_blocks import FIRST_UDIM, ONE_PIECE
from . import properties
from .material.material import SUFFIXES, layers_of
from .material.tags import maps_of

MEASURED = "LIGHT", "CAMERA"  # types of objects that a solve may change
PICTURES = ("image", "mask", "ambient", "flat")  # of a view
SHOWN = ("base_color", "roughness", "specular", "metallic", "normal")  # roles of maps that materials show
# A .blend starts so when plain, gzip (before 3.0) or Zstandard.
MAGIC = (b"BLENDER", b"\x1f\x8b", b"\x28\xb5\x2f\xfd")


def blender_version() -> str:
    """As Blender prints it, with the release cycle."""
    return bpy.app.version_string


def open_blend(path: Path) -> None:
    """Open a .blend in place of what is open.  Raises BadInput when there is none or it cannot be read."""
    if not first_bytes(path, 7).startswith(MAGIC):
        raise BadInput(f"{path}: is not a .blend file; save the scene from Blender and choose that file")
    if not hasattr(bpy.types.Scene, "irpso"):  # in the bpy module nobody has registered the scene's view list
        properties.register()
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False)
    except RuntimeError as error:
        raise BadInput(f"{path}: Blender cannot read it ({one_line(error)}); save it again from Blender") from None


def new_blend() -> None:
    """An empty scene in place of what is open."""
    if not hasattr(bpy.types.Scene, "irpso"):  # as in `open_blend`
        properties.register()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


def save_copy(path: Path) -> None:
    """Save what is open as another file; the open one stays what it was.  Raises BadInput."""
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(path.resolve()), copy=True, compress=True)
    except RuntimeError as error:
        raise BadInput(f"{path.parent}: Blender cannot save there ({one_line(error)}); choose another folder") from None


def relative_path(path: Path, folder: Path) -> str:
    """As a .blend in ``folder`` keeps a path."""
    try:
        return "//" + os.path.relpath(path.resolve(), folder).replace("\\", "/")
    except ValueError:  # on another drive
        return str(path.resolve())


def keep_pictures(folder: Path) -> None:
    """Makes the relative paths of the open scene's views lead to the same files from a .blend in ``folder``."""
    scene = bpy.context.scene.irpso
    for group, names in ((scene, ("captures",)), *((view, PICTURES) for view in scene.views)):
        for name in names:
            if getattr(group, name).startswith("//"):
                setattr(group, name, relative_path(Path(bpy.path.abspath(getattr(group, name))), folder))


def keep(names: Sequence[str]) -> None:
    """Marks lamps and cameras as measured, which a solve leaves as they are given.  Raises BadInput."""
    for name in names:
        obj = bpy.data.objects.get(name)
        if obj is None or obj.type not in MEASURED:
            there = [other for other in bpy.data.objects if other.type in MEASURED]
            raise BadInput(f"'{name}': is not a lamp or camera of this file; there are: {_names(there)}")
        obj.irpso_keep = True


def object_named(name: str) -> bpy.types.Object:
    """The object of that name in the open file."""
    return bpy.data.objects[name]


def require_own_files(obj: bpy.types.Object) -> None:
    """Raises BadInput where files of ``obj`` could be those of another mesh of this file."""
    for other in bpy.data.objects:
        if other.type == "MESH" and other.library is None and other != obj and share_files(obj.name, other.name):
            raise BadInput(f"objects '{obj.name}' and '{other.name}': their files would overwrite each other on some "
                           "systems; rename one of them")


def solved_object(name: str | None) -> bpy.types.Object:
    """The object called ``name``, or the only one that carries maps.  Raises BadInput."""
    solved = [obj for obj in bpy.data.objects if maps_of(obj)]
    if name is not None:
        if name not in bpy.data.objects:
            raise BadInput(f"object '{name}': is not in this file; it has maps on {_names(solved)}")
        if bpy.data.objects[name] not in solved:
            raise BadInput(f"object '{name}': has no maps; run 'irpso solve' first")
        return bpy.data.objects[name]
    if len(solved) != 1:
        raise BadInput(f"{bpy.data.filepath}: has maps on {_names(solved)}; " + (
            "say which with --object" if solved else "run 'irpso solve' first"))
    return solved[0]


def read_maps(obj: bpy.types.Object) -> Maps:
    """The maps that a solve left in the file.  A texel without confidence counts as filled.  Raises BadInput."""
    optional = {role for role in ("specular", "metallic", "normal") if role in maps_of(obj)}
    pixels = {role: _pixels(obj, role) for role in (
        "base_color", "roughness", "confidence", "error", "roughness_sigma", "basecolor_sigma", *sorted(optional))}
    _require_one_size(obj, pixels)
    base, roughness, confidence, error, roughness_sigma, base_sigma, *_ = pixels.values()
    grey = np.array_equal(roughness[..., 0], roughness[..., 2])  # one lobe beside two has weight 1 in blue
    filled = confidence[..., 0] <= 0
    return Maps(
        base_color=base, roughness=roughness[..., 0].copy(), confidence=confidence[..., 0].copy(),
        error=error[..., 0].copy(), filled=filled, coverage=~filled, roughness_sigma=roughness_sigma[..., 0].copy(),
        base_sigma=base_sigma[..., 0].copy(), lobes=None if grey else roughness,
        specular=pixels["specular"][..., 0].copy() if "specular" in optional else None,
        metallic=pixels["metallic"][..., 0].copy() if "metallic" in optional else None,
        normal=pixels.get("normal"))


def painted(obj: bpy.types.Object, maps: Maps) -> Maps:
    """``maps``, which are on the materials of ``obj``, with what was painted on their images since.

    Once one was scaled, the images count alone; raises BadInput where they then differ in size.
    """
    images, found = maps_of(obj), {}
    for role, array in layers_of(maps).items():
        image = images.get(role)
        if image is None or not image.has_data:
            continue
        if tuple(image.size) != array.shape[1::-1]:
            return read_maps(obj)
        if role in SHOWN:
            pixels = _pixels(obj, role)
            found["lobes" if array is maps.lobes else role] = pixels if array.ndim == 3 else pixels[..., 0].copy()
    return replace(maps, **found)


def map_files(obj: bpy.types.Object) -> MapFiles | None:
    """The files that a large solve left for the object; None: its maps are in the .blend, or small."""
    images = maps_of(obj)
    kept = any(image.source not in ("FILE", "TILED") or image.packed_file for image in images.values())
    if kept or "base_color" not in images:
        return None
    paths = {SUFFIXES.get(role, role): Path(bpy.path.abspath(image.filepath)) for role, image in images.items()}
    base = paths["basecolor"]
    filled = base.with_name("_filled".join(base.name.rsplit("_basecolor", 1)))  # has no image
    udims = tuple(tile.number for tile in images["base_color"].tiles) or (FIRST_UDIM,)
    files = MapFiles({**paths, "filled": filled}, udims)
    files = files if all(files.of("filled", udim).exists() for udim in udims) else MapFiles(paths, udims)
    return files if files.tiled or open_image(files.of("basecolor", FIRST_UDIM)).width > ONE_PIECE else None


def _require_one_size(obj: bpy.types.Object, pixels: Mapping[str, F32]) -> None:
    """Raises BadInput for maps of several sizes, or that are not square, as after scaling or cropping their images."""
    size = max(array.shape[0] for array in pixels.values())
    for role, array in pixels.items():
        if array.shape[:2] != (size, size):
            height, width = array.shape[:2]
            raise BadInput(f"object '{obj.name}': its {role} map has {width} x {height} texels, not {size} x {size} as "
                           "another one; scale the images to one size, or solve again")


def _pixels(obj: bpy.types.Object, role: str) -> F32:
    """One of the object's maps, (h, w, 3), row 0 at the bottom.  Raises BadInput."""
    image = maps_of(obj).get(role)
    if image is None:
        raise BadInput(f"object '{obj.name}': its {role} map is gone; run 'irpso solve' again")
    if not image.has_data and not image.size[0]:
        raise BadInput(f"object '{obj.name}': its {role} map cannot be read from {bpy.path.abspath(image.filepath)}; "
                       "put the file back, or solve again")
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(height, width, 4)[..., :3].copy()


def one_line(error: Exception) -> str:
    """Blender's reports as one line, without its 'Error: '."""
    return "; ".join(line.removeprefix("Error: ").strip() for line in str(error).splitlines() if line.strip())


def _names(objects: list[bpy.types.Object]) -> str:
    return ", ".join(f"'{obj.name}'" for obj in objects) or "no object"
