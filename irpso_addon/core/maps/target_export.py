"""Maps to the files that a target takes (`targets.TARGETS`), all of them or none, row of blocks by row of blocks."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

import numpy as np

from ..cpu_solver.rasterise import rasterise
from ..data import F32, I32, MeshArrays
from ..errors import BadInput
from ..images.image_writer import ImageWriter, write_image
from ..storage.output_transaction import OutputTransaction
from ..tiled.uv_blocks import UvBlock
from .export import safe_stem
from .gltf_file import glb
from .map_set import MapReader
from .materialx_document import materialx
from .targets import DIELECTRIC, TARGETS, WEIGHT, Target, TargetFile, pack, pack_normals

LAYERS = ("basecolor", "roughness", "specular", "metallic", "normal")  # that targets take; the last three if there


@dataclass(frozen=True)
class Surface:
    """What a material says beside the maps."""

    name: str = ""
    metallic: float | None = 0.0  # None: the map's
    level: float | None = DIELECTRIC  # Specular IOR Level; None: the map's
    lobes: str = ""  # "ggx" or "beckmann" where it has two
    coat: float = 0.0  # weight
    diffuse_roughness: float = 0.0
    coat_roughness: float = 0.0


@dataclass(frozen=True)
class ExportObject:
    """What goes out."""

    name: str
    mesh: MeshArrays
    surfaces: Sequence[Surface]  # of each slot of the mesh
    # (h, w, 3) tangent-space normal map, 0..1, green up, row 0 at the bottom, where the maps have none
    normal: F32 | None = None
    used: tuple[int, ...] = field(init=False)  # slots that have faces

    def __post_init__(self) -> None:
        object.__setattr__(self, "used", tuple(int(slot) for slot in np.unique(self.mesh.slots)))

    @property
    def shown(self) -> list[Surface]:
        """The materials that have faces."""
        return [self.surfaces[slot] for slot in self.used]

    @property
    def metallic(self) -> float | None:
        """Of all materials; None: it differs from material to material or from texel to texel."""
        return _same([surface.metallic for surface in self.shown])

    @property
    def level(self) -> float | None:
        """Specular IOR Level of all materials; None: it differs from material to material or from texel to texel."""
        return _same([surface.level for surface in self.shown])

    @property
    def coat(self) -> tuple[float, float] | None:
        """Weight and roughness of all materials; None: they differ from material to material."""
        found = {(surface.coat, surface.coat_roughness if surface.coat else 0.0) for surface in self.shown}
        return found.pop() if len(found) == 1 else None

    @property
    def diffuse_roughness(self) -> float | None:
        """Of all materials; None: it differs from material to material."""
        return _same([surface.diffuse_roughness for surface in self.shown])


def write_target(obj: ExportObject, maps: MapReader, target: str, out: Path) -> list[Path]:
    """Writes the files of the target of that name into the folder ``out`` (made if missing); returns their paths.

    Raises BadInput for UDIMs where the target knows none, and when ``out`` cannot be written; older files keep their
    contents then.
    """
    chosen = TARGETS[target]
    if maps.tiled and not chosen.udims:
        raise BadInput(f"{obj.name}: its maps are of several UDIM squares, which {chosen.program} does not know; "
                       "choose another target, or lay its UVs out in one square")
    with OutputTransaction(Path(out)) as staging:
        names = _write_all(obj, maps, chosen, staging.folder)
        for path in maps.paths:
            for name in names:
                if (staging.out / name).exists() and path.samefile(staging.out / name):
                    raise BadInput(f"{path}: is a source map that the export would overwrite; choose another folder")
        staging.publish()
        return [staging.out / name for name in names]


def earlier_files(obj: ExportObject, target: str, written: Sequence[Path]) -> list[str]:
    """Names of the object's files for that target that lie in the folder of those ``written``, and are not theirs."""
    names = "|".join(re.escape(file.name.replace("{}", safe_stem(obj.name))) for file in TARGETS[target].files)
    name = re.compile(rf"({names})(\.\d{{4}})?\.png")
    return sorted(path.name for path in written[0].parent.iterdir()
                  if name.fullmatch(path.name) and path not in written)


def losses(obj: ExportObject, target: str) -> list[str]:
    """What the target cannot show, one line each."""
    chosen, lines = TARGETS[target], []
    for surface in obj.shown:
        if surface.lobes:
            lines.append(f"material '{surface.name}': {chosen.program} has one roughness; the two become their mean, "
                         "weighted by energy" + (", and Beckmann becomes GGX" if surface.lobes == "beckmann" else ""))
        if surface.coat and (not chosen.document or obj.coat is None):
            lines.append(f"material '{surface.name}': its files for {chosen.program} have no coat; the coat of weight "
                         f"{surface.coat:.3g} is lost")
        if surface.diffuse_roughness and (chosen.document != "mtlx" or obj.diffuse_roughness is None):
            lines.append(f"material '{surface.name}': its files for {chosen.program} have no Diffuse Roughness; "
                         f"{surface.diffuse_roughness:.3g} is lost")
        if not chosen.level and surface.level != DIELECTRIC:
            level = "its map" if surface.level is None else f"{surface.level:.3g}"
            lines.append(f"material '{surface.name}': {chosen.program} has no Specular IOR Level; {level} is lost, and "
                         f"{DIELECTRIC} is shown")
    return list(dict.fromkeys(lines))  # a material may be in several slots


