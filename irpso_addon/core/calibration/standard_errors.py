"""Standard errors of a rig's change: how far fits to two parts of the observations are from each other.

What observations leave over says how far a change is off by noise.  It says nothing of what many of them have in
common: a pixel that is wider than a texel, a roughness that is not quite found, a normal between two vertices.  Such
errors differ from part to part.  So a fit to each of two parts is made, and all errors grow until they explain by how
much the two differ (a balanced half sample: Kish and Frankel, J. R. Stat. Soc. B 36, 1974).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..job import Steps, share_of
from .rig_fit import RigFound, fit_rig
from .rig_numbers import Free
from .rig_sample import RigSample

COMMON = 1.5  # times what the parts show: they have errors in common too (python -m studies.standard_errors)


def unexplained(sample: RigSample, free: Free, found: RigFound) -> Steps[float]:
    """What standard errors of ``found``, fitted to ``sample``, are multiplied by to explain its parts; 1 or more."""
    factor = 1.0
    for pair in parts_of(sample):
        if min(len(part.slot) for part in pair) == 0:
            continue
        one = yield from share_of(fit_rig(pair[0], free, start=found), 1.0, 1.0)
        other = yield from share_of(fit_rig(pair[1], free, start=found), 1.0, 1.0)
        factor = max(factor, _apart(one, other))
    return factor


def parts_of(sample: RigSample) -> list[tuple[RigSample, RigSample]]:
    """Texels on both sides of the middle; and observations under light that falls on a texel steeper, and flatter."""
    texels, longest = sample.texels, int(np.ptp(sample.position, axis=0).argmax())
    along = sample.position[:, longest]
    beyond = along > np.median(along)
    light = np.maximum(texels.lobes[..., 3], 1e-12)
    steep = (texels.lobes[..., 2] * light).sum(-1) / light.sum(-1)
    seen = texels.quality > 0
    seen[~seen.any(1)] = True  # of texels that nothing shows, any side does
    steeper = steep > np.nanmedian(np.where(seen, steep, np.nan), axis=1, keepdims=True)
    return [(sample.part(beyond), sample.part(~beyond)), (_seen(sample, steeper), _seen(sample, ~steeper))]


def _seen(sample: RigSample, some: np.ndarray) -> RigSample:
    """``some``: (T, V) observations."""
    texels = sample.texels
    return sample.showing(replace(texels, quality=np.where(some, texels.quality, 0.0)), sample.shade)


def _apart(one: RigFound, other: RigFound) -> float:
    """Root mean square of the differences between places, or else exposures, over their standard errors."""
    for name in ("offset", "log_gain"):
        error = np.hypot(getattr(one.error, name), getattr(other.error, name))
        free = error > 0
        if free.any():
            off = (getattr(one.change, name) - getattr(other.change, name))[free] / error[free]
            return float(np.sqrt(np.mean(off**2)))
    return 1.0
