"""How far the float64 BRDF is from Cycles' pixels.

    python -m tests.blender.measure_brdf      prints the tables of docs/brdf.md

A plane under two cameras and three lamps, and a smooth sphere; lamps are points of radius 0, so that one sample
is free of noise.  Red, green and blue carry three base colours at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, product
from typing import Any

import bpy
import numpy as np

from irpso_addon.core.data import Coat
from irpso_addon.core.shading import brdf, lights

from . import cycles_rig as rig

BASES = (0.05, 0.4, 0.95)
ROUGHNESSES = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0)
LEVELS = (0.0, 0.01, 0.2, 0.8, 1.0)  # Specular IOR Level
METALLICS = (0.3, 1.0)
COATS = (Coat(0.3, 0.3), Coat(1.0, 0.6))
Lobes = tuple[float, float, float]  # roughness of the first and second, weight of the first
LOBES: Lobes = (0.2, 0.6, 0.3)
DARK = 1e-6  # of the brightest pixel: below it, where a lobe stands alone, float32 has few digits
BINS = (0, 30, 60, 75, 85)
PEAK = 0.1  # tan theta_h / alpha below which a pixel is on the highlight's very peak


@dataclass(frozen=True)
class Pixels:
    """Of one render, the pixels that are lit and seen: (n,) or (n, 3)."""

    roughness: float
    level: float
    metallic: float
    error: np.ndarray  # (n, 3) |twin / Cycles - 1| for BASES
    degrees: np.ndarray  # (n,) the larger of the angles to the light and to the viewer
    peak: np.ndarray  # (n,) bool


def scenes(pixels: int, few: bool) -> Iterator[np.ndarray]:
    """Sets up the scenes one by one; gives the camera's position."""
    steep, flat = (0, -1.2, 1.0), (0, -3, 0.5)
    setups = [("plane", steep, 80, (0.3, 0.8, 1.0)), ("plane", flat, 40, (-1.5, 1.2, 0.6)),
              ("sphere", (0, -4, 1), 32, (2, -3, 3))]
    if not few:
        setups += [("plane", c, d, p) for c, d in ((steep, 80), (flat, 40)) for p in ((0, -0.6, 2.0), (0.3, 2.8, 0.6))]
    for kind, eye, degrees, lamp in setups:
        rig.scene(pixels)
        rig.principled(rig.plane() if kind == "plane" else rig.sphere(), BASES, 0.5)
        rig.camera(eye, degrees=degrees)
        rig.lamp("POINT", lamp)
        yield np.array(eye)


Model = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]  # L, V, N (n, 3) -> BRDF (n, 3)


def measure(
    pixels: int = 72, few: bool = False, roughnesses: Sequence[float] = ROUGHNESSES, levels: Sequence[float] = (0.5,),
    metallics: Sequence[float] = (0.0,), coat: Coat | None = None,
) -> Iterator[Pixels]:
    """The Principled in every scene at every roughness, Specular IOR Level and Metallic, maybe below a coat."""
    for eye in scenes(pixels, few):
        bsdf = principled_node()
        if coat is not None:
            bsdf.inputs["Coat Weight"].default_value = coat.weight
            bsdf.inputs["Coat Roughness"].default_value = coat.roughness
        for metallic, level, roughness in product(metallics, levels, roughnesses):
            bsdf.inputs["Roughness"].default_value = roughness
            bsdf.inputs["Specular IOR Level"].default_value = level
            bsdf.inputs["Metallic"].default_value = metallic
            twin = partial(brdf.principled, np.array(BASES), np.array(roughness), level=level, metallic=metallic,
                           coat=coat)
            yield compare(eye, roughness, level, twin, metallic)


def measure_two_lobes(
    ndf: str, pixels: int = 72, few: bool = False, lobes: Lobes = LOBES, bases: Sequence[float] = BASES,
) -> Iterator[Pixels]:
    """Both kinds of two lobes in every scene."""
    for eye in scenes(pixels, few):
        tree = bpy.data.materials["material"].node_tree
        output = next(n for n in tree.nodes if n.type == "OUTPUT_MATERIAL")
        make = two_principled if ndf == "ggx" else cook_torrance
        tree.links.new(make(tree, lobes, bases), output.inputs["Surface"])

        def twin(L: np.ndarray, V: np.ndarray, N: np.ndarray) -> np.ndarray:
            return brdf.two_lobe(np.array(bases), lobes, L, V, N, ndf)

        yield compare(eye, lobes[0], 0.5, twin)


def principled_node() -> Any:
    return next(n for n in bpy.data.materials["material"].node_tree.nodes if n.type == "BSDF_PRINCIPLED")


def mixed(tree: Any, weight: float, shaders: list[Any]) -> Any:
    """Socket: the first shader by ``weight``, the second by the rest."""
    mix = tree.nodes.new("ShaderNodeMixShader")
    mix.inputs["Fac"].default_value = 1 - weight
    for node, socket in zip(shaders, mix.inputs[1:], strict=True):
        tree.links.new(node.outputs[0], socket)
    return mix.outputs[0]


