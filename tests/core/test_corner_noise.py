"""Noise of corners is taken out of normals, and what waves over many edges stays."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.shoot.corner_noise import noise_of, without_noise

SIDE = 160  # corners along a side of a bumpy sheet, one edge apart


def sheet(noise: float, wave: float, height: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Exact normals (V, 3), those of corners that are off by ``noise`` edges, and edges, of triangles.

    ``wave``: edges that a bump is long, a part of SIDE: the sheet goes on at its borders.
    """
    x, y = np.meshgrid(np.arange(SIDE), np.arange(SIDE), indexing="ij")
    turn = 2 * np.pi / wave
    slopes = height * turn * np.stack([np.cos(turn * x) * np.cos(turn * y), -np.sin(turn * x) * np.sin(turn * y)], -1)
    exact = np.concatenate([-slopes, np.ones((SIDE, SIDE, 1))], axis=-1)
    z = height * np.sin(turn * x) * np.cos(turn * y) + np.random.default_rng(0).normal(0, noise, (SIDE, SIDE))
    # A corner's normal by those of the six triangles around it.
    right, left = np.roll(z, -1, 0) - z, z - np.roll(z, 1, 0)
    up, down = np.roll(z, -1, 1) - z, z - np.roll(z, 1, 1)
    across, along = np.roll(right, -1, 1), np.roll(up, -1, 0)
    found = np.zeros((SIDE, SIDE, 3))
    for dx, dy in ((right, along), (across, up), (left, np.roll(up, 1, 0)), (right, down),
                   (np.roll(left, 1, 1), down), (left, np.roll(np.roll(along, 1, 1), 1, 0))):
        one = np.stack([-dx, -dy, np.ones_like(dx)], -1)
        found += one / np.linalg.norm(one, axis=-1, keepdims=True)
    number = x * SIDE + y
    edges = np.concatenate([np.stack([number, np.roll(number, (-i, -j), (0, 1))], -1).reshape(-1, 2)
                            for i, j in ((1, 0), (0, 1), (1, 1))])
    unit = [normals.reshape(-1, 3) / np.linalg.norm(normals.reshape(-1, 3), axis=1, keepdims=True)
            for normals in (exact, found)]
    return *unit, edges.astype(np.int32)


def degrees(one: np.ndarray, other: np.ndarray) -> float:
    """Between normals, root mean square."""
    return float(np.degrees(np.sqrt(np.mean(np.arccos(np.einsum("vk,vk->v", one, other).clip(-1, 1)) ** 2))))


@pytest.mark.parametrize(("noise", "least"), [(0.05, 1.4), (0.1, 1.8), (0.3, 2.5)])
def test_noise_is_taken_out(noise: float, least: float) -> None:
    """By so much, beside bumps that are 32 edges long and 10 degrees steep."""
    exact, rough, edges = sheet(noise, 32, 0.9)
    found, count = without_noise(rough, edges)
    assert count >= 1
    assert degrees(found, exact) < degrees(rough, exact) / least
    moved = np.degrees(np.median(np.arccos(np.einsum("vk,vk->v", rough, exact).clip(-1, 1))))
    assert 0.7 * moved < np.degrees(noise_of(rough, edges)) < 1.3 * moved  # how far normals are off, in the median
    assert np.degrees(noise_of(found, edges)) < 0.5 * moved


@pytest.mark.parametrize("wave", [10, 20, 40, 80])
def test_shape_stays(wave: int) -> None:
    """To the byte, of bumps as short as ten edges; nothing gets worse where noise is a five-hundredth of an edge."""
    _, given, edges = sheet(0.0, wave, wave / 32)
    found, count = without_noise(given, edges)
    assert count == 0
    assert (found == given).all() and noise_of(given, edges) == 0
    exact, rough, edges = sheet(0.002, wave, wave / 32)
    assert degrees(without_noise(rough, edges)[0], exact) <= degrees(rough, exact)


def test_corners_without_neighbours_keep_their_normals() -> None:
    normals = np.tile([0.0, 0.6, 0.8], (5, 1))
    found, count = without_noise(normals, np.zeros((0, 2), np.int32))
    assert count == 0 and (found == normals).all() and noise_of(normals, np.zeros((0, 2), np.int32)) == 0
