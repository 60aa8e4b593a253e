"""The ladder of models, and which rung a material needs.

Evidence is the Bayesian information criterion (Schwarz 1978) on the noise that each model leaves.  A texel
alone has too few observations to tell its noise, so that is measured over cells of the material.  And a number
that neighbours or nothing determine costs nothing: each counts as far as the data themselves determined it
(effective parameters, Moody 1992).  With p log n for every number instead, two lobes were seldom believed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .data import F32, I32, Bool

LADDER = ("lambert", "one-lobe", "one-lobe-specular", "one-lobe-metallic", "two-lobe")  # from the smallest
SCALE_IS_KNOWN = 1.0  # nats a texel that a level other than 0.5 must bring beyond all others: lamps' powers are given
EXPLAINED = 0.75  # share of a cell's texels that is heard: those that some model explains best
NUMBERS_OF_TWO = 3  # that two lobes have, base colour aside
CELL = 32  # texels: width of the square over which noise is measured


@dataclass(frozen=True)
class Fit:
    """What one model leaves at (N,) texels."""

    residual: F32  # weighted relative squared residual
    searched: F32  # how many numbers, base colour aside, the data determined


def evidence(observations: F32, fit: Fit, cells: I32, floor: float) -> float:
    """BIC of one model over texels: sum over cells of n log(R / n + floor^2), plus log n for each number determined.

    observations: (N,) good observations of each texel.  cells: (N,) the cell it lies in.  floor: relative error
    below which a better fit is no evidence, the forward model's own.
    """
    n = np.maximum(observations.astype(np.float64), 1.0)
    _, cell = np.unique(cells, return_inverse=True)
    total, residual = np.bincount(cell, n), np.bincount(cell, fit.residual.astype(np.float64))
    return float(np.sum(total * np.log(residual / total + floor**2)) + np.sum(fit.searched * np.log(n)))


def choose(
    observations: F32, fits: Mapping[str, Fit], cells: I32, floor: float, least_gain: float = 0.0,
    scale_known: bool = True,
) -> tuple[str, str]:
    """The model for one material and why, from its texels under each model that was tried.

    ``least_gain``: of the criterion, a texel: what two lobes must bring, where the data hold errors that numbers
    found in each texel can mimic.  (A Specular IOR Level is one number for all of them.)
    ``scale_known``: the lamps' powers are right, so that 0.5 is the level to expect.
    Texels with fewer than three observations say nothing, nor do those that no model explains (edges of shadow would
    drown all others); with none at all the smallest model is taken.
    """
    tried = [name for name in LADDER if name in fits]
    informed = _heard(observations, fits, cells)
    if not informed.any():
        return tried[0], "no texel has three good observations: too few to detect a highlight"
    texels = int(np.count_nonzero(informed))
    score = {}
    for name in tried:
        fit = Fit(fits[name].residual[informed], fits[name].searched[informed])
        score[name] = evidence(observations[informed], fit, cells[informed], floor) / texels
    if "one-lobe-specular" in score and scale_known:
        score["one-lobe-specular"] += SCALE_IS_KNOWN
    best = tried[0]
    for name in tried[1:]:
        if score[name] < score[best] - (least_gain if name == "two-lobe" else 0.0):
            best = name
    others = ", ".join(f"{name} {score[name] - score[best]:+.3g}" for name in tried if name != best)
    return best, f"information criterion per texel, besides {best}: {others} ({texels} texels; smaller is better)"


def _heard(observations: F32, fits: Mapping[str, Fit], cells: I32) -> Bool:
    """Texels with observations enough whose best residual is among the lower EXPLAINED of their cell."""
    enough = np.flatnonzero(observations >= 3.0)
    best = np.min([fit.residual[enough] for fit in fits.values()], axis=0) / observations[enough]
    order = enough[np.lexsort((best, cells[enough]))]  # by cell, the best explained first
    _, first, count = np.unique(cells[order], return_index=True, return_counts=True)
    rank = np.arange(len(order)) - np.repeat(first, count)
    heard = np.zeros(len(observations), bool)
    heard[order[rank < np.ceil(EXPLAINED * np.repeat(count, count))]] = True
    return heard
