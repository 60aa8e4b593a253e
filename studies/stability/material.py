"""What the patch's material reflects: the models' own, and what no model here describes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from irpso_addon.core.data import F64
from irpso_addon.core.shading import brdf
from tests.support.texel_problem import Estimate

if TYPE_CHECKING:
    from .problem import Angles, Trial

GGX = 2.0  # exponent of generalised Trowbridge-Reitz that is GGX
COAT = 0.1  # roughness of the clear coat
ROUGHEST = 0.9999  # alpha^2: at 1 every exponent gives the same, as 0 / 0


def reflected(trial: Trial, truth: Estimate, at: Angles) -> tuple[F64, F64]:
    """(..., h, w, 1) by a white diffuse, (..., h, w, 1 or 3) by the lobes, 1/sr."""
    cos_l, cos_v = np.maximum(at.cos_l, 1e-3), np.maximum(at.cos_v, 1e-3)
    r = truth.roughness
    geometry = at.sin2h, 0.0, cos_l, cos_v, at.cos_vh
    lobe = brdf.specular_principled(r, *geometry)
    if trial.beckmann:
        classic = brdf.principled_energy(r, cos_v)[..., 0] * brdf.specular_beckmann(r, *geometry)
        lobe = (1 - trial.beckmann) * lobe + trial.beckmann * classic
    if trial.tail != GGX:
        lobe = lobe * tail_ratio(trial.tail, r, at.sin2h)
    if trial.fresnel != "1.5":
        lobe = lobe * fresnel(trial.fresnel, at.cos_vh) / brdf.F_dielectric(at.cos_vh)
    white = brdf.diffuse_principled(r, cos_v)
    if trial.diffuse:
        white = (1 - trial.diffuse) * white + trial.diffuse * through_a_surface(cos_l, cos_v)
    white, lobe = white[..., None], lobe[..., None]
    if trial.metallic:
        metal = brdf.metal(truth.base, r, *geometry)
        white, lobe = (1 - trial.metallic) * white, (1 - trial.metallic) * lobe + trial.metallic * metal
    if trial.coat:
        clear = brdf.specular_principled(COAT, *geometry)[..., None]
        rest = 1 - trial.coat * brdf.principled_energy(COAT, cos_v)[..., 1:]
        white, lobe = rest * white, rest * lobe + trial.coat * clear
    return white, lobe


def fresnel(kind: str, cos_vh: F64) -> F64:
    """Reflectance: unpolarised at an IOR, Schlick's with F0 = .04, or a metal's with F0 = .7."""
    if kind in ("Schlick", "metal"):
        f0 = 0.04 if kind == "Schlick" else 0.7
        return np.asarray(f0 + (1 - f0) * (1 - cos_vh) ** 5)
    g = np.sqrt(float(kind) ** 2 - 1 + cos_vh**2)
    parallel = (cos_vh * (g + cos_vh) - 1) / (cos_vh * (g - cos_vh) + 1)
    return np.asarray(0.5 * ((g - cos_vh) / (g + cos_vh)) ** 2 * (1 + parallel**2))


def tail_ratio(exponent: float, roughness: F64, sin2h: F64) -> F64:
    """Generalised Trowbridge-Reitz over GGX; exponent not 1.  Burley 2012, "Physically Based Shading at Disney", B.2.

    Shadowing stays GGX's: that of another exponent has no closed form.
    """
    a2 = np.minimum(roughness**4, ROUGHEST)
    scale = (exponent - 1) * (1 - a2) / (a2 ** (1 - exponent) - 1)  # over that of GGX, alpha^2
    return np.asarray(scale / a2 * (a2 + (1 - a2) * sin2h) ** (2 - exponent))


def through_a_surface(cos_l: F64, cos_v: F64) -> F64:
    """A white diffuse that light enters and leaves through a surface.  Ashikhmin and Shirley 2000, eq. 5."""
    enters, leaves = (1 - (1 - cos / 2) ** 5 for cos in (cos_l, cos_v))
    return np.asarray(28 / (23 * np.pi) * enters * leaves)
