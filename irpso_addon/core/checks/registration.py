"""How far each view lies from where its camera says, and how far its exposure has drifted.

Texture cannot tell where a camera looks, since the maps are what the views agree on; so every pixel's brightness
(a factor on the prediction, the same in all views of the camera) is eliminated, and what is left moves the camera:
shading, shadows and highlights, which stay while the paint would move, and the silhouette, where the image has alpha
or a mask.  Beside the other views of its camera a single view is held by the texture as well.  A camera with one view
alone is held by the paint that the other cameras agree on: part of it is its own, so it takes some rounds.

Gauss-Newton on image differences (Lucas and Kanade 1981; Baker and Matthews, IJCV 56, 2004), with variable projection
(Golub and Pereyra 1973) for the pixels' factors and Cauchy weights; standard errors from the scores of tiles (the
sandwich of Huber 1967 over clusters), because neighbouring pixels share their errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..check_records import SIGMAS, Misfit
from ..data import F32, F64, Bool, View
from .outline_cameras import OutlinedCamera, Silhouettes, bends, of_one_shape
from .outline_fit import GROWTH, ROLL, Outline
from .registration_fit import Fit, ViewFit, blurred, eroded, fit_views, gain_of_cameras, tiles_of
from .view_check_data import CheckedView, PixelWindow

MEAN = np.full(3, 1 / 3, np.float32)  # of the channels
SAMPLES = 12_000  # pixels of a camera, at most, that are looked at
# Lights that stand elsewhere bend the shading of the whole object, so that its tiles err alike: shifts are then off by
# ten times their standard errors (the cow with lights off by 1 and 3 %).
MODEL = 10.0
UNEXPLAINED = 5.0  # pixels of doubt per unit of relative error left in the pixels: outliers, bad maps
RIM = 4  # pixels next to an edge of the object, left to the silhouette
SHIFT_FLOOR, GAIN_FLOOR = 0.005, 0.001  # errors that no statistics shows: pixels, relative
GAIN_PER_PIXEL = 0.005  # relative, per pixel of shift: while cameras are off the base colours are wrong too
BLIND = 1e4  # pixels: error of a shift that shading says nothing of
LEAST_ALONE = 0.1  # pixels from the other views of its camera: then a view is believed to have moved by itself


class Registration:
    """Takes the checked views one by one, those of a camera together, and keeps little of each."""

    def __init__(self) -> None:
        self._window: PixelWindow | None = None
        self._camera: _Collected | None = None
        self._done: list[_Estimate] = []

    def add(self, view: CheckedView) -> None:
        """One more view."""
        if view.window is not self._window:
            self._finish()
            self._window, self._camera = view.window, _Collected(view.window)
        assert self._camera is not None
        self._camera.add(view)

    def estimate(self) -> tuple[Misfit, ...]:
        """What was found, one for each view that was added."""
        self._finish()
        gains = gain_of_cameras([(e.uv, e.fit.factor) for e in self._done])
        logs = [e.fit.log_gain + g for e, g in zip(self._done, gains, strict=True)]
        mean = float(np.mean(np.concatenate(logs))) if logs else 0.0
        return tuple(m for e, log, bend in zip(self._done, logs, bends([e.seen for e in self._done]), strict=True)
                     for m in _misfits(e.seen, e.fit, log - mean, *bend))

    def _finish(self) -> None:
        if self._camera is not None and self._camera.views:
            self._done.append(self._camera.solve())
        self._window = self._camera = None


class _Collected:
    """One camera's views at a sample of its pixels."""

    def __init__(self, window: PixelWindow) -> None:
        self.window = window
        self.views: list[View] = []
        inside = eroded(window.covered, RIM)
        inside[:RIM], inside[-RIM:], inside[:, :RIM], inside[:, -RIM:] = False, False, False, False
        at = np.flatnonzero(inside)
        self.at = at[:: max(1, -(-len(at) // SAMPLES))]
        self.seen: list[F32] = []  # (4, N): predicted radiance, its slopes, observed; NaN where it tells nothing
        self.outlines: list[Outline | None] = []
        self._silhouettes = Silhouettes(window.drawn, window.corner, window.image)
        self._product = np.zeros(window.covered.shape, np.float32)
        self._square = np.zeros(window.covered.shape, np.float32)

    def add(self, checked: CheckedView) -> None:
        self.views.append(checked.view)
        radiance = checked.radiance @ MEAN
        usable = self.window.covered & np.isfinite(radiance) & ((checked.quality > 0) | checked.unlit)
        observed = blurred(np.where(usable, radiance, np.float32(0)))
        predicted = blurred(np.where(usable, (checked.predicted * checked.irradiance) @ MEAN, np.float32(0)))
        whole = eroded(usable, RIM)
        self._product += np.where(whole, observed * predicted, np.float32(0))
        self._square += np.where(whole, predicted * predicted, np.float32(0))
        up, right = np.gradient(predicted)
        rows = np.stack([np.where(whole, a, np.nan).ravel()[self.at] for a in (predicted, right, up, observed)])
        self.seen.append(rows.astype(np.float32))
        self.outlines.append(self._silhouettes.of(checked.view.camera, checked.coverage))

    def solve(self) -> _Estimate:
        usable = self._square > 1e-6 * max(float(self._square.max(initial=0.0)), 1e-30)
        factor = np.where(usable, self._product / np.where(usable, self._square, np.float32(1)), np.float32(0))
        single = len(self.views) == 1
        if single:  # beside what other cameras show of the same paint
            factor = np.where(usable, np.median(factor[usable]) if usable.any() else np.float32(1), np.float32(0))
        up, right = np.gradient(factor)
        at = self.at[eroded(usable, 1).ravel()[self.at]]
        known = np.isin(self.at, at, assume_unique=True)
        rows, columns = np.divmod(at, usable.shape[1])
        fit = fit_views(np.stack(self.seen, 1)[..., known].astype(np.float64),
                        np.stack([a.ravel()[at] for a in (factor, right, up)]).astype(np.float64),
                        tiles_of(rows, columns), free=not single)
        seen = OutlinedCamera(self.views, self.window.corner, self.window.image, self.outlines)
        return _Estimate(seen, fit, self.window.uv.reshape(-1, 2)[at])


@dataclass(frozen=True)
class _Estimate:
    """Of one camera's V views."""

    seen: OutlinedCamera
    fit: Fit
    uv: F32  # (N, 2) where the fit's pixels look


def outline_misfits(cameras: Sequence[OutlinedCamera]) -> tuple[Misfit, ...]:
    """What outlines alone say, one for each view: no maps are needed for it; gains are 1."""
    blind = [Fit(np.zeros((count, 2)), np.tile(BLIND**2 * np.eye(2), (count, 1, 1)), np.zeros(count),
                 np.full(count, BLIND), np.zeros(0), 0.0) for count in (len(camera.views) for camera in cameras)]
    return tuple(m for camera, fit, bend in zip(cameras, blind, bends(cameras), strict=True)
                 for m in _misfits(camera, fit, fit.log_gain, *bend, blind=True))


def _misfits(
    camera: OutlinedCamera, fit: Fit, log_gain: F64, bend: float, bend_error: float, blind: bool = False,
) -> list[Misfit]:
    """With the views' gains, (V,), and what the lens's k1 lacks.  ``blind``: pixels say nothing."""
    outlines = [None if o is None else o.bent(bend) for o in camera.outlines]
    shift, shift_error, alone = _settled(
        fit, [None if o is None else (o.shift, o.shift_covariance) for o in outlines], blind)
    gain_error = np.sqrt(fit.gain_error**2 + GAIN_FLOOR**2 + (GAIN_PER_PIXEL * np.hypot(*shift.T)) ** 2)
    drawn = [o for o, departs in zip(outlines, alone, strict=True) if o is not None and not departs]
    growth, roll = (of_one_shape(drawn, value) for value in (GROWTH, ROLL))
    x, y = (float(np.mean([o.centre[axis] for o in drawn])) + camera.corner[axis] - camera.image[axis] / 2
            if drawn else 0.0 for axis in (0, 1))
    return [
        Misfit(view.image, view.camera.name, camera.image, (float(right), float(up)), float(error),
               float(np.exp(gain)), float(its_error), bool(departs), *growth, (x, y), *roll, bend, bend_error)
        for view, (right, up), error, gain, its_error, departs in zip(
            camera.views, shift, shift_error, log_gain, gain_error, alone, strict=True)]


def _settled(fit: Fit, outlines: list[ViewFit | None], blind: bool) -> tuple[F64, F64, Bool]:
    """Pixels and silhouettes together: (V, 2) shifts, (V,) their standard errors, (V,) departs from its camera.

    Where pixels say nothing, a view without a silhouette goes by those of its camera's others.
    """
    views = range(len(outlines))
    floor = SHIFT_FLOOR**2 * np.eye(2)
    pixels = [(fit.shift[v], MODEL**2 * fit.covariance[v]) for v in views]
    # Shading is only as good as the model of light and shape: where silhouettes gainsay it, they win.
    quarrel = np.median([fit.shift[v] - o[0] for v, o in enumerate(outlines) if o is not None] or [(0.0, 0.0)], axis=0)
    doubt = floor + ((quarrel**2).mean() + (UNEXPLAINED * fit.noise) ** 2) * np.eye(2)
    each = [_joined((pixels[v][0], pixels[v][1] + doubt), outlines[v]) for v in views]
    shift = np.array([e[0] for e in each])
    error = np.array([np.sqrt(np.trace(e[1]) / 2) for e in each])
    known = np.array([o is not None or not blind for o in outlines])
    middle = np.median(shift[known], axis=0) if known.any() else np.zeros(2)
    alone = known & (np.hypot(*(shift - middle).T) > np.maximum(LEAST_ALONE, SIGMAS * error))
    together = np.flatnonzero(~alone)
    if len(together):
        weights = np.array([np.linalg.inv(pixels[v][1] + floor) for v in together])
        total = np.linalg.inv(weights.sum(0))
        mean = total @ np.einsum("vij,vj->i", weights, fit.shift[together])
        drawn = [o for v in together if (o := outlines[v]) is not None]  # of one shape: their errors do not average out
        outline = (np.mean([o[0] for o in drawn], axis=0), np.mean([o[1] for o in drawn], axis=0)) if drawn else None
        common = _joined((mean, total + doubt), outline)
        shift[together], error[together] = common[0], np.sqrt(np.trace(common[1]) / 2)
    return shift, error, alone


def _joined(pixels: ViewFit, outline: ViewFit | None) -> ViewFit:
    """Two estimates' mean by their covariances."""
    if outline is None:
        return pixels
    first, second = np.linalg.inv(pixels[1]), np.linalg.inv(outline[1] + SHIFT_FLOOR**2 * np.eye(2))
    total = np.linalg.inv(first + second)
    return total @ (first @ pixels[0] + second @ outline[0]), total
