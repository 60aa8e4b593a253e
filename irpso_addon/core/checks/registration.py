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

from dataclasses import dataclass

import numpy as np

from ..check_records import CERTAIN, LEAST_SHIFT, SIGMAS, Misfit
from ..data import F32, F64, Bool, Camera, View
from ..projection import lens_for
from .outline_fit import BEND, GROWTH, ROLL, Optics, Outline, silhouette
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
ALIKE = 0.05  # relative: focal lengths of cameras that have one lens
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
        bends = _bends(self._done)
        return tuple(m for e, log, bend in zip(self._done, logs, bends, strict=True)
                     for m in e.misfits(log - mean, *bend))

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
        self._coverage: F32 | None = None
        self._outline: Outline | None = None
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
        if self._coverage is None or not np.array_equal(self._coverage, checked.coverage):
            optics = optics_of(checked.view.camera, self.window)
            self._coverage, self._outline = checked.coverage, silhouette(self.window.drawn, checked.coverage, optics)
        self.outlines.append(self._outline)

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
        return _Estimate(self.views, self.window, fit, self.outlines, self.window.uv.reshape(-1, 2)[at])


@dataclass(frozen=True)
class _Estimate:
    """Of one camera's V views."""

    views: list[View]
    window: PixelWindow
    fit: Fit
    outlines: list[Outline | None]
    uv: F32  # (N, 2) where the fit's pixels look

    def bend(self) -> tuple[float, float] | None:
        """What its lens's k1 lacks, and its standard error; None: no outline shows it."""
        drawn = [o for o in self.outlines if o is not None and o.optics is not None]
        if not drawn:
            return None
        return (float(np.mean([o.values[BEND] for o in drawn])),
                float(np.mean([o.covariance[BEND, BEND] for o in drawn])) ** 0.5)

    def misfits(self, log_gain: F64, bend: float, bend_error: float) -> list[Misfit]:
        """With the views' gains, (V,), and what the lens's k1 lacks."""
        outlines = [None if o is None else o.bent(bend) for o in self.outlines]
        shift, shift_error, alone = _settled(
            self.fit, [None if o is None else (o.shift, o.shift_covariance) for o in outlines])
        gain_error = np.sqrt(self.fit.gain_error**2 + GAIN_FLOOR**2 + (GAIN_PER_PIXEL * np.hypot(*shift.T)) ** 2)
        drawn = [o for o, departs in zip(outlines, alone, strict=True) if o is not None and not departs]
        growth, roll = (_of_one_shape(drawn, value) for value in (GROWTH, ROLL))
        x, y = (float(np.mean([o.centre[axis] for o in drawn])) + self.window.corner[axis]
                - self.window.image[axis] / 2 if drawn else 0.0 for axis in (0, 1))
        return [
            Misfit(view.image, view.camera.name, self.window.image, (float(right), float(up)), float(error),
                   float(np.exp(gain)), float(its_error), bool(departs), *growth, (x, y), *roll, bend, bend_error)
            for view, (right, up), error, gain, its_error, departs in zip(
                self.views, shift, shift_error, log_gain, gain_error, alone, strict=True)]


def _of_one_shape(outlines: list[Outline], value: int) -> tuple[float, float]:
    """One of several outlines' values, and its standard error: they are of one shape, so errors do not average out."""
    if not outlines:
        return 0.0, 0.0
    return (float(np.mean([o.values[value] for o in outlines])),
            float(np.mean([o.covariance[value, value] for o in outlines])) ** 0.5)


def _bends(cameras: list[_Estimate]) -> list[tuple[float, float]]:
    """What each camera's k1 lacks, and its standard error; 0 unless it is beyond doubt, and worth mending.

    Cameras with one focal length and one size of pictures are taken to have one lens.
    """
    found = [(0.0, 0.0)] * len(cameras)
    left = {n: optics for n, camera in enumerate(cameras)
            if (optics := optics_of(camera.views[0].camera, camera.window)) is not None}
    while left:
        first = min(left)
        size, focal = cameras[first].window.image, left[first].focal
        alike = [n for n, optics in left.items()
                 if cameras[n].window.image == size and abs(np.log(optics.focal / focal)) < ALIKE]
        left = {n: optics for n, optics in left.items() if n not in alike}
        each = np.array([bend for n in alike if (bend := cameras[n].bend()) is not None])
        if not len(each):
            continue
        weights = 1 / np.maximum(each[:, 1], 1e-9) ** 2
        lacks, error = float(weights @ each[:, 0] / weights.sum()), float(weights.sum() ** -0.5)
        corner = 0.5 * float(np.hypot(*size))
        if abs(lacks) > max(LEAST_SHIFT / (corner * (corner / focal) ** 2), CERTAIN * error):
            for n in alike:
                found[n] = lacks, error
    return found


def optics_of(camera: Camera, window: PixelWindow) -> Optics | None:
    """Of a camera's window; None where a bend would not be one of k1's, or a lens with more terms was measured."""
    lens = camera.lens
    if camera.orthographic or (lens is not None and (lens.fisheye or any(lens.radial[1:]) or any(lens.tangential))):
        return None
    lens = lens_for(camera, window.image)
    return Optics((lens.cx - window.corner[0], window.image[1] - lens.cy - window.corner[1]), lens.fx)


def _settled(fit: Fit, outlines: list[ViewFit | None]) -> tuple[F64, F64, Bool]:
    """Pixels and silhouettes together: (V, 2) shifts, (V,) their standard errors, (V,) departs from its camera."""
    views = range(len(outlines))
    floor = SHIFT_FLOOR**2 * np.eye(2)
    pixels = [(fit.shift[v], MODEL**2 * fit.covariance[v]) for v in views]
    # Shading is only as good as the model of light and shape: where silhouettes gainsay it, they win.
    quarrel = np.median([fit.shift[v] - o[0] for v, o in enumerate(outlines) if o is not None] or [(0.0, 0.0)], axis=0)
    doubt = floor + ((quarrel**2).mean() + (UNEXPLAINED * fit.noise) ** 2) * np.eye(2)
    each = [_joined((pixels[v][0], pixels[v][1] + doubt), outlines[v]) for v in views]
    shift = np.array([e[0] for e in each])
    error = np.array([np.sqrt(np.trace(e[1]) / 2) for e in each])
    middle = np.median(shift, axis=0)
    alone = np.hypot(*(shift - middle).T) > np.maximum(LEAST_ALONE, SIGMAS * error)
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
