"""Tables beside the chart: noise, confidence, swarm moves, and the choice of the model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from irpso_addon.core.data import F64
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.phrases import percent
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.solve.ladder_records import Materials
from irpso_addon.gpu.solve.model_ladder import Ladder
from tests.support.texel_problem import FAILED, Estimate, Spec, make

from .opengl import Bench, result

Table = dict[str, Any]
SEEDS = 3
NINETY = 1.6449  # standard deviations that hold 90 % of a normal distribution


def noise(device: Device, rounds: int, size: int) -> Table:
    """Failures at 1 % noise: a texel alone, and with its neighbours."""
    rows, value = [], {}
    for views in (6, 12, 24):
        for borders in (False, True):
            alone, together, border, errors = [], [], [], []
            for seed in range(SEEDS):
                problem = make(Spec("one-lobe", views, size, noise=0.01, borders=borders, seed=seed))
                bench = Bench(device, problem)
                alone.append(problem.score(search_alone(bench, bench.knobs("refined"))).failures)
                found = bench.solve(bench.knobs("refined"))[1]
                bench.release()
                together.append(problem.score(found).failures)
                errors.append(problem.score(found).roughness)
                near = near_border(problem.truth.roughness)
                border.append((problem.roughness_error(found)[near] > FAILED).mean() if borders else np.nan)
            name = "sharp borders" if borders else "smooth"
            value[f"{views} {name}"] = float(np.mean(together))
            rows.append([f"{views}", name, f"{percent(np.mean(alone), 1)}", f"{percent(np.mean(together), 2)}",
                         f"{percent(np.mean(border), 1)}" if borders else "", f"{np.mean(errors):.4f}"])
    return {"title": "One lobe at 1 % noise: failures", "value": value, "rows": rows,
            "head": ["K", "map", "a texel alone", "`refined`", "within 2 texels of a border", "roughness error (mean)"],
            "note": f"A failure is an error of roughness above {FAILED}. Mean of {SEEDS} scenes. The maps with sharp "
                    "borders have two values, 0.25 and 0.5."}


def search_alone(bench: Bench, knobs: Mapping[str, int]) -> Estimate:
    """What the search finds of each texel before neighbours are asked; base colour is left at nothing."""
    outputs = [bench.device.texture(*bench.source.size) for _ in range(3)]
    defines = {"SWARM": str(knobs["u_particles"])} if knobs["u_moves"] else {}
    bench.run("solve/search.kernel", outputs, {"u_seed": 0, **knobs}, defines)
    found = bench.device.read(outputs[0]).astype(np.float64)
    for texture in outputs:
        texture.release()
    base = np.zeros((*found.shape[:2], 3))
    return Estimate(base, found[..., 0]) if bench.lobes == 1 else Estimate(base, *np.moveaxis(found[..., :3], -1, 0))


def near_border(roughness: F64) -> np.ndarray:
    """Texels within two of a step of the map."""
    edge = np.zeros(roughness.shape, bool)
    for axis in (0, 1):
        step = np.diff(roughness, axis=axis) != 0
        wide = [(0, 0), (0, 0)]
        wide[axis] = (2, 3)
        padded = np.pad(step, wide)
        n = roughness.shape[axis]
        for shift in range(4):
            edge |= np.take(padded, np.arange(n) + shift, axis=axis)
    return edge


def confidence(device: Device, rounds: int, size: int) -> Table:
    """Standard errors against true errors: their rank correlation, and how many 90 % intervals hold the truth."""
    rows, value = [], {}
    for spec in (Spec("one-lobe", 12, size, noise=0.01), Spec("one-lobe", 12, size, noise=0.01, borders=True),
                 Spec("one-lobe", 12, size, noise=0.002), Spec("one-lobe", 24, size, noise=0.01),
                 Spec("two-lobe", 24, size, noise=0.002)):
        ranks, drawn, held, held_base = [], [], [], []
        for seed in range(SEEDS):
            problem = make(replace(spec, seed=seed))
            bench = Bench(device, problem)
            _, found, more = bench.solve(bench.knobs("refined"))
            bench.release()
            error = np.abs(found.lobes() - problem.truth.lobes())[..., 0]  # sigma is that of the sharper lobe
            sigma = more["roughness_sigma"]
            ranks.append(rank_correlation(sigma.ravel(), error.ravel()))
            normal = np.abs(np.random.default_rng(seed).standard_normal(sigma.shape))
            drawn.append(rank_correlation(sigma.ravel(), (sigma * normal).ravel()))
            held.append((error <= NINETY * sigma).mean())
            base = np.abs((found.base - problem.truth.base).mean(-1))  # base_sigma is that of the channels' mean
            held_base.append((base <= NINETY * more["base_sigma"]).mean())
        value[spec.title] = {"rank": float(np.mean(ranks)), "drawn": float(np.mean(drawn)),
                             "held": float(np.mean(held))}
        rows.append([spec.title, f"{np.mean(ranks):.2f}", f"{np.mean(drawn):.2f}", f"{percent(np.mean(held), 1)}",
                     f"{percent(np.mean(held_base), 1)}"])
    return {"title": "Confidence", "rows": rows, "value": value,
            "head": ["problem", "rank correlation of roughness_sigma with the error", "drawn",
                     "90 % intervals that hold: roughness", "base colour (mean of its channels)"],
            "note": f"`refined`; mean of {SEEDS} scenes. An interval is the value plus and minus 1.645 of its standard "
                    "error; with two lobes, that of the sharper lobe. *Drawn* is the rank correlation of errors that "
                    "are drawn at random from normal distributions with these standard errors. Neighbours make the "
                    "standard errors more alike, and fewer differences are left to rank."}


def rank_correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Spearman's, without ties."""
    ranks = [np.argsort(np.argsort(v, kind="stable"), kind="stable").astype(np.float64) for v in (a, b)]
    return float(np.corrcoef(*ranks)[0, 1])


