"""What texels tell their neighbours: how noisy the data are, and which roughnesses explain them.

Residual tables are summed up a pyramid and estimates handed down as priors: docs/decisions/0004.
"""

from __future__ import annotations

import moderngl
import numpy as np

from ...core.data import F32, Bool
from ..device.context import Device

NOISE_FLOOR = 1e-4  # relative: float32 and the forward model's own error
NOISE_LEVELS = 4  # noise is averaged over 16 x 16 texels
PRIOR_CUT = 15.0  # an edge in the map costs no more than this, in nats
TOLD = 3.0  # degrees of freedom from which on a texel tells something of the noise
TAIL, TAIL_Z = 0.9, 1.2816  # share of texels below the upper tail, and its place under a normal distribution
FAR = 2.0  # log of a variance: outliers make their texels' so much larger, ...
GROSS = 0.01  # ... and leave relative errors of this size: finer ones are the model's, and alike in neighbours
NOISE_MOST = 0.06  # relative: more is not noise, but outliers in every texel: then ...
NOISE_GUESS = 0.02  # ... this much is taken for a start
ROUGHNESS_SLOPE = 3.0  # expected change of roughness across the UV square: a cell may differ so much from its parent


def noise_map(
    device: Device, valleys: moderngl.Texture, support: moderngl.Texture, lobes: int, unknown: float,
) -> tuple[moderngl.Texture, float]:
    """(log variance of the relative noise around each texel, at 1 / 2^NOISE_LEVELS of the size; its median variance).

    ``unknown``: variance where no camera has views enough to tell: only the scatter between cameras does then.
    """
    noise = device.texture(*valleys.size)
    target = device.framebuffer([noise])
    device.draw("solve/noise.frag", target, textures={"u_valleys": valleys, "u_support": support}, uniforms={},
                defines={"LOBES": str(lobes)})
    target.release()
    for _ in range(NOISE_LEVELS):
        finer = noise
        noise = device.texture((finer.width + 1) // 2, (finer.height + 1) // 2)
        target = device.framebuffer([noise])
        device.draw("maps/fill_down.frag", target, textures={"u_map": finer}, uniforms={})
        target.release()
        finer.release()
    values = device.read(noise)
    known = values[values[..., 3] > 0.1, 0]
    variance = float(np.exp(np.median(known))) if len(known) else unknown
    return noise, max(variance, NOISE_FLOOR**2)


def clean_noise(residual: F32, degrees: F32) -> tuple[float, bool]:
    """(variance of the noise without outliers, whether there are outliers) from what fits leave, (N,) each.

    Texels that no outlier touched are the lower tail: its place under normal noise (chi-squared, by Wilson and
    Hilferty 1931) tells the variance.  There are outliers where the upper tail lies far above its own place.
    """
    told = degrees >= TOLD
    if not told.any():
        return NOISE_FLOOR**2, False
    log = np.log(np.maximum(residual[told] / degrees[told], 1e-12))
    step = 2 / (9 * degrees[told])
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
    device: Device, tables: tuple[moderngl.Texture, ...], gain: float, extent: float = 1.0,
    around: F32 | None = None,
) -> tuple[moderngl.Texture, moderngl.Texture]:
    """Tables summed upwards, estimates handed downwards: (estimate, prior) of every texel.

    ``gain``: of 1; how much four texels together say, in units of what they say apart.  ``extent``: width of the grid
    in UV squares.  ``around``: as `tiled_plan.Before.roughness`; it stands in for all levels from its cells on, which
    lie alike in neighbouring blocks, so that no border shows between them.
    """
    levels = [tables]
    most = 8 if around is None else around.shape[1]
    while levels[-1][0].width > most:
        below = levels[-1]
        half = ((below[0].width + 1) // 2, (below[0].height + 1) // 2)
        above = tuple(device.texture(*half) for _ in range(8))
        target = device.framebuffer(list(above))
        device.draw("solve/pool.frag", target, textures={"u_table": below}, uniforms={"u_gain": gain})
        target.release()
        levels.append(above)
    parent: moderngl.Texture | None = None
    prior: moderngl.Texture | None = None
    if around is not None:
        for summed in levels.pop():
            summed.release()
        parent = device.texture(most, most, data=around)
    for level in range(len(levels) - 1, -1, -1):
        table = levels[level]
        size = table[0].size
        estimate, given = device.texture(*size), device.texture(*size)
        target = device.framebuffer([estimate, given])
        device.draw("solve/descend.frag", target, textures={"u_table": table, "u_parent": parent}, uniforms={
            "u_top": parent is None, "u_step": ROUGHNESS_SLOPE * extent / size[0], "u_prior_cut": PRIOR_CUT,
        })
        target.release()
        for texture in (parent, prior):
            if texture is not None:
                texture.release()
        if level > 0:
            for texture in table:
                texture.release()
        parent, prior = estimate, given
    assert parent is not None and prior is not None
    return parent, prior
