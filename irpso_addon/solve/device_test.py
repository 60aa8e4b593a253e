"""What computes, how IRPSO uses it, and whether it computes rightly.

Each function is a generator of Progress and must run on the GL thread: `gpu.device.thread.run`, `Job`, `remote.Remote`.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping
from dataclasses import dataclass

import numpy as np

from ..core.cpu_solver import solver
from ..core.errors import BadInput
from ..core.job import Progress
from ..core.params import SolveSettings
from ..core.samples import selftest
from ..gpu.device import thread
from ..gpu.device.programs import SLOWER
from . import pipeline

LIMITS = {
    "GL_MAX_TEXTURE_SIZE": "largest map (texels)",
    "GL_MAX_ARRAY_TEXTURE_LAYERS": "texture layers",
    "GL_MAX_TEXTURE_IMAGE_UNITS": "textures per shader",
    "GL_MAX_DRAW_BUFFERS": "outputs per shader",
}
# llvmpipe is off by less than 0.0001; a driver that computes in half floats would be by some 0.005.
TOLERANCE = 0.002
NUMPY_TEXELS = 16  # of the self-test where numpy solves it, so that this takes a second too


@dataclass(frozen=True)
class DetectedDevice:
    """The device as its driver names it."""

    renderer: str
    vendor: str
    version: str
    kernels: str  # compute, fragment, or numpy
    limits: Mapping[str, int]  # by what they limit


@dataclass(frozen=True)
class DeviceTest:
    """A detected device that has solved for known maps."""

    device: DetectedDevice
    seconds: float
    base_error: float  # median over the self-test's square
    rough_error: float


def detect() -> Generator[Progress, None, DetectedDevice]:
    """The device.  Raises BadInput where there is none, or it cannot do what the settings ask."""
    yield Progress(0.0, "device")
    if thread.settings().device == "numpy":
        largest = {LIMITS["GL_MAX_TEXTURE_SIZE"]: solver.MOST_SIZE}
        return DetectedDevice(**solver.device(), kernels="numpy", limits=largest)
    device = thread.device()
    info = device.describe()
    return DetectedDevice(
        renderer=info["renderer"], vendor=info["vendor"], version=info["version"],
        kernels="compute" if device.prefers_compute else "fragment",
        limits={label: int(device.ctx.info[name]) for name, label in LIMITS.items()})


def test() -> Generator[Progress, None, DeviceTest]:
    """The device, tested.  Raises BadInput as `detect` does, and where it computes wrongly."""
    device = yield from detect()
    started = time.perf_counter()
    size = NUMPY_TEXELS if device.kernels == "numpy" else selftest.TEXELS
    square = selftest.build(size)
    solution = yield from pipeline.solve(square.scene, SolveSettings(size=size, model="one-lobe"), square.read_image)
    base_error = float(np.median(np.abs(solution.maps.base_color - square.base_color)))
    rough_error = float(np.median(np.abs(solution.maps.roughness - selftest.ROUGHNESS)))
    if not max(base_error, rough_error) < TOLERANCE:
        raise BadInput(f"{device.renderer}: the self-test is off by {max(base_error, rough_error):.4f}, more than "
                       f"{TOLERANCE}; update the graphics driver, {SLOWER}")
    return DeviceTest(device, time.perf_counter() - started, base_error, rough_error)
