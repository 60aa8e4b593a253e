"""The whole flow: scene -> gbuffer -> observe -> solve -> maps.

Each function is a generator of Progress and must run on the GL thread: ``gpu.device.thread.run`` or ``Job``.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from ..core import log
from ..core.calibration.calibrate import Judged
from ..core.check_records import Checks, Misfit
from ..core.checks.bounced_light import BouncedSample, why_not
from ..core.checks.calibration_lines import calibrated
from ..core.checks.mended_cameras import corrected
from ..core.checks.normals_line import refined
from ..core.checks.residuals import is_indirect
from ..core.checks.solve_checks import TexelFit, left_over, measure
from ..core.checks.warnings import grouped, mended, warnings
from ..core.cpu_solver import solver
from ..core.data import (
    F32,
    Bool,
    Bounced,
    Calibration,
    Maps,
    MaterialPrediction,
    RefinedNormals,
    SceneData,
    Solution,
    ViewPicture,
)
from ..core.errors import BadInput, Cancelled
from ..core.images.reference_image import read_reference
from ..core.job import Progress
from ..core.normals.tangent_map import encoded
from ..core.params import SolveSettings
from ..core.phrases import percent
from ..core.tiled.tiled_plan import Noise
from ..gpu.device import thread
from ..gpu.device.context import Device
from ..gpu.gbuffer.drawn_outline import DrawnOutline
from ..gpu.gbuffer.gbuffer import overlap_counts
from ..gpu.maps.check_views import check_views, with_view_pictures
from ..gpu.maps.finish_maps import FinishedMaps
from ..gpu.maps.partial_solve import PartialSolve, earlier_result_of, partial_solve_of
from ..gpu.observe.picture_memory import most_pixels
from .gpu_path import Clock, Given, ReadImage, Solved, TexelGrid, draw_texels, solve_grid

ALIGN_ROUNDS = 4  # of finding where cameras look
NEAR = 0.05  # pixels that a camera may be off after a round that put it right: no other round is worth its time
FORETOLD = 1.1  # ratio of errors of lightness of left-out views: less is scatter of the samples
ROUND_SIZE = 512  # texels: of maps that only the next round needs
NO_CONFIDENCE = "method paper: gives no uncertainty; confidence is 0 and the standard errors are 0.5 everywhere"



class Bounce(Protocol):
    """Renders the indirect light of a scene's views from the maps so far."""

    def __call__(self, scene: SceneData, solution: Solution) -> Generator[Progress, None, Mapping[int, Bounced]]:
        """Of all views, by their place in the scene."""
        ...

    def sample(self, scene: SceneData, solution: Solution) -> Generator[Progress, None, BouncedSample]:
        """How much there is of it: of a few views, quickly."""
        ...


@dataclass(frozen=True)
class GBuffer:
    """The texel grid as arrays, row 0 at the bottom; zero where not covered."""

    position: F32  # (n, n, 3) world, metres
    normal: F32  # (n, n, 3) world, unit, normal map included
    coverage: Bool  # (n, n)
    overlap: Bool  # (n, n) more than one triangle claims the texel


@dataclass(frozen=True)
class Outcome:
    """What a solve has found of its scene as a whole, beside the maps."""

    scene: SceneData  # cameras, lamps and exposures put right
    given: SceneData  # the same, lamps and exposures as they were given
    solution: Solution
    level: float  # typical radiance of the views
    noise: Mapping[int, Noise]  # by the number of lobes
    robust: bool  # whether outliers were disbelieved
    bounced: Mapping[int, Bounced] | None  # indirect light by the view's place in the scene
    judged: Judged | None  # what was put right of lamps and exposures


def bake_gbuffer(scene: SceneData, size: int) -> Generator[Progress, None, GBuffer]:
    """Position, normal and coverage of every texel.

    Raises BadInput when no texel of the UV square is covered.
    """
    device = thread.device()
    with device.scope():
        grid = draw_texels(device, scene.mesh, size)
        yield Progress(0.5, "gbuffer")
        gbuffer = _checked(device, grid, scene.mesh.name, size)
        yield Progress(1.0, "gbuffer")
        return gbuffer


