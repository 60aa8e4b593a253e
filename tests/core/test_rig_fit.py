"""Suns that are believed elsewhere, beside normals that are wrong in detail, and drawn to where they typically are."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.calibration import rig_fit, rig_sample
from irpso_addon.core.calibration.finish import Final, weighed
from irpso_addon.core.calibration.free_numbers import sure_of_ambient
from irpso_addon.core.calibration.rig_fit import RigFound, fit_rig
from irpso_addon.core.calibration.rig_numbers import Free
from irpso_addon.core.calibration.rig_round import in_common
from irpso_addon.core.calibration.rig_sample import RigSample
from irpso_addon.core.data import Light
from irpso_addon.core.evaluation.joint_material import OneMaterial
from irpso_addon.core.evaluation.sampled_texels import SampledTexels
from irpso_addon.core.job import Steps, run_to_end
from tests.support import tilted_sphere as balls

LAMPS = 12
PLACES = Free(lamps=True, exposures=False)


def found(steps: Steps[RigFound]) -> RigFound:
    return run_to_end(steps, lambda progress: None)


def left(rig: RigSample, of: RigFound) -> float:
    """Degrees by which suns are still off, in the mean."""
    lit = balls.directions(np.random.default_rng(1), len(rig.slot), LAMPS)[1]
    lights = rig.rig.lights(of.change)
    return float(np.mean([balls.degrees_between(lights[f"Sun {n}"].matrix[:3, 2], way) for n, way in enumerate(lit)]))


def test_bumps_that_the_mesh_lacks_hardly_move_suns() -> None:
    """Tilts of 2 degrees, which no normal of the sample has; suns are believed 1 degree off."""
    sample, _ = balls.sphere(balls.principled(0.4), lamps=LAMPS, noise=0.01, slope=0.04, turned=np.radians(1.0))
    beside = Free(lamps=True, exposures=False, tilts=True)
    plain, tilted = (found(fit_rig(sample.rig, free)) for free in (PLACES, beside))
    drawn = found(fit_rig(sample.rig, beside, start=tilted, factor=2.0))
    assert tilted.scatter < 0.3 * plain.scatter
    assert left(sample.rig, tilted) < 0.7 * left(sample.rig, plain)  # 0.35 and 0.59 degrees
    assert left(sample.rig, drawn) < 0.3 * left(sample.rig, plain)  # 0.14


@pytest.mark.parametrize("factor", [1.0, 20.0])
def test_suns_are_drawn_to_where_they_typically_are(factor: float) -> None:
    """What observations cannot tell is taken from what is given: by how much, the found offsets say themselves."""
    sample, _ = balls.sphere(balls.principled(0.4), lamps=LAMPS, texels=100, noise=0.1, turned=np.radians(0.5))
    free = found(fit_rig(sample.rig, PLACES))
    drawn = found(fit_rig(sample.rig, PLACES, start=free, factor=factor))
    assert left(sample.rig, drawn) < left(sample.rig, free)
    assert np.linalg.norm(drawn.change.offset) < np.linalg.norm(free.change.offset)


def test_suns_that_are_surely_far_off_are_not_drawn_back() -> None:
    sample, _ = balls.sphere(balls.principled(0.4), lamps=LAMPS, noise=0.005, turned=np.radians(5.0))
    free = found(fit_rig(sample.rig, PLACES))
    drawn = found(fit_rig(sample.rig, PLACES, start=free, factor=2.0))
    assert left(sample.rig, drawn) < 0.15  # degrees


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_powers_beside_exposures_are_stated_as_sure_as_they_are(seed: int) -> None:
    """Eight suns whose powers are 3 % off, in sixteen pictures whose exposures are 2 % off: one cannot tell which."""
    rng = np.random.default_rng(seed + 10)
    log_power, log_gain = 0.03 * rng.standard_normal(8), 0.02 * rng.standard_normal(16)
    sample, _ = balls.sphere(balls.principled(0.4), lamps=8, noise=0.01, slope=0.02, turned=np.radians(0.5), seed=seed)
    rig, free = balls.seen_twice(sample.rig, log_power, log_gain), Free(lamps=True, exposures=True)
    of = found(weighed(Final(rig, free, found(fit_rig(rig, free)))))
    for name, true in (("log_power", log_power), ("log_gain", log_gain)):
        off = getattr(of.change, name) - true
        off -= np.median(off)  # what all share is not to be found
        assert np.sqrt(np.mean(off**2)) < 0.017  # of the first 0.022, stated as 0.001, without other lamps
        assert 0.4 < np.sqrt(np.mean((off / getattr(of.error, name)) ** 2)) < 1.2


def looked_for(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Whether levels were free, each time that materials are looked for from now on."""
    looked: list[bool] = []
    original = rig_fit.materials_of

    def heard(rig: RigSample, texels: SampledTexels, levels: bool) -> dict[int, OneMaterial]:
        looked.append(levels)
        return original(rig, texels, levels)

    monkeypatch.setattr(rig_fit, "materials_of", heard)
    return looked


