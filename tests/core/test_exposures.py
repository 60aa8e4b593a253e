"""Exposures by EXIF: relative to each other, and to those that are given."""

from __future__ import annotations

import math
import time
from statistics import median_low

import numpy as np
import pytest

from irpso_addon.core.images.image_file import open_image
from irpso_addon.core.images.reference_image import read_reference
from irpso_addon.core.images.shot_settings import (
    ShotSettings,
    brighter_by,
    exposures_by_exif,
    exposures_off,
    not_compared,
    relative_exposures,
)
from tests.support.dng_files import Shot, save_dng
from tests.support.picture_files import view
from tests.support.random_pictures import RNG


def shot(time: float, f_number: float | None = 8.0, iso: float = 100.0) -> ShotSettings:
    return ShotSettings(time, f_number, iso)


def test_exposures_are_relative_to_the_median():
    found, lines = relative_exposures({"a": shot(1 / 60), "b": shot(1 / 30), "c": shot(1 / 60, iso=200.0, f_number=8.0),
                                       "d": shot(1 / 60, f_number=16.0), "e": shot(1 / 60)})
    assert found == pytest.approx({"a": 0, "b": 1, "c": 1, "d": -2, "e": 0})
    assert len(lines) == 1 and "3 of 5" in lines[0] and "-2.00 EV in 'd'" in lines[0]


def test_of_two_groups_of_equal_size_one_is_told_of():
    found, lines = relative_exposures({"a": shot(1 / 60), "b": shot(1 / 30), "c": shot(1 / 30), "d": shot(1 / 60)})
    assert found == pytest.approx({"a": 0, "b": 1, "c": 1, "d": 0})
    assert len(lines) == 1 and "2 of 4" in lines[0] and "shorter than the exposure time" in lines[0]


def test_a_sixth_of_a_step_is_nothing():
    found, lines = relative_exposures({"a": shot(1.0), "b": shot(1.0), "c": shot(1.0, iso=110.0)})
    assert found["c"] == pytest.approx(math.log2(1.1)) and not lines


def test_pictures_without_exif_are_named():
    found, lines = relative_exposures({"a": shot(1.0), "b": None, "c": ShotSettings(time=1.0), "d": shot(1.0)})
    assert found == {"a": 0, "b": 0, "c": 0, "d": 0}
    assert len(lines) == 1 and lines[0].startswith("'b', 'c': EXIF has no time") and "enter it by hand" in lines[0]
    found, lines = relative_exposures({"a": None, "b": None})
    assert found == {"a": 0, "b": 0} and len(lines) == 1
    assert lines[0].startswith("EXIF has no time, aperture and ISO for any picture")
    assert relative_exposures({}) == ({}, ())


def test_a_lens_without_contacts():
    """One aperture for all; time and ISO count as always."""
    found, lines = relative_exposures({"a": shot(1 / 60, None), "b": shot(1 / 30, None), "c": shot(1 / 60, None, 50.0),
                                       "d": shot(1 / 60, None), "e": None})
    assert found == pytest.approx({"a": 0, "b": 1, "c": -1, "d": 0, "e": 0})
    assert len(lines) == 3 and "2 of 5" in lines[0] and "no aperture for any picture" in lines[1]
    assert lines[2].startswith("'e': EXIF has no time and ISO, so")
    found, lines = relative_exposures({"a": shot(1 / 60, None), "b": shot(1 / 30)})  # one aperture is known: not alike
    assert found == {"a": 0, "b": 0}
    assert len(lines) == 1 and lines[0].startswith("'a': EXIF has no time, aperture and ISO")


