"""What a view leaves over: robust statistics of observed over predicted, from which solve_checks.py tells causes.

The residual of a pixel is y = log(observed / predicted), of its channels together.  The maps are the views' consensus,
so what is wrong with one view, or with one light, stays in the residual of just its pixels.

Looked at are some blocks of 4 x 4 pixels, spread over what a camera shows: a block tells noise, in which its pixels
differ, from errors, which they share.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..check_records import Residual
from ..data import F32, F64, Bool
from .view_check_data import CheckedView, PixelWindow

BLOCK, SMALL = 4, 2  # pixels: errors that reach so far are no noise; in highlights, which are small
BLOCKS = 1500  # of a camera, at most
INNER = (5, 6, 9, 10)  # pixels of a block that lie two from its edge or more, counted from 1
DIFFUSE, HIGHLIGHT = 0.25, 0.1  # at most and at least such a share of the prediction is the lobes'
LEAST = 200  # pixels that a statistic needs
SAMPLE = 10_000  # values that a median looks at
LOG_MOST = 3.0  # |y| beyond is cut
OUTLIER = 5.0  # spreads: beyond, an error is cut; an outlier is its pixel's own
BOUNCED = 0.003  # radiance of shadows, as a share of the lit median, from which on light has bounced
MAD = 1.4826  # standard deviation of a normal distribution over its median absolute deviation


def scale_of(values: F64 | F32) -> float:
    """Robust standard deviation about the median; of a sample where there are many."""
    some = values[::max(1, len(values) // SAMPLE)]
    return float(MAD * np.median(np.abs(some - np.median(some)))) if len(some) else 0.0


def sample(window: PixelWindow) -> NDArray[np.int64]:
    """(B, 16) flat indices of the pixels of some blocks that the object covers."""
    h, w = (n // BLOCK * BLOCK for n in window.covered.shape)
    blocks = window.covered[:h, :w].reshape(h // BLOCK, BLOCK, w // BLOCK, BLOCK)
    y, x = np.nonzero(blocks.all((1, 3)))
    chosen = slice(None, None, max(1, -(-len(y) // BLOCKS)))
    inside = np.arange(BLOCK)[:, None] * window.covered.shape[1] + np.arange(BLOCK)
    first = BLOCK * (y[chosen] * window.covered.shape[1] + x[chosen])
    return np.asarray(first[:, None] + inside.ravel(), np.int64)


@dataclass(frozen=True)
class SampledView:
    """One view at its camera's sample, (B, 16)."""

    y: F32  # 0 where not good
    share: F32  # of the prediction that is the lobes'
    light: F32  # irradiance, mean of the channels
    good: Bool
    radiance: F32  # of the picture, mean of the channels
    unlit: Bool


def sample_view(view: CheckedView, at: NDArray[np.int64]) -> SampledView:
    """A view's residuals at ``sample`` of its window; channels count by the light in them."""
    light, observed, predicted, specular, radiance = (
        values.reshape(-1, 3)[at] for values in
        (view.irradiance, view.observed, view.predicted, view.specular, view.radiance))
    total = np.maximum(_sum(light), np.float32(1e-30))
    seen, expected, lobes = (_sum(light * values) / total for values in (observed, predicted, specular))
    edge, unlit = (values.ravel()[at] for values in (view.edge, view.unlit))
    good = (view.quality.ravel()[at] > 0) & ~edge & (expected > 1e-5) & (seen > 0)
    safe = np.where(good, expected, np.float32(1))
    y = np.asarray(np.log(np.where(good, seen, np.float32(1)) / safe).clip(-LOG_MOST, LOG_MOST), np.float32)
    share = np.where(good, lobes / safe, np.float32(0))
    means = [np.asarray(np.maximum(_sum(values), 0) / 3, np.float32) for values in (light, radiance)]
    return SampledView(y, share, means[0], good, means[1], unlit)


def _sum(values: F32) -> F32:
    """Over the channels; several times as fast as over an axis."""
    return np.asarray(values[..., 0] + values[..., 1] + values[..., 2])


@dataclass(frozen=True)
class BlockErrors:
    """Errors of blocks: their means, and what some of their pixels depart from them."""

    means: F32
    within: F32
    pixels: int  # of a block


