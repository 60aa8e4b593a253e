"""What all views say together: whether pictures are linear, and whether lights stand where the scene says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ..check_records import LightResidual, Slope
from ..data import F64, Bool, Light, View
from ..shading.lights import light_irradiance
from .residuals import DIFFUSE, SampledView, scale_of
from .view_check_data import PixelWindow

PLACES = 5000  # pixels of a camera that the regressions look at
FEWEST = 50  # of them that a regression needs
LEAST_SPREAD = 0.1  # of log irradiance, by which an exponent is told
MIN_COS_L = 0.2  # below it the derivative of irradiance is mostly the facets' error
STEP = 1e-4  # of the light's distance, for derivatives
DISC_SIDE = 0.75**0.5  # of its diameter: side of the square with the second moments of a disc
ACROSS = 6  # cells over the object: what neighbours have in common is no pattern of a light
CORRELATED = 3.0  # standard errors of regressions, times what independent pixels would have


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


class Places:
    """Residuals at some places of each camera, for what no view tells by itself."""

    def __init__(self) -> None:
        self._groups: list[_Group] = []
        self._some = slice(None)
        self.count = 0

    def camera(self, window: PixelWindow, at: NDArray[np.int64]) -> None:
        """Views of another camera follow, at these pixels (B, 16)."""
        self._some = slice(None, None, max(1, -(-at.size // PLACES)))
        position, normal = (values.reshape(-1, 3)[at.ravel()[self._some]].astype(np.float64)
                            for values in (window.position, window.normal))
        self._groups.append(_Group(position, normal))

    def add(self, view: View, seen: SampledView, gain: float) -> None:
        """A view, its residuals at its camera's pixels, and its gain."""
        y, share, light = (values.ravel()[self._some] for values in (seen.y, seen.share, seen.light))
        good = seen.good.ravel()[self._some]
        diffuse = good & (share < DIFFUSE)
        self._groups[-1].rows.append(_Row(
            self.count, view.lights, y.astype(np.float64) - np.log(gain),
            np.log(np.where(good, light, 1.0)).astype(np.float64), diffuse if diffuse.sum() >= FEWEST else good))
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
                if ok[n].sum() < FEWEST:
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
        parts, own, center, cells = [], [], [], []
        for group in self._groups:
            for row in group.rows:
                if light.name not in [other.name for other in row.lights]:
                    continue
                ok = row.diffuse.copy()
                ok[ok] = _share(light, row.lights, group.position[ok], group.normal[ok]) > 0.5
                if ok.sum() < FEWEST:
                    continue
                P, N = group.position[ok], group.normal[ok]
                slopes, fine = light_slopes(light, P, N)
                # The view's gain belongs to its exposure or to the light's power: the pattern is what is looked at.
                if fine.sum() < FEWEST:
                    continue
                own.append(gains[row.view])
                parts.append((row.y[ok][fine], slopes[fine] - np.median(slopes[fine], 0)))
                center.append(P.mean(0))
                cells.append(_cells(P[fine]))
        if not parts or sum(len(y) for y, _ in parts) < FEWEST:
            return None
        y, A = (np.concatenate(values) for values in zip(*parts, strict=True))
        move, explained = place_fit(y, A, np.concatenate(cells))
        effect = float(np.sqrt(np.mean((A @ move) ** 2)))
        distance = float(np.linalg.norm(light.matrix[:3, 3] - np.mean(center, 0))) if light.kind != "SUN" else 1.0
        gain = float(np.median(own))
        gain_error = float(1.2533 * scale_of(np.array(own)) / len(own) ** 0.5) if len(own) > 1 else float("inf")
        dx, dy, dz = (float(v) * distance for v in move)
        return LightResidual(light.name, len(own), gain, gain_error, (dx, dy, dz), float(np.linalg.norm(move)), effect,
                             explained, light.kind == "SUN")


def _cells(P: F64) -> Bool:
    """(n,) whether a place lies in an odd cell of a grid over all of them."""
    across = max(float(np.ptp(P, axis=0).max()), 1e-9)
    return np.asarray(((P - P.min(0)) / across * ACROSS).astype(np.int64).sum(-1) % 2 == 1)


def place_fit(y: F64, slopes: F64, odd: Bool) -> tuple[F64, float]:
    """(3,) the move that explains (n,) relative errors of brightness best, and the share of their variance it explains.

    ``slopes``: (n, 3) of brightness by the move.  ``odd``: (n,) half of the places.  The share is that of each half by
    what the other half says: three numbers always explain something of a few places.
    """
    move, explained = _fit(y, slopes)
    if min(odd.sum(), (~odd).sum()) < FEWEST:
        return move, 0.0
    left, before = y - np.median(y), scale_of(y)
    for half in (odd, ~odd):
        rest = y[half] - slopes[half] @ _fit(y[~half], slopes[~half])[0]
        left[half] = rest - np.median(rest)
    return move, min(explained, 1.0 - (scale_of(left) / before) ** 2) if before > 0 else 0.0


def light_slopes(light: Light, P: F64, N: F64, reach: float | None = None) -> tuple[F64, Bool]:
    """(n, 3) d log irradiance as the light moves by its distance (SUN: turns by a radian), and where that is told.

    ``reach``: its distance; None: to the middle of ``P``.
    """
    place = light.matrix[:3, 3]
    offset = np.broadcast_to(-P if light.kind == "SUN" else place - P, P.shape)
    if reach is None:
        reach = 1.0 if light.kind == "SUN" else float(np.linalg.norm(place - P.mean(0)))
    direction = light.matrix[:3, 2] if light.kind == "SUN" else offset
    direction = direction / np.maximum(np.linalg.norm(direction, axis=-1, keepdims=True), 1e-12)
    fine = np.asarray((N * direction).sum(-1) > MIN_COS_L)
    light = four_sided(light)
    if light.kind == "SUN":
        two = np.stack([[light_irradiance(moved(light, axis, by), P, N) for axis in range(3)] for by in (STEP, -STEP)])
    else:  # a lamp that moves is, for the places, places that move the other way: all at once
        by = STEP * reach * np.eye(3)[:, None]
        two = light_irradiance(light, np.stack([P - by, P + by]), N)
    fine &= (two > 0).all((0, 1))
    slopes = np.log(np.maximum(two[0], 1e-30) / np.maximum(two[1], 1e-30)).T / (2 * STEP)
    return slopes, fine & np.isfinite(slopes).all(-1)


def four_sided(light: Light) -> Light:
    """A disc as the rectangle of the same second moments, a soft spot as a sharp one: for both there is a formula.

    The sum over a spot's 64 points blurs the rim of the cone, which says little, and takes as many times as long.
    """
    if light.kind == "SPOT":
        return replace(light, radius=0.0)
    if light.kind != "AREA" or light.shape not in ("DISK", "ELLIPSE"):
        return light
    width, height = light.size
    return replace(light, shape="RECTANGLE",
                   size=(width * DISC_SIDE, (width if light.shape == "DISK" else height) * DISC_SIDE))


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
    if n < FEWEST or xx / n < LEAST_SPREAD**2:  # all under about the same light: nothing can be told
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
