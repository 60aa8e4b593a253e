"""What each target of an export takes: its files, their channels, names and encodings.  One frozen table, `TARGETS`.

The packings and conventions are those of the programs' own manuals: glTF 2.0 (Khronos 2021) with
KHR_materials_specular; Unreal Engine's and Unity's import of textures; Adobe's metallic/roughness workflow; MaterialX
1.39 with OpenPBR Surface 1.1.  All of them have roughness as the Principled BSDF has it (alpha = roughness^2), and F0 =
0.08 times the Specular IOR Level where they have one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from ..data import F32

IRPSO = "irpso"  # the target whose files core/maps/export.py writes
BASE = ("base red", "base green", "base blue")
ORM = ("occlusion", "roughness", "metallic")
OPENGL = ("normal x", "normal y", "normal z")
DIRECTX = ("normal x", "normal -y", "normal z")
LEVEL, WEIGHT = "Specular IOR Level", "specular weight"
DIELECTRIC = 0.5  # Specular IOR Level that every target shows by itself: 4 % at normal incidence

# When a file is written that is not always there.
WHEN = {
    "": "always",
    "level": "where the Specular IOR Level is not 0.5 everywhere",
    "level map": "where the Specular IOR Level is not one value",
    "metallic map": "where Metallic is not one value",
    "normal": "where the material has a normal map",
}


@dataclass(frozen=True)
class TargetFile:
    """One file."""

    name: str  # without its ending .png; {} stands for the object's name
    channels: tuple[str, ...]  # what each of them holds
    kind: str = "png8"  # of core/images/image_writer.py; "png": 16 bits
    when: str = ""  # a key of `WHEN`

    @property
    def srgb(self) -> bool:
        """Whether the values are sRGB-encoded.  Everything but base colour is stored as it is."""
        return self.channels == BASE

    @property
    def bits(self) -> int:
        """Of a channel."""
        return 8 if self.kind == "png8" else 16

    @property
    def words(self) -> str:
        """What the channels hold, for a person."""
        if self.channels in (BASE, OPENGL, DIRECTX):
            return {BASE: "RGB base colour", OPENGL: "RGB normal, OpenGL (green up)",
                    DIRECTX: "RGB normal, DirectX (green down)"}[self.channels]
        if len(self.channels) == 1:
            return f"grey {self.channels[0]}"
        return ", ".join(f"{letter} {word}" for letter, word in zip("RGBA", self.channels, strict=False))


@dataclass(frozen=True)
class Target:
    """All that is particular to one."""

    program: str
    files: tuple[TargetFile, ...]
    udims: bool = True  # whether it knows UDIMs
    level: bool = True  # whether it can show a Specular IOR Level other than 0.5
    document: str = ""  # ending of a file that names the others or holds them

    def written(self, metallic: float | None, level: float | None, normal: bool) -> Iterator[TargetFile]:
        """The files that are written; None: a value differs from texel to texel."""
        there = {"": True, "level": level != DIELECTRIC, "level map": level is None, "metallic map": metallic is None,
                 "normal": normal}
        return (file for file in self.files if there[file.when])


# 16 bits where the program keeps them.  Engines and glTF's viewers compress textures to 8 bits or less, and Unreal
# decodes no sRGB of 16.
TARGETS: dict[str, Target] = {
    "blender": Target("Blender", (
        TargetFile("{}_BaseColor", BASE, "png"),
        TargetFile("{}_Roughness", ("roughness",), "png"),
        TargetFile("{}_Metallic", ("metallic",), "png"),
        TargetFile("{}_Specular", (LEVEL,), "png", "level"),
        TargetFile("{}_Normal", OPENGL, "png", "normal"),
    )),
    "gltf": Target("glTF", (
        TargetFile("{}_baseColor", BASE),
        TargetFile("{}_occlusionRoughnessMetallic", ORM),
        TargetFile("{}_specularWeight", ("white", "white", "white", WEIGHT), when="level map"),
        TargetFile("{}_normal", OPENGL, when="normal"),
    ), udims=False, document="glb"),
    "unreal": Target("Unreal Engine", (
        TargetFile("T_{}_BC", BASE),
        TargetFile("T_{}_ORM", ORM),
        TargetFile("T_{}_S", (LEVEL,), when="level"),
        TargetFile("T_{}_N", DIRECTX, when="normal"),
    )),
    "unity": Target("Unity", (
        TargetFile("{}_BaseMap", BASE),
        TargetFile("{}_MaskMap", ("metallic", "occlusion", "detail", "smoothness")),
        TargetFile("{}_NormalMap", OPENGL, when="normal"),
    ), udims=False, level=False),
    "substance": Target("Substance 3D", (
        TargetFile("{}_BaseColor", BASE, "png"),
        TargetFile("{}_Roughness", ("roughness",), "png"),
        TargetFile("{}_Metallic", ("metallic",), "png"),
        TargetFile("{}_SpecularLevel", (LEVEL,), "png", "level"),
        TargetFile("{}_Normal", DIRECTX, "png", "normal"),
    )),
    "materialx": Target("MaterialX", (
        TargetFile("{}_base_color", BASE, "png"),
        TargetFile("{}_specular_roughness", ("roughness",), "png"),
        TargetFile("{}_base_metalness", ("metallic",), "png", "metallic map"),
        TargetFile("{}_specular_level", (LEVEL,), "png", "level map"),
        TargetFile("{}_geometry_normal", OPENGL, "png", "normal"),
    ), document="mtlx"),
}


def one_roughness(stored: F32) -> F32:
    """(h, w) of a roughness map that is grey or (h, w, 3) as (roughness1, roughness2, weight of lobe 1).

    Two lobes become the mean weighted by their energy: what microfacets lose is given back (docs/brdf.md), so a lobe's
    share of the reflected light is its weight, whatever its roughness.  Three equal channels stay what they are.
    """
    if stored.ndim == 2:
        return stored
    first, second, weight = (stored[..., i] for i in range(3))
    return np.asarray(second + weight * (first - second), np.float32)


def pack(file: TargetFile, layers: Mapping[str, F32], metallic: F32, level: F32, scale: float = 1.0) -> F32:
    """(h, w, channels) of what ``file`` holds of texels, linear, 0..1, row 0 at the bottom.

    layers: as `export.layers` names them.  metallic, level: (h, w).  ``scale``: what the weights are divided by.
    """
    if file.when == "normal":
        return pack_normals(file, layers["normal"])
    base, roughness = layers["basecolor"], one_roughness(layers["roughness"])
    found = {
        **dict(zip(BASE, np.moveaxis(base, -1, 0), strict=True)), "roughness": roughness, "smoothness": 1 - roughness,
        "metallic": metallic, LEVEL: level, WEIGHT: 2 * level / scale,
        "occlusion": np.ones_like(roughness), "white": np.ones_like(roughness), "detail": np.zeros_like(roughness),
    }
    return np.stack([found[channel] for channel in file.channels], axis=-1).astype(np.float32)


def pack_normals(file: TargetFile, normals: F32) -> F32:
    """(h, w, 3) of a tangent-space normal map (h, w, 3), 0..1 and green up, in the convention of ``file``."""
    down = np.array([1, -1, 1], np.float32), np.array([0, 1, 0], np.float32)
    return normals if file.channels == OPENGL else np.asarray(normals * down[0] + down[1], np.float32)


def table() -> list[tuple[str, str, str, str, str, str]]:
    """Rows for a page: target, file, channels, bits, colour space, when."""
    rows = []
    for key, target in TARGETS.items():
        for file in target.files:
            name = file.name.replace("{}", "NAME")
            rows.append((f"`{key}`", f"`{name}.png`", file.words, str(file.bits), "sRGB" if file.srgb else "linear",
                         WHEN[file.when]))
        if target.document:
            what = {"glb": "mesh, material and the images above in one file", "mtlx": "the material, with the names of "
                    "the images above"}[target.document]
            rows.append((f"`{key}`", f"`NAME.{target.document}`", what, "", "", WHEN[""]))
    return rows
