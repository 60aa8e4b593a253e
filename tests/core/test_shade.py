"""Light from all around, by what a ball shows of it where it faces away from all lamps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.calibration.choice import with_ambient
from irpso_addon.core.calibration.contest import Contest
from irpso_addon.core.calibration.rig_fit import RigFound, around_of, fit_rig
from irpso_addon.core.calibration.rig_numbers import Free
from irpso_addon.core.calibration.shade import AWAY, faces_away, shows_shade
from irpso_addon.core.evaluation.folds import split
from irpso_addon.core.job import Steps, run_to_end
from tests.support.ball_in_room import AROUND, ball

BUMPY = Free(lamps=True, exposures=False, ambient=True, tilts=True)


def found(steps: Steps[RigFound]) -> RigFound:
    return run_to_end(steps, lambda progress: None)


def test_what_faces_away_is_seen_and_far_from_lit() -> None:
    made = ball(AROUND)
    away = faces_away(made)
    cosine = np.stack([made.normal @ view.lights[0].matrix[:3, 2] for view in made.rig.views], -1)
    assert (cosine[away] < AWAY).all() and away.sum() > 100
    assert not (away & (made.texels.quality > 0)).any()
    assert shows_shade(made) and not shows_shade(replace(made, shade=None))
    unseen = replace(made, texels=replace(made.texels, quality=np.zeros_like(made.texels.quality)))
    assert not faces_away(unseen).any()
    known = replace(made.rig, views=tuple(replace(view, ambient_radiance=(0.1, 0.1, 0.1)) for view in made.rig.views))
    assert not faces_away(replace(made, rig=known)).any()


@pytest.mark.parametrize(("around", "off"), [(0.0, 3e-4), (AROUND, 0.16 * AROUND), (0.1, 0.005)])
def test_it_is_found_beside_normals_and_suns_that_are_off(around: float, off: float) -> None:
    """Suns and normals by a degree, which lit places take for a little less of such light (0.015 instead of 0.02)."""
    made = ball(around, turned=np.radians(1.0))
    with_shade, without = (found(fit_rig(sample, BUMPY)) for sample in (made, replace(made, shade=None)))
    assert abs(with_shade.change.ambient - around) < off
    assert abs(with_shade.change.ambient - around) <= abs(without.change.ambient - around)
    assert with_shade.error.ambient < without.error.ambient
    assert around_of(made, with_shade).value == pytest.approx(around, rel=0.04, abs=3e-4)


def test_each_channel_says_its_own() -> None:
    """A base colour of red, under white light from everywhere."""
    made = ball(AROUND, base=np.array([0.6, 0.3, 0.1]))
    every = found(fit_rig(made, BUMPY))
    for channel in range(3):
        one = slice(channel, channel + 1)
        own = replace(made, shade=made.shade[..., one], texels=replace(
            made.texels, reflected=made.texels.reflected[..., one], irradiance=made.texels.irradiance[..., one]))
        assert around_of(own, every).value == pytest.approx(AROUND, rel=0.06)
    assert around_of(replace(made, shade=None), every) is None


@pytest.mark.parametrize(("lead", "lit"), [(5.0, True), (12.0, False)])
def test_the_shade_is_believed_as_far_as_lit_places_contradict_less(
    lead: float, lit: bool, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It is sure to ten standard errors; ``lead``: by how many lit places are predicted better without such light."""
    made, free = ball(AROUND, turned=np.radians(1.0)), replace(BUMPY, ambient=False)
    folds = split(made.texels)
    assert folds is not None
    whole = found(fit_rig(made, free))
    contest = Contest(made, whole, folds, tilts=True)
    monkeypatch.setattr(Contest, "lead", lambda self, name, other: lead if name == "without" else -lead)
    taken, change = run_to_end(with_ambient(contest, free, whole), lambda progress: None)
    assert taken.ambient == lit
    assert (change.change.ambient > 0.8 * AROUND) == lit