def two_principled(tree: Any, lobes: Lobes, bases: Sequence[float]) -> Any:
    """Socket: two Principled."""
    made = [tree.nodes.new("ShaderNodeBsdfPrincipled") for _ in range(2)]
    for node, roughness in zip(made, lobes, strict=False):
        node.inputs["Base Color"].default_value = (*bases, 1)
        node.inputs["Roughness"].default_value = roughness
    return mixed(tree, lobes[2], made)


def cook_torrance(tree: Any, lobes: Lobes, bases: Sequence[float]) -> Any:
    """Socket: a diffuse plus two Beckmann conductors that do not absorb: Fresnel of a dielectric."""
    made = [tree.nodes.new("ShaderNodeBsdfMetallic") for _ in range(2)]
    for node, roughness in zip(made, lobes, strict=False):
        node.distribution, node.fresnel_type = "BECKMANN", "PHYSICAL_CONDUCTOR"
        node.inputs["IOR"].default_value, node.inputs["Extinction"].default_value = (1.5,) * 3, (0.0,) * 3
        node.inputs["Roughness"].default_value = roughness
    diffuse, add = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeAddShader")
    diffuse.inputs["Color"].default_value = (*bases, 1)
    tree.links.new(diffuse.outputs[0], add.inputs[0])
    tree.links.new(mixed(tree, lobes[2], made), add.inputs[1])
    return add.outputs[0]


def conductor_is_exact() -> bool:
    """Blender 4.5's physical conductor uses an approximation that holds for metals only."""
    return bpy.app.version >= (5, 0, 0)


def compare(eye: np.ndarray, roughness: float, level: float, twin: Model, metallic: float = 0.0) -> Pixels:
    """Render the scene and lay the twin's radiance beside Cycles'."""
    light = rig.as_light(bpy.data.objects["lamp"])
    image = rig.render()
    P, N, rgb = image["position"], image["normal"], image["rgb"]
    seen = np.linalg.norm(N, axis=-1) > 0.5
    P, N, rgb = P[seen], N[seen] / np.linalg.norm(N[seen], axis=-1, keepdims=True), rgb[seen]
    L, V = lights.light_sample(light, P, 0, 1)[0], eye - P
    L, V = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (L, V))
    cos_l, cos_v = (L * N).sum(-1), (V * N).sum(-1)
    lit = (cos_l > 0.03) & (cos_v > 0.03) & (rgb.min(-1) > DARK * rgb.max())
    irradiance = lights.light_irradiance(light, P, N)[:, None] * light.power
    radiance = twin(L, V, N) * irradiance
    half = (L + V) / np.linalg.norm(L + V, axis=-1, keepdims=True)
    sin2h = (np.cross(N, half) ** 2).sum(-1)
    return Pixels(
        roughness, level, metallic, np.abs(radiance[lit] / rgb[lit] - 1),
        np.degrees(np.arccos(np.minimum(cos_l, cos_v)[lit])), np.sqrt(sin2h / (1 - sin2h))[lit] < PEAK * roughness**2,
    )


def row(name: object, parts: list[Pixels]) -> None:
    """Print max % (mean %) by angle, pixels on the peak left out and told apart."""
    error, degrees, peak = (np.concatenate([getattr(p, k) for p in parts]) for k in ("error", "degrees", "peak"))
    masks = [(degrees >= a) & (degrees < b) & ~peak for a, b in pairwise(BINS)] + [peak]
    cells = [f"{100 * error[m].max():.4f} ({100 * error[m].mean():.4f})" if m.any() else "-" for m in masks]
    print(f"| {name} | " + " | ".join(cells) + " |")


def head(name: str) -> None:
    print(f"| {name} | " + " | ".join(f"{a}-{b} deg" for a, b in pairwise(BINS)) + " | peak |")
    print("|---" * (len(BINS) + 1) + "|")


def main() -> None:
    """Print the tables."""
    print(f"Blender {bpy.app.version_string}; error in % of radiance, max (mean); base colours {BASES}")
    found = list(measure())
    head("roughness")
    for roughness in ROUGHNESSES:
        row(roughness, [p for p in found if p.roughness == roughness])
    found = list(measure(levels=LEVELS, roughnesses=(0.2, 0.4, 0.8)))
    head("level")
    for level in LEVELS:
        row(level, [p for p in found if p.level == level])
    found = list(measure(metallics=METALLICS))
    for metallic in METALLICS:
        head(f"roughness, Metallic {metallic:g}")
        for roughness in ROUGHNESSES:
            row(roughness, [p for p in found if (p.metallic, p.roughness) == (metallic, roughness)])
    head(f"two lobes {LOBES}")
    for ndf in ["ggx"] + ["beckmann"] * conductor_is_exact():
        row(ndf, list(measure_two_lobes(ndf)))
    head("Metallic BSDF as one Beckmann lobe, roughness")
    for roughness in (0.2, 0.5, 0.8):
        row(roughness, list(measure_two_lobes("beckmann", lobes=(roughness, roughness, 0.5), bases=(0, 0, 0))))


if __name__ == "__main__":
    main()