def _checked(device: Device, grid: TexelGrid, name: str, size: int) -> GBuffer:
    """The texel grid as arrays.  Raises BadInput when no texel of the UV square is covered."""
    if not grid.coverage.any():
        raise BadInput(f"{name}: no face covers a texel of the 0-1 UV square at {size} x {size}; "
                       "unwrap the mesh (UV > Smart UV Project)")
    overlap = overlap_counts(device, grid.mesh, size) > 1.5
    return GBuffer(grid.position, grid.normal, grid.coverage, overlap & grid.coverage)


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
        ("ndf beckmann", "ndf ggx", settings.ndf == "beckmann" and settings.model in {"two-lobe", "auto"}),
    ):
        if asked:
            raise BadInput(f"{what}: works with lamps only, but {lit} shines on the views; choose {cure}, or "
                           "take pictures under lamps, with a black world and nothing that glows")


def outcome(
    scene: SceneData, settings: SolveSettings, read_image: ReadImage | None = None, bounce: Bounce | None = None,
) -> Generator[Progress, None, Outcome]:
    """As `solve`, with all that it found on the way."""
    if read_image is None:
        read_image = partial(read_reference, max_pixels=most_pixels(scene.views, thread.settings().memory))
    clock = Clock()
    best = yield from _round(scene, settings, read_image, clock)
    first = best.solution
    if first.cancelled:
        return best
    small = replace(settings, size=min(settings.size, ROUND_SIZE))  # of rounds that only the next one needs
    try:
        solve_round = partial(_round, read_image=read_image, clock=clock, settled=best.judged)
        rough = yield from _align(best, settings, partial(solve_round, settings=small))
        aligned, lit, why = rough.given, None, ""
        if bounce is not None and _bounced(settings, rough.solution):
            lit, why = yield from _take_out_indirect(rough, scene, settings, bounce, solve_round, clock)
        if lit is not None:
            best = lit
        elif aligned is not scene:
            best = rough if small == settings else (yield from solve_round(aligned, settings))
        best = _not_bounced(best, why, _tried(settings))
        if aligned is not scene and first.checks is not None:
            lines = mended(first.checks, settings.registration == "auto", settings.exposures == "solve")
            best = _warned(best, (*lines, *best.solution.warnings))
    except Cancelled:  # the maps so far are whole
        best = replace(best, solution=replace(best.solution, cancelled=True))
    except BadInput as error:  # nothing of the first round is lost
        best = _warned(best, (*best.solution.warnings, str(error)))
    return replace(best, solution=replace(best.solution, seconds=clock.seconds))


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
        aligned = corrected(best.given, best.solution.checks.registration, shifts=settings.registration == "auto",
                            gains=settings.exposures == "solve")
        if aligned is best.given or (
                n > 0 and _near(best.solution.checks.registration, gains=settings.exposures == "solve")):
            break
        if n == 0 and settings.size > ROUND_SIZE:  # coarser maps explain less: like is compared with like
            best = yield from again(best.given)
        after = yield from again(aligned)
        if not _better(after, best):
            break
        best = after
    return best


def _near(misfits: Sequence[Misfit], gains: bool) -> bool:
    """Whether cameras (``gains``: and exposures) that were put right are off by less than is worth another round."""
    return not any(misfit.warped or misfit.pixels > NEAR or (gains and misfit.drifted) for misfit in misfits)


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


def _bounced(settings: SolveSettings, solution: Solution) -> bool:
    """Whether indirect light is to be rendered."""
    assert solution.checks is not None
    return settings.indirect == "on" or (settings.indirect == "auto" and is_indirect(solution.checks.unlit_share))


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
    if auto:
        assert best.solution.checks is not None
        sample = yield from clock.stage("indirect_test", bounce.sample(scene, best.solution))
        if why := why_not(sample, best.solution.checks.unlit_share):
            return None, why
        if best.solution.maps.roughness.shape[0] > small.size:  # like is compared with like
            best = yield from solve_round(best.given, small)
    bounced = yield from clock.stage("indirect", bounce(scene, best.solution))
    rough = yield from solve_round(best.given, small, bounced=bounced)
    if auto and not _better(rough, best):
        return None, "subtracting bounced light did not improve the fit"
    bounced = yield from clock.stage("indirect", bounce(scene, rough.solution))
    return (yield from solve_round(best.given, settings, bounced=bounced)), ""


