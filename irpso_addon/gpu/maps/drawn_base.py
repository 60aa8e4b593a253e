"""Base colours of texels, drawn to that of their material as prediction has found it right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...core.data import F32, I32, JointPrior
from ...core.evaluation.sampled_texels import drawn_to


def draw_bases(
    base: F32, observations: F32, slots: I32, names: Sequence[str], priors: Mapping[str, JointPrior],
) -> F32:
    """(h, w, C) base colour, of which the first three channels are drawn where a material has such a prior.

    ``observations``: (h, w) good ones.  ``slots``: (h, w) material of each texel, one of the ``names``, -1 elsewhere.
    """
    result = base.copy()
    for slot, name in enumerate(names):
        prior = priors.get(name)
        if prior is not None and prior.base:
            own = slots == slot
            result[own, :3] = drawn_to(base[own, :3].astype(np.float64), observations[own, None].astype(np.float64),
                                       np.array(prior.base), prior.base_strength)
    return result
