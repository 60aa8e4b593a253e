"""The methods on a problem: the product's through irpso_addon.gpu, studies/bench's rivals, each to the same maps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from irpso_addon.core.data import F32, F64, Coat, MaterialPrediction
from irpso_addon.core.evaluation.prediction import PlaceView, Surface, predict
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading.tables import principled_table
from irpso_addon.gpu.device.context import Device, Inputs
from irpso_addon.gpu.maps.finish_maps import confidence
from irpso_addon.gpu.observe.observation_atlas import (
    CAMERA_SLACK,
    MODEL_ERROR,
    SHARED_ERROR,
    ArraySource,
    Layers,
    ObservedTexels,
)
from irpso_addon.gpu.solve.ladder_records import Materials
from irpso_addon.gpu.solve.model_ladder import Ladder
from irpso_addon.gpu.solve.paper_swarm import Swarms
from irpso_addon.gpu.solve.solver import Solver
from studies.bench.opengl import SHADERS, result

from .problem import Problem

CROP, GUTTER = 12, 2  # method paper: texels of each seed's map; between them, wider than its window reaches
BASE_PASSES = 3  # in which a metal's multiple scattering, which depends on base colour, is found
ADAM = {"u_steps": 100, "u_rate": 0.02}


@dataclass(frozen=True)
class Answer:
    """What a method says of a map."""

    base: F64  # (h, w, 3)
    roughness: F64  # (h, w)
    solved: np.ndarray  # (h, w) whether any observation
    sigma: F32 | None = None  # (h, w) standard error of roughness, where the method has one
    confidence: F32 | None = None  # (h, w) as the product's map
    observed: F32 | None = None  # (h, w) good observations
    lobes: F64 | None = None  # (h, w, 3) both roughnesses and the first's weight, where the model has them
    level: F64 | None = None  # (h, w) Specular IOR Level, where the model has one
    model: str = "one-lobe"
    metallic: float = 0.0
    coat: Coat | None = None
    diffuse_roughness: float = 0.0
    prediction: MaterialPrediction | None = None  # of left-out lamps, where the method judges by that


class PictureSource(ArraySource):
    """Arrays treated as the product treats pictures (CameraSource): channels apart where lamps are coloured."""

    def __init__(self, device: Device, problem: Problem) -> None:
        apart = problem.channels == 3
        super().__init__(device, ObservedTexels(
            problem.rgb, problem.quality, problem.cos_v, problem.lobes, problem.groups,
            None if apart else problem.irradiance.mean(-1), tuple(range(problem.trial.views))), principled_table())
        self.camera_slack, self.shared_error, self.model_error = CAMERA_SLACK, SHARED_ERROR, MODEL_ERROR
        if apart:
            self._apart(problem)

    def _apart(self, problem: Problem) -> None:
        """The layers of each camera three times, for R, G and B, as shaders/observe/gather_colour.frag makes them."""
        dim = np.minimum(problem.tint, 1.0)
        groups, layers = [], []
        for camera in sorted(set(problem.groups)):
            for channel in range(3):
                for k in (k for k, group in enumerate(problem.groups) if group == camera):
                    groups.append(3 * camera + channel)
                    dark = problem.tint[k, channel] < 1e-3 * problem.tint[k].mean()
                    quality = problem.quality[..., k] * (0.0 if dark else dim[k, channel] ** 2)
                    flags = np.where(quality > 0, 2 * channel + 0.5 * 0.999, 0.0)
                    first = [problem.rgb[..., k, channel], quality, problem.cos_v[..., k], flags]
                    second = [*np.moveaxis(problem.rgb[..., k, :], -1, 0), np.zeros_like(quality)]
                    layers += [np.stack(first, -1), np.stack(second, -1), problem.lobes[..., k, 0, :]]
        self.layers = Layers(tuple(groups), 1, 3, self.layers.spread)
        self.blocks = np.ascontiguousarray(np.stack(layers), np.float32)


class Table:
    """A problem on the GPU, and every method's answer to it."""

    def __init__(self, device: Device, problem: Problem) -> None:
        self.device, self.problem = device, problem
        self.source = PictureSource(device, problem)

    def product(self, method: str, loss: str) -> Answer:
        """The product's whole solve of one lobe."""
        trial = self.problem.trial
        settings = SolveSettings(size=max(trial.size, 16), method=method, seed=trial.seed, loss=loss)
        solver = Solver(self.device, self.source, settings, self.source.size)
        maps = result(solver.solve())
        albedo = result(solver.albedo(maps.roughness))
        rough, detail = (self.device.read(t).copy() for t in (maps.roughness, maps.detail))
        base = self.device.read(albedo)[..., :3].astype(np.float64)
        for thing in (maps.roughness, maps.detail, albedo, solver):
            thing.release()
        solved = rough[..., 3] > 0.5
        told = np.where(solved, confidence(rough[..., 0], rough[..., 1], detail[..., 0], solved), 0.0)
        return Answer(base, rough[..., 0].astype(np.float64), solved, rough[..., 1],
                      told.astype(np.float32), detail[..., 0])

    def whole(self) -> Answer:
        """The product's solve with model `auto`: the smallest model that the data support."""
        trial, shape = self.problem.trial, self.problem.quality.shape[:2]
        settings = SolveSettings(size=max(trial.size, 16), seed=trial.seed)
        ladder = Ladder(self.device, self.source, settings, Materials(np.zeros(shape, np.int32), ("Paint",)))
        found = result(ladder.solve())
        ladder.release()
        at, model, prediction = found.texels, found.model.get("Paint", "one-lobe"), found.predictions.get("Paint")
        rough, sigma = at.roughness.astype(np.float64), at.sigma
        level = None if found.level is None else found.level.astype(np.float64)
        if model == "lambert":  # what is in doubt is the base colour, as in gpu/maps/finish_maps.py
            rough, level, sigma = np.ones(shape), np.zeros(shape), at.base_sigma
        trusted = at.solved & (prediction is None or prediction.fits)
        sure = np.where(trusted, confidence(rough.astype(np.float32), sigma, at.observations, at.solved), 0.0)
        answer = Answer(np.zeros((*shape, 3)), rough, at.solved, sigma, sure.astype(np.float32), at.observations,
                        None if found.lobes is None else found.lobes.astype(np.float64), level, model,
                        found.metallic.get("Paint", 0.0), found.coats.get("Paint"),
                        found.diffuse_roughness.get("Paint", 0.0), prediction)
        return replace(answer, base=base_of(self.problem, answer))

    def rival(self, shader: str, uniforms: dict[str, float]) -> Answer:
        """A kernel of studies/bench/shaders, with the slack between cameras that the product starts from."""
        trial = self.problem.trial
        solver = Solver(self.device, self.source, SolveSettings(size=max(trial.size, 16)), self.source.size)
        solver.slack = CAMERA_SLACK**2 / max(trial.noise, 1e-3) ** 2
        for _ in self.source.gather(solver.atlas, (0, 0), True):
            pass
        found = self.device.texture(*self.source.size)
        target = self.device.framebuffer([found])
        self.device.kernel(str(SHADERS / shader), target, Inputs(textures={
            "u_texel_position": self.source.position, "u_observations": solver.atlas.texture,
            "u_principled_table": self.source.principled_table,
        }, uniforms={**solver.atlas.uniforms, "u_group_slack": solver.slack, "u_tile": (0, 0), **uniforms},
            defines={**self.source.layers.defines(), "LOBES": "1"}), region=(0, 0, *self.source.size))
        albedo = result(solver.albedo(found))
        rough, base = (self.device.read(t).astype(np.float64) for t in (found, albedo))
        for thing in (target, found, albedo, solver):
            thing.release()
        return Answer(base[..., :3], rough[..., 0], (self.problem.quality > 0).any(-1))

    def release(self) -> None:
        """Free the textures."""
        self.source.release()


