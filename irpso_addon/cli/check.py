"""irpso check: what is wrong with a shoot, in seconds, before it is solved."""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

from ..blender import files
from ..blender.scene.scene import read_scene
from ..blender.shoot import check_sheet
from ..core.checks.shoot_check import ShootCheck
from ..core.checks.warnings import grouped
from ..core.errors import BadInput
from ..core.phrases import percent
from ..gpu.device import thread
from ..solve import check_shoot
from . import console, options


def run(arguments: argparse.Namespace) -> None:
    """The command.  Raises BadInput; then nothing is written."""
    started = time.perf_counter()
    scene: Path = arguments.scene
    out: Path = arguments.out or scene.with_name(f"{scene.stem}_check.png")
    if out.suffix.lower() != ".png":
        raise BadInput(f"{out}: must end in .png; change --out")
    if arguments.out and not out.resolve().parent.is_dir():
        raise BadInput(f"{out}: folder not found; create it or choose another")
    thread.configure(options.device(arguments))
    with console.quiet():
        files.open_blend(scene)
        data = read_scene(None, arguments.object, arguments.captures)
    with console.progress() as show:
        check = thread.run(lambda: check_shoot.check(data), show)
    with console.quiet():
        check_sheet.save(check, out)
    for line in grouped(data.warnings):
        console.warn(f"warning: {line}")
    for finding in check.findings:
        console.warn(f"warning: {finding}")
    _print(check)
    wrong = f"{len(check.findings)} problems found" if len(check.findings) > 1 else (
        "1 problem found" if check.findings else "the checked views show no problem")
    console.say(f"{out}: {wrong}; {time.perf_counter() - started:.1f} s")


def _print(check: ShootCheck) -> None:
    """A row for each view and for each pair of them, and the line of all."""
    console.table(["view", "edges, px", "outline, px", "highlight, deg", "clipped", "of white", "lit", "base colour"], [
        [view.view, _number(view.pixels, ".2f"), _number(view.outline, ".2f"),
         _number(view.highlight[1] if view.highlight else None, ".1f"),
         percent(view.clipped, 1), _share(view.brightness), percent(view.lit), _number(view.albedo, ".2f")]
        for view in check.views])
    if check.pairs:
        console.say("")
        console.table(["neighbouring views", "epipolar, px", "points"], [
            [f"{pair.one}, {pair.other}", f"{pair.pixels:.2f}" if pair.measured else "not measured", str(pair.points)]
            for pair in check.pairs])
    console.say(check.summary)


def _share(value: float | None) -> str:
    return "-" if value is None or math.isnan(value) else percent(value)


def _number(value: float | None, form: str) -> str:
    return "-" if value is None or math.isnan(value) else format(value, form)
