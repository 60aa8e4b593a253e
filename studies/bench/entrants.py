"""Who takes part: the product's methods, and the rivals, each at several budgets.

An entrant's ``run`` gives one point for every budget: a fresh run where that is quick, else one long run that is
stopped now and then outside the clock.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.solve.paper_swarm import Swarms
from tests.support.texel_problem import Errors, Estimate, Problem, Spec, make

from .opengl import Bench
from .worker import Worker

PASSES = (100, 200, 400, 800, 1600)
SAMPLE = 48  # texels that SciPy solves
MITSUBA_SECONDS = 12


@dataclass(frozen=True)
class Point:
    """One method at one budget."""

    setting: str
    seconds: float
    errors: Errors
    default: bool = False  # what a user of that method gets unasked


@dataclass
class Stage:
    """A problem set up for everybody."""

    problem: Problem
    bench: Bench
    workers: dict[str, Worker]

    @property
    def spec(self) -> Spec:
        """Of the problem."""
        return self.problem.spec

    def worker(self, name: str) -> Worker:
        """The process of that name; started when first asked for."""
        if name not in self.workers or self.workers[name].process.poll() is not None:
            self.workers[name] = Worker()
        return self.workers[name]


def set_up(device: Device, spec: Spec, workers: dict[str, Worker]) -> Stage:
    """Make the problem and put it on the GPU."""
    problem = make(spec)
    return Stage(problem, Bench(device, problem), workers)


Run = Callable[[Stage, bool], Iterator[Point]]  # stage, whether the first budget is enough


@dataclass(frozen=True)
class Entrant:
    """A method that takes part."""

    key: str
    label: str
    family: str  # "irpso": the product's; "glsl", "torch", "scipy", "none": rivals
    run: Run
    needs: str = ""  # a package
    fitting: Callable[[Spec], bool] = lambda spec: True

    @property
    def missing(self) -> bool:
        """Whether its package is not installed."""
        return bool(self.needs) and find_spec(self.needs) is None


def _product(variants: Callable[[Bench], Mapping[str, Mapping[str, int]]], default: str) -> Run:
    def run(stage: Stage, brief: bool) -> Iterator[Point]:
        for name, knobs in list(variants(stage.bench).items())[:1 if brief else None]:
            seconds, found, _ = stage.bench.solve(knobs)
            yield Point(name, seconds, stage.problem.score(found), name == default)

    return run


def _refined(bench: Bench) -> dict[str, dict[str, int]]:
    """The product's two, and one with fewer and one with more of everything."""
    own = bench.knobs("refined")
    less, more = ({**own, **{k: int(own[k] * by) for k in ("u_particles", "u_race_steps", "u_final_steps")}}
                  for by in (0.5, 2))
    return {"half of all": less, "draft": bench.knobs("draft"), "refined": own, "twice all": more}


def _swarm(bench: Bench) -> dict[str, dict[str, int]]:
    """The product's number of moves, and others."""
    own = bench.knobs("swarm")
    counts = sorted({3, 6, 12, 25, 50, own["u_moves"]})
    return {"swarm" if n == own["u_moves"] else f"{n} moves": {**own, "u_moves": n} for n in counts}


def _glsl(shader: str, budgets: Callable[[Spec], list[tuple[str, dict[str, float]]]]) -> Run:
    def run(stage: Stage, brief: bool) -> Iterator[Point]:
        for name, uniforms in budgets(stage.spec)[:1 if brief else None]:
            seconds, found = stage.bench.rival(shader, uniforms)
            yield Point(name, seconds, stage.problem.score(found))

    return run


def _golden(spec: Spec) -> list[tuple[str, dict[str, float]]]:
    nodes = (6, 9, 12, 18) if spec.model == "two-lobe" else (8, 16, 32, 64, 128)
    return [(f"{n} nodes, 14 sections", {"u_nodes": n, "u_steps": 14}) for n in nodes]