def residual(seen: SampledView) -> tuple[Residual, BlockErrors, BlockErrors]:
    """A view's figures; the errors of its highlights, relative to what the lobes add there; and as large, elsewhere."""
    diffuse = seen.good & (seen.share < DIFFUSE)
    judged = diffuse if diffuse.sum() >= LEAST else seen.good
    values = seen.y[judged]
    if len(values) < LEAST:
        nothing = BlockErrors(values[:0], values[:0], SMALL**2)
        return Residual(len(values), 1.0, np.inf, 0.0, 0.0, 0.0, *_unlit(seen, 0.0)), nothing, nothing
    middle, spread = np.float32(np.median(values)), scale_of(values)
    y, rows = seen.y - middle, (-1, BLOCK, BLOCK)
    clear = judged.reshape(rows)[..., 1:] & judged.reshape(rows)[..., :-1]
    noise = scale_of(np.diff(y.reshape(rows))[clear]) / 2**0.5
    errors = block_errors(y, judged, spread)
    structure = shared_error(errors)
    error = 1.2533 * float(np.hypot(structure, spread / BLOCK)) / max(len(errors.means), 1) ** 0.5
    figures = Residual(len(values), float(np.exp(middle)), error, spread, noise, structure, *_unlit(seen, noise))
    shiny = seen.good & (seen.share > HIGHLIGHT)
    usual = np.float32(np.median(seen.share[shiny]) if shiny.any() else 1)
    lobes = block_errors(_small(y / np.maximum(seen.share, HIGHLIGHT)), _small(shiny), scale_of(y[shiny]) / usual)
    return figures, lobes, block_errors(_small(y / usual), _small(judged & ~shiny), spread / usual)


def _small(values: Any) -> Any:
    """Blocks (B, 16) as four times as many of four pixels."""
    corners = (-1, BLOCK // SMALL, SMALL, BLOCK // SMALL, SMALL)
    return values.reshape(corners).swapaxes(2, 3).reshape(-1, SMALL**2)


def block_errors(values: F32, good: Bool, spread: float | np.float32) -> BlockErrors:
    """Of blocks (B, n) most pixels of which are good."""
    limit = np.float32(OUTLIER * spread)
    known = np.where(good, np.clip(values, -limit, limit), np.float32(0))
    count = good.sum(1)
    full = count >= 0.7 * values.shape[1]
    means = known[full].sum(1) / count[full]
    left = (known[full] - means[:, None])[good[full]]
    return BlockErrors(means, left[::max(1, len(left) // SAMPLE)], values.shape[1])


def shared_error(errors: BlockErrors) -> float:
    """Robust standard deviation of what the pixels of a block have in common; 0 where there are too few to tell.

    The mean of n pixels of independent noise s has s / sqrt(n), and they depart from it by s sqrt(1 - 1 / n).
    About 0, not about the median: a bias is an error too.
    """
    if len(errors.means) * errors.pixels < LEAST:
        return 0.0
    noise = scale_of(errors.within) / (errors.pixels - 1) ** 0.5
    return float(np.sqrt(max((MAD * float(np.median(np.abs(errors.means)))) ** 2 - noise**2, 0.0)))


def _unlit(seen: SampledView, noise: float) -> tuple[float | None, int]:
    """Mean radiance where no light arrives over the lit pixels' median (bright sparks cut); of how many pixels.

    Read noise cannot go below black, so its mean is not 0: 0.65 of the usual difference of two pixels is taken off, but
    no more than the lit pixels' ``noise`` (relative) makes; what differs beyond it is light.
    """
    dark = seen.radiance[seen.unlit.all(1)][:, INNER]  # away from shadows' edges
    if dark.size < LEAST or seen.good.sum() < LEAST:
        return None, dark.size
    level = max(float(np.median(seen.radiance[seen.good])), 1e-20)
    differ = scale_of((dark[:, 1:] - dark[:, :-1]).ravel()) / level
    mean = float(np.minimum(dark / np.float32(level), 1).mean())
    return max(mean - min(0.65 * differ, 0.7 * noise), 0.0), dark.size


def is_indirect(share: float) -> bool:
    """Whether shadows so bright (a share of the lit median) hold light that has bounced; NaN: nothing tells."""
    return share > BOUNCED
