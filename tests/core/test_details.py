"""In which order numbers are looked for where a mesh may be wrong in detail, and what is looked for once."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest

from irpso_addon.core.calibration import details
from irpso_addon.core.job import Progress, Steps, run_to_end

FIRST, PLAIN = 0.04, 0.02  # what predictions are off by, after the first fit of all numbers and after the best


@dataclass
class Rig:
    """What a sample would say, and what was asked."""

    left: float | None  # what predictions are off by beside tilts; None: nothing is changed there
    common: float = 0.02  # what neighbours leave over in common, without tilts
    away: bool = True
    judged: str | None = "tilts"  # what the larger sample says of the change beside tilts

    def __post_init__(self) -> None:
        self.asked: list[str] = []

    def begun_of(self, sample: object, lamps: bool, exposures: bool, tilts: bool) -> Steps[Any]:
        yield Progress(0.0, "calibrate")
        quick = SimpleNamespace(foretold=lambda: FIRST)
        return SimpleNamespace(tilts=tilts, from_afar=False, away=self.away, common=self.common, quick=quick)

    def everything_of(self, begun: Any) -> Steps[Any]:
        yield Progress(0.0, "calibrate")
        self.asked.append("tilts" if begun.tilts else "plain")
        found = SimpleNamespace(common=(0.04, self.common))
        return SimpleNamespace(tilts=begun.tilts, found=found, foretold=lambda: PLAIN)

    def chosen(self, every: Any) -> Steps[Any]:
        yield Progress(0.0, "calibrate")
        left = self.left if every.tilts else PLAIN
        return None if left is None else SimpleNamespace(left=left, found=every.found, tilts=every.tilts)

    def judged_of(self, chosen: Any, more: object) -> Steps[str | None]:
        yield Progress(0.0, "calibrate")
        self.asked.append("tilts judged" if chosen.tilts else "plain judged")
        return self.judged if chosen.tilts else "plain"


def found(rig: Rig, normals: bool, monkeypatch: pytest.MonkeyPatch) -> object:
    for name in ("begun_of", "everything_of", "chosen", "judged_of"):
        monkeypatch.setattr(details, name, getattr(rig, name))
    nothing: Any = None
    return run_to_end(details.with_details(nothing, True, True, nothing, normals), lambda progress: None)


@pytest.mark.parametrize(("rig", "asked", "change"), [
    (Rig(0.019), ["tilts", "tilts judged"], "tilts"),  # clearly better
    (Rig(0.019, judged=None), ["tilts", "tilts judged", "plain", "plain judged"], "plain"),
    (Rig(0.021), ["tilts", "plain", "plain judged"], "plain"),  # than the first fit, but not than the best
    (Rig(None), ["tilts", "plain", "plain judged"], "plain"),
    (Rig(0.017, away=False), ["plain", "tilts", "tilts judged"], "tilts"),  # better than the best
    (Rig(0.019, away=False), ["plain", "tilts", "plain judged"], "plain"),
    (Rig(0.010, common=0.2), ["plain", "tilts", "tilts judged"], "tilts"),  # lamps are far off
    (Rig(0.010, common=0.002), ["plain", "plain judged"], "plain"),  # the mesh is right
])
def test_tilts_come_before_all_that_numbers_alone_may_be(
    rig: Rig, asked: list[str], change: str, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where these ran away at first: but they are looked for completely, unless the change beside tilts is taken."""
    rig.asked.clear()
    assert found(rig, True, monkeypatch) == change
    assert rig.asked == asked


def test_of_a_mesh_that_is_right_no_tilts_are_looked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(0.001)
    assert found(rig, False, monkeypatch) == "plain"
    assert rig.asked == ["plain", "plain judged"]
