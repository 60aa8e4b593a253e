"""Environments by formula: radiance as a function of direction, and as pictures of it."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.data import Environment
from irpso_addon.core.shading import environment as model

SUN = np.array([0.5, -0.6, 0.62]) / np.linalg.norm([0.5, -0.6, 0.62])
WINDOW = np.array([-0.8, -0.4, 0.3]) / np.linalg.norm([-0.8, -0.4, 0.3])


def unit_directions(height: int) -> np.ndarray:
    """(h, 2 h, 3) of an equirectangular picture, row 0 straight down; Cycles: u = 1/2 - atan2(y, x) / (2 pi)."""
    v, u = (np.arange(height) + 0.5) / height, (np.arange(2 * height) + 0.5) / (2 * height)
    latitude, longitude = (np.pi * (v - 0.5))[:, None], (2 * np.pi * (0.5 - u))[None]
    x, y = np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude)
    return np.stack([x, y, np.sin(latitude) + 0 * longitude], -1)


def radiance(d: np.ndarray, sun: float = 0.0, width: float = 0.03, window: float = 0.0) -> np.ndarray:
    """(..., 3) of an overcast sky (CIE: a third as bright at the horizon), a sun (Gauss) and a window with bars."""
    up = np.clip(d[..., 2], 0, 1)
    sky = np.where(d[..., 2] > 0, (1 + 2 * up) / 3, 0.12)[..., None] * np.array([0.75, 0.9, 1.1])
    off = np.arccos(np.clip(d @ SUN, -1, 1))
    sky = sky + (sun * np.exp(-0.5 * (off / width) ** 2))[..., None] * np.array([1.0, 0.9, 0.75])
    side = np.cross(WINDOW, (0, 0, 1.0))
    side /= np.linalg.norm(side)
    ahead = d @ WINDOW
    x, y = (d @ axis / np.maximum(ahead, 1e-6) for axis in (side, np.cross(side, WINDOW)))
    pane = (ahead > 0) & (np.abs(x) < 0.45) & (np.abs(y) < 0.6) & (np.abs(x) > 0.03) & (np.abs(y - 0.1) > 0.03)
    return np.asarray(sky + window * pane[..., None] * np.array([0.9, 1.0, 1.1]))


def sky(height: int = 256, rotation: np.ndarray | None = None, **settings: float) -> Environment:
    """``settings``: of `radiance`."""
    picture = radiance(unit_directions(height), **settings).astype(np.float32)
    return Environment("sky", picture, np.eye(3) if rotation is None else rotation)


def sum_few_directions(patch: pytest.MonkeyPatch, most: int = 128) -> None:
    """For tests that judge something else than this sum, whose shadows would be most of their time."""
    every = model.directions

    def few(environment: Environment, count: int = model.COUNT, divides: bool = True) -> model.Directions:
        return every(environment, min(count, most), divides)

    patch.setattr(model, "directions", few)
