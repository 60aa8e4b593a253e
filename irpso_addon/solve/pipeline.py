"""The whole flow: scene -> gbuffer -> observe -> solve -> maps.

Each function is a generator of Progress and must run on the GL thread: ``gpu.device.thread.run`` or ``Job``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping
from dataclasses import replace
from functools import partial
from typing import Protocol

import numpy as np

from ..core import log
from ..core.checks.bounced_light import BouncedSample, why_not
from ..core.checks.camera_changes import camera_changes
from ..core.checks.camera_lines import corrected_cameras
from ..core.checks.mended_cameras import corrected, near
from ..core.checks.residuals import is_indirect
from ..core.checks.solve_checks import left_over
from ..core.checks.warnings import mended, warnings
from ..core.cpu_solver import solver
from ..core.data import Bounced, SceneData, Solution
from ..core.errors import BadInput, Cancelled
from ..core.images.reference_image import read_reference
from ..core.job import Progress
from ..core.params import SolveSettings
from ..core.shading.wide_lamps import with_wide_lamps_as_meshes
from ..gpu.device import thread
from ..gpu.observe.picture_memory import coarser_line, most_pixels
from .kept_images import KeptImages, ReadImage
from .one_round import Outcome, one_round, tried
from .stages import Clock

ALIGN_ROUNDS = 4  # of finding where cameras look
STUCK = 0.75  # of what a camera was off before a round: left over, it says that outlines and shading quarrel
FORETOLD = 1.1  # ratio of errors of lightness of left-out views: less is scatter of the samples
ROUND_SIZE = 512  # texels: of maps that only the next round needs


class Bounce(Protocol):
    """Renders the indirect light of a scene's views from the maps so far."""

    @property
    def direct_only(self) -> bool:
        """The file renders no light that bounces: nor then do pictures that it has rendered hold any."""
        ...

    def __call__(self, scene: SceneData, solution: Solution) -> Generator[Progress, None, Mapping[int, Bounced]]:
        """Of all views, by their place in the scene."""
        ...

    def sample(self, scene: SceneData, solution: Solution) -> Generator[Progress, None, BouncedSample]:
        """How much there is of it: of a few views, quickly."""
        ...


def solve(
    scene: SceneData, settings: SolveSettings, read_image: ReadImage | None = None, bounce: Bounce | None = None,
) -> Generator[Progress, None, Solution]:
    """From a scene's data to its maps.

    ``read_image`` gives a view's reference; None reads its file, reduced where all views together would not fit into
    the memory that the device's settings allow.  ``bounce`` renders indirect light from the maps so far; None: none.
    Cancelled after the first solved tile, it returns the partial maps (``Solution.cancelled``), or those of the round
    before; before that it raises Cancelled.  Raises BadInput for what cannot be used.
    """
    return (yield from log.watched(scene, settings, thread.settings(), _solved(scene, settings, read_image, bounce)))


def _solved(
    scene: SceneData, settings: SolveSettings, read_image: ReadImage | None, bounce: Bounce | None,
) -> Generator[Progress, None, Solution]:
    check_environments(scene, settings)
    if thread.settings().device == "numpy":
        read_image = read_image or partial(read_reference, max_pixels=solver.MOST_PIXELS)
        return (yield from solver.solve(scene, settings, read_image, thread.settings().memory))
    return (yield from outcome(scene, settings, read_image, bounce)).solution


def check_environments(scene: SceneData, settings: SolveSettings) -> None:
    """Raises BadInput where the world or ambient light shines and what is asked for knows lamps alone."""
    if thread.settings().device == "numpy" and any(any(view.ambient_radiance) for view in scene.views):
        raise BadInput("device numpy: works with lamps only, but views have ambient light; choose device opengl, or "
                       "set the views' Ambient Light to 0")
    lit = next((view.environment.title for view in scene.views if view.environment is not None), None)
    if lit is None:
        return
    for what, cure, asked in (
        ("device numpy", "device opengl", thread.settings().device == "numpy"),
        ("method paper", "another method", settings.method == "paper"),
        ("ndf beckmann", "ndf ggx", _two_highlights(settings)),
    ):
        if asked:
            raise BadInput(f"{what}: works with lamps only, but {lit} shines on the views; choose {cure}, or "
                           "take pictures under lamps, with a black world and nothing that glows")


