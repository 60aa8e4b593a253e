"""What the product would warn of after a solve: solve_checks.py and warnings.py on the problem's views."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from irpso_addon.core.check_records import Checks
from irpso_addon.core.checks.solve_checks import TexelFit, measure
from irpso_addon.core.checks.view_check_data import CheckedView, PixelWindow
from irpso_addon.core.checks.warnings import warnings
from irpso_addon.core.data import Camera, Light, View
from irpso_addon.core.phrases import percent
from irpso_addon.solve.one_round import unfit

from .methods import Answer, predicted
from .problem import Problem

KINDS = {  # words of a warning -> its kind in the atlas; the first that fits
    "non-linear": "not linear", "pixels off": "registration", "check its p": "light", "appear elsewhere": "light",
    "exposure": "exposure", "brighter or darker": "exposure", "shadows are": "indirect light",
    "clipped": "clipped", "highlights are off": "misfit", "unexplained": "misfit",
    "no model": "no model fits", "good observations": "few observations", "highlight": "no highlight",
    "lit in no view": "not seen",
}
UNSEEN = 0.05  # irpso_addon/solve/one_round.py: share of texels seen by no view


def warned(answer: Answer, checks: Checks, mended: Sequence[str] = ()) -> list[tuple[str, str]]:
    """(kind, text) of each warning; ``mended``: what was put right before these checks."""
    found = [*mended, *warnings(checks)]
    if answer.prediction is not None and not answer.prediction.fits:
        found.append(unfit("Paint", answer.prediction))
    if (~answer.solved).mean() > UNSEEN:
        found = [f"patch: {percent((~answer.solved).mean())} of its texels are lit in no view", *found]
    return [(kind_of(text), text) for text in found]


def checks_of(problem: Problem, answer: Answer, views: Sequence[View] = ()) -> Checks:
    """As irpso_addon/solve/one_round.py, _checks; ``views``: the problem's, where they were put right."""
    assert answer.observed is not None and answer.sigma is not None
    return measure(checked_views(problem, answer, views or views_of(problem)), TexelFit(
        "patch", {"Paint": answer.model}, np.zeros(answer.solved.shape, np.int32), ("Paint",), answer.solved,
        answer.observed, answer.roughness.astype(np.float32), answer.sigma,
        misfit=answer.prediction is not None and not answer.prediction.clear))


def kind_of(text: str) -> str:
    """What a warning is about."""
    return next((kind for words, kind in KINDS.items() if words in text), "other")


def checked_views(problem: Problem, answer: Answer, views: Sequence[View]) -> Iterator[CheckedView]:
    """Each view beside what the estimate says that it should show; the texels are the cameras' pixels."""
    h, w = problem.quality.shape[:2]
    believed = problem.believed
    at = (np.stack(np.meshgrid(np.arange(w), np.arange(h)), -1) + 0.5) / (w, h)
    windows: dict[str, PixelWindow] = {}
    for k, seen in enumerate(views):
        camera = seen.camera.name
        cos_v = problem.cos_v[..., k]
        if camera not in windows:
            windows[camera] = PixelWindow((0, 0), (w, h), np.ones((h, w), bool), believed.place.astype(np.float32),
                                     believed.normal.astype(np.float32), at.astype(np.float32),
                                     np.zeros((h, w), np.float32), cos_v)
        specular, white = predicted(problem, answer, k)
        quality = problem.quality[..., k]
        yield CheckedView(
            view=seen, window=windows[camera], observed=problem.rgb[:, :, k],
            predicted=(answer.base * white + specular).astype(np.float32), specular=specular.astype(np.float32),
            quality=quality,
            edge=quality <= 0, unlit=problem.unlit[..., k], radiance=problem.radiance[:, :, k],
            irradiance=np.where((quality > 0)[..., None], problem.irradiance[:, :, k], np.float32(0)),
            sin2h=problem.lobes[:, :, k, 0, 0], coverage=np.ones((h, w), np.float32),
            clipped=float(problem.clipped[k]))


def views_of(problem: Problem) -> tuple[View, ...]:
    """The problem's views as the pipeline has them; the identity for a projection."""
    return tuple(_view(problem, k, camera) for k, camera in enumerate(problem.groups))


def _view(problem: Problem, k: int, camera: int) -> View:
    place = problem.believed.cameras[camera]
    matrix = np.eye(4)
    lamp = problem.believed.lamps[k]
    matrix[:3, 3] = lamp if lamp.ndim == 1 else lamp.mean((0, 1))
    seen = Camera(f"camera {camera + 1}", np.eye(4), np.eye(4), place, -place / np.linalg.norm(place), False, 1.0)
    return View(Path(f"view_{k + 1:02}"), seen, (Light(f"lamp {k + 1}", "POINT", problem.believed.power[k], matrix),))
