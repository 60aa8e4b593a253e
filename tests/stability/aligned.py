"""The product's rounds of solving, checking and putting cameras and exposures right (irpso_addon/pipeline.py, solve).

Where the product moves a camera, the picture is moved here: the texels are the cameras' pixels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from irpso_addon.core.advice import mended
from irpso_addon.core.checks import Checks
from irpso_addon.core.data import F64
from irpso_addon.pipeline import ALIGN_ROUNDS

from .methods import Answer
from .problem import Problem
from .spoil import shifted
from .warned import checks_of


def rounds(
    problem: Problem, solve: Callable[[Problem], Answer], exposures: bool,
) -> tuple[Answer, Checks, tuple[str, ...]]:
    """(answer, its checks, what was put right before it, in words): cameras always, exposures where asked."""
    shift, gain = np.zeros((problem.trial.views, 2)), np.ones(problem.trial.views)
    answer = solve(problem)
    first = checks = checks_of(problem, answer)
    for _ in range(ALIGN_ROUNDS):
        changed = False
        for k, misfit in enumerate(checks.registration):
            if misfit.shifted:
                shift[k] += misfit.shift
                changed = True
            if exposures and misfit.drifted:
                gain[k] *= misfit.gain
                changed = True
        if not changed:
            break
        better = _mended(problem, shift, gain)
        answer = solve(better)
        checks = checks_of(better, answer)
    return answer, checks, mended(first, True, exposures)


def _mended(problem: Problem, shift: F64, gain: F64) -> Problem:
    rgb, quality, radiance = (a.copy() for a in (problem.rgb, problem.quality, problem.radiance))
    for k in range(problem.trial.views):
        picture = problem.radiance[:, :, k].astype(np.float64)
        lost = shifted(np.isnan(picture).astype(np.float64), shift[k]).max(-1) > 0.01
        picture = shifted(np.nan_to_num(picture), shift[k]) / gain[k]
        quality[..., k] = np.where(lost, 0.0, quality[..., k])
        radiance[:, :, k] = np.where(lost[..., None], np.nan, picture)
        seen = (quality[..., k] > 0)[..., None]
        rgb[:, :, k] = np.where(seen, picture / np.maximum(problem.irradiance[:, :, k], 1e-9), 0.0)
    return replace(problem, rgb=rgb, quality=quality, radiance=radiance)
