"""Measured materials and what has been published of them: networks in place of MERL's tables, and Cook-Torrance fits.

Matusik et al. 2003, "A Data-Driven Reflectance Model" (the 100 materials); Sztrajman et al. 2021, "Neural BRDF
Representation and Importance Sampling" (the networks); Ngan et al. 2005, "Experimental Analysis of BRDF Models", and
Low et al. 2012, "BRDF Models for Accurate and Efficient Rendering of Glossy Surfaces" (the fits, as Peers' bbm holds
them).  None of that is in the repository: ``--data`` names a folder with

    merl_nbrdf.npz   names (n), and of each material fc1 (6, 21), b1 (21), fc2 (21, 21), b2 (21), fc3 (21, 3), b3 (3):
                     the weights of github.com/asztr/Neural-BRDF
    low_cooktorrance_E1.csv, low_cooktorrance_E2.csv, ngan_cooktorrance.csv
                     material, kd_r, kd_g, kd_b, ks_r, ks_g, ks_b, roughness, eta: of github.com/bsdfbenchmark/bbm

All directions are unit vectors (..., 3) in the frame of the normal, which is z; all BRDFs 1/sr, without the cosine, and
0 below the horizon.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from irpso_addon.core.data import F64
from irpso_addon.core.shading import brdf

NETWORKS = "merl_nbrdf.npz"
FITS = {"Low E1": "low_cooktorrance_E1.csv", "Low E2": "low_cooktorrance_E2.csv", "Ngan": "ngan_cooktorrance.csv"}
NGAN_SCALE = np.array([1.0, 1.15, 1.66])  # MERL's scale of the channels, which Ngan's numbers lack


@dataclass(frozen=True)
class Network:
    """One material: half and difference direction -> 21 -> 21 -> RGB."""

    name: str
    weights: tuple[F64, ...]  # (6, 21), (21, 21), (21, 3)
    biases: tuple[F64, ...]

    def __call__(self, L: F64, V: F64) -> F64:
        """(..., 3)."""
        seen = (L[..., 2] > 0) & (V[..., 2] > 0)
        at = np.concatenate(half_difference(L[seen], V[seen]), axis=-1)
        for weight, bias in zip(self.weights[:2], self.biases[:2], strict=True):
            at = np.maximum(at @ weight + bias, 0.0)
        result = np.zeros((*seen.shape, 3))
        result[seen] = np.maximum(np.exp(at @ self.weights[2] + self.biases[2]) - 1.0, 0.0)
        return result


def networks(folder: Path) -> list[Network]:
    """All materials, in the file's order."""
    with np.load(folder / NETWORKS) as file:
        data = {key: file[key] for key in file.files}
    layers = [[data[f"{kind}{n}"].astype(np.float64) for n in (1, 2, 3)] for kind in ("fc", "b")]
    return [Network(str(name), tuple(w[i] for w in layers[0]), tuple(b[i] for b in layers[1]))
            for i, name in enumerate(data["names"])]


def half_difference(L: F64, V: F64) -> tuple[F64, F64]:
    """Half and difference direction, (..., 3) each, with the half vector turned to azimuth 0.

    Rusinkiewicz 1998, "A New Change of Variables for Efficient BRDF Representation": the difference is L turned so that
    the half vector is at the pole.  Head on, where the azimuth has no meaning, it is taken as 0.
    """
    half = L + V
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    cos_h, sin_h = half[..., 2], np.hypot(half[..., 0], half[..., 1])
    level = sin_h > 1e-9
    below = np.where(level, sin_h, 1.0)
    cos_p, sin_p = np.where(level, half[..., 0], 1.0) / below, np.where(level, half[..., 1], 0.0) / below
    x = cos_p * L[..., 0] + sin_p * L[..., 1]
    y = cos_p * L[..., 1] - sin_p * L[..., 0]
    turned = np.stack([sin_h, np.zeros_like(sin_h), cos_h], -1)
    difference = np.stack([cos_h * x - sin_h * L[..., 2], y, sin_h * x + cos_h * L[..., 2]], -1)
    return turned, difference


@dataclass(frozen=True)
class CookTorrance:
    """A published fit: Lambert plus a Beckmann lobe between V-grooves."""

    diffuse: F64  # (3,)
    specular: F64  # (3,) scale of the lobe, by channel
    m: float  # root mean square slope of Beckmann's distribution
    eta: float  # index of refraction; of ``schlick`` the reflectance head-on
    schlick: bool

    def __call__(self, L: F64, V: F64) -> F64:
        """(..., 3): kd / pi + ks D F G / (pi cos_l cos_v), D without or (Ngan) with 1 / pi.

        Cook and Torrance 1982, eq. 1; D is their eq. 4 (Beckmann), G their eq. 2.
        """
        at = brdf.angles(L, V, np.array([0.0, 0.0, 1.0]))
        cos2h = np.maximum(1 - at.sin2h, 1e-12)
        D = np.exp(-at.sin2h / (self.m**2 * cos2h)) / (self.m**2 * cos2h**2)
        G = v_grooves(np.sqrt(cos2h), at.cos_l, at.cos_v, at.cos_vh)
        F = fresnel_schlick(at.cos_vh, self.eta) / np.pi if self.schlick else fresnel(at.cos_vh, self.eta)
        lobe = D * F * G / (np.pi * at.cos_l * at.cos_v)
        return np.where(at.seen[..., None], self.diffuse / np.pi + self.specular * lobe[..., None], 0.0)

    @property
    def roughness(self) -> float:
        """As a Blender node would show it, alpha = m: the slopes are Beckmann's, so it is no GGX roughness."""
        return float(np.sqrt(self.m))


def fits(folder: Path) -> dict[str, dict[str, CookTorrance]]:
    """Published fits by source and material."""
    result: dict[str, dict[str, CookTorrance]] = {}
    for source, file in FITS.items():
        scale = NGAN_SCALE if source == "Ngan" else np.ones(3)
        with open(folder / file, newline="") as lines:
            result[source] = {row["material"]: CookTorrance(
                scale * np.array([float(row[f"kd_{c}"]) for c in "rgb"]),
                scale * np.array([float(row[f"ks_{c}"]) for c in "rgb"]),
                float(row["roughness"]), float(row["eta"]), source == "Ngan") for row in csv.DictReader(lines)}
    return result


def v_grooves(cos_h: F64, cos_l: F64, cos_v: F64, cos_vh: F64) -> F64:
    """Masking and shadowing of Torrance and Sparrow 1967."""
    return np.asarray(np.minimum(1.0, 2 * cos_h * np.minimum(cos_l, cos_v) / cos_vh))


def fresnel(cos_vh: F64, eta: float) -> F64:
    """Unpolarised reflectance at a real index of refraction.  Cook and Torrance 1982, sec. 5."""
    g = np.sqrt(np.maximum(eta**2 - 1 + cos_vh**2, 0.0))
    parallel = (cos_vh * (g + cos_vh) - 1) / (cos_vh * (g - cos_vh) + 1)
    return np.asarray(0.5 * ((g - cos_vh) / (g + cos_vh)) ** 2 * (1 + parallel**2))


def fresnel_schlick(cos_vh: F64, f0: float) -> F64:
    """Schlick 1994, "An Inexpensive BRDF Model", eq. 15."""
    return np.asarray(f0 + (1 - f0) * (1 - cos_vh) ** 5)
