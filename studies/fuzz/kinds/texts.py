"""The program's own text files when something else stands in them, and names of objects as those of files."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from irpso_addon.core.data import Maps
from irpso_addon.core.evaluation.ground_truth import read_truth
from irpso_addon.core.maps.export import KINDS, safe_stem, write_maps
from irpso_addon.core.params import DeviceSettings, SolveSettings
from irpso_addon.core.reporting import estimates
from irpso_addon.core.reporting.report import write_report

from .. import spoil
from ..case import Box

VIEWS = [estimates.ViewSize(1000, 600, "Cam", 2), estimates.ViewSize(36, 24, "Cam 2", 1)]


def prepare(_folder: Path) -> Maps:
    """Maps that are written under odd names."""
    grey, flags = np.full((4, 4), 0.5, np.float32), np.ones((4, 4), bool)
    return Maps(np.full((4, 4, 3), 0.5, np.float32), grey, grey, grey, flags, flags, grey, grey)


def make(shared: Maps, rng: Random, box: Box) -> Callable[[], None]:
    """One of the three."""
    which = rng.choices((_factors, _report, _maps), (5, 3, 2))[0]
    return which(shared, rng, box)


def _factors(_shared: Maps, rng: Random, box: Box) -> Callable[[], None]:
    """What solves on this machine have taken, and an estimate by it."""
    path = box.given / "irpso_speed.json"
    stages = [*estimates.STAGES, "solve refined auto", "compiled one, 2 views, 2 cameras"]
    told: Any = {"factors": {rng.choice([*stages, spoil.word(rng)]): rng.choice((1.0, 0.3, spoil.number(rng)))
                             for _ in range(rng.randrange(8))}}
    if rng.random() < 0.2:
        told = spoil.value(rng)
    elif rng.random() < 0.3:
        told["factors"][rng.choice(stages)] = spoil.value(rng)
    try:
        data = json.dumps(told).encode("utf-8", "surrogatepass")
    except ValueError:
        data = b'{"factors": {"solve": 1' + b"0" * 5000 + b"}}"
    path.write_bytes(spoil.spoilt(data, rng) if rng.random() < 0.4 else data)
    if rng.random() < 0.05:
        path = spoil.odd_place(path, rng)
    return partial(_estimated, path, box.out / "irpso_speed.json", rng)


def _estimated(path: Path, out: Path, rng: Random) -> None:
    factors = estimates.read_factors(path)
    settings = SolveSettings(model=rng.choice(("auto", "lambert", "two-lobe")), size=rng.choice((16, 1024, 8192)))
    found = estimates.estimate(VIEWS, settings, factors, 2.0, rounds=rng.random() < 0.5)
    assert math.isfinite(found.seconds) and found.seconds > 0 and found.gpu_bytes > 0 and found.host_bytes > 0
    assert estimates.in_words(found.seconds)
    after = estimates.learnt(factors, VIEWS, settings, {"solve": rng.choice((0.0, 1.0, 1e9))}, 2.0)
    estimates.write_factors(out, after)
    assert estimates.read_factors(out).keys() == after.keys()


def _report(_shared: Maps, rng: Random, box: Box) -> Callable[[], None]:
    """A report in which names and numbers are odd."""
    report = {"command": ["irpso", spoil.word(rng)], "models": {spoil.word(rng): spoil.word(rng)},
              "more": spoil.value(rng), "views": [os.fsdecode(rng.randbytes(8))]}
    name = rng.choice(("report.json", spoil.file_name(rng, ".json"), "no such folder/report.json", "n" * 300))
    path = box.out / name
    if rng.random() < 0.1:
        (box.out / "report.json").mkdir()
    box.names = (path.name,)

    def write() -> None:
        write_report(path, report)
        json.loads(path.read_text(encoding="utf-8"))

    return write


def _maps(shared: Maps, rng: Random, box: Box) -> Callable[[], None]:
    """Maps of an object whose name is no file's."""
    name = rng.choice((spoil.word(rng), spoil.file_name(rng), os.fsdecode(rng.randbytes(12))))
    kind = rng.choice((*KINDS, "exr", "exr", "jpg"))
    box.names = (kind,) if kind == "jpg" else (safe_stem(name)[:10], box.out.name)

    def write() -> None:
        SolveSettings(), DeviceSettings()
        for path in write_maps(shared, name, box.out, kind):
            assert path.parent == box.out and path.stat().st_size
        base, rough = read_truth(box.out, name)
        assert np.allclose(rough, 0.5, atol=1e-4) and np.allclose(base, 0.5, atol=1e-2)

    return write