def test_fits_that_begin_alike_look_for_materials_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """And find the same bytes as by themselves.  Levels that are free have materials of their own."""
    sample, _ = balls.sphere(balls.principled(0.4), lamps=LAMPS, texels=100, noise=0.01, turned=np.radians(0.5))
    frees = PLACES, Free(lamps=False, exposures=True), replace(PLACES, levels=True)
    apart = [found(fit_rig(replace(sample.rig), free, rounds=2)) for free in frees]
    looked = looked_for(monkeypatch)
    together = [found(fit_rig(sample.rig, free, rounds=2)) for free in frees]
    assert looked == [False, True]
    for one, other in zip(apart, together, strict=True):
        assert one.change.offset.tobytes() == other.change.offset.tobytes()
        assert one.change.log_gain.tobytes() == other.change.log_gain.tobytes()
        assert one.materials == other.materials


@pytest.mark.parametrize("tilts", [False, True])
def test_fits_from_one_change_look_for_materials_once(tilts: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """What other numbers do not change; and they find the same bytes as by themselves.  Another change has its own."""
    sample, _ = balls.sphere(balls.principled(0.4), lamps=LAMPS, texels=100, noise=0.01, turned=np.radians(0.5))
    places = replace(PLACES, tilts=tilts)
    start, other = (found(fit_rig(sample.rig, places, rounds=rounds)) for rounds in (2, 3))
    frees = replace(places, ambient=True), replace(places, cosine=True)
    apart = [found(fit_rig(replace(sample.rig), free, start=start, rounds=2)) for free in frees]
    looked = looked_for(monkeypatch)
    together = [found(fit_rig(sample.rig, free, start=start, rounds=2)) for free in frees]
    assert len(looked) == 1
    for one, two in zip(apart, together, strict=True):
        assert one.change.offset.tobytes() == two.change.offset.tobytes()
        assert one.materials == two.materials
    found(fit_rig(sample.rig, frees[0], start=other, rounds=1))
    assert len(looked) == 2


def test_slopes_of_places_that_are_near_are_taken_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """And suns end where slopes at their own places would have led them, to a fifth of their standard errors."""
    sample, _ = balls.sphere(balls.principled(0.4), lamps=LAMPS, noise=0.01, turned=np.radians(0.5))
    taken: list[str] = []
    original = rig_sample.light_slopes

    def heard(light: Light, *more: Any) -> Any:
        taken.append(light.name)
        return original(light, *more)

    monkeypatch.setattr(rig_sample, "light_slopes", heard)
    near = found(fit_rig(replace(sample.rig), PLACES))
    assert LAMPS <= len(taken) <= 3 * LAMPS  # of six rounds
    monkeypatch.setattr(rig_sample, "NEAR", 1e-9)
    own = found(fit_rig(replace(sample.rig), PLACES))
    assert len(taken) > 6 * LAMPS
    assert (np.abs(near.change.offset - own.change.offset) <= 0.2 * own.error.offset).all()


def test_pictures_in_which_no_lamp_shone_show_no_ambient_light() -> None:
    """They are alike wherever the lamps stand: light from all around would be many times the lamps'."""
    sample, _ = balls.sphere(balls.principled(0.4), lamps=8, noise=0.01)
    texels = sample.rig.texels
    dull = replace(sample.rig, texels=replace(
        texels, reflected=0.1 * texels.irradiance.max() / np.maximum(texels.irradiance, 1e-9)))
    of = found(fit_rig(dull, Free(lamps=False, exposures=True, ambient=True), rounds=20))
    assert of.change.ambient <= 1.0
    assert not sure_of_ambient(of)


def test_what_neighbours_have_in_common_is_that_of_each_pair() -> None:
    """Summed pair by pair; clusters lie scattered, and some observations are missing or beyond what is cut off."""
    rng = np.random.default_rng(3)
    rest, seen, cluster = rng.standard_normal((12, 5)) + 1.0, rng.uniform(size=(12, 5)) > 0.3, rng.integers(2, 6, 12)
    products = [np.clip(rest[i, v], -2, 2) * np.clip(rest[j, v], -2, 2) for v in range(5)
                for i in range(12) for j in range(12)
                if i != j and cluster[i] == cluster[j] and seen[i, v] and seen[j, v]]
    assert in_common(rest, seen, cluster.astype(np.int32), 2.0) == pytest.approx(np.sqrt(np.mean(products)))