def predicted(problem: Problem, answer: Answer, k: int) -> tuple[F64, F64]:
    """(specular (h, w, 3), what a white diffuse gives (h, w, 1)) of view k in the believed geometry, 1/sr.

    Of a metal: what black gives, and what each channel adds for each unit of base colour, (h, w, 3), at the answer's.
    """
    shape = answer.roughness.shape
    r = np.clip(answer.roughness, 0.05, 1.0)
    lobes = np.stack([r, r, np.ones_like(r)], -1) if answer.lobes is None else answer.lobes
    level = np.full(shape, 0.5) if answer.level is None else answer.level
    rgb = problem.rgb[:, :, k].reshape(-1, 3)
    geometry = np.repeat(problem.lobes[:, :, k].reshape(-1, 1, 1, 4), 3, 1)
    view = PlaceView(rgb, np.ones_like(rgb), problem.cos_v[..., k].ravel(), geometry)
    metallic = np.full(r.size, answer.metallic)
    coats = (None, ()) if answer.coat is None else (np.zeros(r.size, np.int32), (answer.coat,))
    rough = np.full(r.size, answer.diffuse_roughness) if answer.diffuse_roughness > 0 else None
    by_base = answer.metallic > 0 or rough is not None
    base = np.maximum(answer.base, 0.01) if by_base else np.ones((*shape, 3))
    black, shown = (predict(Surface(values.reshape(-1, 3), lobes.reshape(-1, 3), level.ravel(),
                                    np.zeros(r.size, bool), metallic, *coats, rough), view).reshape(*shape, 3)
                    for values in (np.zeros_like(base), base))
    each = (shown - black) / base
    return black, each if by_base else each[..., :1]


def base_of(problem: Problem, answer: Answer) -> F64:
    """Base colour (h, w, 3) by least squares at the lobes found."""
    shape = (*answer.roughness.shape, 3)
    answer = replace(answer, base=np.full(shape, 0.5))
    for _ in range(BASE_PASSES if answer.metallic > 0 or answer.diffuse_roughness > 0 else 1):
        total, weight = np.zeros(shape), np.full(shape, 1e-12)
        for k in range(problem.trial.views):
            specular, white = predicted(problem, answer, k)
            quality = problem.quality[..., k, None]
            total += quality * white * (problem.rgb[:, :, k] - specular)
            weight += quality * white**2
        answer = replace(answer, base=np.clip(total / weight, 0.0, 1.0))
    return answer.base


