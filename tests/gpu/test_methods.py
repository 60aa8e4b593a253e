"""Methods on observations that are exact: what they find, the same bytes each time and with any tiles."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.observe import observation_atlas
from irpso_addon.gpu.solve.solver import Solver
from tests.support.texels import Texels, exact, finish

METHODS = ("refined", "draft", "swarm")


def solve(on_gl: Any, texels: Texels, lobes: int = 1, **chosen: Any) -> list[np.ndarray]:
    """All maps of a solve, the first of them roughness or the pairs of lobes, and the base colour."""

    def job(device: Device) -> list[np.ndarray]:
        source = texels.source(device)
        h, w = texels.quality.shape[:2]
        solver = Solver(device, source, SolveSettings(size=max(h, w), **chosen))
        maps = finish(solver.solve_two() if lobes == 2 else solver.solve())
        found = maps.roughness if maps.pairs is None else maps.pairs
        albedo = finish(solver.albedo(found, lobes))
        textures = [found, albedo, maps.roughness, maps.detail]
        result = [device.read(texture).copy() for texture in textures]
        for thing in (*dict.fromkeys(textures), solver, source):
            thing.release()
        return result

    return on_gl(job)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("views", [6, 12, 24])
def test_a_method_finds_exact_maps(on_gl, method, views):
    """Mean error of roughness below 0.001, of base colour too; 24 views are more than loops are unrolled for."""
    problem, texels = exact(size=48, views=views)
    found, albedo, *_ = solve(on_gl, texels, method=method)
    off = np.abs(found[..., 0] - problem.truth.roughness)
    assert off.mean() < 1e-3
    assert np.median(off) < 1e-5
    assert (off > 0.1).mean() < 0.003
    assert np.abs(albedo[..., :3] - problem.truth.base).mean() < 1e-3
    assert (found[..., 3] == 1).all()


@pytest.mark.parametrize("method", METHODS)
def test_cameras_and_lamps_of_every_number(on_gl, method):
    """Three cameras with four views each."""
    problem, texels = exact(size=48, cameras=3)
    off = np.abs(solve(on_gl, texels, method=method)[0][..., 0] - problem.truth.roughness)
    assert off.mean() < 1e-3


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("tile", [(24, 10), (40, 40)])
@pytest.mark.parametrize("spec", [{}, {"noise": 0.01}, {"model": "two-lobe"}, {"model": "two-lobe", "noise": 0.01}],
                         ids=lambda spec: " ".join(map(str, spec.values())) or "clean")
def test_the_same_bytes_again_and_with_other_tiles(on_gl, monkeypatch, method, tile, spec):
    """Two lobes too: their passes ask neighbours of the whole map, not of a tile."""
    texels, lobes = exact(size=40, views=8, **spec)[1], 2 if "model" in spec else 1
    whole = [a.tobytes() for a in solve(on_gl, texels, lobes, method=method)]
    if tile == (40, 40):
        assert [a.tobytes() for a in solve(on_gl, texels, lobes, method=method)] == whole
        return
    monkeypatch.setattr(observation_atlas, "TILE", tile)
    assert [a.tobytes() for a in solve(on_gl, texels, lobes, method=method)] == whole


@pytest.mark.parametrize("method", METHODS)
def test_a_seed_is_used_and_does_not_matter(on_gl, method):
    texels = exact()[1]
    first, other = (solve(on_gl, texels, method=method, seed=seed)[0][..., 0] for seed in (1, 2))
    assert (first != other).any()
    assert np.quantile(np.abs(first - other), 0.98) < 1e-4
