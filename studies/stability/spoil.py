"""What happens to pictures: cameras that are off, shadows and reflections nobody knows of, noise, and the file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from irpso_addon.core.data import F64, Bool
from irpso_addon.core.images.colour import linear_to_srgb, srgb_to_linear
from tests.support.texel_problem import smooth_map

if TYPE_CHECKING:
    from .problem import Trial

SHADOWED = 0.05  # what is left of an observation in a shadow taken for lit, as in studies/bench
BLOB = 5.0  # texels: width of outliers that lie together


@dataclass(frozen=True)
class Pictures:
    """Radiance of every view, by part."""

    diffuse: F64  # (h, w, K, 3)
    specular: F64  # (h, w, K, 3)
    base: F64  # (h, w, 3)
    lit: Bool  # (h, w, K) believed to be seen and lit


def develop(trial: Trial, pictures: Pictures, rng: np.random.Generator) -> tuple[F64, Bool, F64]:
    """(radiance (h, w, K, 3) as read from the files, whether it is kept (h, w, K), share clipped of each view)."""
    value = pictures.diffuse + pictures.specular
    if trial.shadows or trial.doubled:
        kind = _kinds(trial, value.shape[:3], rng)
        shadow, double = kind < trial.shadows, (kind >= trial.shadows) & (kind < trial.shadows + trial.doubled)
        value = np.where(shadow[..., None], SHADOWED * value, value)
        value = np.where(double[..., None], value + pictures.specular, value)
    if trial.bounce:
        value = value + trial.bounce * pictures.base[:, :, None]
    for deviation in (trial.noise * value, trial.shot * np.sqrt(value), trial.read * np.ones_like(value)):
        if np.any(deviation):
            value = value + deviation * rng.standard_normal(value.shape)
    value = np.maximum(value, 0.0) if trial.depth.isdigit() else value
    over = (value >= trial.clip).any(-1)
    value = np.minimum(value, trial.clip)
    if trial.tone != 1.0:
        value = np.maximum(value, 0.0) ** trial.tone
    value = stored(value, trial.depth)
    clipped = (over & pictures.lit).sum((0, 1)) / np.maximum(pictures.lit.sum((0, 1)), 1)
    return value, ~(over & trial.masked), clipped


def _kinds(trial: Trial, shape: tuple[int, ...], rng: np.random.Generator) -> F64:
    """Numbers 0..1, evenly spread, that decide what each observation is."""
    if not trial.blobs:
        return rng.random(shape)
    fields = np.stack([smooth_map(shape[0], rng, 0, 1, BLOB) for _ in range(shape[2])], -1)
    ranks = fields.reshape(-1, shape[2]).argsort(0).argsort(0)
    return np.asarray((ranks / ranks.shape[0]).reshape(shape))


def stored(value: F64, depth: str) -> F64:
    """Written to a file whose largest value is the largest there is, and read again."""
    if depth == "float":
        return value
    if depth == "half":
        return value.astype(np.float16).astype(np.float64)
    full = float(value.max())
    steps = 2 ** int(depth) - 1
    share = np.clip(value / full, 0.0, 1.0)
    if depth != "8":
        return np.asarray(full * np.round(share * steps) / steps)
    return np.asarray(full * srgb_to_linear(np.round(linear_to_srgb(share) * steps) / steps))


def shifted(image: F64, by: F64) -> F64:
    """An image (h, w, c) seen by a camera that is off by (x, y) texels: Catmull-Rom, the border repeated."""
    for axis, amount in ((1, by[0]), (0, by[1])):
        whole = int(np.floor(amount))
        t = float(amount) - whole
        if amount == 0:
            continue
        weights = (-0.5 * t + t**2 - 0.5 * t**3, 1 - 2.5 * t**2 + 1.5 * t**3,
                   0.5 * t + 2 * t**2 - 1.5 * t**3, -0.5 * t**2 + 0.5 * t**3)
        index = np.arange(image.shape[axis])
        image = sum((w * np.take(image, np.clip(index + whole + j - 1, 0, len(index) - 1), axis)
                     for j, w in enumerate(weights)), np.zeros_like(image))
    return np.maximum(image, 0.0) if np.any(by) else image
