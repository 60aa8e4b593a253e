"""The energy table of the Principled BSDF at IOR 1.5: what its specular lobe returns and leaves to the diffuse.

Cycles keeps the albedo of the lobe on 32x32 (roughness, cosine) nodes and its mean Fresnel on 16x16, and
interpolates both linearly. Its pixels therefore contain those grids' interpolation error, largest at grazing
views, which has to be reproduced rather than removed. The file beside this module holds our own integrals on
those nodes (``tools/make_tables.py`` computes them); here they become the one table that
``shaders/include/brdf.glsl`` and ``core/brdf.py`` interpolate.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from .data import F32, F64

NODES = Path(__file__).with_name("principled_ior15.npz")
IOR = 1.5
F0 = ((IOR - 1) / (IOR + 1)) ** 2
# Every node of both grids is a node of this one (31 * 15 = 465 cells), so the table has no kink inside a cell:
# resampling costs at most 9e-6 of 1 - A; with 256 nodes it costs up to 1.5e-3, with 128 up to 6e-3.
SIZE = 466


@cache
def principled_table() -> F32:
    """(comp, A), shape (SIZE, SIZE, 2): axis 0 roughness i/(SIZE-1), axis 1 cosine to the viewer j/(SIZE-1).

    comp multiplies the specular lobe for multiple scattering; A is the share of the light that the lobe
    takes from the diffuse below it.  The array is read-only.
    """
    with np.load(NODES) as nodes:
        albedo, mean, fresnel = (nodes[name].astype(np.float64) for name in ("albedo", "mean", "fresnel"))
    grid = np.linspace(0, 1, SIZE)
    table = energy(albedo, mean, fresnel, *np.meshgrid(grid, grid, indexing="ij")).astype(np.float32)
    table.setflags(write=False)
    return table


def energy(albedo: F64, mean: F64, fresnel: F64, roughness: F64, cosine: F64) -> F64:
    """(comp, A) from the nodes themselves, shape (..., 2).

    albedo (32, 32): E1, of the lobe with Fresnel 1; mean (32,): Eavg, its mean over the hemisphere; fresnel
    (16, 16): s, the mean of (F - F0) / (1 - F0) over visible normals.  comp after Kulla and Conty 2017,
    "Revisiting Physically Based Shading at Imageworks", with their fit of the mean Fresnel.
    """
    lobe = bilinear(albedo, roughness, cosine)
    hemisphere = np.interp(roughness, np.linspace(0, 1, len(mean)), mean)
    single = (IOR - 1) / (4.08567 + 1.00071 * IOR)
    multiple = single * hemisphere / (1 - single * (1 - hemisphere))
    comp = 1 + multiple * (1 - lobe) / lobe
    return np.stack([comp, (F0 + (1 - F0) * bilinear(fresnel, roughness, cosine)) * lobe * comp], axis=-1)


def bilinear(table: F64, x: F64, y: F64) -> F64:
    """``table`` (n, m, ...) at x along axis 0 and y along axis 1; 0..1 spans the nodes, clamped outside."""
    fx, fy = np.clip(x, 0, 1) * (table.shape[0] - 1), np.clip(y, 0, 1) * (table.shape[1] - 1)
    i = np.minimum(np.asarray(fx).astype(int), table.shape[0] - 2)
    j = np.minimum(np.asarray(fy).astype(int), table.shape[1] - 2)
    extra = (...,) + (None,) * (table.ndim - 2)
    tx, ty = np.asarray(fx - i)[extra], np.asarray(fy - j)[extra]
    low = table[i, j] * (1 - ty) + table[i, j + 1] * ty
    high = table[i + 1, j] * (1 - ty) + table[i + 1, j + 1] * ty
    result: F64 = low * (1 - tx) + high * tx
    return result
