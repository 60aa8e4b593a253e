"""Hundreds of views: llvmpipe ends a shader's loops after 65535 rounds in all, and says nothing of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.errors import BadInput
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.observe import observation_atlas
from irpso_addon.gpu.observe.observation_atlas import Layers
from irpso_addon.gpu.solve.solver import Solver
from tests.support import texel_problem
from tests.support.texels import Texels, as_metal, exact, finish

METALLIC = 0.6


def observed(views: int, cameras: int, metallic: float = 0.0) -> tuple[Texels, np.ndarray]:
    """(observations with 5 % noise, true roughness) of 8 x 8 texels; cameras stand about the three that there are."""
    rng = np.random.default_rng(3)
    given = texel_problem.CAMERAS
    around = given[rng.integers(0, 3, cameras)] + rng.normal(0, 0.4, (cameras, 3))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(texel_problem, "CAMERAS", np.concatenate([given, around])[:cameras])
        problem, texels = exact(size=8, views=views, cameras=cameras)
    if metallic:
        texels = as_metal(problem, metallic)
    noisy = texels.rgb * (1 + 0.05 * rng.standard_normal(texels.rgb.shape))
    return replace(texels, rgb=noisy.astype(np.float32)), problem.truth.roughness


def roughness(on_gl: Any, texels: Texels, loss: str, metallic: float = 0.0) -> np.ndarray:
    def run(device: Device) -> np.ndarray:
        solver = Solver(device, texels.source(device), SolveSettings(size=16, loss=loss))
        solver.use_metallic(metallic)
        maps = finish(solver.solve())
        found = device.read(maps.roughness)[..., 0].copy()
        for thing in (maps.roughness, maps.detail, solver, solver.source):
            thing.release()
        return found

    return on_gl(run)


@pytest.mark.one_python
@pytest.mark.parametrize(("views", "cameras"), [(300, 3), (280, 280)])
def test_outliers_are_sought_among_hundreds_of_views(on_gl, views: int, cameras: int) -> None:
    """As right as squares, which they do without outliers; each view through a camera of its own, or of three."""
    texels, truth = observed(views, cameras)
    plain, robust = (np.median(np.abs(roughness(on_gl, texels, loss) - truth)) for loss in ("squares", "robust"))
    assert plain < 0.01 and robust < 1.5 * plain, (plain, robust)


@pytest.mark.one_python
@pytest.mark.parametrize(("cameras", "metallic", "least"), [
    (3, 0.0, 33 * 12 * 6), (11, 0.0, 33 * 12 * 3), (21, 0.0, 33 * 12 * 6), (21, 0.0, 33 * 12 * 3),
    (3, METALLIC, 33 * 17 * 6)])
def test_rounds_that_do_several_views_change_no_byte(
    on_gl, monkeypatch, cameras: int, metallic: float, least: int,
) -> None:
    texels, _ = observed(21, cameras, metallic)
    found = []
    for rounds in (65535, least):
        monkeypatch.setattr(observation_atlas, "LOOP_ROUNDS", rounds)
        found.append(roughness(on_gl, texels, "robust", metallic))
    assert np.array_equal(*found)


def test_more_views_than_can_be_told_apart_without_a_gpu(on_gl, monkeypatch) -> None:
    """Outliers are not sought there by themselves; who asks for that is told."""
    texels, _ = observed(21, 3)
    monkeypatch.setattr(on_gl(lambda device: device), "is_software", True)
    monkeypatch.setattr(observation_atlas, "LOOP_ROUNDS", 10)
    assert np.array_equal(*(roughness(on_gl, texels, loss) for loss in ("squares", "auto")))
    with pytest.raises(BadInput, match="loss robust: there are more views than it can take without a GPU"):
        roughness(on_gl, texels, "robust")


@pytest.mark.parametrize(("groups", "loops", "at_once"), [
    (range(100), 600, 1), (range(400), 600, 4), (range(800), 600, 8), (range(1000), 600, 0),
    ([0] * 50 + [1] * 50, 600, 1), ([0] * 150 + [1] * 150, 600, 4), ([0] * 400 + [1] * 400, 600, 8),
    ([n // 2 for n in range(300)], 600, 4), ([n // 5 for n in range(500)], 600, 0)])
def test_how_many_views_a_round_does(groups: Any, loops: int, at_once: int) -> None:
    """Of 65535 rounds: a round for each camera that has few views, else one for each camera and for its views."""
    assert Layers(tuple(groups), 1, 1, False).at_once(loops) == at_once
