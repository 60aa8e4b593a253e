"""irpso doctor: versions, device, limits, a short self-test, and where the log lies.

The output names no folder but the log's, and that one from the user's home on: it can be attached to a bug report.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path

from .. import examine
from ..blender import logs
from ..blender.files import blender_version
from ..core.errors import BadInput
from ..core.params import DeviceSettings
from ..core.report import versions
from ..gpu import thread
from . import console, options

Rows = list[tuple[str, str]]


def run(arguments: argparse.Namespace) -> None:
    """The command.  Raises BadInput where OpenGL is missing or computes wrongly."""
    settings = options.device(arguments)
    rows: Rows = [(name, value) for name, value in (versions() | {"blender": blender_version()}).items()]
    rows += [("processors", str(os.cpu_count())), ("log", _from_home(logs.path()))]
    try:
        rows += _device(settings)
    except BadInput:
        if settings.device == "opengl":
            rows += [("OpenGL", "not usable, see below"), *_slower(settings)]
        raise
    finally:
        console.table(("", "here"), rows)
    console.say("\nall is well")


def _device(settings: DeviceSettings) -> Rows:
    """What it is, and that it computes rightly.  Raises BadInput."""
    thread.configure(settings)
    tested: examine.Tested = thread.run(examine.test)
    device = tested.device
    rows = [(name, str(getattr(device, name))) for name in ("renderer", "vendor", "version", "kernels")]
    rows += [(label, str(limit)) for label, limit in device.limits.items()]
    return [*rows, ("self-test (s)", f"{tested.seconds:.1f}"),
            ("self-test, base colour error", f"{tested.base_error:.4f}"),
            ("self-test, roughness error", f"{tested.rough_error:.4f}")]


def _slower(settings: DeviceSettings) -> Rows:
    """Whether the slower path would do."""
    try:
        seconds = dict(_device(replace(settings, device="numpy")))["self-test (s)"]
    except BadInput as error:
        return [("device numpy", str(error))]
    return [("device numpy", f"works, self-test {seconds} s")]


def _from_home(path: Path) -> str:
    """The path, with the user's home as "~"."""
    return f"~/{path.relative_to(Path.home()).as_posix()}" if path.is_relative_to(Path.home()) else str(path)