def _two_highlights(settings: SolveSettings) -> bool:
    return settings.ndf == "beckmann" and settings.model in {"two-lobe", "auto"}


def outcome(
    scene: SceneData, settings: SolveSettings, read_image: ReadImage | None = None, bounce: Bounce | None = None,
) -> Generator[Progress, None, Outcome]:
    """As `solve`, with all that it found on the way."""
    from_files, memory = read_image is None, thread.settings().memory
    if settings.method != "paper" and not _two_highlights(settings):  # which know lamps alone
        scene = with_wide_lamps_as_meshes(scene)
    if read_image is None:
        read_image = partial(read_reference, max_pixels=most_pixels(scene.views, memory))
    read_image = KeptImages(read_image)  # views are observed again and again, and large pictures take seconds each
    clock = Clock()
    best = yield from one_round(
        scene, settings, read_image, clock, aligns=settings.registration == "auto" and scene.region is None,
        first=True)
    first = best
    if first.solution.cancelled:
        return _with_cameras(scene, best)
    small = replace(settings, size=min(settings.size, ROUND_SIZE))  # of rounds that only the next one needs
    lines: tuple[str, ...] = ()
    try:
        solve_round = partial(one_round, read_image=read_image, clock=clock, settled=best.judged)
        rough = yield from _align(best, settings, partial(solve_round, settings=small))
        aligned, lit, why = rough.given, None, ""
        if bounce is not None and _may_bounce(settings, scene, rough.solution, bounce):
            lit, why = yield from _take_out_indirect(rough, scene, settings, bounce, solve_round, clock)
        if lit is not None:
            best = lit
        elif aligned is not first.given:
            best = rough if small == settings else (yield from solve_round(aligned, settings))
        best = not_bounced(best, why, tried(settings))
        if aligned is not first.given and first.solution.checks is not None and settings.exposures == "solve":
            lines = mended(first.solution.checks.registration)
        if from_files and settings.method != "paper":  # which searches each texel
            lines += coarser_line(scene, settings.size, memory)
    except Cancelled:  # the maps so far are whole
        best = replace(best, solution=replace(best.solution, cancelled=True))
    except BadInput as error:  # nothing of the first round is lost
        best = _warned(best, (*best.solution.warnings, str(error)))
    best = _with_cameras(scene, _warned(best, (*lines, *best.solution.warnings)))
    return replace(best, solution=replace(best.solution, seconds=clock.seconds))


def _with_cameras(scene: SceneData, best: Outcome) -> Outcome:
    """With what was put right of the cameras of ``scene``; those of a part are the rest's."""
    if scene.region is not None:
        kept = scene.start.cameras if scene.start is not None else ()
        return replace(best, solution=replace(best.solution, cameras=kept))
    checks = best.solution.checks
    cameras = camera_changes(scene, best.given, checks.registration) if checks is not None else ()
    best = _warned(best, (*corrected_cameras(cameras), *best.solution.warnings))
    return replace(best, solution=replace(best.solution, cameras=cameras))


def _warned(best: Outcome, lines: tuple[str, ...]) -> Outcome:
    return replace(best, solution=replace(best.solution, warnings=lines))


def _align(
    best: Outcome, settings: SolveSettings, again: Callable[[SceneData], Generator[Progress, None, Outcome]],
) -> Generator[Progress, None, Outcome]:
    """The scene with cameras and exposures put right as far as the settings let, and what it gives.

    What does not make the maps explain the views better is not kept: one light in the wrong place looks like a shift.
    """
    for n in range(ALIGN_ROUNDS):
        assert best.solution.checks is not None
        misfits, gains = best.solution.checks.registration, settings.exposures == "solve"
        aligned = corrected(best.given, misfits, settings.registration == "auto", gains)
        if aligned is best.given or near(best.given, misfits, gains):
            break
        if n == 0 and settings.size > ROUND_SIZE:  # coarser maps explain less: like is compared with like
            best = yield from again(best.given)
        after = yield from again(aligned)
        if not _better(after, best):
            break
        stuck = not gains and _stuck(after, best)
        best = after
        if stuck:
            break
    return best


