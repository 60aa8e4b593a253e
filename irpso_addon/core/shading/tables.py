"""The energy of the Principled BSDF at IOR 1.5: what its specular lobe returns and leaves to the diffuse.

Cycles keeps the albedo of the lobe on 32x32 (roughness, cosine) nodes and its mean Fresnel on 16x16x16 (and
the fourth root of the reflectance head-on), and interpolates both linearly. Its pixels therefore contain those
grids' interpolation error, largest at grazing views, which has to be reproduced rather than removed. The file
beside this module holds our own integrals on those nodes (``tools/make_tables.py`` computes them); here they
become what ``shaders/include/brdf.glsl`` and ``brdf.py`` interpolate: for Specular IOR Level 0.5 one table,
for any other level the nodes themselves.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..data import F32, F64

NODES = Path(__file__).with_name("principled_ior15.npz")
IOR = 1.5
F0 = ((IOR - 1) / (IOR + 1)) ** 2
# Every node of both grids is a node of this one (31 * 15 = 465 cells), so the table has no kink inside a cell:
# resampling costs at most 9e-6 of 1 - A; with 256 nodes it costs up to 1.5e-3, with 128 up to 6e-3.
SIZE = 466



LOBE_NODES, FRESNEL_NODES = 32, 16  # along roughness and cosine
SLICES = 9  # of Cycles' 16 mean Fresnels, at z = k/15: level 1 is at z = 0.08^(1/4) = 7.98/15


class Nodes(NamedTuple):
    """Integrals over the lobe; axis 0 (of a slice) roughness, axis 1 cosine to the viewer, both 0..1."""

    albedo: F64  # (32, 32) E1, of the lobe with Fresnel 1
    mean: F64  # (32,) Eavg, its mean over the hemisphere
    fresnel: F64  # (9, 16, 16) s, the mean of (F - F0) / (1 - F0) over visible normals, at F0 = (k/15)^4


@cache
def energy_nodes() -> Nodes:
    """What the file holds, as float64."""
    with np.load(NODES) as nodes:
        return Nodes(*(nodes[name].astype(np.float64) for name in Nodes._fields))


@cache
def principled_table() -> F32:
    """The texture u_principled_table, shape (SIZE + LOBE_NODES, SIZE, 4), read-only.

    Two values and their steps to the next column.  Rows [:SIZE] are (comp, A) at Specular IOR Level 0.5: row i
    roughness i/(SIZE-1), column j cosine to the viewer j/(SIZE-1).  comp multiplies the specular lobe for multiple
    scattering; A is the share of the light that the lobe takes from the diffuse below it.  Rows [SIZE:] hold the
    nodes for other levels: (E1, Eavg) at [SIZE + i, j], (s_k, s_k+1) at [SIZE + i, LOBE_NODES + FRESNEL_NODES k + j].
    """
    nodes = energy_nodes()
    table = np.zeros((SIZE + LOBE_NODES, SIZE, 2), np.float32)
    grid = np.linspace(0, 1, SIZE)
    table[:SIZE] = energy(nodes, *np.meshgrid(grid, grid, indexing="ij"))
    table[SIZE:, :LOBE_NODES, 0] = nodes.albedo
    table[SIZE:, :LOBE_NODES, 1] = nodes.mean[:, None]
    for k in range(SLICES - 1):
        left = LOBE_NODES + FRESNEL_NODES * k
        table[SIZE : SIZE + FRESNEL_NODES, left : left + FRESNEL_NODES] = np.moveaxis(nodes.fresnel[k : k + 2], 0, -1)
    table = np.concatenate([table, np.diff(table, axis=1, append=table[:, -1:])], axis=2)  # two fetches instead of four
    table.setflags(write=False)
    return table


def level_ior(level: float | F64) -> F64:
    """The IOR that Cycles gives a Principled of IOR 1.5: its reflectance head-on is 2 level times that of 1.5."""
    root = np.sqrt(2 * np.asarray(level, np.float64) * F0)
    ior: F64 = (1 + root) / (1 - root)
    return ior


def energy(nodes: Nodes, roughness: F64, cosine: F64, level: float = 0.5) -> F64:
    """(comp, A) from the nodes themselves, shape (..., 2).

    comp after Kulla and Conty 2017, "Revisiting Physically Based Shading at Imageworks", with their fit of the
    mean Fresnel.
    """
    ior, f0 = level_ior(level), 2 * level * F0
    lobe = bilinear(nodes.albedo, roughness, cosine)
    hemisphere = np.interp(roughness, np.linspace(0, 1, len(nodes.mean)), nodes.mean)
    single = (ior - 1) / (4.08567 + 1.00071 * ior)
    multiple = single * hemisphere / (1 - single * (1 - hemisphere))
    comp = 1 + multiple * (1 - lobe) / lobe
    fresnel = bilinear(level_fresnel(nodes, level), roughness, cosine)
    return np.stack([comp, (f0 + (1 - f0) * fresnel) * lobe * comp], axis=-1)


def level_fresnel(nodes: Nodes, level: float) -> F64:
    """s at one level, (16, 16), rounded to float32: linear between Cycles' slices."""
    z = (2 * level * F0) ** 0.25 * (FRESNEL_NODES - 1)
    below = min(int(z), SLICES - 2)
    share = z - below
    mixed = nodes.fresnel[below] * (1 - share) + nodes.fresnel[below + 1] * share
    rounded: F64 = mixed.astype(np.float32).astype(np.float64)
    return rounded


def bilinear(table: F64, x: F64, y: F64) -> F64:
    """``table`` (n, m, ...) at x along axis 0 and y along axis 1; 0..1 spans the nodes, clamped outside."""
    low, high, along, _ = _cell(table, x, y, None)
    return low + along * (high - low)


def bilinear_d(table: F64, x: F64, y: F64, layer: NDArray[np.int64] | None = None) -> tuple[F64, F64]:
    """(bilinear, its slope by x, which is the cell's own).  Arrays of x, y and layer broadcast.

    ``layer``: which of several tables, (k, n, m, ...), is looked up.
    """
    low, high, along, nodes = _cell(table, x, y, layer)
    rise = high - low
    return low + along * rise, rise * (nodes - 1)


def _cell(table: F64, x: F64, y: F64, layer: NDArray[np.int64] | None) -> tuple[F64, F64, F64, int]:
    """(values at y on the nodes below and above x; how far x is from the one to the other; nodes along x)."""
    if layer is None:
        table, layer = table[None], np.asarray(0)
    rows, columns = table.shape[1:3]
    fx, fy = np.clip(x, 0, 1) * (rows - 1), np.clip(y, 0, 1) * (columns - 1)
    i, j = np.minimum(fx.astype(int), rows - 2), np.minimum(fy.astype(int), columns - 2)
    extra = (...,) + (None,) * (table.ndim - 3)
    tx, ty = (fx - i)[extra], (fy - j)[extra]
    nodes = table.reshape(-1, *table.shape[3:])
    at = (layer * rows + i) * columns + j  # one index gathers faster than three
    low, high = nodes.take(at, 0), nodes.take(at + columns, 0)
    low = low + ty * (nodes.take(at + 1, 0) - low)
    high = high + ty * (nodes.take(at + columns + 1, 0) - high)
    return low, high, tx, rows
