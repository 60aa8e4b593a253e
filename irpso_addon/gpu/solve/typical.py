"""What the texels that know their roughness say of those that do not: docs/decisions/0053."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...core.data import F32, F64, I32, Bool
from ...core.tiled.tiled_plan import Typical
from .colour_kinds import KINDS, colour_kinds
from .texel_records import FEW, WELL_KNOWN

LEAST_SHARE = 0.1  # texels that are well known tell of a kind's others if so much of the usual share are such
ASKED = 65536  # texels at least, if there are so many
EDGE, EDGE_Z = 0.02, 2.0537  # share of them beyond either end of their range, and that end under a normal distribution
WIDER = 3.0  # a texel is drawn to what is typical by a prior so much wider than they are: others may differ more
KINDS_TELL = 0.5  # of the spread of all: if texels spread less about the means of their kinds, colour tells roughness
UNKNOWN = Typical(0.5, 1e9)


def typical(roughness: F32, sigma: F32, base: F32) -> tuple[Typical, ...]:
    """From what texels say of themselves: roughness and its standard error, (N,) each; ``base``: (N, 3) their colours.

    One for all texels, or one for each kind of colour: where colour tells roughness, and where texels of some kind
    know little.  These may be of another roughness: then nothing is known of them, or, where few know theirs, of all.
    """
    roughness, sigma, base = (a[::max(1, len(a) // ASKED)] for a in (roughness, sigma, base))
    well = sigma < WELL_KNOWN
    if well.sum() < FEW:
        return (UNKNOWN,)
    kinds = colour_kinds(base[None], np.ones((1, len(base)), bool))[0]
    means = _means(roughness, well, kinds)
    mean, spread = _mean_and_spread(roughness[well])
    told = well & ~np.isnan(means[kinds])
    within = max(_mean_and_spread(roughness[told] - means[kinds[told]])[1], WELL_KNOWN)  # means are no better known
    enough = well.sum() >= FEW * KINDS
    if not enough or within > KINDS_TELL * spread:
        means, within = np.where(np.isnan(means), np.nan, mean), spread
        rare = np.bincount(kinds, minlength=KINDS) <= EDGE * len(kinds)
        if not np.isnan(means[~rare]).any():
            return (_prior(mean, spread),)
        if not enough:
            return (UNKNOWN,)
    return tuple(_of_colour(UNKNOWN if np.isnan(means[kind]) else _prior(means[kind], within), base[kinds == kind])
                 for kind in range(KINDS) if (kinds == kind).any())


def _prior(mean: float, spread: float) -> Typical:
    return Typical(round(float(mean), 4), (WIDER * round(spread, 4)) ** 2)  # the same on all machines


def _of_colour(of: Typical, base: F32) -> Typical:
    """The same for texels about these colours, (N, 3)."""
    red, green, blue = (round(float(c), 4) for c in np.sqrt(np.maximum(base, 0)).mean(0, dtype=np.float64))
    return replace(of, colour=(red, green, blue))


def _mean_and_spread(known: F32 | F64) -> tuple[float, float]:
    """Of the roughness of (N,) texels that know it, without those beyond either end of their range."""
    edge = int(EDGE * len(known))
    ordered = np.sort(known).astype(np.float64)
    low, high = ordered[edge], ordered[-1 - edge]
    spread = max(float(high - low) / (2 * EDGE_Z), WELL_KNOWN / WIDER)
    return float(ordered[edge:len(known) - edge].mean()), spread


def _means(roughness: F32, well: Bool, kinds: I32) -> F64:
    """Of each kind of texels, (KINDS,); NaN where fewer are known ``well`` than of the others, (N,) each."""
    found = np.full(KINDS, np.nan)
    for kind in range(KINDS):
        its = kinds == kind
        if its.any() and well[its].mean() > LEAST_SHARE * well.mean():
            found[kind], _ = _mean_and_spread(roughness[its & well])
    return found
