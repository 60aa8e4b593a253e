"""What the views leave over: robust statistics of observed over predicted, from which core/checks.py tells causes.

The residual of a pixel is y = log(observed / predicted), the mean of its channels.  The maps are the views' consensus,
so what is wrong with one view, or with one light, stays in the residual of just its pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .checked import CheckedView, Window
from .data import F32, F64, Bool, Light
from .lights import light_irradiance

BLOCK, SMALL = 4, 2  # pixels: errors that reach so far are no noise; in highlights, which are small
DIFFUSE, HIGHLIGHT = 0.25, 0.1  # at most and at least such a share of the prediction is the lobes'
LEAST = 200  # pixels that a statistic needs
SAMPLE = 10_000  # values that a median looks at
PLACES = 5000  # of a camera that the regressions look at
LOG_MOST = 3.0  # |y| beyond is cut
BOUNCED = 0.01  # radiance of shadows, as a share of the lit median, from which on light has bounced
MIN_COS_L = 0.2  # below it the derivative of irradiance is mostly the facets' error
STEP = 1e-4  # of the light's distance, for derivatives
MAD = 1.4826  # standard deviation of a normal distribution over its median absolute deviation
CORRELATED = 5.0  # standard errors of regressions, times what independent pixels would have


def scale_of(values: F64 | F32) -> float:
    """Robust standard deviation about the median; of a sample where there are many."""
    some = values[::max(1, len(values) // SAMPLE)]
    return float(MAD * np.median(np.abs(some - np.median(some)))) if len(some) else 0.0


@dataclass(frozen=True)
class Residual:
    """One view's residuals, summed up.  Shares and spreads are relative (0.01: 1 %)."""

    pixels: int  # that were judged
    gain: float  # median of observed / predicted
    gain_error: float  # its standard error
    spread: float  # robust standard deviation of observed / predicted
    noise: float  # the part of it that differs from pixel to pixel
    structure: float  # the part that neighbours share: what the model does not explain
    unlit: float | None  # radiance where no light of the view arrives, as a share of the lit pixels' median
    unlit_pixels: int


def grey(values: F32, lit: Bool) -> F64:
    """Mean of the channels that have light, (...); channel by channel, several times as fast as a sum over an axis."""
    total = sum(np.where(lit[..., c], values[..., c], np.float32(0)) for c in range(3))
    return np.asarray(total / np.maximum(sum(lit[..., c].astype(np.int8) for c in range(3)), 1), np.float64)


def log_ratio(view: CheckedView) -> tuple[F64, F64, Bool]:
    """(h, w) y, the lobes' share of the prediction, and where both are known."""
    lit = view.observed > -100
    observed, predicted = grey(view.observed, lit), grey(view.predicted, lit)
    good = view.good & (predicted > 1e-5) & (observed != 0)
    safe = np.where(good, predicted, 1.0)
    y = np.log(np.clip(np.where(good, observed, 1.0) / safe, np.exp(-LOG_MOST), np.exp(LOG_MOST)))
    return y, np.where(good, grey(view.specular, lit) / safe, 0.0), good


def residual(view: CheckedView, y: F64, share: F64, good: Bool) -> tuple[Residual, tuple[F64, F64]]:
    """A view's figures, and block_means of its highlights, relative to the lobes' part."""
    diffuse = good & (share < DIFFUSE)
    judged = diffuse if diffuse.sum() >= LEAST else good
    values = y[judged]
    if len(values) < LEAST:
        return Residual(len(values), 1.0, np.inf, 0.0, 0.0, 0.0, *unlit(view)), (np.zeros(0), np.zeros(0))
    middle, spread = float(np.median(values)), scale_of(values)
    clear = judged[:, 1:] & judged[:, :-1]
    noise = scale_of((y[:, 1:] - y[:, :-1])[clear]) / np.sqrt(2) if clear.sum() >= LEAST else spread
    blocks, within = block_means(y - middle, judged, BLOCK)
    structure = shared(blocks, within, BLOCK) if len(blocks) >= LEAST / BLOCK**2 else 0.0
    error = 1.2533 * float(np.hypot(structure, spread / BLOCK)) / max(len(blocks), 1) ** 0.5
    shiny = good & (share > HIGHLIGHT)
    lobes = block_means((y - middle) / np.maximum(share, HIGHLIGHT), shiny, SMALL)
    return Residual(int(judged.sum()), float(np.exp(middle)), error, spread, noise, structure, *unlit(view)), lobes


