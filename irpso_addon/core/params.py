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
    """A dataclass field with everything that the interface, the command line and the docs need."""
    return field(default=default, metadata={
        "doc": doc, "label": label, "low": low, "high": high, "unit": unit, "choices": choices, "advanced": advanced,
    })


# Names of choices in the interface, where they are not the key in capitals.
NAMES = {
    "lambert": "Diffuse Only", "one-lobe": "Roughness", "one-lobe-specular": "Roughness + Specular",
    "one-lobe-metallic": "Roughness + Metallic", "two-lobe": "Two Roughnesses", "anew": "From Scratch",
    "last": "From Last Result", "squares": "Least Squares", "ggx": "GGX", "opengl": "OpenGL", "numpy": "NumPy",
    "irpso": "IRPSO", "gltf": "glTF", "unreal": "Unreal Engine", "materialx": "MaterialX", "srgb": "sRGB",
}


def choice_name(key: str) -> str:
    """What the interface calls a choice."""
    return NAMES.get(key, key.replace("-", " ").title())


@dataclass(frozen=True)
class Table:
    """Checks its rows.  Raises ValueError for what is out of range or no choice."""

    def __post_init__(self) -> None:
        for f in fields(self):
            value, low, high = getattr(self, f.name), f.metadata["low"], f.metadata["high"]
            if f.type is float:
                object.__setattr__(self, f.name, float(np.float32(value)))
            if f.metadata["choices"] and value not in [c[0] for c in f.metadata["choices"]]:
                known = ", ".join(c[0] for c in f.metadata["choices"])
                raise ValueError(f"{f.name} is '{value}': must be one of {known}")
            if low is not None and not low <= value <= high:
                raise ValueError(f"{f.name} is {value}: must be between {low} and {high}")


@dataclass(frozen=True)
class SolveSettings(Table):
    """What the user may choose about a solve."""

    size: int = parameter(1024, "Width and height of the maps", label="Size", low=16, high=8192, unit="texels")
    udim: str = parameter("first", "UV squares to solve", label="UDIM", choices=(
        ("first", "Only the square from 0 to 1"),
        ("all", "Every square with faces; each gets a file, numbered from 1001"),
    ), advanced=True)
    model: str = parameter("auto", "Inputs of the material to solve for", label="Model", choices=(
        ("auto", "Choose for each material the smallest model that the pictures support"),
        ("lambert", "Base colour of a surface without highlights (Specular IOR Level 0)"),
        ("one-lobe", "Base colour and roughness of the Principled BSDF"),
        ("one-lobe-specular", "Base colour, roughness and Specular IOR Level; for pictures without an absolute scale"),
        ("one-lobe-metallic", "Base colour, roughness and Metallic, one Metallic value for each material"),
        ("two-lobe", "Base colour, two roughnesses and the share of the first"),
    ))
    specular: str = parameter("material", "Where the Specular IOR Level may vary; for model Roughness + Specular",
                              label="Specular", choices=(
        ("material", "One value for each material"),
        ("texel", "One value for each texel: a map"),
    ))
    ndf: str = parameter("ggx", "Shape of the two highlights; for model Two Roughnesses", label="Highlight "
                                                                                                "Shape", choices=(
        ("ggx", "Two Principled BSDFs, mixed"),
        ("beckmann", "A Diffuse BSDF and two Metallic BSDFs without absorption (Cook-Torrance)"),
    ), advanced=True)
    method: str = parameter("refined", "Search algorithm", label="Method", choices=(
        ("refined", "Particle swarm with Levenberg-Marquardt steps; fast and exact"),
        ("draft", "Refined with fewer particles and steps; for a first look"),
        ("swarm", "Particle swarm in a ring; derivatives only refine the two best; slower"),
        ("paper", "IRPSO as published, which searches every parameter; for comparison"),
    ))
    particles: int = parameter(16, "Particles in the swarm of a texel (m); for method Paper", label="Particles",
                               low=2, high=64, advanced=True)
    iterations: int = parameter(1600, "Passes, in each of which one particle of every swarm moves; for method Paper",
                                label="Passes", low=1, high=1_000_000, advanced=True)
    c1: float = parameter(2.05, "Pull of a particle's own best (c1); for method Paper", label="Own Best", low=0.0,
                          high=4.0, advanced=True)
    c2: float = parameter(2.05, "Pull of the texel's best (c2); for method Paper", label="Texel's Best", low=0.0,
                          high=4.0, advanced=True)
    c3: float = parameter(0.05, "Pull of the neighbours' bests (c3); for method Paper", label="Neighbours' Bests",
                          low=0.0, high=4.0, advanced=True)
    window: int = parameter(3, "Width of the neighbourhood (H), an odd number; for method Paper", label="Window",
                            low=1, high=15, unit="texels", advanced=True)
    threshold: float = parameter(0.0, "Relative error below which a swarm stops; for method Paper",
                                 label="Threshold", low=0.0, high=1.0, advanced=True)
    start: str = parameter("anew", "Where the search begins", label="Start", choices=(
        ("anew", "Search all roughnesses"),
        ("last", "Search near the last result, with fewer particles; faster. Model Auto keeps its models"),
    ))
    loss: str = parameter("auto", "How outliers are weighted, such as a missed shadow or a mirrored lamp",
                          label="Outliers", choices=(
        ("auto", "Robust where the first fit leaves outliers"),
        ("squares", "Give outliers full weight"),
        ("robust", "Give an outlier less weight the farther it is off"),
    ), advanced=True)
    indirect: str = parameter("auto", "Light that arrived by way of other surfaces; Cycles renders it from the "
                              "maps, and IRPSO subtracts it", label="Indirect Light", choices=(
        ("auto", "Subtract it where shadows in the pictures are not dark; under a world, where small renders show it"),
        ("off", "Do not subtract it: the pictures show direct light only"),
        ("on", "Subtract it from every picture"),
    ))
    registration: str = parameter("auto", "Direction, roll, focal length and radial distortion of the cameras",
                                  label="Camera Alignment", choices=(
        ("auto", "Correct what the pictures show clearly to be off"),
        ("given", "Use the scene's cameras unchanged"),
    ), advanced=True)
    lamps: str = parameter("auto", "Place, power and colour of the lamps, turn of the world, and ambient light",
                           label="Lamps", choices=(
        ("auto", "Correct where that predicts left-out views better"),
        ("given", "Use the scene's lamps and world, and the views' ambient light, unchanged"),
    ), advanced=True)
    exposures: str = parameter("auto", "Exposure and white balance of each view, vignetting, response and black level",
                               label="Exposures", choices=(
        ("given", "Use each view's exposure, white balance, vignetting, response and black level unchanged"),
        ("solve", "Find every exposure from the pictures; keep their mean, and all else that the views state"),
        ("auto", "Correct where that predicts left-out views better"),
    ), advanced=True)
    normals: str = parameter("auto", "Shading normals", label="Normals", choices=(
        ("auto", "Refine where that predicts left-out views better; they become a normal map"),
        ("mesh", "Use those of the mesh and of its material's normal map unchanged"),
    ), advanced=True)
    raw_size: str = parameter("half", "Resolution at which RAW files are read", label="RAW Size", choices=(
        ("half", "One pixel from 2 x 2 samples (X-Trans: 3 x 3), which hold all colours"),
        ("full", "One pixel from each sample, with the other colours interpolated; 4 times the data"),
    ), advanced=True)
    seed: int = parameter(0, "Seed of the swarm's random numbers", label="Seed", low=0, high=2**31 - 1,
                          advanced=True)


