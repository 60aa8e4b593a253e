"""The axes of the atlas: what goes wrong, how far, and what else is wrong meanwhile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from .problem import Trial

NOISY = Trial(noise=0.01)
QUIET = Trial()


@dataclass(frozen=True)
class Point:
    """One place on an axis."""

    label: str
    trial: Trial


@dataclass(frozen=True)
class Axis:
    """One chart."""

    key: str
    title: str
    unit: str  # what stands below the chart
    points: tuple[Point, ...]
    kind: str = ""  # "drifts": exposures are off; "other": the material is not of the model


def _axis(key: str, title: str, unit: str, base: Trial, values: Sequence[Any], *fields: str, percent: bool = False,
          kind: str = "", **more: Any) -> Axis:
    """An axis along fields of the trial that all get the value; percent: of 1, and told so."""
    points = []
    for value in values:
        amount = value / 100 if percent else value
        points.append(Point(f"{value:g}" if isinstance(value, (int, float)) else value,
                            replace(base, **{**dict.fromkeys(fields, amount), **more})))
    return Axis(key, title, unit, tuple(points), kind)


def _both(base: Trial, values: Sequence[float]) -> tuple[Point, ...]:
    """Shadows and doubled highlights, half and half; values in percent."""
    return tuple(Point(f"{v:g}", replace(base, shadows=v / 200, doubled=v / 200)) for v in values)


SHARES = (0, 2, 5, 10, 20, 30)
ALONE = (
    _axis("views", "Number of views", "views, 1 % noise", NOISY, (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 64), "views"),
    _axis("cameras", "Cameras that share 12 views", "cameras, 1 % noise", NOISY, (1, 2, 3, 4, 6, 12), "cameras"),
    _axis("roughness", "True roughness", "roughness, 1 % noise", NOISY, (0.05, 0.1, 0.15, 0.2, 0.3, 0.45, 0.65, 0.8, 1),
          "roughness"),
    _axis("coverage", "Highlight coverage", "tan(theta_h) / alpha of the best view, 6 views, 1 % noise",
          replace(NOISY, views=6), (0, 0.5, 1, 2, 3, 4, 6, 8), "coverage"),
    _axis("grazing", "Grazing angle", "degrees between cameras and normal, 1 % noise", NOISY,
          (0, 25, 45, 60, 65, 70, 75, 80, 85), "grazing"),
    _axis("noise", "Noise in proportion", "% of the signal", QUIET, (0, 0.1, 0.2, 0.5, 1, 2, 3, 5), "noise",
          percent=True),
    _axis("shot", "Shot noise", "% of white, by the root below", QUIET, (0, 0.2, 0.5, 1, 2, 3, 5), "shot",
          percent=True),
    _axis("read", "Read noise", "% of white", QUIET, (0, 0.2, 0.5, 1, 2, 3, 5), "read", percent=True),
    _axis("depth", "Depth of the files", "bits (8: sRGB, else linear)", QUIET, ("8", "10", "12", "16", "half", "float"),
          "depth"),
    _axis("tone", "Non-linear files", "exponent of a curve that is not undone", QUIET,
          (1, 0.95, 0.9, 0.8, 0.65, 0.4545), "tone"),
    _axis("saturation", "Saturation, clipped pixels left out", "clipped at, of white", QUIET,
          (10, 3, 1.5, 1, 0.7, 0.5, 0.35, 0.25), "clip"),
    _axis("saturation-kept", "Saturation, clipped pixels believed", "clipped at, of white", QUIET,
          (10, 3, 1.5, 1, 0.7, 0.5, 0.35, 0.25), "clip", masked=False),
    _axis("shadows", "Shadows taken for lit", "% of the observations", QUIET, SHARES, "shadows", percent=True),
    _axis("doubled", "Highlights doubled by reflection", "% of the observations", QUIET, SHARES, "doubled",
          percent=True),
    Axis("outliers", "Shadows and doubled highlights", "% of the observations, 1 % noise", _both(NOISY, SHARES)),
    Axis("blobs", "The same, lying together", "% of the observations in spots of 5 texels, 1 % noise",
         _both(replace(NOISY, blobs=True), SHARES)),
    _axis("bounce", "Light by way of other surfaces", "% of a lamp's irradiance, ignored", QUIET,
          (0, 1, 2, 5, 10, 20, 30), "bounce", percent=True),
    _axis("normal", "Wrong normals", "degrees, RMS, smooth over 4 texels", QUIET, (0, 0.25, 0.5, 1, 2, 3, 5), "normal"),
    _axis("shift", "Misregistration", "texels, each camera in its own direction", QUIET,
          (0, 0.1, 0.25, 0.5, 1, 1.5, 2), "shift"),
    _axis("moved", "Wrong positions of all lamps", "% of their distance", QUIET, (0, 0.2, 0.5, 1, 2, 5, 10), "moved",
          percent=True),
    _axis("moved-one", "Wrong position of one lamp", "% of its distance", QUIET, (0, 1, 2, 5, 10, 20, 40), "moved_one",
          percent=True),
    _axis("gain", "Wrong intensities, or drifting exposure", "%, standard deviation", QUIET, (0, 0.5, 1, 2, 5, 10, 20),
          "gain", percent=True, kind="drifts"),
    _axis("radius", "Lamps with a size, believed points", "radius, % of their distance", QUIET,
          (0, 2, 5, 10, 15, 20, 30), "radius", percent=True),
    _axis("footprint", "Texel larger than the highlight", "spread of the half vector over a texel, of alpha", QUIET,
          (0, 0.25, 0.5, 1, 2, 4), "footprint"),
    _axis("beckmann", "Wrong distribution", "% Beckmann in the lobe", QUIET, (0, 10, 25, 50, 75, 100), "beckmann",
          percent=True, kind="other"),
    _axis("fresnel", "Wrong Fresnel", "IOR of the surface (solved for 1.5)", QUIET,
          ("1.5", "Schlick", "1.4", "1.6", "1.33", "1.8", "2.4", "metal"), "fresnel", kind="other"),
    _axis("diffuse", "Diffuse that is not Lambert's", "% of a diffuse that light enters and leaves through a surface",
          QUIET, (0, 25, 50, 75, 100), "diffuse", percent=True, kind="other"),
    _axis("tail", "Longer tails than GGX's", "exponent of generalised Trowbridge-Reitz (2: GGX)", QUIET,
          (2, 1.9, 1.8, 1.7, 1.6, 1.5), "tail", kind="other"),
    _axis("metallic", "Metallic", "% metal", QUIET, (0, 10, 25, 50, 75, 100), "metallic", percent=True, kind="other"),
    _axis("coat", "Clear coat", "% of a clear lobe of roughness 0.1 above", QUIET, (0, 10, 25, 50, 75, 100), "coat",
          percent=True, kind="other"),
    _axis("albedo", "Albedo", "albedo, 1 % noise", NOISY, (0, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 1), "albedo"),
    _axis("colour", "Coloured lamps", "saturation of the lamps, 0.5 % read noise", replace(QUIET, read=0.005),
          (0, 0.5, 0.7, 0.8, 0.9, 0.97, 1), "colour"),
    _axis("border", "Sharp borders", "width of the spots, texels (two roughnesses), 1 % noise", NOISY,
          (16, 10, 6, 4, 2.5, 1.5, 0.5), "border"),
)
PAIRS = (
    _axis("views-outliers", "Few views, outliers", "views, 10 % outliers, 1 % noise",
          replace(NOISY, shadows=0.05, doubled=0.05), (3, 4, 6, 8, 12, 24, 64), "views"),
    _axis("views-quiet", "Few views, nothing else", "views, 0.2 % noise", QUIET, (1, 2, 3, 4, 6, 8, 12, 24), "views"),
    _axis("shift-border", "Misregistration, sharp borders", "texels, spots of 6 texels", replace(QUIET, border=6.0),
          (0, 0.1, 0.25, 0.5, 1, 1.5, 2), "shift"),
    _axis("depth-dark", "Depth of the files, dark surface", "bits (8: sRGB, else linear), albedo 0.02",
          replace(QUIET, albedo=0.02), ("8", "10", "12", "16", "half", "float"), "depth"),
    _axis("saturation-sharp", "Saturation, sharp highlights believed", "clipped at, of white, roughness 0.2",
          replace(QUIET, roughness=0.2, masked=False), (10, 3, 1.5, 1, 0.7, 0.5, 0.35), "clip"),
    _axis("grazing-normal", "Grazing angle, wrong normals", "degrees, normals off by 2 degrees",
          replace(QUIET, normal=2.0), (0, 25, 45, 60, 65, 70, 75, 80), "grazing"),
    _axis("moved-sharp", "Wrong lamps, sharp highlights", "% of their distance, roughness 0.15",
          replace(QUIET, roughness=0.15), (0, 0.2, 0.5, 1, 2, 5, 10), "moved", percent=True),
    _axis("footprint-unknown", "Bumps smaller than a texel, unknown",
          "spread of the half vector over a texel, of alpha", replace(QUIET, known=False), (0, 0.25, 0.5, 1, 2, 4),
          "footprint"),
    _axis("gain-views", "Drifting exposure, 6 views", "%, standard deviation", replace(QUIET, views=6),
          (0, 0.5, 1, 2, 5, 10, 20), "gain", percent=True, kind="drifts"),
    _axis("coverage-outliers", "Highlight coverage, outliers",
          "tan(theta_h) / alpha of the best view, 10 % outliers, 1 % noise",
          replace(NOISY, shadows=0.05, doubled=0.05), (0, 0.5, 1, 2, 3, 4, 6, 8), "coverage"),
)
AXES = (*ALONE, *PAIRS)
BY_KEY = {axis.key: axis for axis in AXES}

# The figure that was asked for: 1 % noise, 12 views, one lobe; 10 % of the observations replaced.
ROW = Axis("row", "12 views, 1 % noise", "outliers", tuple(
    Point(f"{kind}, {cameras} camera{'s' * (cameras > 1)}", replace(NOISY, cameras=cameras, **more))
    for cameras in (1, 3) for kind, more in {
        "none": {}, "10 % shadow": {"shadows": 0.1}, "10 % doubled": {"doubled": 0.1},
        "5 % of each": {"shadows": 0.05, "doubled": 0.05}}.items()))
