"""Base colours of texels, drawn to that of their material as prediction has found it right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...core.data import F32, I32, ONE_BASE, JointPrior
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


def drawn_sigmas(
    sigma: F32, base: F32, observations: F32, slots: I32, names: Sequence[str], priors: Mapping[str, JointPrior],
) -> F32:
    """(h, w) standard errors of the base colours that `draw_bases` makes.  ``sigma``: of texels' own, in ``base``.

    What is drawn keeps a part of a texel's own error, and lacks the rest of what its true colour differs from the
    material's: by what own colours scatter beyond their errors, in the mean of the material.  Where they scatter less
    than their errors, all may be wrong alike by the rest.  One colour for all has that error.
    """
    result = sigma.copy()
    for slot, name in enumerate(names):
        prior = priors.get(name)
        own = (slots == slot) & (observations > 0)
        if prior is not None and prior.base and own.any():
            apart = ((base[own, :3] - np.array(prior.base)) ** 2).mean()
            beyond = float(apart) - float((sigma[own] ** 2).mean())
            texture = abs(beyond) if prior.base_strength >= ONE_BASE else max(beyond, 0.0)
            share = observations[own] / (observations[own] + prior.base_strength)
            result[own] = np.sqrt((share * sigma[own]) ** 2 + (1 - share) ** 2 * texture)
    return result
