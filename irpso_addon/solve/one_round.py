"""One round of a solve: the scene as it is given, once from its G-buffer to its maps and what the views say of them.

Each function is a generator of Progress and must run on the GL thread, as in `pipeline`.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from ..core.calibration.finish import Judged
from ..core.change_records import Calibration, RefinedNormals
from ..core.check_records import Checks
from ..core.checks.calibration_lines import calibrated, worlds_in_doubt
from ..core.checks.normals_line import refined
from ..core.checks.solve_checks import Measured, TexelFit
from ..core.checks.warnings import grouped, warnings
from ..core.data import F32, Bool, Bounced, Maps, MaterialPrediction, MeshArrays, SceneData, Solution, ViewPicture
from ..core.errors import BadInput, Cancelled
from ..core.job import Progress
from ..core.normals.tangent_map import encoded
from ..core.params import SolveSettings
from ..core.phrases import percent
from ..core.resampling import on_grid
from ..core.tiled.tiled_plan import Noise
from ..gpu.device import thread
from ..gpu.device.context import Device
from ..gpu.gbuffer.drawn_outline import DrawnOutline
from ..gpu.gbuffer.gbuffer import overlap_counts
from ..gpu.gbuffer.texel_grid import TexelGrid, draw_texels
from ..gpu.maps.check_views import check_views, with_view_pictures
from ..gpu.maps.finish_maps import FinishedMaps
from ..gpu.maps.partial_solve import PartialSolve, earlier_result_of, partial_solve_of
from .gpu_path import Given, Solved, keeps_normals, solve_grid
from .kept_images import ReadImage
from .stages import Clock

DARKEST = 0.015  # base colour that a median seldom is below: coal has 0.02 to 0.04
FEW = 24  # cameras whose views are checked when a solve was stopped: who stops does not want to wait
MANY = 0.05  # of the texels that are holes
PLAIN = 0.01  # of a metal's texels that look like no metal
NO_CONFIDENCE = "method paper: gives no uncertainty; confidence is 0 and the standard errors are 0.5 everywhere"


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
    given: SceneData  # the same, lamps as they were given; exposures, too, unless they were solved beside cameras
    solution: Solution
    level: float  # typical radiance of the views
    noise: Mapping[int, Noise]  # by the number of lobes
    robust: bool  # whether outliers were disbelieved
    bounced: Mapping[int, Bounced] | None  # indirect light by the view's place in the scene
    judged: Judged | None  # what was put right of lamps and exposures
    tilt: F32 | None  # (m, m, 3) over the texel grid: what refined normals add to the mesh's own, world


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


def one_round(
    scene: SceneData, settings: SolveSettings, read_image: ReadImage, clock: Clock,
    bounced: Mapping[int, Bounced] | None = None, settled: Judged | None = None, aligns: bool = False,
    first: bool = False,
) -> Generator[Progress, None, Outcome]:
    """One solve of the scene as it is given.  ``first``: nothing else is kept if it is stopped.

    ``bounced``: indirect light, by the view's place in the scene.  ``settled``: which numbers of lamps and exposures an
    earlier round has put right.  ``aligns``: cameras may be put right by outlines first.
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
                scene, settings, read_image, part, last, bounced, settled=settled, aligns=aligns,
                calibrates=scene.region is None), clock)
        if not solved.made.good.any() and not solved.ladder.cancelled:
            raise BadInput(
                f"{scene.mesh.name}: no texel is lit and seen well in any view; check that its faces point outwards "
                "(Mesh > Normals > Recalculate Outside), that lamps light it and have their real power, that masks are "
                "white where it is, and that faces do not share UVs with others")
        checks, pictures, stopped = yield from clock.stage("maps", _checks(scene, settings, solved.made, grid, first))
        solution = replace(_solution(scene, settings, gbuffer, solved, part), cancelled=stopped)
        normals = _normals(grid, solved)
        if normals is not None or keeps_normals(scene):
            solution = replace(solution, maps=replace(
                solution.maps, normal=encoded(scene.mesh, solved.grid.normal, grid.coverage)))
        lines = (*calibrated(solved.calibration), *worlds_in_doubt(solved.in_doubt), *refined(normals),
                 *solution.warnings, *warnings(checks, tried(settings, bounced is not None)),
                 *([NO_CONFIDENCE] if settings.method == "paper" else []))
        solution = replace(
            solution, seconds=clock.seconds, device=device.describe(), checks=checks, pictures=pictures,
            calibration=_calibration(scene, solved), warnings=lines, normals=normals,
            normals_why=solved.normals if isinstance(solved.normals, str) else "")
        return Outcome(
            solved.scene, solved.given, solution, solved.observations.level, solved.ladder.noise, solved.ladder.robust,
            bounced, solved.judged, solved.grid.mesh.offsets)


