"""The whole pipeline with the larger models, and auto that finds them, on exact pictures of such materials."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.data import Solution
from irpso_addon.core.errors import Cancelled
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading import brdf
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.observe import observation_atlas as gpu_atlas
from irpso_addon.solve import pipeline
from tests.support import synthetic as syn
from tests.support.shoots import AS_GIVEN, errors, rig, run
from tests.support.texels import held

SIZE = 48
WEIGHT, RATIO = 0.6, 1.8  # of the first lobe; of the roughnesses


def coat(ndf: str) -> syn.Truth:
    """Four paints of two lobes."""
    def reflect(base: np.ndarray, r: np.ndarray, *directions: np.ndarray) -> np.ndarray:
        return brdf.two_lobe(base, (r, RATIO * r, np.full_like(r, WEIGHT)), *directions, ndf)

    return replace(syn.PATCHES, roughness=syn.quarters([0.2, 0.25, 0.3, 0.35]), reflect=reflect)


TRUTHS = {"lacquer": replace(syn.PATCHES, reflect=partial(brdf.principled, level=0.8)), "coat": coat("ggx"),
          "cook-torrance": coat("beckmann")}


@pytest.fixture(scope="module")
def shoots() -> dict[str, syn.Shoot]:
    return {name: syn.shoot(truth, rig(lamps=10), (56, 56)) for name, truth in TRUTHS.items()}


def solved(found: Solution) -> np.ndarray:
    return found.maps.coverage & ~found.maps.filled


@pytest.mark.one_python
@pytest.mark.parametrize("settings", [{"model": "one-lobe-specular"}, {}, {
    "model": "one-lobe-specular", "specular": "texel"}], ids=["material", "auto", "texel"])
def test_a_specular_level_comes_out(shoots, settings):
    found = run(shoots["lacquer"], size=SIZE, **settings)
    maps, off = found.maps, errors(found, TRUTHS["lacquer"])
    assert found.model == {"Paint": "one-lobe-specular"}
    if settings.get("specular") == "texel":
        assert found.levels == {}
    else:
        assert found.levels == {"Paint": pytest.approx(0.8, abs=0.003)}
        np.testing.assert_allclose(maps.specular, found.levels["Paint"], atol=1e-6)
    assert maps.specular.shape == (SIZE, SIZE)
    assert np.quantile(np.abs(maps.specular - 0.8)[solved(found)], 0.95) < 0.01
    assert maps.lobes is None
    assert np.median(off.rough) < 3e-4
    assert np.quantile(off.rough, 0.9) < 0.002
    assert np.median(off.base) < 3e-4
    assert off.share > 0.98


@pytest.mark.one_python
def test_the_wrong_level_is_seen(shoots):
    """Solved for one lobe of level 0.5, the same pictures leave ten times the error: what auto goes by.

    By squares: the robust loss disbelieves most of it.
    """
    one, other = (run(shoots["lacquer"], size=SIZE, model=model, loss="squares")
                  for model in ("one-lobe", "one-lobe-specular"))
    assert one.maps.specular is None
    assert one.levels == {}
    assert one.residual > 10 * other.residual


@pytest.mark.one_python
@pytest.mark.parametrize(("name", "settings"), [
    ("coat", {"model": "two-lobe"}), ("coat", {}), ("cook-torrance", {"model": "two-lobe", "ndf": "beckmann"})])
def test_two_lobes_come_out(shoots, name, settings):
    found = run(shoots[name], size=SIZE, **settings)
    maps, truth, ok = found.maps, TRUTHS[name], solved(found)
    assert found.model == {"Paint": "two-lobe"}
    assert found.ndf == settings.get("ndf", "ggx")
    assert maps.lobes.shape == (SIZE, SIZE, 3)
    assert maps.specular is None
    np.testing.assert_array_equal(maps.lobes[..., 0], maps.roughness)
    assert (maps.lobes[..., 0] <= maps.lobes[..., 1]).all()
    assert maps.lobes.min() >= 0
    assert maps.lobes.max() <= 1
    at = (np.arange(SIZE) + 0.5) / SIZE
    r = truth.roughness(*np.meshgrid(at, at))
    off = np.abs(maps.lobes - np.stack([r, RATIO * r, np.full_like(r, WEIGHT)], -1))[ok]
    assert (np.median(off, axis=0) < 1e-4).all()
    assert (np.quantile(off, 0.8, axis=0) < 0.02).all()
    base = errors(found, truth)
    assert np.median(base.base) < 2e-4
    assert np.quantile(base.base, 0.9) < 0.01
    assert base.share > 0.98


@pytest.mark.one_python
def test_beckmann_read_as_ggx_fits_worse(shoots):
    right, wrong = (run(shoots["cook-torrance"], size=SIZE, model="two-lobe", ndf=ndf) for ndf in ("beckmann", "ggx"))
    assert wrong.residual > 5 * right.residual


@pytest.mark.one_python
@pytest.mark.parametrize("name, model", [("lacquer", "one-lobe-specular"), ("coat", "two-lobe")])
def test_a_start_at_a_draft_is_no_worse_than_one_anew(shoots, name, model):
    anew, draft = (run(shoots[name], size=SIZE, model=model, method=method) for method in ("refined", "draft"))
    shoot = replace(shoots[name], scene=replace(shoots[name].scene, start=draft))
    again = run(shoot, size=SIZE, model=model, start="last")
    for part, slack in ((0.5, 1.1), (0.9, 1.5)):
        for kind in ("rough", "base"):
            found, best = (np.quantile(getattr(errors(s, TRUTHS[name]), kind), part) for s in (again, anew))
            assert found < slack * best + 1e-6
    assert again.levels == pytest.approx(anew.levels, abs=0.001)


@pytest.mark.one_python
@pytest.mark.parametrize("settings", [{}, {"model": "one-lobe-specular"}, {"model": "two-lobe"}],
                         ids=["auto", "specular", "two-lobe"])
def test_a_stop_keeps_what_was_found_and_leaves_nothing(on_gl, shoots, monkeypatch, settings):
    """At a third of the solve stage's steps, and at two thirds; of four tiles."""
    monkeypatch.setattr(gpu_atlas, "TILE", (8, 8))
    shoot: Any = shoots["coat"]

    def job(stop: int | None) -> Any:
        def steps() -> Any:
            inner = pipeline.solve(shoot.scene, SolveSettings(size=16, **AS_GIVEN, **settings), shoot.read_image)
            count = 0
            try:
                while True:
                    step = next(inner)
                    count += step.stage == "solve"
                    if count == stop:
                        count += 1
                        step = inner.throw(Cancelled())
                    yield step
            except StopIteration as end:
                return count, end.value

        return thread.run(steps)

    total, whole = job(None)
    run(shoot, size=16, model="one-lobe")  # what an early stop leaves: its programs are built now
    before = on_gl(held)
    assert not whole.cancelled
    for stop in (total // 3, 2 * total // 3):
        _, found = job(stop)
        assert found.cancelled
        assert found.texels["solved"] > 0
        assert np.isfinite(found.maps.roughness).all()
        assert np.isfinite(found.maps.base_color).all()
        assert on_gl(held) <= before