def moves(device: Device, rounds: int, size: int) -> Table:
    """How many moves of the swarm the default should make before it refines."""
    rows = []
    specs = (Spec("one-lobe", 6, size), Spec("one-lobe", 12, size, noise=0.01),
             Spec("one-lobe", 12, size, outliers=0.1), Spec("two-lobe", 12, size),
             Spec("two-lobe", 24, size, noise=0.002))
    for spec in specs:
        problem = make(spec)
        bench = Bench(device, problem)
        counts = (0, 1, 2, 4, 8)
        taken: dict[int, list[float]] = {n: [] for n in counts}
        for n in counts:
            bench.solve({**bench.knobs("refined"), "u_moves": n})
        found = {}
        for _ in range(rounds):
            for n in counts:
                seconds, found[n], _ = bench.solve({**bench.knobs("refined"), "u_moves": n})
                taken[n].append(seconds)
        bench.release()
        for n in counts:
            errors = problem.score(found[n])
            rows.append([spec.title, f"{n}", f"{np.median(taken[n]) * 1e3:.1f}", f"{errors.roughness:.5f}",
                         f"{percent(errors.failures, 2)}", f"{errors.albedo:.5f}"])
    return {"title": "Swarm moves between start and refinement", "rows": rows,
            "head": ["problem", "moves", "time (ms)", "roughness error (mean)", "failures", "albedo error (RMSE)"],
            "note": "`refined` with its own particles and steps; the first row of each problem is the default."}


def auto(device: Device, rounds: int, size: int) -> Table:
    """Share of regions for which `auto` takes the model that made the data."""
    rows, value = [], {}
    region = size // 4
    slots = (np.arange(size) // region)[:, None] * 4 + np.arange(size) // region
    names = tuple(f"region {i}" for i in range(16))
    for model in ("lambert", "one-lobe", "two-lobe"):
        chosen: list[str] = []
        for seed in range(SEEDS):
            bench = Bench(device, make(Spec(model, 12, size, noise=0.01, seed=seed)))
            ladder = Ladder(device, bench.source, SolveSettings(size=max(size, 16)),
                            Materials(slots.astype(np.int32), names))
            chosen += result(ladder.solve()).model.values()
            ladder.solver.release()
            bench.release()
        value[model] = chosen.count(model) / len(chosen)
        told = ("lambert", "one-lobe", "one-lobe-specular", "two-lobe")
        rows.append([model, f"{len(chosen)}", *(f"{percent(chosen.count(name) / len(chosen))}" for name in told)])
    return {"title": "`auto`, by region", "rows": rows, "value": value,
            "head": ["truth", "regions", "lambert", "one-lobe", "one-lobe-specular", "two-lobe"],
            "note": f"K = 12, 1 % noise; each region of {region} x {region} texels decides for itself."}