def _normals(given: TexelGrid, solved: Solved) -> RefinedNormals | None:
    """What is to be said of normals that were refined."""
    judged = solved.normals
    if isinstance(judged, str):
        return None
    seen = given.coverage & solved.grid.coverage & ~solved.made.maps.filled  # others keep the mesh's normals
    chord = np.linalg.norm(given.normal[seen].astype(np.float64) - solved.grid.normal[seen], axis=-1)
    tilt = 2 * np.degrees(np.arcsin(np.clip(chord / 2, 0, 1)))
    return RefinedNormals(float(np.median(tilt)) if len(tilt) else 0.0, judged.given, judged.refined, _movement(solved))


def _movement(solved: Solved) -> float:
    """As of RefinedNormals."""
    before, after = solved.given.mesh.positions, solved.scene.mesh.positions
    if before is after:
        return 0.0
    square = float(((after.astype(np.float64) - before) ** 2).sum(-1).mean())
    return float(np.sqrt(square) / max(float(np.ptp(before.reshape(-1, 3), axis=0).max()), 1e-12))


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
    squared = made.squared_residuals(made.solved)
    observed, cancelled = made.solved | made.shown, ladder.cancelled or made.albedo.cancelled
    lit = made.solved if cancelled else observed  # a solve that was stopped did not reach the others
    return Solution(
        maps=maps, model=ladder.model, why=ladder.why, seconds={}, device={}, levels=ladder.levels,
        metallic=ladder.metallic, coats=ladder.coats, diffuse_roughness=ladder.diffuse_roughness, paint=made.paint,
        predictions=ladder.predictions, priors=ladder.priors, stride=solved.stride,
        residual=float(np.sqrt(np.mean(squared))) if len(squared) else 0.0,
        cancelled=cancelled, ndf=settings.ndf,
        texels={"covered": int(gbuffer.coverage.sum()), "observed": int(observed.sum()),
                "solved": int(made.good.sum()), "filled": int((gbuffer.coverage & maps.filled).sum()),
                "kept": int((part.known & ~made.good).sum())},
        views_used=tuple(v.view.image.name for c in observations.cameras for v in c.views),
        views_skipped=scene.skipped + observations.skipped,
        warnings=(*scene.warnings, *grouped(observations.warnings),
                  *_warnings(scene, gbuffer, maps, lit, settings.udim),
                  *(unfit(name, found) for name, found in ladder.predictions.items() if not found.fits),
                  *(no_metal(name, share) for name, share in made.plain.items() if share > PLAIN)))


