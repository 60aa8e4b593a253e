"""Rounds over entrants and problems: medians of seconds, and the machine they were taken on."""

from __future__ import annotations

import datetime
import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from statistics import median
from typing import Any

from irpso_addon.gpu.device.context import Device
from studies import pages
from tests.support.texel_problem import Spec

from .entrants import Entrant, Point, Stage, set_up
from .worker import Worker

ROOT = Path(__file__).resolve().parents[2]
ALLOWANCE = 7.0  # seconds of one entrant on one problem, beyond which no further round begins
Say = Callable[[str], None]
Curve = dict[str, Any]


def curves(device: Device, specs: Sequence[Spec], entrants: Sequence[Entrant], rounds: int, say: Say) -> list[Curve]:
    """Every entrant on every problem, in interleaved rounds; one record each."""
    found: list[Curve] = []
    workers: dict[str, Worker] = {}
    try:
        for spec in specs:
            stage = set_up(device, spec, workers)
            taking = [e for e in entrants if not e.missing and e.fitting(spec)]
            try:
                found += _rounds(stage, taking, rounds, say)
            finally:
                stage.bench.release()
    finally:
        for worker in workers.values():
            worker.close()
    return found


def _rounds(stage: Stage, entrants: Sequence[Entrant], rounds: int, say: Say) -> list[Curve]:
    first: dict[str, float] = {}
    runs: dict[str, list[list[Point]]] = {}
    for entrant in entrants:
        say(f"{stage.spec.title}: {entrant.label}: first run")
        try:  # whatever compiles, compiles now
            first[entrant.key] = sum(p.seconds for p in entrant.run(stage, True))
            again = sum(p.seconds for p in entrant.run(stage, True))
        except RuntimeError as error:
            say(f"{stage.spec.title}: {entrant.label}: left out: {error}")
            continue
        first[entrant.key] -= again
        runs[entrant.key] = []
    for number in range(rounds):
        for entrant in entrants:
            past = runs.get(entrant.key)
            if past is None or (past and _spent(past) + _spent(past[-1:]) > ALLOWANCE):
                continue
            say(f"{stage.spec.title}: round {number + 1} of {rounds}: {entrant.label}")
            past.append(list(entrant.run(stage, False)))
    return [{"problem": asdict(stage.spec), "title": stage.spec.title, "method": e.key, "label": e.label,
             "family": e.family, "compile": round(max(first[e.key], 0.0), 3), "points": _points(runs[e.key])}
            for e in entrants if e.key in runs]


def _spent(runs: Sequence[Sequence[Point]]) -> float:
    return sum(p.seconds for run in runs for p in run)


def _points(runs: Sequence[Sequence[Point]]) -> list[dict[str, Any]]:
    return [{"setting": same[-1].setting, "seconds": float(f"{median(p.seconds for p in same):.4g}"), "runs": len(same),
             "default": same[-1].default, **{k: float(f"{v:.4g}") for k, v in asdict(same[-1].errors).items()}}
            for same in zip(*runs, strict=True)]


def machine(device: Device) -> dict[str, str]:
    """What the figures depend on."""
    packages = {}
    for name in ("numpy", "moderngl", "torch", "scipy", "mitsuba"):
        try:
            packages[name] = version(name)
        except PackageNotFoundError:
            continue
    return {
        "cpu": pages.processors(), "gl": f"{device.ctx.info['GL_RENDERER']}",
        "gl_version": device.ctx.info["GL_VERSION"], "compute": "yes" if device.prefers_compute else "no",
        "system": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "packages": ", ".join(f"{k} {v}" for k, v in packages.items()), "commit": pages.commit(),
        "date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"),
    }