def block_means(values: F64, good: Bool, size: int) -> tuple[F64, F64]:
    """Means over blocks of size x size pixels most of which are good, and what their pixels depart from them."""
    h, w = (n // size * size for n in values.shape)
    shape = (h // size, size, w // size, size)
    inside = good[:h, :w].reshape(shape)
    count = inside.sum((1, 3))
    known = np.where(inside, values[:h, :w].reshape(shape), 0.0)
    full = count >= 0.7 * size**2
    mean = np.where(full, known.sum((1, 3)) / np.maximum(count, 1), 0.0)
    left = (known - mean[:, None, :, None])[inside & full[:, None, :, None]]
    return mean[full], left[::max(1, len(left) // SAMPLE)]


def shared(means: F64, within: F64, size: int) -> float:
    """Robust standard deviation of what the pixels of a block have in common.

    The mean of n pixels of independent noise s has s / sqrt(n), and they depart from it by s sqrt(1 - 1 / n).
    About 0, not about the median: a bias is an error too.
    """
    noise = scale_of(within) / (size**2 - 1) ** 0.5
    return float(np.sqrt(max((MAD * float(np.median(np.abs(means)))) ** 2 - noise**2, 0.0)))


def unlit(view: CheckedView) -> tuple[float | None, int]:
    """Mean radiance where no light arrives over the lit pixels' median (bright sparks cut); of how many pixels.

    Read noise cannot go below black, so its mean is not 0: about 0.65 of the difference of two pixels is taken off.
    """
    dark = eroded(view.unlit, 2)
    if dark.sum() < LEAST or view.good.sum() < LEAST:
        return None, int(dark.sum())
    radiance = np.maximum(_mean(view.radiance), 0)
    level = max(float(np.median(radiance[view.good])), 1e-20)
    pairs = dark[:, 1:] & dark[:, :-1]
    noise = scale_of((radiance[:, 1:] - radiance[:, :-1])[pairs]) if pairs.any() else 0.0
    return max(float(np.minimum(radiance[dark] / level, 1.0).mean()) - 0.65 * noise / level, 0.0), int(dark.sum())


def is_indirect(share: float) -> bool:
    """Whether shadows so bright (a share of the lit median) hold light that has bounced; NaN: nothing tells."""
    return share > BOUNCED


def _mean(values: F32) -> F32:
    """Mean of the channels of (..., 3), several times as fast as over an axis."""
    return np.asarray((values[..., 0] + values[..., 1] + values[..., 2]) / 3, np.float32)


def eroded(mask: Bool, pixels: int) -> Bool:
    """The mask without its rim."""
    result = mask.copy()
    for _ in range(pixels):
        padded = np.pad(result, 1)
        result = result & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return result


# ---- over views


@dataclass
class _Row:
    """One view at its camera's places."""

    view: int
    lights: tuple[Light, ...]
    y: F64  # (P,)
    log_e: F64  # (P,) log irradiance
    diffuse: Bool  # (P,) to be used


@dataclass
class _Group:
    """The views that share places: those of a camera."""

    position: F64  # (P, 3)
    normal: F64  # (P, 3)
    rows: list[_Row] = field(default_factory=list)


@dataclass(frozen=True)
class Slope:
    """Exponent between image and radiance."""

    exponent: float
    error: float  # its standard error


@dataclass(frozen=True)
class LightResidual:
    """What a light's pixels say of it."""

    name: str
    views: int
    gain: float  # by which its irradiance should be multiplied
    gain_error: float
    offset: tuple[float, float, float]  # metres by which it should be moved, from its shading
    offset_share: float  # of its distance
    effect: float  # relative: the errors of shading that the move would take away, root mean square
    explained: float  # share of the residual's variance that the move explains


class Places:
    """Residuals at some places of each camera, for what no view tells by itself."""

    def __init__(self) -> None:
        self._groups: list[_Group] = []
        self._window: Window | None = None
        self._at: tuple[slice, slice] = (slice(None), slice(None))
        self._inside = np.zeros((0, 0), bool)
        self.count = 0

    def add(self, view: CheckedView, y: F64, share: F64, good: Bool, gain: float) -> None:
        """A view with what log_ratio says of it; views of one window follow one another."""
        if view.window is not self._window:
            self._window = view.window
            step = max(1, int((view.window.covered.sum() / PLACES) ** 0.5))
            self._at = (slice(step // 2, None, step), slice(step // 2, None, step))
            self._inside = view.window.covered[self._at]
            position, normal = (a[self._at][self._inside].astype(np.float64)
                                for a in (view.window.position, view.window.normal))
            self._groups.append(_Group(position, normal))
        at, inside = self._at, self._inside
        light = np.maximum(view.irradiance[at][inside], 0).mean(-1, dtype=np.float64)
        known = good[at][inside] & (light > 0)
        diffuse = known & (share[at][inside] < DIFFUSE)
        self._groups[-1].rows.append(_Row(
            self.count, view.view.lights, y[at][inside] - np.log(gain), np.log(np.where(known, light, 1.0)),
            diffuse if diffuse.sum() >= LEAST / 4 else known))
        self.count += 1

    def slopes(self) -> tuple[Slope | None, list[Slope | None]]:
        """Of all views together and of each: the slope of log radiance observed over log radiance expected.

        Within a place, over its views: there the base colour, that took in the mean of all, is the same.
        """
        moments = np.zeros((self.count, 3))  # sums of x x, x y, weights
        squares = np.zeros(self.count)
        for group in self._groups:
            x, y = (np.stack([getattr(row, name) for row in group.rows]) for name in ("log_e", "y"))
            ok = np.stack([row.diffuse for row in group.rows])
            if len(group.rows) >= 3:
                ok = ok & (ok.sum(0) >= 3)
                x, y = (_without_place(v, ok) for v in (x, y))
            for n, row in enumerate(group.rows):
                if ok[n].sum() < LEAST / 4:
                    continue
                xs, ys = x[n, ok[n]], y[n, ok[n]]
                xs, ys = xs - np.median(xs), ys - np.median(ys)
                weight = _huber(ys - _slope(xs, ys, np.ones_like(xs)) * xs)
                weight = _huber(ys - _slope(xs, ys, weight) * xs)
                moments[row.view] = (weight * xs * xs).sum(), (weight * xs * ys).sum(), weight.sum()
                squares[row.view] = (weight * (ys - _slope(xs, ys, weight) * xs) ** 2).sum()
        each = [_exponent(m[None], q[None]) for m, q in zip(moments, squares, strict=True)]
        return _exponent(moments, squares), each

    def lights(self, gains: Sequence[float]) -> list[LightResidual]:
        """Each light's, by name; ``gains`` of the views as given to ``add``."""
        lights = {light.name: light for group in self._groups for row in group.rows for light in row.lights}
        return [found for light in lights.values() if (found := self._light(light, gains)) is not None]

    def _light(self, light: Light, gains: Sequence[float]) -> LightResidual | None:
        parts, own, center = [], [], []
        for group in self._groups:
            for row in group.rows:
                if light.name not in [other.name for other in row.lights]:
                    continue
                ok = row.diffuse.copy()
                ok[ok] = _share(light, row.lights, group.position[ok], group.normal[ok]) > 0.5
                if ok.sum() < LEAST / 4:
                    continue
                P, N = group.position[ok], group.normal[ok]
                slopes, fine = light_slopes(light, P, N)
                # The view's gain belongs to its exposure or to the light's power: the pattern is what is looked at.
                if fine.sum() < LEAST / 4:
                    continue
                own.append(gains[row.view])
                parts.append((row.y[ok][fine], slopes[fine] - np.median(slopes[fine], 0)))
                center.append(P.mean(0))
        if not parts or sum(len(y) for y, _ in parts) < LEAST / 4:
            return None
        y, A = (np.concatenate(values) for values in zip(*parts, strict=True))
        move, explained = _fit(y, A)
        effect = float(np.sqrt(np.mean((A @ move) ** 2)))
        distance = float(np.linalg.norm(light.matrix[:3, 3] - np.mean(center, 0))) if light.kind != "SUN" else 1.0
        gain = float(np.median(own))
        gain_error = float(1.2533 * scale_of(np.array(own)) / len(own) ** 0.5) if len(own) > 1 else float("inf")
        dx, dy, dz = (float(v) * distance for v in move)
        return LightResidual(light.name, len(own), gain, gain_error, (dx, dy, dz), float(np.linalg.norm(move)), effect,
                             explained)


def light_slopes(light: Light, P: F64, N: F64) -> tuple[F64, Bool]:
    """(n, 3) d log irradiance as the light moves by its distance (SUN: turns by a radian), and where that is told."""
    place = light.matrix[:3, 3]
    offset = np.broadcast_to(-P if light.kind == "SUN" else place - P, P.shape)
    reach = 1.0 if light.kind == "SUN" else float(np.linalg.norm(place - P.mean(0)))
    direction = light.matrix[:3, 2] if light.kind == "SUN" else offset
    direction = direction / np.maximum(np.linalg.norm(direction, axis=-1, keepdims=True), 1e-12)
    fine = np.asarray((N * direction).sum(-1) > MIN_COS_L)
    slopes = np.zeros(P.shape)
    for axis in range(3):
        two = [light_irradiance(moved(light, axis, sign * STEP * reach), P, N) for sign in (1, -1)]
        fine &= (two[0] > 0) & (two[1] > 0)
        slopes[:, axis] = np.log(np.maximum(two[0], 1e-30) / np.maximum(two[1], 1e-30)) / (2 * STEP)
    return slopes, fine & np.isfinite(slopes).all(-1)


def moved(light: Light, axis: int, by: float) -> Light:
    """The light, moved along a world axis; a SUN's direction is."""
    matrix = light.matrix.copy()
    if light.kind == "SUN":
        back = matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
        back[axis] += by
        matrix[:3, 2] = back / np.linalg.norm(back)
    else:
        matrix[axis, 3] += by
    return replace(light, matrix=matrix)


def _share(light: Light, lights: Sequence[Light], P: F64, N: F64) -> F64:
    """(n,) of the irradiance that is this light's, shadows apart."""
    if len(lights) == 1:
        return np.ones(len(P))
    each = {other.name: light_irradiance(other, P, N) * other.power.mean() for other in lights}
    return np.asarray(each[light.name] / np.maximum(sum(each.values()), 1e-30))


def _without_place(values: F64, ok: Bool) -> F64:
    """(K, P) less each place's median over the views that are ok, which one odd view does not move."""
    ordered = np.sort(np.where(ok, values, np.inf), axis=0)
    count = np.maximum(ok.sum(0), 1)
    middle = [np.take_along_axis(ordered, index[None], 0)[0] for index in ((count - 1) // 2, count // 2)]
    with np.errstate(invalid="ignore"):  # a place that no view sees well
        return np.asarray(values - (middle[0] + middle[1]) / 2)


def _huber(left: F64) -> F64:
    """Weights of Huber's loss at 1.345 standard deviations."""
    limit = 1.345 * max(scale_of(left), 1e-9)
    return np.asarray(np.minimum(1.0, limit / np.maximum(np.abs(left), 1e-12)))


def _slope(x: F64, y: F64, weight: F64) -> float:
    return float((weight * x * y).sum() / max(float((weight * x * x).sum()), 1e-12))


def _exponent(moments: F64, squares: F64) -> Slope | None:
    """From sums over views."""
    xx, xy, n = moments.sum(0)
    if n < LEAST / 4 or xx / n < 1e-3:  # all under about the same light: nothing can be told
        return None
    return Slope(1.0 + float(xy / xx), CORRELATED * float(np.sqrt(squares.sum() / n / xx)))


def _fit(y: F64, A: F64) -> tuple[F64, float]:
    """Robust least squares of y on A (n, 3) and a constant: its solution, and the share of variance it explains."""
    full = np.concatenate([A, np.ones((len(A), 1))], 1)
    weight = np.ones(len(y))
    solution = np.zeros(4)
    for _ in range(4):
        W = full * weight[:, None]
        solution = np.linalg.solve(W.T @ full + 1e-6 * len(y) * np.eye(4), W.T @ y)
        weight = _huber(y - full @ solution)
    left = y - full @ solution
    before = scale_of(y)
    return solution[:3], 1.0 - (scale_of(left) / before) ** 2 if before > 0 else 0.0
