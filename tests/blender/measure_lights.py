"""How far the float64 lamps are from Cycles' pixels.

    python -m tests.blender.measure_lights    prints the table of docs/brdf.md

A white Lambertian plane under each kind of lamp, turned and unevenly scaled.  Lamps with a size are rendered with
SAMPLES samples, whose noise is most of the error of single pixels; the signed mean tells the model's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from irpso_addon.core.shading import lights

from . import cycles_rig as rig

SAMPLES = 256
PIXELS = 40
ABOVE = {"position": (0.5, -0.6, 1.4), "target": (0.1, 0.1, 0), "scale": (1.4, 0.8, 1.2)}
CUT = {"position": (1.2, 0.0, 0.2), "target": (0, 0, 0.2)}  # the plane hides the emitter's lower part
CONE = {"spot_size": 1.0, "spot_blend": 0.4}
AREA = {"shape": "RECTANGLE", "size": 0.9, "size_y": 0.4}

CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "POINT": ("POINT", ABOVE),
    "POINT, radius 0.2 m, soft falloff": ("POINT", ABOVE | {"shadow_soft_size": 0.2, "use_soft_falloff": True}),
    "POINT, radius 0.2 m, sphere": ("POINT", ABOVE | {"shadow_soft_size": 0.2, "use_soft_falloff": False}),
    "SUN": ("SUN", ABOVE | {"angle": 0.0, "energy": 3.0}),
    "SUN, 40 deg wide": ("SUN", ABOVE | {"angle": np.radians(40), "energy": 3.0}),
    "SUN, 40 deg wide, half set": ("SUN", {"position": (1, 0.3, 0.1), "angle": np.radians(40), "energy": 3.0}),
    "SPOT": ("SPOT", ABOVE | CONE),
    "SPOT, hard rim": ("SPOT", ABOVE | {"spot_size": 0.9, "spot_blend": 0.0}),
    "SPOT, radius 0.1 m": ("SPOT", ABOVE | CONE | {"shadow_soft_size": 0.1, "use_soft_falloff": True}),
    "SPOT, radius 0.1 m, sphere": ("SPOT", ABOVE | CONE | {"shadow_soft_size": 0.1, "use_soft_falloff": False}),
    "AREA, square": ("AREA", ABOVE | {"shape": "SQUARE", "size": 0.5}),
    "AREA, rectangle": ("AREA", ABOVE | AREA),
    "AREA, rectangle cut by the horizon": ("AREA", CUT | AREA | {"size": 0.5, "size_y": 0.8}),
    "AREA, disk": ("AREA", ABOVE | {"shape": "DISK", "size": 0.6}),
    "AREA, ellipse": ("AREA", ABOVE | AREA | {"shape": "ELLIPSE"}),
    "AREA, rectangle, spread 120 deg": ("AREA", ABOVE | AREA | {"spread": np.radians(120)}),
    "AREA, rectangle, spread 90 deg": ("AREA", ABOVE | AREA | {"spread": np.radians(90)}),
    "AREA, ellipse, spread 90 deg": ("AREA", ABOVE | AREA | {"shape": "ELLIPSE", "spread": np.radians(90)}),
    "AREA, rectangle, spread 40 deg": ("AREA", ABOVE | AREA | {"spread": np.radians(40)}),
}


@dataclass(frozen=True)
class Errors:
    """Of the lit pixels, relative: the largest, the mean size, the signed mean of the whole plane's light."""

    largest: float
    mean: float
    bias: float


def noisy(name: str) -> bool:
    """Does the lamp have a size, so that Cycles samples it?"""
    kind, settings = CASES[name]
    return kind == "AREA" or settings.get("shadow_soft_size", 0) > 0 or settings.get("angle", 0) > 0


def measure(name: str) -> Errors:
    """Render one case and compare.  Lit: more than 2 % of the brightest pixel, where rims and noise do not rule."""
    kind, settings = CASES[name]
    rig.scene(PIXELS, SAMPLES if noisy(name) else 1)
    rig.principled(rig.plane(), (1, 1, 1), 0.5, specular=0.0)
    rig.camera((0, -1.6, 1.6), degrees=55)
    light = rig.as_light(rig.lamp(kind, **settings))
    image = rig.render()
    truth = image["rgb"][..., 0] * np.pi
    twin = lights.light_irradiance(light, image["position"], [0.0, 0, 1]) * light.power[0]
    lit = truth > 0.02 * truth.max()
    error = np.abs(twin / np.where(lit, truth, 1) - 1)[lit]
    return Errors(float(error.max()), float(error.mean()), float(twin.sum() / truth.sum() - 1))


def main() -> None:
    """Print a row for each case."""
    print(f"Blender {bpy.app.version_string}; error of irradiance in %, lamps with a size at {SAMPLES} samples")
    print("| lamp | max | mean | signed mean |\n|---|---|---|---|")
    for name in CASES:
        errors = measure(name)
        print(f"| {name} | {100 * errors.largest:.4f} | {100 * errors.mean:.4f} | {100 * errors.bias:+.4f} |")


if __name__ == "__main__":
    main()
