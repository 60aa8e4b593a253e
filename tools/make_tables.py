"""Recompute the integrals that ``irpso_addon/core/shading/tables.py`` reads: ``principled_ior15.npz``.

    python tools/make_tables.py [--check]

Our own integrals of the published model, on the grids that Cycles keeps its own tables on: the
albedo of the lobe E1 on 32x32 (roughness, cosine) nodes, its hemispherical mean Eavg on 32, the mean
Fresnel interpolant s on 16x16x16 (roughness, cosine, sqrt of (n-1)/(n+1)) nodes, of which the nine
slices up to Specular IOR Level 1 are needed.  --check prints what resampling them to one table costs.

Sources: GGX visible normals: Heitz 2018, "Sampling the GGX Distribution of Visible Normals";
height-correlated Smith: Heitz 2014, eq. 99; multiple scattering: Kulla and Conty 2017,
"Revisiting Physically Based Shading at Imageworks" (with the fit of the mean Fresnel, slide 19).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from irpso_addon.core.data import F64
from irpso_addon.core.shading.tables import FRESNEL_NODES, LOBE_NODES, NODES, SLICES, Nodes, bilinear, energy

SMALLEST = 1e-4  # roughness and cosine of the first node: 0 itself is degenerate
POINTS = 46368  # of a Fibonacci lattice on the unit square (46368 and 28657 are neighbours)


def fresnel(cosine: F64, ior: float) -> F64:
    """Unpolarised reflectance of a dielectric."""
    g = np.sqrt(ior * ior - 1 + cosine * cosine)
    parallel = (cosine * (g + cosine) - 1) / (cosine * (g - cosine) + 1)
    return 0.5 * ((g - cosine) / (g + cosine)) ** 2 * (1 + parallel**2)


def normal_reflectance(ior: float) -> float:
    """Fresnel at normal incidence."""
    return ((ior - 1) / (ior + 1)) ** 2


def smith_lambda(alpha: float, cosine: F64) -> F64:
    """Smith's Lambda of GGX (Heitz 2014, eq. 72)."""
    return 0.5 * (np.sqrt(1 + alpha * alpha * (1 / (cosine * cosine) - 1)) - 1)


def visible_normals(roughness: float, cosine: float) -> tuple[F64, F64, F64]:
    """(V.H, N.L, weight G2/G1) of GGX normals visible from ``cosine``; weight 0 below the surface."""
    alpha = max(roughness, SMALLEST) ** 2
    cosine = max(cosine, SMALLEST)
    index = np.arange(POINTS)
    radius, phi = np.sqrt((index + 0.5) / POINTS), 2 * np.pi * ((index * 28657) % POINTS + 0.5) / POINTS
    sine = np.sqrt(1 - cosine * cosine)
    stretched = np.hypot(alpha * sine, cosine)
    vx, vz = alpha * sine / stretched, cosine / stretched
    # A point of the disc as the stretched view sees the half sphere, lifted onto it (Heitz 2018, sec. 3.2).
    t1, t2 = radius * np.cos(phi), radius * np.sin(phi)
    blend = 0.5 * (1 + vz)
    t2 = (1 - blend) * np.sqrt(1 - t1 * t1) + blend * t2
    up = np.sqrt(np.maximum(1 - t1 * t1 - t2 * t2, 0))
    # Basis of the stretched view (vx, 0, vz): T1 = (0, 1, 0), T2 = V x T1 = (-vz, 0, vx).
    hx, hy, hz = alpha * (-vz * t2 + vx * up), alpha * t1, np.maximum(vx * t2 + vz * up, 1e-9)
    length = np.sqrt(hx * hx + hy * hy + hz * hz)
    hx, hz = hx / length, hz / length
    cos_vh = sine * hx + cosine * hz
    cos_l = 2 * cos_vh * hz - cosine
    lit = cos_l > 0
    lambda_v = smith_lambda(alpha, np.float64(cosine))
    weight = np.where(lit, (1 + lambda_v) / (1 + lambda_v + smith_lambda(alpha, np.where(lit, cos_l, 1.0))), 0.0)
    return np.maximum(cos_vh, 0), cos_l, weight


def lobe_albedo(roughness: float, cosine: float) -> float:
    """E1: directional albedo of the single-scattering lobe with Fresnel 1."""
    return float(visible_normals(roughness, cosine)[2].mean())


def mean_lobe_albedo(roughness: float) -> float:
    """Eavg = 2 int E1 mu dmu over the hemisphere, by Gauss-Legendre."""
    nodes, weights = np.polynomial.legendre.leggauss(24)
    cosines = 0.5 * (nodes + 1)
    return float(sum(w * c * lobe_albedo(roughness, c) for c, w in zip(cosines, weights, strict=True)))


def mean_fresnel(roughness: float, cosine: float, ior: float) -> float:
    """s: (F - F0) / (1 - F0) averaged over visible normals, those that reflect into the surface as 0."""
    cos_vh, cos_l, _ = visible_normals(roughness, cosine)
    f0 = normal_reflectance(ior)
    return float(np.where(cos_l > 0, np.clip((fresnel(cos_vh, ior) - f0) / (1 - f0), 0, 1), 0).mean())


def fresnel_slice(k: int) -> F64:
    """s (16, 16), axis 0 roughness, axis 1 cosine, at the IOR whose F0 is (k / 15)^4."""
    z2 = (k / (FRESNEL_NODES - 1)) ** 2
    ior = (1 + z2) / (1 - z2)
    grid = np.linspace(0, 1, FRESNEL_NODES)
    return np.array([[mean_fresnel(r, c, ior) for c in grid] for r in grid])


def compute_nodes() -> Nodes:
    """All the integrals; half a minute."""
    grid = np.linspace(0, 1, LOBE_NODES)
    albedo = np.array([[lobe_albedo(r, c) for c in grid] for r in grid])
    mean = np.array([mean_lobe_albedo(r) for r in grid])
    return Nodes(albedo, mean, np.stack([fresnel_slice(k) for k in range(SLICES)]))


def check(nodes: Nodes) -> None:
    """Print what resampling to n x n costs, relative, in comp, A and 1 - A (which multiplies the diffuse)."""
    rng = np.random.default_rng(0)
    r, c = rng.uniform(0.05, 1, (2, 200_000))
    truth = energy(nodes, r, c)
    for size in (64, 128, 192, 256, 466):
        grid = np.linspace(0, 1, size)
        comp, dim = bilinear(energy(nodes, *np.meshgrid(grid, grid, indexing="ij")), r, c).T
        errors = {
            "comp": np.abs(comp / truth[:, 0] - 1), "A": np.abs(dim / truth[:, 1] - 1),
            "1 - A": np.abs((1 - dim) / (1 - truth[:, 1]) - 1),
        }
        print(size, "  ".join(f"{k} max {e.max():.1e} p99.9 {np.quantile(e, 0.999):.1e} mean {e.mean():.1e}"
                              for k, e in errors.items()))


def main() -> None:
    """Write the nodes, or with --check print what resampling costs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="print resampling errors instead of writing")
    check_only = parser.parse_args().check
    nodes = compute_nodes()
    if check_only:
        check(nodes)
    else:
        albedo, mean = nodes.albedo.astype(np.float32), nodes.mean.astype(np.float32)
        np.savez_compressed(NODES, albedo=albedo, mean=mean, fresnel=nodes.fresnel)


if __name__ == "__main__":
    main()
