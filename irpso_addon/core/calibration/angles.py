"""Whether views show surfaces under angles that other views show too."""

from __future__ import annotations

import numpy as np

from ..data import F64
from ..vectors import summed
from .rig_sample import RigSample

OWN = 0.05  # share of the angles' variance that lies within views: below it, each view has angles of its own
LEAST = 1e-12


def angles_overlap(sample: RigSample) -> bool:
    """Whether views have angles in common: else how bright each view is may be its exposure, or all of its material.

    A flat object under suns shows each of them one angle.  A coat that it has then shines in some views everywhere.
    """
    return bool(min(_within(sample, angle) for angle in _angles(sample)) > OWN)


def _angles(sample: RigSample) -> tuple[F64, F64]:
    """(T, V) each, sines: of the angle between normal and half vector, and of that between normal and lamps."""
    lobes = sample.texels.lobes
    light = lobes[..., 3] / np.maximum(summed(lobes[..., 3])[..., None], LEAST)
    half, cosine = (np.clip(summed(lobes[..., k] * light), 0.0, 1.0) for k in (0, 2))
    return np.sqrt(half), np.sqrt(1 - cosine**2)


def _within(sample: RigSample, angle: F64) -> float:
    """Share of the variance of an angle, (T, V), that lies within views."""
    usable = sample.texels.usable()
    within = whole = 0.0
    middle = float(angle[usable].mean()) if usable.any() else 0.0
    for place in np.unique(sample.view):
        own = angle[:, sample.view == place][usable[:, sample.view == place]]
        if len(own):
            within += float(((own - own.mean()) ** 2).sum())
            whole += float(((own - middle) ** 2).sum())
    return within / max(whole, LEAST)
