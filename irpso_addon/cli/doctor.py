"""irpso doctor: versions, device, limits, and a short self-test."""

from __future__ import annotations

import argparse
import time
from collections.abc import Generator
from typing import Any

import numpy as np

from .. import pipeline
from ..blender.files import blender_version
from ..core import selftest
from ..core.data import Solution
from ..core.errors import BadInput
from ..core.job import Progress
from ..core.params import SolveSettings
from ..core.report import versions
from ..gpu import thread
from . import console, options

LIMITS = {
    "GL_MAX_TEXTURE_SIZE": "largest map (texels)",
    "GL_MAX_ARRAY_TEXTURE_LAYERS": "texture layers",
    "GL_MAX_TEXTURE_IMAGE_UNITS": "textures a shader",
    "GL_MAX_DRAW_BUFFERS": "outputs a shader",
}
# llvmpipe is off by less than 0.0001; a driver that computes in half floats would be by some 0.005.
TOLERANCE = 0.002


def run(arguments: argparse.Namespace) -> None:
    """The command.  Raises BadInput where OpenGL is missing or computes wrongly."""
    thread.configure(options.device(arguments))
    rows = [(name, value) for name, value in (versions() | {"blender": blender_version()}).items()]
    info = thread.run(_device)
    rows += [(name, str(info[name])) for name in ("renderer", "vendor", "version", "kernels")]
    rows += [(label, str(info[name])) for name, label in LIMITS.items()]
    started = time.perf_counter()
    base_error, rough_error = check()
    rows += [
        ("self-test (s)", f"{time.perf_counter() - started:.1f}"),
        ("self-test, base colour error", f"{base_error:.4f}"), ("self-test, roughness error", f"{rough_error:.4f}")]
    console.table(("", "here"), rows)
    if not max(base_error, rough_error) < TOLERANCE:
        raise BadInput(f"{info['renderer']}: the self-test is off by more than {TOLERANCE}; update the graphics driver")
    console.say("\nall is well")


def check() -> tuple[float, float]:
    """Median error of base colour and roughness over the self-test's square."""
    test = selftest.build()
    settings = SolveSettings(size=selftest.TEXELS, model="one-lobe")
    solution: Solution = thread.run(lambda: pipeline.solve(test.scene, settings, test.read_image))
    base_error = np.median(np.abs(solution.maps.base_color - test.base_color))
    return float(base_error), float(np.median(np.abs(solution.maps.roughness - selftest.ROUGHNESS)))


def _device() -> Generator[Progress, None, dict[str, Any]]:
    """Runs on the GL thread."""
    yield Progress(0.0, "device")
    device = thread.device()
    kernels = {"kernels": "compute" if device.prefers_compute else "fragment"}
    return device.describe() | kernels | device.ctx.info
