"""A black level in files, told from light that comes from all around or has bounced."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.calibration.black_level import BlackLevel, black_level, without_black
from irpso_addon.core.calibration.rig_fit import fit_rig
from irpso_addon.core.calibration.rig_numbers import Free
from irpso_addon.core.calibration.rig_sample import RigSample
from irpso_addon.core.evaluation.folds import split
from irpso_addon.core.job import run_to_end
from tests.support import tilted_sphere as balls
from tests.support.ball_in_room import AROUND, ball

BLACK = np.array([0.006, 0.004, 0.008])  # of white under a sun: 1
TEXELS = 600


def tones(of: np.random.Generator, dark: float = 0.1) -> np.ndarray:
    """(T, 3) a third of the texels are dark, anywhere on the ball."""
    return np.where(of.random(TEXELS)[:, None] < 0.33, dark, 1.0) * np.array([0.7, 0.5, 0.6])


def raised(sample: RigSample, gains: np.ndarray | None = None) -> RigSample:
    """With a black level in its files, exposed so; (V,)."""
    gains = np.ones(len(sample.view)) if gains is None else gains
    views = tuple(replace(view, gain=float(gain)) for view, gain in zip(sample.rig.views, gains, strict=True))
    return without_black(replace(sample, rig=replace(sample.rig, views=views)), -BLACK)


def found(sample: RigSample) -> BlackLevel | None:
    folds = split(sample.texels)
    assert folds is not None
    first = run_to_end(fit_rig(sample, Free(False, False), rounds=1), lambda progress: None)
    return run_to_end(black_level(sample, folds, first), lambda progress: None)


@pytest.mark.parametrize("around", [0.0, AROUND])
def test_it_is_found_in_each_channel(around: float) -> None:
    """Noise of a third of it, normals off by a degree; exposures that differ, after which it is alike in the files."""
    made = ball(around, base=tones(np.random.default_rng(3)))
    gains = np.exp(0.5 * np.random.default_rng(5).standard_normal(len(made.view)))
    for sample in (raised(made), raised(made, gains)):
        black = found(sample)
        assert black is not None
        np.testing.assert_allclose(black.level, BLACK, atol=6e-4)
        assert (np.abs(black.level - BLACK) < 3 * black.error).all() and (black.error < 5e-4).all()
        assert black.changed.lightness < black.given.lightness
        right, corrected = (each.texels.reflected[made.texels.quality > 0] for each in (made, black.corrected(sample)))
        np.testing.assert_allclose(corrected, right, atol=0.01)


def test_none_is_found_where_there_is_none() -> None:
    """Light from all around, and light that bounces from paint to paint: in proportion to the square of what it is."""
    paint = tones(np.random.default_rng(3), dark=0.3)
    made = ball(AROUND, base=paint)
    assert made.shade is not None
    bounced = replace(made, shade=made.shade + 0.02 * paint[:, None] ** 2)
    assert found(made) is None and found(bounced) is None
    noise = ball(0.0, base=paint)
    assert found(noise) is None


def test_one_paint_does_not_tell() -> None:
    """Whatever the shade shows is then light from all around, which lit places show as well."""
    assert found(raised(ball(AROUND))) is None


@pytest.mark.parametrize("seed", range(4))
def test_one_paint_does_not_tell_where_lamps_are_off(seed: int) -> None:
    """Base colours that seem to differ by a tenth, on which the light from all around does not depend."""
    made, rng = ball(AROUND), np.random.default_rng(seed)
    patch = np.unique(made.cluster, return_inverse=True)[1]
    off = (1 + 0.1 * rng.standard_normal(patch.max() + 1))[patch, None] * (
        1 + 0.03 * rng.standard_normal(len(made.view)))
    texels = replace(made.texels, reflected=made.texels.reflected * off[..., None])
    assert found(replace(made, texels=texels)) is None


def test_where_it_is_not_looked_for() -> None:
    made = raised(ball(0.0, base=tones(np.random.default_rng(3))))
    assert found(made) is not None
    bent = replace(made.rig, views=tuple(replace(view, response=0.5) for view in made.rig.views))
    assert found(replace(made, rig=bent)) is None
    assert found(replace(made, shade=None)) is None


def test_a_picture_without_lamps_took_it_away() -> None:
    """Of the views that have one, nothing is subtracted."""
    made = ball(AROUND, base=balls.BASE)
    first, *others = made.rig.views
    some = replace(made, rig=replace(made.rig, views=(replace(first, ambient=Path("dark.exr")), *others)))
    less = without_black(some, BLACK)
    lost = some.texels.reflected - less.texels.reflected
    assert not lost[:, 0].any() and (lost[:, 1:] > 0).all()
    assert not any(less.rig.views[0].black_level) and all(less.rig.views[1].black_level)


def test_it_is_alike_in_the_files() -> None:
    """What a sample loses is the level over the exposure, of what it shows in the shade too."""
    made = ball(AROUND, base=balls.BASE)
    bright = replace(made, rig=replace(made.rig, views=tuple(
        replace(view, gain=4.0, exposure=1.0) for view in made.rig.views)))
    less = without_black(bright, BLACK)
    assert bright.shade is not None and less.shade is not None
    known = np.isfinite(bright.shade)
    np.testing.assert_allclose((bright.shade - less.shade)[known], np.broadcast_to(BLACK / 8, known.shape)[known])
    lost = (bright.texels.reflected - less.texels.reflected) * made.texels.irradiance
    np.testing.assert_allclose(lost, np.broadcast_to(BLACK / 8, lost.shape), rtol=1e-6, atol=1e-12)
    assert less.rig.views[0].black_level == pytest.approx(tuple(BLACK))
