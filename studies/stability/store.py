"""Records kept from run to run: build/stability/<axis>.json, thrown away point by point when what made them changes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

from .axes import Axis, Point
from .measure import Record, summary
from .methods import METHODS, Method

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "build" / "stability"
COMMON = ("studies/stability/problem.py", "studies/stability/material.py", "studies/stability/spoil.py",
          "tests/support/texel_problem.py",
          "irpso_addon/core/shading/brdf.py", "irpso_addon/core/observation_quality.py",
          "irpso_addon/core/images/colour.py")
EDITION = 2  # raised when measure.py or methods.py make other records of the same answers


@cache
def stamp(method: Method) -> str:
    """Of all files that a method's records come from."""
    made = hashlib.sha256(str(EDITION).encode())
    for name in sorted({*COMMON, *method.files}):
        path = ROOT / name
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.exists() and file.suffix in (".py", ".glsl", ".kernel", ".frag", ".vert"):
                made.update(file.relative_to(ROOT).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return made.hexdigest()[:16]


class Store:
    """The records of one axis."""

    def __init__(self, axis: Axis, folder: Path = FOLDER) -> None:
        self.axis, self.path = axis, folder / f"{axis.key}.json"
        self.held: dict[str, Any] = json.loads(self.path.read_text("utf-8")) if self.path.exists() else {}

    def seeds(self, point: Point, method: Method, any_age: bool = False) -> dict[str, Record]:
        """Records by seed; none where trial or code have changed since."""
        held = self.held.get(point.label, {}).get(method.key, {})
        fresh = held.get("stamp") == stamp(method) and held.get("trial") == _trial(point)
        readable = any_age and held.get("edition") == EDITION
        found: dict[str, Record] = held.get("seeds", {}) if fresh or readable else {}
        return found

    def put(self, point: Point, method: Method, records: dict[str, Record]) -> None:
        """Add records and write the file."""
        kept = self.seeds(point, method)
        self.held.setdefault(point.label, {})[method.key] = {
            "stamp": stamp(method), "edition": EDITION, "trial": _trial(point), "seeds": {**kept, **records}}

    def write(self) -> None:
        """All of it, whole or not at all."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        fresh = self.path.with_suffix(".new")
        fresh.write_text(json.dumps(self.held), "utf-8")
        fresh.replace(self.path)

    def summaries(self, seeds: int) -> dict[str, Any]:
        """{point: {method: summary}} of the first seeds, made by whatever code."""
        found: dict[str, Any] = {}
        for point in self.axis.points:
            for method in METHODS:
                held = self.seeds(point, method, any_age=True)
                told = [held[str(s)] for s in range(seeds) if str(s) in held]
                if told:
                    found.setdefault(point.label, {})[method.key] = summary(told)
        return found


def stale(axes: Sequence[Axis], seeds: int, methods: Sequence[Method]) -> list[str]:
    """Axes whose records are not those of the code as it is."""
    return [axis.key for axis in axes for store in [Store(axis)]
            if any(str(seeds - 1) not in store.seeds(p, m) for p in axis.points for m in methods)]


def _trial(point: Point) -> dict[str, Any]:
    return json.loads(json.dumps(asdict(point.trial)))
