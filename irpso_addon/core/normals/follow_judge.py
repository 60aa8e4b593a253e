"""Whether cameras agree better about a surface once its mesh has followed its refined normals.

Two cameras whose pictures have the same light see the same colour at a place, highlights apart.  Where the mesh is off,
they see two places beside it, and differ where the texture changes.  Tilts know nothing of that: it judges them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..data import F32, I32
from ..evaluation.folds import scatter

ROUNDS = 4
SURE = 3.0  # standard errors
LEAST_CHANGE = 1e-12


@dataclass(frozen=True)
class CameraPair:
    """What two pictures show of N texels, on the mesh as it is given and as it would be."""

    texels: I32  # (N,) numbers
    given: F32  # (C, N) logarithm of the one's radiance over the other's
    moved: F32  # (C, N)


@dataclass(frozen=True)
class Following:
    """The share of the movement under which pictures agree best: 0 as the mesh is given, 1 as it would be."""

    share: float
    error: float  # standard error

    @property
    def pays(self) -> bool:
        """Whether pictures agree better with all of it than with nothing, beyond doubt."""
        return self.share - 0.5 > SURE * self.error


def judged(pairs: Sequence[CameraPair], clusters: I32) -> Following | None:
    """Least squares under Cauchy weights, because of highlights; None where nothing changes.

    ``clusters``: (T,) of each texel: texels of a cluster err alike.
    """
    if not pairs:
        return None
    texels = np.concatenate([pair.texels for pair in pairs])
    given = np.concatenate([pair.given for pair in pairs], axis=1)
    change = given - np.concatenate([pair.moved for pair in pairs], axis=1)
    if not len(texels) or not np.abs(change).max() > LEAST_CHANGE:
        return None
    unit = np.float32(max(1.4826 * float(np.median(np.abs(given))), LEAST_CHANGE))
    share, weight, curvature = np.float32(0), np.ones(len(texels), np.float32), 1.0
    for _ in range(ROUNDS):
        weight = 1 / (1 + (np.abs(given - share * change).max(0) / unit) ** 2)
        curvature = _sum(weight, change, change)
        share = np.float32(_sum(weight, change, given) / curvature)
    force = np.bincount(texels, weight * (change * (given - share * change)).sum(0), len(clusters))
    return Following(float(share), scatter(force, clusters) / curvature)


def _sum(weight: F32, one: F32, other: F32) -> float:
    """Of (C, N) products under (N,) weights."""
    return float((weight * (one * other).sum(0)).sum(dtype=np.float64))
