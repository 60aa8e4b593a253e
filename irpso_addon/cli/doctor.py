"""irpso doctor: versions, device, limits, a short self-test, and where the log lies.

The output names no folder but the log's, and that one from the user's home on: it can be attached to a bug report.
"""

from __future__ import annotations

import argparse
import os
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..blender import logs
from ..blender.files import blender_version
from ..core.errors import BadInput
from ..core.params import DeviceSettings
from ..core.versions import versions
from ..process.remote import Remote, Worker
from ..solve import device_test
from . import console, options

POLL = 0.1  # seconds
Rows = list[tuple[str, str]]


def run(arguments: argparse.Namespace) -> None:
    """The command.  Raises BadInput where OpenGL is missing or computes wrongly."""
    settings = options.device(arguments)
    rows = [*versions().items(), ("blender", blender_version()), ("processors", str(os.cpu_count())),
            ("log", _from_home(logs.path()))]
    console.table(("program", "here"), rows)  # each table at once: a driver may hang
    try:
        with _Apart(settings) as apart:
            detected = _detected(apart.run("solve.device_test:detect"))
            console.say("")
            console.table(("device", "here"), detected)
            tested: device_test.DeviceTest = apart.run("solve.device_test:test")
    except BadInput:
        if settings.device == "opengl":
            console.say("")
            console.table(("without it", "here"), [("OpenGL", "not usable, see below"), _slower(settings)])
        raise
    console.say("")
    console.table(("self-test", "here"), [
        ("self-test (s)", f"{tested.seconds:.1f}"), ("self-test, base colour error", f"{tested.base_error:.4f}"),
        ("self-test, roughness error", f"{tested.rough_error:.4f}")])
    console.say("\nall is well")


class _Apart:
    """A process that looks at the device: a driver that crashes ends that one alone."""

    def __init__(self, settings: DeviceSettings) -> None:
        """Raises BadInput where it cannot be started."""
        self._worker = Worker(settings)

    def __enter__(self) -> _Apart:
        return self

    def __exit__(self, *_: object) -> None:
        self._worker.close()

    def run(self, task: str) -> Any:
        """A job's result.  Raises BadInput: what it raises, or DeviceLost when the process ended."""
        job = Remote(task, worker=self._worker)
        while not job.wait(POLL):  # Ctrl-C comes through, on Windows too
            pass
        return job.result()


def _detected(device: device_test.DetectedDevice) -> Rows:
    rows = [(name, str(getattr(device, name))) for name in ("renderer", "vendor", "version", "kernels")]
    return rows + [(label, str(limit)) for label, limit in device.limits.items()]


def _slower(settings: DeviceSettings) -> tuple[str, str]:
    """Whether the slower path would do."""
    try:
        with _Apart(replace(settings, device="numpy")) as apart:
            return "device numpy", f"works, self-test {apart.run('solve.device_test:test').seconds:.1f} s"
    except BadInput as error:
        return "device numpy", str(error)


def _from_home(path: Path) -> str:
    """The path, with the user's home as "~"."""
    with suppress(RuntimeError):  # nobody knows where that is
        home = Path.home()
        if home != home.parent and path.is_relative_to(home):
            return f"~/{path.relative_to(home).as_posix()}"
    return str(path)