def _tried(settings: SolveSettings) -> tuple[str, ...]:
    """Settings by which the solve puts right what `warnings` are about."""
    tried = {"registration": settings.registration == "auto", "exposures": settings.exposures == "solve"}
    return tuple(name for name, does in tried.items() if does)


def _not_bounced(best: Outcome, why: str, tried: tuple[str, ...]) -> Outcome:
    """With the reason, if there is one, for which indirect light was not taken out."""
    checks = best.solution.checks
    if not why or checks is None:
        return best
    log.info("indirect", why=why)
    now = replace(checks, not_bounced=why)
    changed = dict(zip(warnings(checks, tried), warnings(now, tried), strict=True))
    return replace(best, solution=replace(
        best.solution, checks=now, warnings=tuple(changed.get(line, line) for line in best.solution.warnings)))


def _round(
    scene: SceneData, settings: SolveSettings, read_image: ReadImage, clock: Clock,
    bounced: Mapping[int, Bounced] | None = None, settled: Judged | None = None,
) -> Generator[Progress, None, Outcome]:
    """One solve of the scene as it is given.

    ``bounced``: indirect light, by the view's place in the scene.  ``settled``: which numbers of lamps and exposures an
    earlier round has put right.
    """
    device = thread.device()
    with device.scope():
        drawn = yield from clock.stage("gbuffer", _drawn(device, scene, settings.size))
        grid, gbuffer = drawn
        clock.coverage = grid.coverage
        part = partial_solve_of(device, scene, settings.size, grid.position, grid.slots)
        last = earlier_result_of(part, scene, settings, grid.slots)
        solved = yield from solve_grid(
            device, grid, Given(
                scene, settings, read_image, part, last, bounced, settled=settled,
                calibrates=scene.region is None), clock)
        checks, pictures = yield from clock.stage("maps", _checks(scene, settings, solved.made, grid))
        solution = _solution(scene, settings, gbuffer, solved, part)
        normals = _normals(grid, solved)
        if normals is not None or _keeps_normals(scene):
            solution = replace(solution, maps=replace(
                solution.maps, normal=encoded(scene.mesh, solved.grid.normal, grid.coverage)))
        lines = (*calibrated(solved.calibration), *refined(normals), *solution.warnings,
                 *warnings(checks, _tried(settings)), *([NO_CONFIDENCE] if settings.method == "paper" else []))
        solution = replace(
            solution, seconds=clock.seconds, device=device.describe(), checks=checks, pictures=pictures,
            calibration=_calibration(scene, solved), warnings=lines, normals=normals,
            normals_why=solved.normals if isinstance(solved.normals, str) else "")
        return Outcome(
            solved.scene, scene, solution, solved.observations.level, solved.ladder.noise, solved.ladder.robust,
            bounced, solved.judged)


def _normals(given: TexelGrid, solved: Solved) -> RefinedNormals | None:
    """What is to be said of normals that were refined."""
    judged = solved.normals
    if isinstance(judged, str):
        return None
    texels = given.coverage & solved.grid.coverage
    cosine = (given.normal[texels] * solved.grid.normal[texels]).sum(-1, dtype=np.float64)
    tilt = float(np.median(np.degrees(np.arccos(np.clip(cosine, -1, 1)))))
    return RefinedNormals(tilt, judged.given, judged.refined)


def _keeps_normals(scene: SceneData) -> bool:
    """Whether a part is solved, under the normals that the last result has."""
    return scene.region is not None and scene.start is not None and scene.start.maps.normal is not None


def _calibration(scene: SceneData, solved: Solved) -> Calibration | None:
    """What was put right; a part is lit as the rest was."""
    if scene.region is not None and scene.start is not None:
        return scene.start.calibration
    return solved.calibration


def _drawn(device: Device, scene: SceneData, size: int) -> Generator[Progress, None, tuple[TexelGrid, GBuffer]]:
    """The mesh and its G-buffer, on the device and as arrays."""
    grid = draw_texels(device, scene.mesh, size)
    yield Progress(0.5, "gbuffer")
    gbuffer = _checked(device, grid, scene.mesh.name, size)
    yield Progress(1.0, "gbuffer")
    return grid, gbuffer


