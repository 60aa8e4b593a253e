"""How fast this device calculates, and how much of that the search reaches.

The probe (peak.kernel) runs chains of one operation each.  What an evaluation of the residual needs is counted by
hand from shaders/solve/{observations,fit}.glsl, in the operations that are left when the compiler has folded what
constants allow (one light a view, no spread, one camera, one lobe): see PER_OBSERVATION and PER_EVALUATION.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from irpso_addon.core.params import SolveSettings
from irpso_addon.core.phrases import percent
from irpso_addon.gpu.device.context import Device, Inputs
from irpso_addon.gpu.solve.paper_swarm import Swarms
from tests.support.texel_problem import Spec, make

from .opengl import SHADERS, Bench

OPERATIONS = {
    "multiply-add": ("((a) * x + y)", 2000), "divide": ("(x / ((a) + y))", 200), "square root": ("sqrt((a) + y)", 200),
    "fetch": ("texelFetch(u_map, ivec2(int(a), 1), 0).x", 100),
}
PROBE = 192  # texels
# specular_d: 25 (D 10, the lamp's root 3, the quotient 2, s 1, its slope 9), add_group: 12.  Divisions: 1 / q,
# tan2 / root, 1 / (root_l + root).
PER_OBSERVATION = {"multiply-add": 37, "divide": 3, "square root": 1, "fetch": 0}
# toward: 40 (powers 4, place in the table 10, its interpolation 16, the rest 10), fold: 45, evaluate and step: 32.
# Fetches: the four corners of the table's cell.
PER_EVALUATION = {"multiply-add": 117, "divide": 9, "square root": 1, "fetch": 4}


class Probe:
    """The device's best rate of each operation so far."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.target = device.framebuffer([device.texture(PROBE, PROBE)])
        self.map = device.texture(8, 8, 4, np.zeros((8, 8, 4), np.float32))
        self.rates = dict.fromkeys(OPERATIONS, 0.0)  # operations a second
        self.measure()  # compiles

    def measure(self) -> None:
        """One more go at each."""
        for name, (operation, steps) in OPERATIONS.items():
            self.device.ctx.finish()
            start = time.perf_counter()
            self.device.kernel(str(SHADERS / "peak.kernel"), self.target, Inputs(textures={"u_map": self.map},
                               uniforms={"u_steps": steps, "u_x": 0.999, "u_y": 1e-3},
                               defines={"OPERATION(a)": operation}), region=(0, 0, PROBE, PROBE))
            self.device.ctx.finish()
            rate = PROBE**2 * steps * 64 / (time.perf_counter() - start)
            self.rates[name] = max(self.rates[name], rate)

    def release(self) -> None:
        """Free the textures."""
        for resource in (*self.target.color_attachments, self.map, self.target):
            resource.release()


def arithmetic(device: Device, rounds: int, size: int) -> dict[str, Any]:
    """The table of the device's arithmetic, and the fraction that the search reaches."""
    benches = {views: Bench(device, make(Spec(views=views, size=size))) for views in (6, 12, 24)}
    # Race steps alone: all texels then make the same number of evaluations.
    knobs = {"u_particles": 24, "u_moves": 0, "u_race_steps": 2, "u_final_steps": 0}
    evaluations = size * size * knobs["u_particles"] * (knobs["u_race_steps"] + 1)
    probe, best = Probe(device), dict.fromkeys(benches, 0.0)
    for _ in range(2 * rounds):  # in turn, so that both sides have the machine's best moments
        probe.measure()
        for views, bench in benches.items():
            best[views] = max(best[views], evaluations / search_seconds(bench, knobs, 1))
    rows = []
    for views, rate in best.items():
        benches[views].release()
        needs = {name: views * PER_OBSERVATION[name] + PER_EVALUATION[name] for name in OPERATIONS}
        bound = 1 / sum(count / probe.rates[name] for name, count in needs.items())
        flops = 2 * needs["multiply-add"] + needs["divide"] + needs["square root"]
        rows.append([f"{views}", f"{rate / 1e6:.1f}", f"{bound / 1e6:.1f}", f"{percent(rate / bound)}",
                     f"{flops * rate / 1e9:.1f}", f"{percent(flops * rate / (2 * probe.rates['multiply-add']))}"])
    probe.release()
    rates = "; ".join(f"{name} {rate / 1e9:.1f}" for name, rate in probe.rates.items())
    return {
        "title": "How much of the device's arithmetic the search uses",
        "head": ["K", "evaluations (M/s)", "bound by counted operations (M/s)", "reached", "GFLOP/s",
                 "of multiply-adds alone"], "rows": rows,
        "note": f"Measured here, 10^9 a second, each alone at its best: {rates} (a multiply-add is two flops: "
                f"{2 * probe.rates['multiply-add'] / 1e9:.0f} GFLOP/s). An evaluation with its derivatives needs, for "
                f"each observation, {_in_words(PER_OBSERVATION)}, and once {_in_words(PER_EVALUATION)}: counted by "
                "hand in studies/bench/peak.py, good to about 15 %. The bound is the time of these operations one kind "
                "after the other, without loading, storing or loops; kinds that overlap can exceed it. A GFLOP here "
                "takes each multiply-add for two, each division and root for one.",
        "value": float(rows[0][3].rstrip("%")) / 100,
    }


