"""What texels tell their neighbours: how noisy the data are, and which roughnesses explain them.

Residual tables are summed up a pyramid and estimates handed down as priors: docs/decisions/0004.
"""

from __future__ import annotations

import moderngl
import numpy as np

from ...core.data import F32, Bool
from ..device.context import Device, Inputs

NOISE_FLOOR = 1e-4  # relative: float32 and the forward model's own error
NOISE_LEVELS = 4  # noise is averaged over 16 x 16 texels
PRIOR_CUT = 15.0  # an edge in the map costs no more than this, in nats
LEAST_DEGREES = 3.0  # of freedom from which on a texel says something of the noise
TAIL, TAIL_Z = 0.9, 1.2816  # share of texels below the upper tail, and its place under a normal distribution
FAR = 2.0  # log of a variance: outliers make their texels' so much larger, ...
GROSS = 0.01  # ... and leave relative errors of this size: finer ones are the model's, and alike in neighbours
NOISE_MOST = 0.06  # relative: more is not noise, but outliers in every texel: then ...
NOISE_GUESS = 0.02  # ... this much is taken for a start
ROUGHNESS_SLOPE = 3.0  # expected change of roughness across the UV square: a cell may differ so much from its parent
Tables = tuple[moderngl.Texture, ...]  # of a kernel's eight outputs


def noise_map(
    device: Device, valleys: moderngl.Texture, support: moderngl.Texture, lobes: int, unknown: float,
) -> tuple[moderngl.Texture, float]:
    """(log variance of the relative noise around each texel, at 1 / 2^NOISE_LEVELS of the size; its median variance).

    ``unknown``: variance where no camera has views enough to tell: only the scatter between cameras does then.
    """
    with device.scope() as owned:
        noise = device.texture(*valleys.size)
        with device.target([noise]) as target:
            device.draw("solve/noise.frag", target, Inputs(
                {"u_valleys": valleys, "u_support": support}, defines={"LOBES": str(lobes)}))
        for _ in range(NOISE_LEVELS):
            finer = noise
            noise = device.texture((finer.width + 1) // 2, (finer.height + 1) // 2)
            with device.target([noise]) as target:
                device.draw("maps/fill_down.frag", target, Inputs({"u_map": finer}))
        owned.hand_over(noise)
    values = device.read(noise)
    known = values[values[..., 3] > 0.1, 0]
    variance = float(np.exp(np.median(known))) if len(known) else unknown
    return noise, max(variance, NOISE_FLOOR**2)


def clean_noise(residual: F32, degrees: F32) -> tuple[float, bool]:
    """(variance of the noise without outliers, whether there are outliers) from what fits leave, (N,) each.

    Texels that no outlier touched are the lower tail: its place under normal noise (chi-squared, by Wilson and
    Hilferty 1931) tells the variance.  There are outliers where the upper tail lies far above its own place.
    """
    informed = degrees >= LEAST_DEGREES
    if not informed.any():
        return NOISE_FLOOR**2, False
    log = np.log(np.maximum(residual[informed] / degrees[informed], 1e-12))
    step = 2 / (9 * degrees[informed])
    low, high = (np.quantile(log - 3 * np.log1p(-step + z * np.sqrt(step)), share)
                 for z, share in ((-TAIL_Z, 1 - TAIL), (TAIL_Z, TAIL)))
    if low > 2 * np.log(NOISE_MOST):
        return NOISE_GUESS**2, True
    return max(float(np.exp(low)), NOISE_FLOOR**2), bool(high - low > FAR and high > 2 * np.log(GROSS))


def scatter(roughness: F32, observed: Bool) -> float:
    """Mean difference of roughness between neighbouring texels, (h, w) each; 0 where none are observed."""
    across = np.abs(np.diff(roughness, axis=1))[observed[:, 1:] & observed[:, :-1]]
    along = np.abs(np.diff(roughness, axis=0))[observed[1:] & observed[:-1]]
    both = np.concatenate([across, along])
    return float(both.mean(dtype=np.float64)) if len(both) else 0.0


def pyramid(
    device: Device, tables: Tables, gain: float, extent: float = 1.0, around: F32 | None = None,
) -> tuple[moderngl.Texture, moderngl.Texture]:
    """Tables summed upwards, estimates handed downwards: (estimate, prior) of every texel.

    ``gain``: of 1; how much four texels together say, in units of what they say apart.  ``extent``: width of the grid
    in UV squares.  ``around``: as `tiled_plan.Before.roughness`; it stands in for all levels from its cells on, which
    lie alike in neighbouring blocks, so that no border shows between them.
    """
    with device.scope() as owned:
        levels = _summed(device, tables, gain, 8 if around is None else around.shape[1])
        estimate: moderngl.Texture | None = None
        prior: moderngl.Texture | None = None
        if around is not None:
            levels.pop()
            estimate = device.texture(around.shape[1], around.shape[1], data=around)
        for table in reversed(levels):
            estimate, prior = _handed_down(device, table, estimate, extent)
        assert estimate is not None and prior is not None
        owned.hand_over(estimate, prior)
        return estimate, prior


def _summed(device: Device, tables: Tables, gain: float, most: int) -> list[Tables]:
    """The tables and their sums over ever larger cells, until there are no more than ``most`` of these in a row."""
    levels = [tables]
    while levels[-1][0].width > most:
        below = levels[-1]
        half = ((below[0].width + 1) // 2, (below[0].height + 1) // 2)
        above = tuple(device.texture(*half) for _ in range(8))
        with device.target(above) as target:
            device.draw("solve/pool.frag", target, Inputs({"u_table": below}, {"u_gain": gain}))
        levels.append(above)
    return levels


def _handed_down(
    device: Device, table: Tables, parent: moderngl.Texture | None, extent: float,
) -> tuple[moderngl.Texture, moderngl.Texture]:
    """(estimate, prior) of a level from its tables and the estimate of the coarser one."""
    size = table[0].size
    estimate, prior = device.texture(*size), device.texture(*size)
    with device.target([estimate, prior]) as target:
        device.draw("solve/descend.frag", target, Inputs({"u_table": table, "u_parent": parent}, {
            "u_top": parent is None, "u_step": ROUGHNESS_SLOPE * extent / size[0], "u_prior_cut": PRIOR_CUT}))
    return estimate, prior
