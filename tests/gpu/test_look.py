"""Looks at a running solve: what they say, and how sure they say it is."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import moderngl
import numpy as np
import pytest

from irpso_addon.core.data import F32
from irpso_addon.core.job import Progress
from irpso_addon.core.live_maps import Live
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.device.memory import DeviceMemory
from irpso_addon.solve import pipeline
from tests.support import shoots
from tests.support import synthetic as syn

WRONG = 0.15  # an error of roughness that a user would see


@pytest.fixture(scope="module")
def noisy() -> syn.Shoot:
    return syn.shoot(syn.PATCHES, shoots.rig(), noise=0.02)


def looks(shoot: syn.Shoot, **settings: Any) -> dict[str, Live]:
    """The last look at each message's first word and stage: of the search, of the polish, ..."""
    seen: dict[str, Live] = {}

    def job() -> Generator[Progress, None, None]:
        chosen = SolveSettings(size=shoots.SIZE, **shoots.AS_GIVEN, **settings)
        for step in pipeline.solve(shoot.scene, chosen, shoot.read_image):
            if step.look is not None:
                live = step.look()
                half = "early" if step.fraction <= 0.6 else "late"  # the search is the first half of the solve stage
                seen[f"{half} {' '.join(sorted(live.maps))}"] = live
            yield step

    thread.run(job)
    return seen


def errors(live: Live, truth: syn.Truth) -> tuple[np.ndarray, np.ndarray]:
    """(absolute error of roughness, confidence) of what is known."""
    at = (np.arange(shoots.SIZE) + 0.5) / shoots.SIZE
    rough, sure = live.maps["roughness"], live.maps["confidence"]
    off, known = np.abs(rough - truth.roughness(*np.meshgrid(at, at))), np.isfinite(rough)
    assert known.mean() > 0.5
    return off[known], sure[known]


@pytest.mark.one_python
@pytest.mark.parametrize("part", ["early", "late"])
def test_what_is_sure_while_it_runs_is_right(noisy: syn.Shoot, part: str) -> None:
    """A solve may be stopped at any look: what is then called confident is seldom wrong, and less so than the rest."""
    off, sure = errors(looks(noisy, model="one-lobe", loss="squares")[f"{part} confidence error roughness"],
                       noisy.truth)
    confident = sure > 0.5
    assert 0.05 < confident.mean() < 0.999
    assert np.mean(off[confident] > WRONG) < 0.02
    assert off[confident].mean() < 0.5 * off[~confident].mean()


@pytest.mark.one_python
def test_the_published_swarm_is_never_sure(noisy: syn.Shoot) -> None:
    seen = looks(noisy, method="paper", iterations=60, model="one-lobe")
    swarm = next(live for name, live in seen.items() if "base_color" in name and "roughness" in name)
    known = np.isfinite(swarm.maps["roughness"])
    assert known.mean() > 0.5
    assert np.all(swarm.maps["confidence"][known] == 0)


def test_no_look_shows_what_nobody_has_written(noisy: syn.Shoot, monkeypatch: pytest.MonkeyPatch) -> None:
    """New textures hold anything on some drivers: here a number that no map may have."""
    made, roughest = DeviceMemory.texture, list[float]()

    def texture(self: DeviceMemory, width: int, height: int, channels: int = 4, data: F32 | None = None,
                dtype: str = "f4") -> moderngl.Texture:
        if data is None and dtype == "f4":
            data = np.full((height, width, channels), 7.0, np.float32)
        return made(self, width, height, channels, data, dtype)

    def job() -> Generator[Progress, None, None]:
        settings = SolveSettings(size=shoots.SIZE, method="paper", iterations=20, model="one-lobe", **shoots.AS_GIVEN)
        for step in pipeline.solve(noisy.scene, settings, noisy.read_image):
            if step.look is not None and "roughness" in (maps := step.look().maps):
                roughest.append(float(np.nan_to_num(maps["roughness"]).max()))
            yield step

    monkeypatch.setattr(DeviceMemory, "texture", texture)
    thread.run(job)
    assert roughest and max(roughest) <= 1


def test_two_lobes_are_not_sure_before_they_are_polished(noisy: syn.Shoot) -> None:
    seen = looks(noisy, model="two-lobe")
    early, late = (seen[f"{half} confidence error roughness"].maps["confidence"] for half in ("early", "late"))
    assert np.nanmax(early) == 0
    assert np.nanmax(late) > 0