def _checks(
    scene: SceneData, settings: SolveSettings, made: FinishedMaps, grid: TexelGrid, first: bool,
) -> Generator[Progress, None, tuple[Checks, tuple[ViewPicture, ...], bool]]:
    """What the views say of the maps, how they look beside what those predict, and whether the solve was stopped.

    Of a solve that was stopped, a few views.
    """
    pictures: list[ViewPicture] = []
    outline = None if scene.region is not None else DrawnOutline(  # that of a part is not the object's
        made.albedo.device, grid.mesh, scene.occluders, scene.pixel_filter)
    stopped, cameras = made.ladder.cancelled or made.albedo.cancelled, made.albedo.observations.cameras
    cameras = cameras[::-(-len(cameras) // FEW) if stopped else 1]
    count = sum(len(camera.views) for camera in cameras)
    texels = TexelFit(scene.mesh.name, made.ladder.model, grid.slots, scene.mesh.slot_names, made.good,
                      made.ladder.texels.observations, made.maps.roughness, made.maps.roughness_sigma,
                      sure=settings.method != "paper", chosen=settings.model == "auto",
                      misfit=any(not (found.clear and found.fits) for found in made.ladder.predictions.values()),
                      one_value=tuple(name for name, prior in made.ladder.priors.items() if prior.one_value and not (
                          name in made.ladder.coats or name in made.ladder.diffuse_roughness)),
                      contradicted=made.contradicted)
    measured = Measured(made.good.size)
    try:
        with closing(with_view_pictures(check_views(made.albedo, made.base, cameras, outline), pictures)) as views:
            for n, view in enumerate(views):
                measured.add(view)
                yield Progress(1.0, "maps", f"checks, {n + 1} of {count}")
    except Cancelled:  # the maps are whole
        if not first:
            raise
        stopped = True
    return measured.checks(texels), tuple(pictures), stopped


def no_metal(name: str, share: float) -> str:
    """What to say of a metal, part of whose texels is none."""
    return (f"material '{name}': {percent(share)} of its texels do not look like metal, as the rest does, and were not "
            "solved separately, so their confidence is 0; give them a material slot of their own, and solve the whole "
            "object")


def unfit(name: str, prediction: MaterialPrediction) -> str:
    """What to say of a material that no model explains."""
    error, of = prediction.error, prediction.left_out
    off = f"off by {percent(error.relative_rms)} of the radiance, {error.lightness:.0f} L*"
    if error.fits:
        return (f"material '{name}': no model fits: a metal of roughness 1 predicts left-out {of} best ({off}), and "
                "translucent materials and cloth look like that, so its confidence is 0; IRPSO cannot solve for these; "
                "if it is neither, check lamps, cameras and mesh")
    return (f"material '{name}': no model predicts left-out {of} ({off}), so its confidence is 0; IRPSO "
            "cannot solve for materials that are translucent, move or mirror their surroundings, or for other light "
            "than the lamps'; if it is none of these, check lamps, cameras and mesh")


def _warnings(scene: SceneData, gbuffer: GBuffer, maps: Maps, observed: Bool, udim: str) -> list[str]:
    """What a user must know of the mesh before trusting the maps."""
    covered = max(int(gbuffer.coverage.sum()), 1)
    name = scene.mesh.name
    lines = []
    overlap = gbuffer.overlap.sum() / covered
    if overlap > 0.001:
        lines.append(f"{name}: {100 * overlap:.1f} % of its texels are claimed by more than one face "
                     "(overlapping UVs) and show one face's result; unwrap the mesh without overlaps")
    outside = share_outside(scene.mesh)
    if outside > 0:
        where = "outside the 0-1 UV square" if udim == "first" else "in no UDIM square"
        lines.append(f"{name}: {100 * outside:.1f} % of its faces are {where} and are not solved"
                     + ("; set UDIM to All to solve every square" if udim == "first" else
                        "; move each face's UVs into one square of the ten columns, or unwrap the mesh again"))
    holes = gbuffer.coverage & maps.filled
    unlit, dark = (int(some.sum()) / covered for some in (holes & ~observed, holes & observed))
    if unlit > MANY:
        lines.append(f"{name}: {percent(unlit)} of its texels are seen lit in no view, so IRPSO filled them from their "
                     "neighbours; add views and lights that reach these places")
    if dark > MANY:
        lines.append(f"{name}: {percent(dark)} of its texels are seen only at edges of shadows or of the object, or "
                     "too dark to be solved, so IRPSO filled them from their neighbours; take larger or nearer "
                     "pictures, or add views that show these places lit and away from edges")
    seen = gbuffer.coverage & ~maps.filled
    shown = float(np.median(maps.base_color[seen].mean(-1))) if seen.any() else 1.0
    if shown < DARKEST:
        lines.append(f"{name}: base colour is {shown:.2g} in the median, darker than any common material; check the "
                     "lamps' power and the views' exposure")
    return lines


def share_outside(mesh: MeshArrays) -> float:
    """Of the faces, those that do not lie on the texel grid as a whole."""
    return float(np.mean(~on_grid(mesh.uvs if mesh.grid is None else mesh.grid).all(1)))


def tried(settings: SolveSettings, bounced: bool = False) -> tuple[str, ...]:
    """Settings by which the solve puts right what `warnings` are about.  ``bounced``: indirect light was subtracted."""
    tried = {"registration": settings.registration == "auto", "exposures": settings.exposures == "solve",
             "model": settings.model == "auto", "indirect": bounced}
    return tuple(name for name, does in tried.items() if does)