def test_cameras_that_keep_their_iso_to_themselves():
    """Old compact ones write it into notes of their own alone: one ISO for all; time and aperture count as always."""
    found, lines = relative_exposures({"a": ShotSettings(1 / 60, 8.0), "b": ShotSettings(1 / 30, 8.0),
                                       "c": ShotSettings(1 / 60, 16.0), "d": ShotSettings(1 / 60, 8.0), "e": None})
    assert found == pytest.approx({"a": 0, "b": 1, "c": -2, "d": 0, "e": 0})
    assert len(lines) == 3 and "2 of 5" in lines[0] and lines[1].startswith("EXIF has no ISO for any picture, so")
    assert lines[2].startswith("'e': EXIF has no time and aperture, so")
    found, lines = relative_exposures({"a": ShotSettings(1 / 60), "b": ShotSettings(1 / 30), "c": None})
    assert found == pytest.approx({"a": 0, "b": 1, "c": 0}) and len(lines) == 4
    assert lines[3].startswith("'c': EXIF has no time, so")
    found, lines = relative_exposures({"a": ShotSettings(None, 8.0), "b": ShotSettings(iso=100.0)})
    assert found == {"a": 0, "b": 0} and len(lines) == 1 and "for any picture, so equal" in lines[0]
    assert brighter_by(ShotSettings(1 / 30, 8.0), ShotSettings(1 / 60, 8.0)) == pytest.approx(1)
    assert brighter_by(ShotSettings(1 / 30, 8.0), ShotSettings(1 / 60, 8.0, 100.0)) is None


def test_exposures_beside_those_of_all_other_views():
    """As the median of all pairs has them, to rounding; settings that are missing here and there, and equal views."""
    def by_pairs(views: list[tuple[ShotSettings, float]]) -> list[float]:
        pairs = [[by - (given - other) for n, (shot, other) in enumerate(views)
                  if n != at and (by := brighter_by(own, shot)) is not None] for at, (own, given) in enumerate(views)]
        return [median_low(found) if found else 0.0 for found in pairs]

    for count in (0, 1, 2, 3, 4, 5, 40, 41):
        for _ in range(20):
            views = [(ShotSettings(*(None if RNG.random() < 0.2 else float(RNG.choice(values)) for values in (
                (1 / 125, 1 / 60, 1 / 30), (5.6, 8.0), (100.0, 200.0)))), float(RNG.choice([0.0, 0.0, 1.0, -0.5])))
                for _ in range(count)]
            assert exposures_off(views) == pytest.approx(by_pairs(views), abs=1e-12)


def test_exposures_by_exif_differ_as_exif_does():
    """From those of one setting to another's; a view whose EXIF cannot be compared keeps its own."""
    views = [(shot(1 / 60), 0.5), (shot(1 / 30), 0.5), (shot(1 / 60, iso=400.0), 2.5), (shot(1 / 60, None), 7.0),
             (ShotSettings(), 3.0)]
    assert exposures_by_exif(views) == pytest.approx([0.5, 1.5, 2.5, 7.0, 3.0])
    assert exposures_by_exif([(shot(1.0), 0.0), (shot(2.0), 0.0)]) == pytest.approx([0, 1])
    assert exposures_by_exif([]) == []
    assert not_compared([view for view, _ in views]) == [3, 4] and not_compared([]) == []
    assert not_compared([ShotSettings(), shot(1.0, None)]) == [0]


def test_exposures_of_thousands_of_views_take_no_time():
    """All pairs of 3,000 views take 50 s."""
    views = [(shot(1 / (60 + n)), 0.0) for n in range(3000)]
    start = time.thread_time()
    exposures_off(views)
    assert time.thread_time() - start < 1


def test_equal_light_whatever_the_exposure(tmp_path):
    """Two DNGs of one light: the brighter settings' picture is as much brighter, and the same when equalised."""
    one, two = Shot(), Shot(exposure=(1 / 250, 8.0, 400 * 2))
    raw = RNG.integers(2000, 6000, (40, 60))
    bright = (raw - one.black) * 2 + one.black  # 1/250 s at ISO 800 is twice 1/125 s at ISO 200
    paths = [save_dng(tmp_path / "a.dng", raw.astype(np.uint16), one),
             save_dng(tmp_path / "b.dng", bright.astype(np.uint16), two)]
    found, _ = relative_exposures({path.name: open_image(path).shot for path in paths})
    first, second = (read_reference(view(path, exposure=found[path.name])).rgb for path in paths)
    np.testing.assert_allclose(first, second, rtol=1e-4, atol=1e-5)
