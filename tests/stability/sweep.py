"""Runs an axis: every point, every method, every seed that is not there yet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from irpso_addon.gpu.context import Device

from .axes import Axis
from .measure import record
from .methods import Method, Table, middle, paper
from .problem import Problem, make
from .store import JUDGED, Store

Say = Callable[[str], None]


def sweep(device: Device, axis: Axis, methods: Sequence[Method], seeds: int, say: Say) -> None:
    """Fill the axis's file."""
    store = Store(axis)
    for point in axis.points:
        missing = {m: [s for s in range(seeds) if str(s) not in store.seeds(point, m)] for m in methods}
        wanted = sorted({s for m in methods for s in missing[m]})
        if not wanted:
            continue
        say(f"{axis.title}: {point.label}")
        problems: dict[int, Problem] = {}
        for seed in wanted:
            problem = problems[seed] = make(replace(point.trial, seed=seed))
            if not any(m.run and seed in missing[m] for m in methods):
                continue
            table = Table(device, problem)
            for method in methods:
                if method.run and seed in missing[method]:
                    told = record(problem, method.run(table), judged=method.key == JUDGED)
                    store.put(point, method, {str(seed): told})
            table.release()
        for method in methods:
            if method.run is None and missing[method]:
                chosen = [problems[s] for s in missing[method]]
                answers = paper(device, chosen)
                store.put(point, method, {str(s): record(p, a, middle(p)) for s, p, a in
                                          zip(missing[method], chosen, answers, strict=True)})
        store.write()
