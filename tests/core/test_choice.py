"""Ways in which all numbers are looked for end where they lead nowhere."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.calibration import choice
from irpso_addon.core.calibration.contest import GIVEN, Contest
from irpso_addon.core.calibration.rig_fit import RigFit, RigFound, fit_rig
from irpso_addon.core.calibration.rig_numbers import Free
from irpso_addon.core.evaluation.folds import split
from irpso_addon.core.images.response import curved
from irpso_addon.core.job import Steps, run_to_end
from tests.support import tilted_sphere as balls

LAMPS = 12
PLACES = Free(lamps=True, exposures=False)
ALL = Free(lamps=True, exposures=False, vignetting=True, ambient=True, response=True)


def result(steps: Steps[Any]) -> Any:
    return run_to_end(steps, lambda progress: None)


def heard(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Free, int]]:
    """Numbers and rounds of the fits that are made from now on."""
    fits: list[tuple[Free, int]] = []
    original = RigFit.found

    def found(fit: RigFit, rounds: int) -> Steps[RigFound]:
        fits.append((fit.free, rounds))
        return (yield from original(fit, rounds))

    monkeypatch.setattr(RigFit, "found", found)
    return fits


@pytest.mark.parametrize("turned", [0.0, 5.0])
def test_all_numbers_follow_lamps_that_explain_something(turned: float, monkeypatch: pytest.MonkeyPatch) -> None:
    sample, _ = balls.sphere(balls.principled(0.4), lamps=LAMPS, texels=200, noise=0.002, turned=np.radians(turned))
    fits = heard(monkeypatch)
    found = result(choice._from_afar(sample.rig, ALL))
    assert [free for free, _ in fits] == ([PLACES, ALL] if turned else [PLACES])
    assert (found.scatter < 0.5 * found.given) == bool(turned)


@pytest.mark.parametrize("power", [1.0, 1.2])
def test_a_number_alone_is_fitted_to_the_end_if_it_seems_off(power: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a response that is off, that is looked for to the end; of files that are right, nothing."""
    sample, _ = balls.sphere(balls.principled(0.4), lamps=LAMPS, texels=200, noise=0.01)
    texels = sample.rig.texels
    shown = curved(texels.reflected * texels.irradiance, power, 1.0) / texels.irradiance
    rig = replace(sample.rig, texels=replace(texels, reflected=shown))
    found = result(fit_rig(rig, ALL))
    fits = heard(monkeypatch)
    frees = [Free(False, False, response=True), ALL]
    alone = result(choice._one_number(choice.Everything(rig, frees, found, False)))
    assert alone.frees == frees[:1]
    assert [rounds for _, rounds in fits] == ([choice.QUICK] if power == 1 else [choice.QUICK, choice.ROUNDS])


@pytest.mark.parametrize(("turned", "far"), [(5.0, True), (0.0, False)])
def test_a_diffuse_that_is_out_of_reach_is_not_fitted_to_the_end(
    turned: float, far: bool, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Beside suns that are found elsewhere; beside such as stay it may be about as good, and is."""
    sample, _ = balls.sphere(balls.principled(0.4), lamps=LAMPS, texels=200, noise=0.01, turned=np.radians(turned))
    folds = split(sample.rig.texels)
    assert folds is not None
    found = result(fit_rig(sample.rig, PLACES))
    contest = Contest(sample.rig, found, folds)
    contest.add(str(PLACES), contest.of_whole(found))
    assert (contest.scale(str(PLACES)) < 0.5 * contest.scale(GIVEN)) == far
    fits = heard(monkeypatch)
    assert result(choice._is_diffuse(contest, str(PLACES), PLACES)) == (not far)
    assert [rounds for _, rounds in fits][:2] == ([choice.QUICK] if far else [choice.QUICK, choice.ROUNDS])