def _stuck(after: Outcome, before: Outcome) -> bool:
    """Whether a round has hardly brought the camera nearer that is off the most."""
    assert after.solution.checks is not None and before.solution.checks is not None
    left, had = (max((misfit.pixels for misfit in checks.registration), default=0.0)
                 for checks in (after.solution.checks, before.solution.checks))
    return left > STUCK * had and not any(misfit.warped for misfit in after.solution.checks.registration)


def _better(after: Outcome, before: Outcome) -> bool:
    """Whether maps explain the views better than others of the same size, and predict left-out ones no worse.

    Predictions are judged by lightness, because single highlights make their errors of radiance.  What is worse by less
    than the views are explained better is scatter.
    """
    assert after.solution.checks is not None and before.solution.checks is not None
    foretold = [np.log(max(after.solution.predictions[name].error.lightness, 1e-6) / max(found.error.lightness, 1e-6))
                for name, found in before.solution.predictions.items() if name in after.solution.predictions]
    explained = left_over(before.solution.checks) - left_over(after.solution.checks)
    # All materials together: a view that is put right seldom suits the small sample of each.
    return explained > 0 and (not foretold or float(np.mean(foretold)) < max(np.log(FORETOLD), explained))


def _may_bounce(settings: SolveSettings, scene: SceneData, solution: Solution, bounce: Bounce) -> bool:
    """Whether indirect light is to be rendered; with indirect 'auto', a few small renders have a say in it too.

    Under a world no place is unlit, so that no shadow shows it.
    """
    assert solution.checks is not None
    unlit = solution.checks.unlit_share
    hidden = math.isnan(unlit) and any(view.environment is not None for view in scene.views) and not bounce.direct_only
    return settings.indirect == "on" or (settings.indirect == "auto" and (hidden or is_indirect(unlit)))


def _take_out_indirect(
    best: Outcome, scene: SceneData, settings: SolveSettings, bounce: Bounce,
    solve_round: Callable[..., Generator[Progress, None, Outcome]], clock: Clock,
) -> Generator[Progress, None, tuple[Outcome | None, str]]:
    """The whole round after indirect light was taken out; or none, and why not.

    ``best``: the round so far; ``scene``: as it was given, whose cameras the .blend has.  With indirect 'on' it is
    always taken out.  Else only where a few views say that it is worth the time, and where the maps then explain the
    views better than without it.
    """
    auto, small = settings.indirect == "auto", replace(settings, size=min(settings.size, ROUND_SIZE))
    if any(view.environment is not None for view in scene.views):  # tilts would take up the light that bounces
        small = replace(small, normals="mesh")
    if auto:
        assert best.solution.checks is not None
        sample = yield from clock.stage("indirect_test", bounce.sample(scene, best.solution))
        if why := why_not(sample, best.solution.checks.unlit_share):
            return None, why
        refined = best.solution.normals is not None and small.normals != settings.normals
        if best.solution.maps.roughness.shape[0] > small.size or refined:  # like is compared with like
            best = yield from solve_round(best.given, small)
    bounced = yield from clock.stage("indirect", bounce(scene, best.solution))
    rough = yield from solve_round(best.given, small, bounced=bounced)
    if auto and not _better(rough, best):
        return None, "subtracting bounced light did not improve the fit"
    bounced = yield from clock.stage("indirect", bounce(scene, rough.solution))
    return (yield from solve_round(best.given, settings, bounced=bounced)), ""


def not_bounced(best: Outcome, why: str, tried: tuple[str, ...]) -> Outcome:
    """With the reason, if there is one, for which indirect light was not taken out."""
    checks = best.solution.checks
    if not why or checks is None:
        return best
    log.info("indirect", why=why)
    now = replace(checks, not_bounced=why)
    changed = dict(zip(warnings(checks, tried), warnings(now, tried), strict=True))
    return replace(best, solution=replace(
        best.solution, checks=now, warnings=tuple(changed.get(line, line) for line in best.solution.warnings)))
