"""Runs the axes: every point, every method, every seed that is not there yet."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace

from irpso_addon.gpu.device.context import Device

from .aligned import rounds
from .axes import Axis
from .measure import Record, record
from .methods import BY_KEY, Answer, Method, Table, middle, paper
from .problem import Problem, make
from .store import Store
from .warned import warned

Say = Callable[[str], None]
THREADS = "LP_NUM_THREADS"  # of Mesa's software rasteriser


def sweep_all(axes: Sequence[Axis], methods: Sequence[Method], seeds: int, jobs: int, say: Say) -> None:
    """Fill the files of all axes, so many at a time, each by a process of its own: small maps leave threads idle."""
    os.environ.setdefault(THREADS, "1")
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as workers:
        waiting = {workers.submit(_axis, axis, [m.key for m in methods], seeds): axis for axis in axes}
        for number, done in enumerate(as_completed(waiting)):
            try:
                done.result()
            except BaseException:  # no other axis begins
                workers.shutdown(wait=False, cancel_futures=True)
                raise
            say(f"{number + 1} of {len(axes)}: {waiting[done].title}")


_devices: list[Device] = []  # this process's, once it has one


def _axis(axis: Axis, methods: Sequence[str], seeds: int) -> None:
    if not _devices:
        _devices.append(Device())
    sweep(_devices[0], axis, [BY_KEY[key] for key in methods], seeds)


def sweep(device: Device, axis: Axis, methods: Sequence[Method], seeds: int, say: Say = lambda words: None) -> None:
    """Fill the axis's file."""
    store = Store(axis)
    for point in axis.points:
        taking = [m for m in methods if m.needs in ("", axis.kind)]
        missing = {m: [s for s in range(seeds) if str(s) not in store.seeds(point, m)] for m in taking}
        wanted = sorted({s for m in taking for s in missing[m]})
        if not wanted:
            continue
        say(f"{axis.title}: {point.label}")
        problems: dict[int, Problem] = {}
        for seed in wanted:
            problem = problems[seed] = make(replace(point.trial, seed=seed))
            if not any(m.run and seed in missing[m] for m in taking):
                continue
            table = Table(device, problem)
            for method in taking:
                if method.run and seed in missing[method]:
                    store.put(point, method, {str(seed): _record(device, table, method)})
            table.release()
        for method in taking:
            if method.run is None and missing[method]:
                chosen = [problems[s] for s in missing[method]]
                answers = paper(device, chosen)
                store.put(point, method, {str(s): record(p, a, middle(p)) for s, p, a in
                                          zip(missing[method], chosen, answers, strict=True)})
        store.write()


def _record(device: Device, table: Table, method: Method) -> Record:
    answer, warnings = answered(device, table, method)
    return record(table.problem, answer, warnings=warnings)


def answered(device: Device, table: Table, method: Method) -> tuple[Answer, list[tuple[str, str]] | None]:
    """What a method says, after all its rounds, and what it warns of, where the product would."""
    assert method.run is not None
    run = method.run
    if not method.rounds:
        return run(table), None

    def solve(better: Problem) -> Answer:
        if better is table.problem:
            return run(table)
        other = Table(device, better)
        answer = run(other)
        other.release()
        return answer

    answer, checks, mended = rounds(table.problem, solve, method.needs == "drifts")
    return answer, warned(answer, checks, mended)