@dataclass(frozen=True)
class ExportSettings(Table):
    """What the user may choose about an export.  core/maps/targets.py says what each target's files hold."""

    target: str = parameter("irpso", "Program to export the files for", label="Target", choices=(
        ("irpso", "All maps, with confidence and standard errors, in the chosen format"),
        ("blender", "Base colour, roughness and Metallic by names that Node Wrangler recognises"),
        ("gltf", "A .glb of the mesh, and its images: base colour; occlusion, roughness and Metallic in one"),
        ("unreal", "Base colour; occlusion, roughness and Metallic in one; DirectX normals"),
        ("unity", "Unity's HDRP and URP: base map, and a mask map with smoothness in its alpha"),
        ("substance", "Substance 3D: base colour, roughness and Metallic by Adobe's names; DirectX normals"),
        ("materialx", "A MaterialX document with OpenPBR Surface, and its images"),
    ))


@dataclass(frozen=True)
class DeviceSettings(Table):
    """What computes, and how the graphics device is used.

    The maps do not depend on it, but for ``device``, and for ``memory`` where pictures are reduced.
    """

    device: str = parameter("opengl", "Hardware that solves", label="Device", choices=(
        ("opengl", "The graphics device, through OpenGL 3.3 or later"),
        ("numpy", "The processor; for computers without OpenGL; one roughness, small maps, slow"),
    ))
    kernels: str = parameter("auto", "Kind of shaders that search on the graphics device", label="Shaders", choices=(
        ("auto", "Compute shaders where they are clearly faster, measured once"),
        ("fragment", "Fragment shaders, which every device has"),
        ("compute", "Compute shaders, which need OpenGL 4.3"),
    ))
    memory: float = parameter(2.0, "Most memory of the graphics device for pictures and observations; larger "
                              "pictures are reduced", label="Memory", low=0.25, high=256.0, unit="GB")
    slice: int = parameter(15, "Longest GPU batch; lower keeps Blender responsive, higher solves a little "
                           "faster", label="GPU Batch", low=1, high=500, unit="ms")


@dataclass(frozen=True)
class ShootSettings(Table):
    """How a shoot was lit and how its pictures are read."""

    rig: str = parameter("flash", "Lighting of the pictures", label="Light", choices=(
        ("flash", "A flash fixed to the camera"),
        ("lamps", "Lamps in the scene, the same for every picture; place them after the import"),
    ))
    flash_right: float = parameter(0.0, "Distance of the flash to the right of the lens, seen from behind a "
                                   "level camera",
                                   label="Right of the Lens", low=-2000.0, high=2000.0, unit="mm")
    flash_above: float = parameter(0.0, "Distance of the flash above the lens of a level camera",
                                   label="Above the Lens", low=-2000.0, high=2000.0, unit="mm")
    flash_front: float = parameter(0.0, "Distance of the flash in front of the lens's entrance pupil",
                                   label="In Front of the Lens", low=-2000.0, high=2000.0, unit="mm")
    flash_size: float = parameter(30.0, "Diameter of the flash's shining surface", label="Diameter",
                                  low=0.0, high=2000.0, unit="mm")
    flash_power: float = parameter(0.0, "Power of the flash; 0: estimate it from the pictures, so that the surface is "
                                   "neither black nor brighter than white", label="Power", low=0.0, high=1e9, unit="W")
    scale: float = parameter(0.0, "Metres in one unit of the project; 0: the project's own, or 1 without one",
                             label="Scale", low=0.0, high=1e6, unit="m")
    colors: str = parameter("file", "Colour space of all pictures; RAW files are always linear",
                            label="Colors", choices=(
        ("file", "Each file's own; without one, linear for float files and sRGB for others"),
        ("srgb", "sRGB, as in JPEG files from cameras"),
        ("linear", "Linear Rec.709, as in 16-bit files that a RAW converter made without a curve"),
    ))