def _same(values: Sequence[float | None]) -> float | None:
    """The one value that all have."""
    return values[0] if len(set(values)) == 1 else None


def _write_all(obj: ExportObject, maps: MapReader, target: Target, folder: Path) -> list[str]:
    """Every file of the set; their names."""
    files = list(target.written(obj.metallic, obj.level, obj.normal is not None or "normal" in maps.layers))
    packed = [file for file in files if _of_texels(file, maps)]
    scale = 1.0
    if any(WEIGHT in file.channels for file in packed):
        scale = max(1.0, *(2 * float(values.level.max()) for values in _values(obj, maps)))
    names = _write_images(obj, maps, packed, folder, scale)
    for file in files:
        if file not in packed:
            assert obj.normal is not None
            names.append(_file_name(obj, file))
            write_image(folder / names[-1], pack_normals(file, obj.normal), kind=file.kind, color=False)
    if target.document:
        images = {file.name: _file_name(obj, file, maps.tiled and file in packed) for file in files}
        names.append(f"{safe_stem(obj.name)}.{target.document}")
        path, coat = folder / names[-1], obj.coat or (0.0, 0.0)
        if target.document == "mtlx":
            path.write_bytes(materialx(obj.name, images, obj.metallic, obj.level, obj.diffuse_roughness or 0.0, coat))
        else:
            files_by_name = {key: folder / name for key, name in images.items()}
            path.write_bytes(glb(obj.mesh, files_by_name, obj.level, scale, coat))
    return names


def _of_texels(file: TargetFile, maps: MapReader) -> bool:
    """Whether a file is made of the maps' texels: all but a normal map that is the material's alone."""
    return file.when != "normal" or "normal" in maps.layers


def _file_name(obj: ExportObject, file: TargetFile, tiled: bool = False, udim: int | None = None) -> str:
    """Of one file; with ``tiled`` but no UDIM: of all of them."""
    tile = f".{udim}" if udim is not None else ".<UDIM>" if tiled else ""
    return f"{file.name.replace('{}', safe_stem(obj.name))}{tile}.png"


# ---- texels


@dataclass(frozen=True)
class _Values:
    """Of a block."""

    window: UvBlock
    layers: Mapping[str, F32]
    metallic: F32  # (h, w)
    level: F32  # (h, w)


def _values(obj: ExportObject, maps: MapReader) -> Iterator[_Values]:
    """Blocks as files are written: the top first."""
    constant = all(len({getattr(surface, name) for surface in obj.shown}) == 1 for name in ("metallic", "level"))
    metallic, level = (np.array([np.nan if value is None else value for value in values], np.float32) for values in (
        [surface.metallic for surface in obj.surfaces], [surface.level for surface in obj.surfaces]))
    for window in sorted(maps.windows, key=lambda w: (w.udim, -w.y, w.x)):
        layers = maps.read(window.key)
        slots = np.full(window.shape, obj.used[0]) if constant else slots_of_texels(obj.mesh, window)
        found = [np.where(np.isnan(of[slots]), layers.get(layer, np.full(window.shape, other, np.float32)), of[slots])
                 for of, layer, other in ((metallic, "metallic", 0.0), (level, "specular", DIELECTRIC))]
        yield _Values(window, layers, *found)


def _write_images(
    obj: ExportObject, maps: MapReader, files: Sequence[TargetFile], folder: Path, scale: float,
) -> list[str]:
    """The files that are made of texels; their names, those of one UDIM after those of another."""
    names: list[str] = []
    for udim, blocks in groupby(_values(obj, maps), key=lambda values: values.window.udim):
        with ExitStack() as open_files:
            writers: list[ImageWriter] = []
            for _, row in groupby(blocks, key=lambda values: values.window.y):
                values = list(row)
                if not writers:
                    size, first = values[0].window.size, len(names)
                    names += [_file_name(obj, file, udim=udim if maps.tiled else None) for file in files]
                    writers = [open_files.enter_context(ImageWriter(
                        folder / name, size, size, len(file.channels), kind=file.kind, color=file.srgb))
                        for name, file in zip(names[first:], files, strict=True)]
                for writer, file in zip(writers, files, strict=True):
                    writer.add(np.concatenate(
                        [pack(file, v.layers, v.metallic, v.level, scale) for v in values], axis=1))
    return names


def slots_of_texels(mesh: MeshArrays, window: UvBlock) -> I32:
    """(h, w) material slot of each texel of a block; outside the islands the nearest island's, near by."""
    owner, _ = rasterise(window.grid(mesh.uvs), window.side)
    slots = np.where(owner >= 0, mesh.slots[owner], -1)
    for _ in range(window.halo):  # what pads the seams
        around = np.pad(slots, 1, constant_values=-1)
        for y, x in ((0, 1), (2, 1), (1, 0), (1, 2)):
            near = around[y:y + window.side, x:x + window.side]
            slots = np.where(slots < 0, near, slots)
    slots = np.where(slots < 0, mesh.slots.min(), slots)
    return np.asarray(slots[window.core], np.int32)