def _in_words(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} x {name}" for name, count in counts.items() if count)


def search_seconds(bench: Bench, knobs: Mapping[str, int], rounds: int) -> float:
    """Least time of the search kernel alone, in one go."""
    outputs = [bench.device.texture(*bench.source.size) for _ in range(3)]
    defines = {"SWARM": str(knobs["u_particles"])} if knobs["u_moves"] else {}
    taken = []
    for _ in range(rounds + 1):
        bench.device.ctx.finish()
        start = time.perf_counter()
        bench.run("solve/search.kernel", outputs, {"u_seed": 0, **knobs}, defines)
        bench.device.ctx.finish()
        taken.append(time.perf_counter() - start)
    for texture in outputs:
        texture.release()
    return min(taken[1:])


def throughput(device: Device, rounds: int, size: int) -> dict[str, Any]:
    """Texels a second of the whole solve, by size; large maps are what a GPU is for."""
    rows, rate = [], 0.0
    for noise in (0.0, 0.01):
        for across in (size, 2 * size, 7 * size // 2):
            bench = Bench(device, make(Spec("one-lobe", 12, across, noise=noise)))
            taken = [bench.solve(bench.knobs("refined"))[0] for _ in range(rounds + 1)]
            bench.release()
            speed = across**2 / min(taken[1:])
            rate = max(rate, speed) if not noise else rate
            rows.append([f"{100 * noise:g} %", f"{across}", f"{min(taken[1:]) * 1e3:.3g}", f"{speed / 1e6:.3g}",
                         f"{4096**2 / speed:.3g}"])
    return {"title": "Texels a second", "rows": rows, "value": {"seconds": 4096**2 / rate, "gpu": is_gpu(device)},
            "head": ["noise", "texels across", "time (ms)", "M texels/s", "4096 x 4096 at that rate (s)"],
            "note": "`refined`, one lobe, K = 12; with noise the search uses neighbours as well. Times are the "
                    "least of the rounds. The largest size is the one that fits into one texture of observations."}


def is_gpu(device: Device) -> bool:
    """Whether this is no software renderer."""
    return not any(name in device.ctx.info["GL_RENDERER"].lower() for name in ("llvmpipe", "softpipe", "swiftshader"))


def fused(device: Device, rounds: int, size: int) -> dict[str, Any]:
    """Evaluations a second: a whole swarm in one draw against one particle a pass."""
    rows, ratios, passing = [], [], []
    for spec in (Spec(size=size), Spec(views=24, size=size), Spec("two-lobe", 12, size)):
        bench = Bench(device, make(spec))
        knobs = bench.knobs("swarm")
        once = search_seconds(bench, knobs, rounds)
        swarms = Swarms(device, bench.source, SolveSettings(size=max(size, 16), method="paper"), spec.model,
                        tile=bench.source.size)
        for _ in swarms.gather((0, 0)):
            pass
        passes = []
        for _ in range(rounds + 1):
            device.ctx.finish()
            start = time.perf_counter()
            for _ in range(32):
                swarms.step()
            device.ctx.finish()
            passes.append((time.perf_counter() - start) / 32)
        swarms.release()
        bench.release()
        # The swarm's places, its moves, and one more evaluation of each best with derivatives.
        together = size * size * knobs["u_particles"] * (knobs["u_moves"] + 2) / once
        alone = size * size / min(passes[1:])
        ratios.append(together / alone)
        passing.append(min(passes[1:]))
        rows.append([spec.title, f"{together / 1e6:.1f}", f"{alone / 1e6:.1f}", f"{ratios[-1]:.1f}"])
    fixed = passing[0] - 6 * (passing[1] - passing[0]) / 18
    return {"title": "A swarm in one draw against one particle a pass",
            "head": ["problem", "`swarm` (M evaluations/s)", "`paper` (M evaluations/s)", "ratio"], "rows": rows,
            "note": "The search kernel alone, and the passes alone; least of the rounds. A pass at K = 6 takes "
                    f"{passing[0] * 1e3:.2f} ms; {percent(fixed / passing[0])} of it would remain without any "
                    "observation (from the times at 6 and 24): reading and writing the state, random numbers, "
                    "neighbours. An evaluation of the exact model takes long, so that this weighs less than with a "
                    "simple model. An evaluation of `swarm` also finds the best base colour; `paper`'s takes the "
                    "particle's.",
            "value": ratios[0]}