def paper(device: Device, problems: Sequence[Problem]) -> list[Answer]:
    """Method `paper` on the middle of every problem's map, all in one map: nothing but its window couples texels."""
    columns = int(np.ceil(np.sqrt(len(problems))))
    step = CROP + GUTTER
    places = [(step * (i // columns), step * (i % columns)) for i in range(len(problems))]
    rows = -(-len(problems) // columns)

    def together(name: str) -> F32:
        cut = [getattr(p, name)[middle(p)] for p in problems]
        whole = np.zeros((step * rows, step * columns, *cut[0].shape[2:]), np.float32)
        for (y, x), part in zip(places, cut, strict=True):
            whole[y:y + CROP, x:x + CROP] = part
        return whole

    whole = replace(problems[0], **{name: together(name) for name in ("rgb", "quality", "cos_v", "lobes")})
    source = PictureSource(device, whole)
    settings = SolveSettings(size=max(*source.size, 16), method="paper")
    swarms = Swarms(device, source, settings, "one-lobe", tile=source.size)
    result(swarms.gather((0, 0)))
    while swarms.passes < settings.iterations:
        swarms.step()
        if swarms.passes % 8 == 0:
            device.ctx.finish()  # a queue too long is no faster
    best, more = (device.read(texture).astype(np.float64) for texture in swarms.best)
    swarms.release()
    source.release()
    answers = []
    for y, x in places:
        part = best[y:y + CROP, x:x + CROP]
        answers.append(Answer(part[..., :3], part[..., 3], more[y:y + CROP, x:x + CROP, 3] > 0))
    return answers


def middle(problem: Problem) -> tuple[slice, slice]:
    """The texels that method paper gets."""
    first = (problem.trial.size - CROP) // 2
    return slice(first, first + CROP), slice(first, first + CROP)


@dataclass(frozen=True)
class Method:
    """One that takes part."""

    key: str
    label: str
    run: Callable[[Table], Answer] | None  # None: paper, many seeds at once
    files: tuple[str, ...]  # what a result depends on, from the root of the repository
    rounds: bool = False  # with checks, warnings and registration, as the product comes
    needs: str = ""  # the axes it is for: "drifts", where exposures are solved as well; "other", another material


_LIBRARY = "irpso_addon/"
_SOLVE = (*(_LIBRARY + file for file in (
    "gpu/solve/solver.py", "gpu/solve/tile_passes.py", "gpu/solve/neighbours.py", "gpu/observe/observation_atlas.py",
    "core/shading/tables.py", "gpu/maps/finish_maps.py")),
    "shaders/solve", "shaders/include", "studies/stability/measure.py")
_CHECKS = ("studies/stability/aligned.py", "studies/stability/warned.py", _LIBRARY + "core/checks")
_FIT = ("shaders/solve/observations.glsl", "shaders/solve/each_group.glsl", "shaders/solve/fit.glsl",
        "shaders/include")
METHODS = (
    Method("paper", "paper", None, (
        _LIBRARY + "gpu/solve/paper_swarm.py", "shaders/solve/paper_prepare.kernel", "shaders/solve/paper_move.kernel",
        "shaders/solve/paper_keep.kernel", "shaders/solve/observations.glsl", "shaders/solve/each_group.glsl",
        "shaders/include")),
    Method("swarm", "swarm", lambda t: t.product("swarm", "auto"), _SOLVE),
    Method("squares", "refined, squares", lambda t: t.product("refined", "squares"), _SOLVE),
    Method("refined", "refined", lambda t: t.product("refined", "auto"), (*_SOLVE, *_CHECKS), rounds=True),
    Method("exposed", "exposures solved", lambda t: t.product("refined", "auto"), (*_SOLVE, *_CHECKS),
           rounds=True, needs="drifts"),
    Method("auto", "model auto", lambda t: t.whole(),
           (*_SOLVE, *_CHECKS, *(_LIBRARY + file for file in (
               "gpu/solve/model_ladder.py", "gpu/solve/material_solves.py", "gpu/solve/metal_ladder.py",
               "gpu/solve/model_prediction.py", "gpu/solve/drawn_base_trials.py",
               "gpu/solve/prediction_trials.py", "gpu/solve/trial_runs.py", "gpu/solve/material_sample.py",
               "gpu/solve/specular_level.py", "core/evaluation", "core/models.py"))), rounds=True, needs="other"),
    Method("single", "LM, one start", lambda t: t.rival("single.kernel", {"u_steps": 16}),
           (*_FIT, "studies/bench/shaders")),
    Method("adam", "Adam", lambda t: t.rival("adam.kernel", ADAM),
           (*_FIT, "studies/bench/shaders")),
)
BY_KEY = {m.key: m for m in METHODS}
