"""How far maps are from others: on one common grid, so that methods with maps of any size compare.

Maps are (h, w, channels), row 0 at the bottom; base colour is linear Rec.709, roughness perceptual.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..change_records import PredictionError
from ..data import F64, Bool
from ..resampling import BAD
from .folds import WHITE, lightness

FAIL = 0.1  # a roughness that is off by more counts as failed


@dataclass(frozen=True)
class MapErrors:
    """Errors of one pair of maps over the texels asked for."""

    albedo_rmse: float
    albedo_psnr: float  # dB, against 1
    rough_mae: float
    rough_median: float
    rough_fail: float  # share of texels off by more than FAIL


def map_errors(base: F64, rough: F64, true_base: F64, true_rough: F64, where: Bool) -> MapErrors:
    """Base colours (n, n, 3) and roughnesses (n, n) against the truth over ``where``, which must hold a texel."""
    base, rough, true_base, true_rough = base[where], rough[where], true_base[where], true_rough[where]
    bad = (np.abs(base) > 0.1 * BAD).any(-1) | (np.abs(rough) > 0.1 * BAD)
    base = np.where(bad[:, None], np.where(true_base > 0.5, 0.0, 1.0), base)
    off = np.abs(np.where(bad, np.where(true_rough > 0.5, 0.0, 1.0), rough) - true_rough)
    square = float(np.mean((base - true_base) ** 2))
    return MapErrors(
        albedo_rmse=square**0.5, albedo_psnr=psnr(square), rough_mae=float(off.mean()),
        rough_median=float(np.median(off)), rough_fail=float((off > FAIL).mean()))


def prediction_error(seen: F64, told: F64) -> PredictionError | None:
    """Of radiances (T, 3) beside those seen, as folds.py has it; None without any."""
    if not len(seen):
        return None
    white = max(float(np.percentile(seen, WHITE)), 1e-20)
    light = lightness(told / white) - lightness(seen / white)
    return PredictionError(float(np.sqrt(((told - seen) ** 2).sum() / max(float((seen**2).sum()), 1e-30))),
                           float(np.sqrt((light**2).mean())))


def psnr(mean_square: float) -> float:
    """Peak signal-to-noise ratio in dB against a peak of 1."""
    return float(-10 * np.log10(mean_square + 1e-12))
