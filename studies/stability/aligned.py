"""The product's rounds of solving, checking and putting cameras and exposures right (solve/pipeline.py).

Where the product moves a camera, the picture is moved here: the texels are the cameras' pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from irpso_addon.core.check_records import Checks
from irpso_addon.core.checks.camera_changes import camera_changes
from irpso_addon.core.checks.camera_lines import corrected_cameras
from irpso_addon.core.checks.mended_cameras import corrected
from irpso_addon.core.checks.solve_checks import left_over
from irpso_addon.core.checks.warnings import mended
from irpso_addon.core.data import SceneData, View
from irpso_addon.solve.pipeline import ALIGN_ROUNDS
from tests.support.synthetic import plane_mesh

from .methods import Answer
from .problem import Problem
from .spoil import shifted
from .warned import checks_of, views_of


def rounds(
    problem: Problem, solve: Callable[[Problem], Answer], exposures: bool,
) -> tuple[Answer, Checks, tuple[str, ...]]:
    """(answer, its checks, what was put right before it, in words): cameras always, exposures where asked."""
    given = scene = SceneData("patch", plane_mesh(), np.zeros((0, 3, 3), np.float32), views_of(problem))
    answer = solve(problem)
    first = checks = checks_of(problem, answer)
    for _ in range(ALIGN_ROUNDS):
        better = corrected(scene, checks.registration, shifts=True, gains=exposures)
        if better is scene:
            break
        mended_problem = _mended(problem, better.views)
        there = solve(mended_problem)
        told = checks_of(mended_problem, there, better.views)
        if left_over(told) >= left_over(checks):
            break
        scene, answer, checks = better, there, told
    lines = corrected_cameras(camera_changes(given, scene, checks.registration))
    return answer, checks, (*lines, *(mended(first.registration) if exposures and scene is not given else ()))


def _mended(problem: Problem, views: Sequence[View]) -> Problem:
    """With pictures moved by what the views' projections were, and divided by their gains."""
    h, w = problem.quality.shape[:2]
    shift = np.stack([view.camera.projection[:2, 3] for view in views]) * (w / 2, h / 2)
    gain = [view.gain for view in views]
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