def _solution(
    scene: SceneData, settings: SolveSettings, gbuffer: GBuffer, solved: Solved, part: PartialSolve,
) -> Solution:
    """The maps with their figures; checks, and the warnings that follow from these, are not in it yet."""
    made, observations = solved.made, solved.observations
    ladder, maps = made.ladder, made.maps
    relative = made.relative[made.solved].astype(np.float64)
    return Solution(
        maps=maps, model=ladder.model, why=ladder.why, seconds={}, device={}, levels=ladder.levels,
        metallic=ladder.metallic, coats=ladder.coats,
        predictions=ladder.predictions, priors=ladder.priors,
        residual=float(np.sqrt(np.mean(relative**2))) if len(relative) else 0.0,
        cancelled=ladder.cancelled or made.albedo.cancelled, ndf=settings.ndf,
        texels={"covered": int(gbuffer.coverage.sum()), "observed": int((made.solved | made.shown).sum()),
                "solved": int(made.good.sum()), "filled": int((gbuffer.coverage & maps.filled).sum()),
                "kept": int((part.known & ~made.good).sum())},
        views_used=tuple(v.view.image.name for c in observations.cameras for v in c.views),
        views_skipped=scene.skipped + observations.skipped,
        warnings=(*scene.warnings, *grouped(observations.warnings), *_warnings(scene, gbuffer, maps, settings.udim),
                  *(unfit(name, found) for name, found in ladder.predictions.items() if not found.fits)))


def _checks(
    scene: SceneData, settings: SolveSettings, made: FinishedMaps, grid: TexelGrid,
) -> Generator[Progress, None, tuple[Checks, tuple[ViewPicture, ...]]]:
    """What the views say of the maps, and how they look beside what those predict."""
    pictures: list[ViewPicture] = []
    outline = None if scene.region is not None else DrawnOutline(  # that of a part is not the object's
        made.albedo.device, grid.mesh, scene.occluders, scene.pixel_filter)
    views = with_view_pictures(check_views(made.albedo, made.base, outline), pictures)
    texels = TexelFit(scene.mesh.name, made.ladder.model, grid.slots, scene.mesh.slot_names, made.good,
                      made.ladder.texels.observations, made.maps.roughness, made.maps.roughness_sigma,
                      sure=settings.method != "paper", chosen=settings.model == "auto",
                      misfit=any(not found.clear for found in made.ladder.predictions.values()))
    yield Progress(1.0, "maps", "checks")
    return measure(views, texels), tuple(pictures)


def unfit(name: str, prediction: MaterialPrediction) -> str:
    """What to say of a material that no model explains."""
    error = prediction.error
    return (f"material '{name}': no model predicts left-out {prediction.left_out} (off by "
            f"{percent(error.relative_rms)} of the radiance, {error.lightness:.0f} L*), so its confidence is 0; IRPSO "
            "cannot solve for materials that are translucent, move or mirror their surroundings, or for other light "
            "than the lamps'")


def _warnings(scene: SceneData, gbuffer: GBuffer, maps: Maps, udim: str) -> list[str]:
    """What a user must know of the mesh before trusting the maps."""
    covered = max(int(gbuffer.coverage.sum()), 1)
    name = scene.mesh.name
    lines = []
    overlap = gbuffer.overlap.sum() / covered
    if overlap > 0.001:
        lines.append(f"{name}: {100 * overlap:.1f} % of its texels are claimed by more than one face "
                     "(overlapping UVs); they show one face's result")
    grid = scene.mesh.uvs if scene.mesh.grid is None else scene.mesh.grid
    outside = np.mean(np.any((grid < -1e-4) | (grid > 1 + 1e-4), axis=(1, 2)))
    if outside > 0:
        where = "outside the 0-1 UV square" if udim == "first" else "in no UDIM square"
        lines.append(f"{name}: {100 * outside:.1f} % of its faces are {where} and are not solved"
                     + ("; set UDIM to All to solve every square" if udim == "first" else ""))
    unseen = (gbuffer.coverage & maps.filled).sum() / covered
    if unseen > 0.05:
        lines.append(f"{name}: {100 * unseen:.0f} % of its texels are lit in no view, so IRPSO filled them from their "
                     "neighbours")
    return lines
