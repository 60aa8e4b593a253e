"""Shading normals that the mesh lacks are refined under light from all around; exact ones stay."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.data import Solution, View
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading.environment import about_z
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.solve import world_light
from irpso_addon.solve import pipeline
from tests.support import shoots, skies
from tests.support import synthetic as syn
from tests.support.plane_normals import angles
from tests.support.sky_shoot import shoot

SKY = skies.sky(48, sun=60.0, width=0.12, window=8.0)
TURNS = 8
WAVES, SLOPE = 12.0, 0.08  # bumps: radians a metre
ROLLING = syn.plane_normal


@pytest.fixture(scope="module", autouse=True)
def few_directions() -> Iterator[None]:
    """As many as tell normals: errors of the light, a few per cent, are small beside what bumps do to it."""
    with pytest.MonkeyPatch.context() as patch:
        skies.sum_few_directions(patch)
        yield


def bumpy(points: np.ndarray) -> np.ndarray:
    """The plane's rolling normals with bumps on them."""
    normal = ROLLING(points)
    x, y = points[..., 0], points[..., 1]
    normal = normal + SLOPE * np.stack([np.sin(WAVES * x + 3 * y), np.cos(WAVES * y), 0 * x], -1)
    return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))


def views() -> list[View]:
    """One camera; the object stands on a table that turns."""
    turned = [replace(SKY, rotation=SKY.rotation @ about_z(turn), turn=turn)
              for turn in np.arange(TURNS) * 2 * np.pi / TURNS]
    return [View(Path(f"{n}.exr"), syn.cameras(6)[1], (), environment=each) for n, each in enumerate(turned)]


def solved(made: syn.Shoot, **settings: object) -> Solution:
    return thread.run(lambda: pipeline.solve(made.scene, SolveSettings(
        size=40, model="one-lobe", lamps="given", **settings), made.read_image))


@pytest.fixture(scope="module")
def rough() -> syn.Shoot:
    """Pictures of a bumpy plane, whose mesh has no bumps."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(syn, "plane_normal", bumpy)
        return shoot(views())


@pytest.mark.one_python
def test_many_turns_keep_the_normals_and_the_report_says_so(rough, monkeypatch) -> None:
    monkeypatch.setattr(world_light, "MOST_TILTED", TURNS - 1)
    found = solved(rough)
    assert found.normals is None
    assert found.normals_why == f"worlds with more than {TURNS - 1} turns light the views"


def test_bumps_become_a_normal_map(rough) -> None:
    refined, given = solved(rough), solved(rough, normals="mesh")
    assert refined.normals is not None and refined.normals.refined < 0.6 * refined.normals.given
    before, after = angles(refined, ROLLING, bumpy)
    assert before.mean() > 3.0 and after.mean() < 0.5 * before.mean()
    errors = [shoots.errors(solution, rough.truth).base.mean() for solution in (given, refined)]
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.one_python
def test_exact_normals_stay_to_the_byte() -> None:
    made = shoot(views())
    auto, given = solved(made), solved(made, normals="mesh")
    assert auto.normals is None and auto.maps.normal is None and auto.normals_why
    assert np.array_equal(auto.maps.base_color, given.maps.base_color)
    assert np.array_equal(auto.maps.roughness, given.maps.roughness)
