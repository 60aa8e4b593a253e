"""Intervals on pictures: the small form of ``python -m studies.intervals``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from irpso_addon.blender.oiio import ensure_openimageio
from irpso_addon.core.data import Maps
from studies.intervals.assets import ASSETS, Asset, grille_paint, make_knot, truth
from studies.intervals.measure import Figures, judge, solve
from studies.intervals.page import row

pytest.importorskip("bpy")
SMALL = 64


@pytest.mark.parametrize("asset", ASSETS, ids=lambda asset: asset.name)
def test_assets_are_what_they_say(asset: Asset) -> None:
    """UV islands do not overlap and lie inside the square; quads face outwards; the truth is a material's."""
    texels = np.zeros((128, 128), int)
    for part in asset.sheets:
        assert part.uvs.min() > 0 and part.uvs.max() < 1
        low, high = (np.floor(128 * edge(part.uvs.reshape(-1, 2), axis=0)).astype(int) for edge in (np.min, np.max))
        texels[low[1] + 1:high[1], low[0] + 1:high[0]] += 1
    assert texels.max() == 1
    base, rough = truth(asset, SMALL)
    assert base.shape == (SMALL, SMALL, 3) and rough.shape == (SMALL, SMALL)
    assert 0.01 < base.min() and base.max() < 0.95 and 0.1 < rough.min() and rough.max() <= 1


def test_the_tube_faces_outwards() -> None:
    for part in make_knot(0).sheets:
        corner = part.vertices[part.quads]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 3] - corner[:, 0])
        middle = corner.mean(1).reshape(36, 96, 3)
        outwards = middle - middle.mean(0)  # from the tube's own middle
        assert ((normal.reshape(outwards.shape) * outwards).sum(-1) > 0).all()


def test_the_grille_is_finer_than_its_pixels() -> None:
    """In each third both roughnesses stand within 5 texels of every texel; a pixel is 2.5 texels and more."""
    axis = (np.arange(256) + 0.5) / 256
    rough = grille_paint(*np.meshgrid(axis, axis))[1]
    windows = np.lib.stride_tricks.sliding_window_view(rough, (5, 5))
    assert (windows.min((2, 3)) == 0.25).all() and (windows.max((2, 3)) == 1.0).all()


def test_figures_by_hand() -> None:
    flat = np.full((4, 4), 0.5, np.float32)
    found = flat.copy()
    found[0], found[1] = 0.52, 0.7  # 4 texels in their interval, 4 far outside
    sure = np.where(np.arange(16).reshape(4, 4) < 6, 0.9, 0.1).astype(np.float32)  # 2 of these are wrong
    filled = np.zeros((4, 4), bool)
    filled[3] = True
    maps = Maps(base_color=np.full((4, 4, 3), 0.3, np.float32), roughness=found, confidence=sure, error=flat * 0,
                filled=filled, coverage=~filled | filled, roughness_sigma=flat * 0 + np.float32(0.02),
                base_sigma=flat * 0 + np.float32(0.01))
    told = judge(maps, np.full((4, 4, 3), 0.32, np.float32), flat)
    assert told.texels == 12 and told.held == pytest.approx(8 / 12) and told.base_held == 0.0
    assert told.confident == pytest.approx(6 / 12) and told.wrong == pytest.approx(2 / 6)
    assert told.all_wrong == pytest.approx(4 / 12) and told.mean_error == pytest.approx((4 * 0.02 + 4 * 0.2) / 12)
    assert told.base_error == pytest.approx(0.02, rel=1e-4)


def test_a_share_of_nothing_is_no_figure() -> None:
    """Where no texel is confident, none of them is wrong: the table has no share then."""
    told = Figures(100, 0.1, 0.1, 0.1, 0.5, 0.5, 0.0, float("nan"), 0.5)
    solution = SimpleNamespace(model={"Paint": "one-lobe"})
    assert [cell.strip() for cell in row(ASSETS[0], solution, told).split("|")][-4:-1] == ["0 %", "-", "50.0 %"]


def test_a_grille_finer_than_its_pixels_is_not_believed(tmp_path: Path) -> None:
    """Most texels are wrong by more than 0.1, and the solve, which cannot see that, is confident of none."""
    ensure_openimageio()
    asset = replace(next(a for a in ASSETS if a.name == "grille"), pixels=40)
    told = judge(solve(asset, tmp_path, 6, SMALL).maps, *truth(asset, SMALL))
    assert told.texels > 1000 and told.all_wrong > 0.2 and told.base_held > 0.8
    assert told.wrong * told.confident < 0.003
