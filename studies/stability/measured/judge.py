"""How a relighting looks beside the truth: on lamps that were not in the data, from cameras of which one was not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from irpso_addon.core.change_records import PredictionError
from irpso_addon.core.data import F64, Bool
from irpso_addon.core.evaluation.folds import lightness
from irpso_addon.core.images.colour import linear_to_srgb

from .rig import View

BRIGHT = 95  # percentile of the truth's luminance that the exposure puts at ...
EXPOSED = 0.8  # ... this, linear
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

Shown = Callable[[View, Bool], F64]  # f (n, 3) of a view's texels


@dataclass(frozen=True)
class Judgement:
    """Errors over all judged texels, each counting as the picture shows it."""

    display: float  # RMSE of the sRGB-encoded picture, 0..1
    relative: float  # mean absolute error of radiance over its mean
    as_predicted: PredictionError  # in the unit of core/evaluation/folds.py; there each observation counts alike


class Judge:
    """Knows the truth of one material."""

    def __init__(self, views: list[View], truth: Shown, where: Bool, white: float) -> None:
        """``where``: (h, w) texels that count.  ``white``: the radiance whose L* is 100."""
        self.views, self.where, self.white = views, where, white
        self.masks = [view.seen & where for view in views]
        self.truth = self._radiance(truth)
        self.share = np.concatenate([v.share[m] for v, m in zip(views, self.masks, strict=True)])
        self.share /= self.share.sum()
        self.exposure = EXPOSED / max(float(np.percentile(self.truth @ LUMINANCE, BRIGHT)), 1e-12)

    def __call__(self, shown: Shown) -> Judgement:
        """Of a relighting."""
        radiance = self._radiance(shown)
        off = encode(self.exposure * radiance) - encode(self.exposure * self.truth)
        display = float(np.sqrt(self.share @ (off**2).mean(-1)))
        relative = self.share @ np.abs(radiance - self.truth).mean(-1) / (self.share @ self.truth.mean(-1))
        return Judgement(display, float(relative), self._as_predicted(radiance))

    def _as_predicted(self, radiance: F64) -> PredictionError:
        light = lightness(radiance / self.white) - lightness(self.truth / self.white)
        rms = np.sqrt(((radiance - self.truth) ** 2).sum() / max(float((self.truth**2).sum()), 1e-30))
        return PredictionError(float(rms), float(np.sqrt((light**2).mean())))

    def _radiance(self, shown: Shown) -> F64:
        return np.concatenate([shown(v, m) * v.irradiance[m][:, None]
                               for v, m in zip(self.views, self.masks, strict=True)])


def encode(linear: F64) -> F64:
    """sRGB, clipped at white."""
    return linear_to_srgb(np.clip(linear, 0.0, 1.0))
