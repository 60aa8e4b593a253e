"""Places from which the scene hides a world, where the object shows that nothing does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.data import Solution, View
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading.environment import about_z
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.maps import finish_maps
from irpso_addon.solve import pipeline
from tests.support import skies
from tests.support import synthetic as syn
from tests.support.sky_shoot import shoot

SIZE = 40
TURNS = 4
SKY = skies.sky(48, sun=60.0, width=0.12, window=8.0)
DARK = replace(syn.PATCHES, base=lambda u, v: 0.25 * syn.PATCHES.base(u, v))  # up to 0.2
LEFT, RIGHT, NEAR, FAR, HEIGHT = 0.2, 0.5, -0.1, 0.2, 0.03  # metres, of a lid that only the scene has


def covered() -> syn.Shoot:
    """Pictures of a plane under a sky that turns, and a scene that has a lid over a part of it."""
    made = shoot([View(Path(f"{n}.exr"), syn.cameras(6)[1], (), environment=replace(
        SKY, rotation=SKY.rotation @ about_z(turn), turn=turn)) for n, turn in enumerate(
            np.arange(TURNS) * 2 * np.pi / TURNS)], DARK)
    corners = np.array([[LEFT, NEAR, HEIGHT], [RIGHT, NEAR, HEIGHT], [RIGHT, FAR, HEIGHT], [LEFT, FAR, HEIGHT]])
    return replace(made, scene=replace(made.scene, unseen=corners[[[0, 1, 2], [0, 2, 3]]].astype(np.float32)))


def solved(made: syn.Shoot) -> Solution:
    settings = SolveSettings(size=SIZE, model="one-lobe", lamps="given", normals="mesh")
    return thread.run(lambda: pipeline.solve(made.scene, settings, made.read_image))


@pytest.mark.one_python
def test_base_colour_that_nothing_explains_is_one_of_its_material(monkeypatch) -> None:
    """The little light that comes in under the lid makes it far too bright there."""
    made = covered()
    kept = solved(made).maps
    monkeypatch.setattr(finish_maps, "within_material", lambda base, *_: base)
    free = solved(made).maps
    at = (np.arange(SIZE) + 0.5) / SIZE
    off = [np.abs(maps.base_color - made.truth.base(*np.meshgrid(at, at))).mean(-1) for maps in (kept, free)]
    changed = (kept.base_color != free.base_color).any(-1)
    assert off[1][changed].mean() > 0.2  # else this shows nothing
    assert off[0][changed].mean() < 0.5 * off[1][changed].mean()
