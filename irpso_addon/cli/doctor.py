"""irpso doctor: versions, device, limits, and a short self-test."""

from __future__ import annotations

import argparse

from .. import examine
from ..blender.files import blender_version
from ..core.report import versions
from ..gpu import thread
from . import console, options


def run(arguments: argparse.Namespace) -> None:
    """The command.  Raises BadInput where OpenGL is missing or computes wrongly."""
    thread.configure(options.device(arguments))
    rows = [(name, value) for name, value in (versions() | {"blender": blender_version()}).items()]
    device: examine.Detected = thread.run(examine.detect)
    rows += [(name, getattr(device, name)) for name in ("renderer", "vendor", "version", "kernels")]
    rows += [(label, str(limit)) for label, limit in device.limits.items()]
    try:
        tested: examine.Tested = thread.run(examine.test)
        rows += [("self-test (s)", f"{tested.seconds:.1f}"),
                 ("self-test, base colour error", f"{tested.base_error:.4f}"),
                 ("self-test, roughness error", f"{tested.rough_error:.4f}")]
    finally:
        console.table(("", "here"), rows)
    console.say("\nall is well")
