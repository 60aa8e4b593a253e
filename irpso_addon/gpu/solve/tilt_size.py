"""By how much normals seem to be off: docs/decisions/0052."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from ...core.data import F32, F64, Bool
from ...core.job import Progress
from ...core.params import SolveSettings
from ..device.context import Device
from ..observe.observation_atlas import CameraSource, tiles
from .material_sample import packed, spread_squares, squares_for
from .solver import Solver
from .tile_passes import KernelPass

TRIED = (0.1, 0.3, 1.0)  # standard deviations of a tilt, as of `Tilts`; the last is the usual one
DEAR = 0.15  # nats a degree of freedom: more is too dear for what the usual one protects from
FEWEST = 50  # texels that tell
LEAST_DEGREES = 2.0  # of freedom that base colours leave: one is roughness's
NOISES = np.geomspace(1e-4, 0.1, 60)  # relative
NOISE_PRIOR = 4.0  # as in shaders/solve/nodes.glsl
UNKNOWN = 1 / 12  # variance of a roughness of which nothing is known


def tilt_size(
    device: Device, source: CameraSource, texels: Bool, settings: SolveSettings,
) -> Generator[Progress, None, float]:
    """Standard deviation of a tilt, as of `Tilts`, by what a sample of the texels shows.  ``texels``: (h, w)."""
    squares = spread_squares(texels, squares_for(len(source.layers.groups)), settings.seed)
    with device.scope():
        sample = packed(device, source, texels, squares)
        solver = Solver(device, sample, replace(settings, loss="squares"))
        solver.shown = False
        return likeliest((yield from tilt_fits(solver, sample.covered)))


def tilt_fits(solver: Solver, texels: Bool) -> Generator[Progress, None, F32]:
    """(N, TRIED, 4) of the N ``texels`` (h, w): as of solve/tilts.kernel."""
    chosen = tiles(solver.atlas, texels)
    valleys, _ = yield from solver.search(chosen)
    outputs = solver.textures(len(TRIED))
    yield from solver.run(chosen, (0.5, 1.0), KernelPass(
        "solve/tilts.kernel", outputs, {"u_valleys": valleys}, {"u_tried": TRIED}))
    return np.stack([solver.device.read(texture)[texels] for texture in outputs], 1)


def likeliest(fits: F32) -> float:
    """One of TRIED: the usual one or, where texels are less likely under it by more than DEAR, the likeliest.

    ``fits``: as of `tilt_fits`.  Tilts, base colours and roughness are integrated out.  The noise is that under which
    all texels are likeliest; each differs from it as in solve/nodes.glsl (Student's t).
    """
    residual, bend, widened, degrees = np.moveaxis(fits[fits[:, 0, 3] >= LEAST_DEGREES].astype(np.float64), -1, 0)
    if len(residual) < FEWEST:
        return TRIED[-1]
    likely = [max(_likelihood(*of, noise**2) for noise in NOISES)
              for of in zip(residual.T, bend.T, widened.T, degrees.T, strict=True)]
    best = int(np.argmax(likely))
    return TRIED[best] if likely[best] - likely[-1] > DEAR * float(degrees[:, 0].sum()) else TRIED[-1]


def _likelihood(residual: F64, bend: F64, widened: F64, degrees: F64, variance: float) -> float:
    """Its logarithm, but for a constant.  All of N texels, (N,)."""
    around = NOISE_PRIOR * variance
    return float(np.sum(
        0.5 * NOISE_PRIOR * np.log(around) - 0.5 * (degrees + NOISE_PRIOR) * np.log(residual + around)
        - 0.5 * widened - 0.5 * np.log(1 + np.maximum(bend, 0) * UNKNOWN / variance)))
