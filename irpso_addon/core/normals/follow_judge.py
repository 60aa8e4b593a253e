"""Whether cameras agree better about a surface once its mesh has followed its refined normals.

Two cameras whose pictures have the same light see the same colour at a place, highlights apart.  Where the mesh is off,
they see two places beside it, and differ where the texture changes.  Tilts know nothing of that: it judges them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..data import F64, I32
from ..evaluation.folds import scatter

ROUNDS = 4
SURE = 3.0  # standard errors
LEAST_CHANGE = 1e-12


@dataclass(frozen=True)
class CameraPair:
    """What two pictures show of N texels, on the mesh as it is given and as it would be."""

    texels: I32  # (N,) numbers
    given: F64  # (N, C) logarithm of the one's radiance over the other's
    moved: F64  # (N, C)


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
    given = np.concatenate([pair.given for pair in pairs])
    change = given - np.concatenate([pair.moved for pair in pairs])
    if not len(given) or not np.abs(change).max() > LEAST_CHANGE:
        return None
    unit = max(1.4826 * float(np.median(np.abs(given))), LEAST_CHANGE)
    share, weight, curvature = 0.0, np.ones((len(given), 1)), 1.0
    for _ in range(ROUNDS):
        weight = 1 / (1 + (np.abs(given - share * change).max(1, keepdims=True) / unit) ** 2)
        curvature = float((weight * change**2).sum())
        share = float((weight * change * given).sum()) / curvature
    force = np.bincount(texels, (weight * change * (given - share * change)).sum(1), len(clusters))
    return Following(share, scatter(force, clusters) / curvature)
