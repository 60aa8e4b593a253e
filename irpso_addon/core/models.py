"""The ladder of models, and which rung a material needs.

The Bayesian information criterion (Schwarz 1978) is summed over a material's texels: a single texel
has too few observations to tell.
"""

from __future__ import annotations

import numpy as np

from .data import F32

PARAMETERS = {"lambert": 3, "one-lobe": 4}  # numbers solved for at each texel
FLOOR = 0.003  # relative error below which a better fit is no evidence: the forward model's own


def evidence(observations: F32, residual: F32, parameters: int) -> float:
    """BIC of one model over texels: sum of n log(R / n + floor^2) + p log n.

    observations, residual: (N,) good observations and weighted relative squared residual of each texel.
    """
    n = np.maximum(observations.astype(np.float64), 1.0)
    return float(np.sum(n * np.log(residual / n + FLOOR**2) + parameters * np.log(n)))


def choose(observations: F32, residual: F32, lambert_residual: F32) -> tuple[str, str]:
    """The model for one material and why, from its solved texels.

    Texels with fewer than three observations say nothing; with none at all the smaller model is taken.
    """
    told = observations >= 3.0
    if not told.any():
        return "lambert", "no texel has three good observations: too few to tell a lobe from none"
    smaller = evidence(observations[told], lambert_residual[told], PARAMETERS["lambert"])
    larger = evidence(observations[told], residual[told], PARAMETERS["one-lobe"])
    name = "one-lobe" if larger < smaller else "lambert"
    gain = (smaller - larger) / float(np.count_nonzero(told))
    texels = np.count_nonzero(told)
    return name, f"a specular lobe changes the information criterion by {-gain:.3g} a texel ({texels} texels)"