def _paper(stage: Stage, brief: bool) -> Iterator[Point]:
    """IRPSO as published, one run with snapshots."""
    device, spec = stage.bench.device, stage.spec
    settings = SolveSettings(size=max(spec.size, 16), method="paper", seed=spec.seed)
    swarms = Swarms(device, stage.bench.source, settings, "two-lobe" if spec.model == "two-lobe" else "one-lobe",
                    tile=stage.bench.source.size)
    device.ctx.finish()
    start, seconds = time.perf_counter(), 0.0
    for _ in swarms.gather((0, 0)):
        pass
    for passes in PASSES[:1 if brief else None]:
        while swarms.passes < passes:
            swarms.step()
            if swarms.passes % 8 == 0:
                device.ctx.finish()  # a queue too long is no faster
        device.ctx.finish()
        seconds += time.perf_counter() - start
        best, more = (device.read(texture).astype(np.float64) for texture in swarms.best)
        rest = (more[..., 0], more[..., 1]) if swarms.lobes == 2 else ()
        found = Estimate(best[..., :3], best[..., 3], *rest)
        yield Point(f"{passes} passes", seconds, stage.problem.score(found), passes == settings.iterations)
        device.ctx.finish()
        start = time.perf_counter()
    swarms.release()


def _none(stage: Stage, brief: bool) -> Iterator[Point]:
    """Reference divided by Lambertian irradiance, roughness 0.5."""
    problem = stage.problem
    start = time.perf_counter()
    weight = problem.quality[..., None]
    base = np.clip((weight * problem.rgb).sum(2) / np.maximum(weight.sum(2), 1) * np.pi, 0, 1)
    seconds = time.perf_counter() - start
    flat = np.full(problem.quality.shape[:2], 0.5)
    yield Point("mean", seconds, problem.score(Estimate(base.astype(np.float64), flat)))


def _asked(process: str, method: str, budgets: Callable[[Spec], tuple[int, ...]], **more: object) -> Run:
    def run(stage: Stage, brief: bool) -> Iterator[Point]:
        for p in stage.worker(process).ask(method, stage.spec, budgets(stage.spec)[:1 if brief else None], **more):
            yield Point(p["setting"], p["seconds"], Errors(p["albedo"], p["roughness"], p["failures"]))

    return run


def _steps(name: str, counts: tuple[int, ...], **more: float) -> Callable[[Spec], list[tuple[str, dict[str, float]]]]:
    return lambda spec: [(f"{n} {name}", {"u_steps": n, **more}) for n in counts]


def _adam_steps(spec: Spec) -> tuple[int, ...]:
    """To the albedo error 0.01 on one lobe; two lobes are slower, and never find the roughness either."""
    return (10, 30, 100, 200) if spec.model == "two-lobe" else (10, 30, 100, 200, 250, 300, 350, 400)


LM_STEPS = (1, 2, 4, 8, 12)
ENTRANTS = [
    Entrant("refined", "refined", "irpso", _product(_refined, "refined")),
    Entrant("swarm", "swarm", "irpso", _product(_swarm, "swarm")),
    Entrant("paper", "paper", "irpso", _paper, fitting=lambda spec: spec.model != "lambert"),
    Entrant("single", "LM, one start (GLSL)", "glsl", _glsl("single.kernel", _steps("steps", (2, 4, 8, 16)))),
    Entrant("adam", "Adam (GLSL)", "glsl", _glsl("adam.kernel", _steps("steps", (10, 30, 100, 300), u_rate=0.02))),
    Entrant("golden", "grid + golden section (GLSL)", "glsl", _glsl("golden.kernel", _golden)),
    Entrant("torch-lm", "LM, 8 starts (PyTorch)", "torch",
            _asked("torch", "lm", lambda spec: LM_STEPS, compiled=False), "torch"),
    Entrant("torch-lm-c", "LM, 8 starts (PyTorch, compiled)", "torch",
            _asked("torch", "lm", lambda spec: LM_STEPS, compiled=True), "torch"),
    Entrant("torch-adam", "Adam (PyTorch)", "torch", _asked("torch", "adam", _adam_steps, compiled=False), "torch"),
    Entrant("torch-adam-c", "Adam (PyTorch, compiled)", "torch",
            _asked("torch", "adam", _adam_steps, compiled=True), "torch"),
    Entrant("scipy", "least_squares (SciPy)", "scipy",
            _asked("scipy", "scipy", lambda spec: (1, 4), sample=SAMPLE), "scipy"),
    Entrant("mitsuba", "Adam (Mitsuba 3)", "mitsuba",
            _asked("mitsuba", "mitsuba", lambda spec: (1, MITSUBA_SECONDS)), "mitsuba", lambda spec: spec.plane),
    Entrant("none", "no solver", "none", _none),
]

