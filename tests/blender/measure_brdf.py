"""How far the float64 BRDF is from Cycles' pixels.

    python -m tests.blender.measure_brdf      prints the table of docs/brdf.md

A plane under two cameras and three lamps, and a smooth sphere; lamps are points of radius 0, so that one sample
is free of noise.  Red, green and blue carry three base colours at once.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import bpy
import numpy as np

from irpso_addon.core import brdf, lights
from irpso_addon.core.data import Light

from . import cycles_rig as rig

BASES = (0.05, 0.4, 0.95)
ROUGHNESSES = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0)
BINS = (0, 30, 60, 75, 85)
PEAK = 0.1  # tan theta_h / alpha below which a pixel is on the highlight's very peak


@dataclass(frozen=True)
class Pixels:
    """Of one render, the pixels that are lit and seen: (n,) or (n, 3)."""

    roughness: float
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


def measure(pixels: int = 72, few: bool = False) -> Iterator[Pixels]:
    """Every scene at every roughness."""
    for eye in scenes(pixels, few):
        light = rig.as_light(bpy.data.objects["lamp"])
        nodes = bpy.data.materials["material"].node_tree.nodes
        bsdf = next(n for n in nodes if n.type == "BSDF_PRINCIPLED")
        for roughness in ROUGHNESSES:
            bsdf.inputs["Roughness"].default_value = roughness
            image = rig.render()
            P, N = image["position"], image["normal"]
            seen = np.linalg.norm(N, axis=-1) > 0.5
            N = N[seen] / np.linalg.norm(N[seen], axis=-1, keepdims=True)
            yield compare(light, eye, roughness, P[seen], N, image["rgb"][seen])


def compare(
    light: Light, eye: np.ndarray, roughness: float, P: np.ndarray, N: np.ndarray, rgb: np.ndarray,
) -> Pixels:
    """The twin's radiance beside Cycles', of pixels that see P with normal N (n, 3)."""
    L, V = lights.light_sample(light, P, 0, 1)[0], eye - P
    L, V = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (L, V))
    cos_l, cos_v = (L * N).sum(-1), (V * N).sum(-1)
    lit = (cos_l > 0.03) & (cos_v > 0.03)
    irradiance = lights.light_irradiance(light, P, N)[:, None] * light.power
    twin = brdf.principled(np.array(BASES), np.array(roughness), L, V, N) * irradiance
    half = (L + V) / np.linalg.norm(L + V, axis=-1, keepdims=True)
    sin2h = (np.cross(N, half) ** 2).sum(-1)
    return Pixels(
        roughness, np.abs(twin[lit] / rgb[lit] - 1), np.degrees(np.arccos(np.minimum(cos_l, cos_v)[lit])),
        np.sqrt(sin2h / (1 - sin2h))[lit] < PEAK * roughness**2,
    )


def main() -> None:
    """Print max % (mean %) per roughness and angle, pixels on the peak left out and told apart."""
    found = list(measure())
    print(f"Blender {bpy.app.version_string}; error in % of radiance, max (mean); base colours {BASES}")
    print("| roughness | " + " | ".join(f"{a}-{b} deg" for a, b in pairwise(BINS)) + " | peak |")
    print("|---" * (len(BINS) + 1) + "|")
    for roughness in ROUGHNESSES:
        parts = [p for p in found if p.roughness == roughness]
        error, degrees, peak = (np.concatenate([getattr(p, k) for p in parts]) for k in ("error", "degrees", "peak"))
        masks = [(degrees >= a) & (degrees < b) & ~peak for a, b in pairwise(BINS)] + [peak]
        cells = [f"{100 * error[m].max():.4f} ({100 * error[m].mean():.4f})" if m.any() else "-" for m in masks]
        print(f"| {roughness} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
