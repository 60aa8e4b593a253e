"""Kinds of base colour among a material's texels, where colour may tell roughness."""

from __future__ import annotations

import numpy as np

from ...core.data import F32, I32, Bool

KINDS = 8  # of a material
TEXELS, ROUNDS = 4096, 12  # from which kinds are found, and in how many rounds


def colour_kinds(base: F32, mine: Bool) -> I32:
    """(h, w) kind of base colour of each of a material's texels, 0..KINDS - 1, and -1 elsewhere.

    ``base``: (h, w, 3).  Lloyd's algorithm (1982) on some texels' square roots, which are about as far apart as they
    look; it starts at quantiles of brightness.
    """
    colours = np.sqrt(np.maximum(base[mine], 0))
    some = colours[::max(1, len(colours) // TEXELS)]
    order = np.argsort(some.sum(1), kind="stable")
    middles = some[order[((np.arange(KINDS) + 0.5) / KINDS * len(some)).astype(int)]]
    for _ in range(ROUNDS):
        nearest = _nearest(some, middles)
        members = [some[nearest == kind] for kind in range(KINDS)]
        middles = np.stack([m.mean(0) if len(m) else old for m, old in zip(members, middles, strict=True)])
    kinds = np.full(mine.shape, -1, np.int32)
    kinds[mine] = _nearest(colours, middles)
    return kinds


def _nearest(colours: F32, middles: F32) -> I32:
    """(N,) index of the nearest of ``middles`` (K, 3) to each colour (N, 3)."""
    red, green, blue = np.ascontiguousarray(colours.T)
    nearest, least = np.zeros(len(colours), np.int32), np.full(len(colours), np.inf, np.float32)
    for kind, (r, g, b) in enumerate(middles):
        away = (red - r) ** 2 + (green - g) ** 2 + (blue - b) ** 2
        nearest[away < least] = kind
        np.minimum(least, away, out=least)
    return nearest
