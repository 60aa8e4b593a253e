"""The relief of a flat sample under flashes becomes a normal map, by the whole pipeline."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.job import Progress
from irpso_addon.core.normals import relief
from tests.support import shoots
from tests.support import synthetic as syn
from tests.support.flat_relief import PLACES

pytestmark = pytest.mark.one_python
WAVES, SLOPE = 20.0, 0.06  # radians a metre


def bumpy(points: np.ndarray) -> np.ndarray:
    x, y = points[..., 0], points[..., 1]
    normal = np.stack([SLOPE * np.sin(WAVES * x + 3 * y), SLOPE * np.cos(WAVES * y), 0 * x + 1], -1)
    return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))


def flashes() -> list[Any]:
    """Nine cameras that look down, each with a flash in its place."""
    rig, lamp = [], syn.lamps(1)[0]
    for n, (x, y) in enumerate(PLACES):
        camera = syn.camera(np.array([2 * x, 2 * y, 4.0]), name=f"Camera {n}")
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = camera.world_to_camera[:3, :3].T, camera.position
        rig.append((camera, [replace(lamp, name=f"Flash {n}", matrix=matrix)]))
    return rig


def test_highlights_show_the_relief_of_a_plane(monkeypatch) -> None:
    """Normals are 0.5 degrees off where those of the plane are 3.3.

    What is judged first would find them too: it is left out.
    """
    monkeypatch.setattr(syn, "bumpy_normal", lambda x, y: np.stack([0 * x, 0 * y, 0 * x + 1], -1))
    mesh = syn.plane_mesh()
    monkeypatch.setattr(syn, "plane_normal", bumpy)
    shoot = syn.shoot(syn.VARIED, flashes(), (96, 96), mesh=mesh, noise=0.01)

    def no_better(sample: Any) -> Generator[Progress, None, str]:
        yield Progress(0.0, "normals")
        return relief.NO_BETTER

    monkeypatch.setattr(relief, "judge_normals", no_better)
    solution = shoots.run(shoot, model="one-lobe", registration="given", indirect="off", normals="auto", size=96)
    assert solution.normals is not None and solution.maps.normal is not None, solution.normals_why
    maps = solution.maps
    at = (np.arange(96) + 0.5) / 96
    places = np.stack([*np.meshgrid(at, at), np.zeros((96, 96))], -1)
    points = (places - syn.MARGIN) / (1 - 2 * syn.MARGIN) * 2 - 1
    points[..., 2] = 0
    inside = maps.coverage & ~maps.filled & (np.abs(points[..., :2]).max(-1) < 0.9)
    true, found = bumpy(points)[inside], maps.normal[inside].astype(np.float64) * 2 - 1
    found /= np.linalg.norm(found, axis=-1, keepdims=True)
    before = np.degrees(np.arccos(np.clip(true[:, 2], -1, 1)))
    after = np.degrees(np.arccos(np.clip((true * found).sum(-1), -1, 1)))
    assert before.mean() > 2.5 and after.mean() < 0.25 * before.mean()
