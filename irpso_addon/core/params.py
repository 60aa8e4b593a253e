"""THE table of parameters: each is defined here once, and becomes RNA property, flag, uniform and docs row.

No ``from __future__ import annotations`` here: the field types are read at run time.
Floats are rounded to float32 on construction, because Blender stores them so; otherwise the panel
and the command line would give different bits.
"""

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np


def parameter(
    default: Any, doc: str, *, label: str, low: float | None = None, high: float | None = None,
    unit: str = "", choices: tuple[tuple[str, str], ...] = (), advanced: bool = False,
) -> Any:
    """A dataclass field with all that UI, command line and docs say of it."""
    return field(default=default, metadata={
        "doc": doc, "label": label, "low": low, "high": high, "unit": unit, "choices": choices, "advanced": advanced,
    })


@dataclass(frozen=True)
class Table:
    """Checks its rows.  Raises ValueError for what is out of range or no choice."""

    def __post_init__(self) -> None:
        for f in fields(self):
            value, low, high = getattr(self, f.name), f.metadata["low"], f.metadata["high"]
            if f.type is float:
                object.__setattr__(self, f.name, float(np.float32(value)))
            if f.metadata["choices"] and value not in [c[0] for c in f.metadata["choices"]]:
                raise ValueError(f"{f.name} is '{value}': want one of {', '.join(c[0] for c in f.metadata['choices'])}")
            if low is not None and not low <= value <= high:
                raise ValueError(f"{f.name} is {value}: want {low} to {high}")


@dataclass(frozen=True)
class SolveSettings(Table):
    """What the user may choose about a solve."""

    size: int = parameter(1024, "Width and height of the maps", label="Size", low=16, high=8192, unit="texels")
    udim: str = parameter("first", "UV squares that are solved", label="UDIM", choices=(
        ("first", "The 0-1 square alone"),
        ("all", "Every square that holds faces: a file for each, numbered from 1001 on"),
    ), advanced=True)
    model: str = parameter("auto", "How much of the material is solved for", label="Model", choices=(
        ("auto", "The smallest model that the data support, chosen for each material"),
        ("lambert", "Base colour only: a surface without highlight (Specular IOR Level 0)"),
        ("one-lobe", "Base colour and roughness of the Principled BSDF"),
        ("one-lobe-specular", "And its Specular IOR Level: for pictures without an absolute scale"),
        ("one-lobe-metallic", "And its Metallic: one value for each material"),
        ("two-lobe", "Base colour, two roughnesses and the share of the first lobe"),
    ))
    specular: str = parameter("material", "Model one-lobe-specular: where the Specular IOR Level may differ",
                              label="Specular", choices=(
        ("material", "One value for each material"),
        ("texel", "A map"),
    ))
    ndf: str = parameter("ggx", "Model two-lobe: distribution of the surface's slopes", label="Distribution", choices=(
        ("ggx", "Two Principled BSDFs, mixed"),
        ("beckmann", "Cook-Torrance: a diffuse and two Metallic BSDFs without absorption, Beckmann"),
    ), advanced=True)
    method: str = parameter("refined", "How the swarm searches", label="Method", choices=(
        ("refined", "Stratified particles take Levenberg-Marquardt steps and race; fast and exact"),
        ("draft", "The same with fewer particles and steps, for a first look"),
        ("swarm", "The particle swarm alone, ring topology; slower, makes no use of derivatives"),
        ("paper", "IRPSO as published, every parameter searched; for comparison"),
    ))
    particles: int = parameter(16, "Method paper: particles of a texel's swarm (m)", label="Particles", low=2, high=64,
                               advanced=True)
    iterations: int = parameter(1600, "Method paper: passes; in each, one particle of every swarm moves",
                                label="Passes", low=1, high=1_000_000, advanced=True)
    c1: float = parameter(2.05, "Method paper: pull of a particle's own best (c1)", label="Own Best", low=0.0, high=4.0,
                          advanced=True)
    c2: float = parameter(2.05, "Method paper: pull of the texel's best (c2)", label="Texel's Best", low=0.0, high=4.0,
                          advanced=True)
    c3: float = parameter(0.05, "Method paper: pull of the neighbours' bests (c3)", label="Neighbours' Bests", low=0.0,
                          high=4.0, advanced=True)
    window: int = parameter(3, "Method paper: width of the neighbourhood (H), odd", label="Window", low=1, high=15,
                            unit="texels", advanced=True)
    threshold: float = parameter(0.0, "Method paper: a swarm stops once its relative error is below this",
                                 label="Threshold", low=0.0, high=1.0, advanced=True)
    start: str = parameter("anew", "Where the search begins", label="Start", choices=(
        ("anew", "Everywhere: particles over all roughnesses"),
        ("last", "At the last result, whose models Auto keeps: fewer particles, faster"),
    ))
    loss: str = parameter("auto", "How much an observation counts that fits nothing: a missed shadow, a mirrored lamp",
                          label="Loss", choices=(
        ("auto", "Robust where the first fit leaves such observations"),
        ("squares", "Squares: in full"),
        ("robust", "The less the farther it is off"),
    ), advanced=True)
    indirect: str = parameter("auto", "Light that came by way of other surfaces, rendered by Cycles from the maps "
                              "found and taken out", label="Indirect Light", choices=(
        ("auto", "Where shadows of the references are not dark"),
        ("off", "The references hold direct light alone"),
        ("on", "The references hold it"),
    ))
    registration: str = parameter("auto", "Where the cameras look", label="Registration", choices=(
        ("auto", "Shifted where the pictures say beyond doubt that they are off"),
        ("given", "Exactly where the scene says"),
    ), advanced=True)
    exposures: str = parameter("given", "Exposure of each view", label="Exposures", choices=(
        ("given", "As the view says"),
        ("solve", "Drifting: found from the pictures, their mean as the views say"),
    ), advanced=True)
    seed: int = parameter(0, "Seed of the swarm's random numbers", label="Seed", low=0, high=2**31 - 1,
                          advanced=True)


@dataclass(frozen=True)
class DeviceSettings(Table):
    """What computes, and how the graphics device is used.

    The maps do not depend on it, but for ``device``, and for ``memory`` where pictures are reduced.
    """

    device: str = parameter("opengl", "What solves", label="Device", choices=(
        ("opengl", "The graphics device, by OpenGL 3.3 or later"),
        ("numpy", "The processor, in Python: for computers without OpenGL; one lobe, small maps, slow"),
    ))
    kernels: str = parameter("auto", "How the search runs on the graphics device", label="Kernels", choices=(
        ("auto", "As compute shaders where they are clearly faster, measured once"),
        ("fragment", "As fragment shaders, which every device has"),
        ("compute", "As compute shaders, which need OpenGL 4.3"),
    ))
    memory: float = parameter(2.0, "Memory of the graphics device that pictures and observations may take; larger "
                              "pictures are reduced", label="Memory", low=0.25, high=256.0, unit="GB")
    slice: int = parameter(15, "Time the graphics device works between two chances for others to draw; longer is a "
                           "little faster", label="Slice", low=1, high=500, unit="ms")
