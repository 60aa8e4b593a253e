"""Files that hold radiance to some power over a black level: read, read again otherwise, and in parts of blocks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from irpso_addon.core.data import F32, F64, RadianceImage, View
from irpso_addon.core.images.image_writer import write_image
from irpso_addon.core.images.reference_image import Reference, read_reference
from irpso_addon.core.images.response import as_read, curved, straight, straightened
from irpso_addon.solve.kept_images import KeptImages
from tests.support import synthetic as syn

SIZE = 30, 20
POWER, EXPOSURE, GAIN = 0.8, 1.5, 0.7
BLACK = 0.02, 0.03, 0.01
TINT = 1.2, 1.0, 0.7


@pytest.fixture
def radiance() -> F32:
    return np.random.default_rng(2).uniform(0.05, 2.0, (SIZE[1], SIZE[0], 3)).astype(np.float32)


@pytest.fixture
def view(tmp_path: Path, radiance: F32) -> View:
    """A file that holds (radiance 2^exposure gain) to a power, over a black level."""
    path = tmp_path / "a.exr"
    value = (radiance.astype(np.float64) * 2**EXPOSURE * GAIN) ** POWER + BLACK
    write_image(path, value.astype(np.float32), kind="exr", color=True)
    camera = syn.camera((0.2, -1.0, 1.5), degrees=60, aspect=SIZE[0] / SIZE[1])
    return View(path, camera, (), exposure=EXPOSURE, gain=GAIN, response=POWER, black_level=BLACK)


def test_a_file_is_read_as_radiance(view: View, radiance: F32) -> None:
    np.testing.assert_allclose(read_reference(view).rgb, radiance, rtol=2e-3)  # half floats in the file


def test_a_white_balance_is_divided_out(view: View, radiance: F32) -> None:
    """A file that holds (radiance tint 2^exposure gain) to a power, over a black level; also with a flat field."""
    path, even = view.image.with_name("tinted.exr"), view.image.with_name("even.exr")
    value = (radiance.astype(np.float64) * TINT * 2**EXPOSURE * GAIN) ** POWER + BLACK
    write_image(path, value.astype(np.float32), kind="exr", color=True)
    write_image(even, np.full_like(radiance, 0.8**POWER) + np.array(BLACK, np.float32), kind="exr", color=True)
    tinted = replace(view, image=path, tint=TINT)
    for of in (tinted, replace(tinted, flat=even)):
        np.testing.assert_allclose(read_reference(of).rgb, radiance, rtol=4e-3)  # half floats in the file


def test_ambient_light_and_flat_field_have_the_same_response_and_black_level(view: View, radiance: F32) -> None:
    """By the formula of a file, docs/shooting.md; read whole, and as a block of a large solve reads it."""
    room = np.random.default_rng(3).uniform(0.01, 0.1, radiance.shape)
    lens = np.linspace(0.5, 1.0, SIZE[0])[:, None]  # that of the last column counts as 1

    def file(name: str, light: F64, scale: float) -> Path:
        path = view.image.with_name(name)
        write_image(path, ((light * lens * scale) ** POWER + BLACK).astype(np.float32), kind="exr", color=True)
        return path

    lit = replace(view, image=file("lit.exr", radiance + room, 2**EXPOSURE * GAIN),
                  ambient=file("room.exr", room, 2**EXPOSURE * GAIN),
                  flat=file("flat.exr", np.full_like(room, 0.8), 1.0))
    found = read_reference(lit).rgb
    np.testing.assert_allclose(found, radiance, rtol=1e-2, atol=5e-3)  # half floats in the files
    for (developed, _, _) in Reference(lit).bands():
        np.testing.assert_allclose(straightened(developed, lit)[::-1], found, rtol=1e-5)
    without = replace(lit, flat=None, ambient=None)
    assert np.abs(read_reference(without).rgb / radiance - 1).max() > 0.3


def test_a_second_look_is_as_if_read_anew(view: View) -> None:
    """Exposure, white balance, response, black level and vignetting all differ."""
    read: list[View] = []

    def image(of: View) -> RadianceImage:
        read.append(of)
        return read_reference(of)

    kept = KeptImages(image)
    first = replace(view, response=1.0, gain=1.0, vignetting=2.0)
    kept(first)
    for other in (view, first, replace(first, tint=TINT), replace(view, tint=TINT),
                  replace(view, vignetting=4.0, response=0.9, gain=0.6, black_level=(0.01, 0.0, -0.01)),
                  replace(first, black_level=BLACK)):
        np.testing.assert_allclose(kept(other).rgb, read_reference(other).rgb, rtol=1e-4)
    assert read == [first]


def test_nothing_to_do(radiance: F32, view: View) -> None:
    assert straightened(radiance, replace(view, response=1.0, black_level=(0.0, 0.0, 0.0))) is radiance


def test_noise_below_black_stays_below() -> None:
    dark = np.array([-0.01, 0.0, 0.01], np.float32)
    np.testing.assert_allclose(straight(2 * dark, 0.5, 1.0) / 2, [-0.0002, 0.0, 0.0002], atol=1e-9)
    np.testing.assert_allclose(straight(dark, 1.0, 10.0), [-0.001009, 0.0, 0.001009], atol=1e-6)


@given(st.floats(0.3, 3), st.floats(1, 50))
def test_a_shoulder_is_flatter_at_white(response: float, shoulder: float) -> None:
    """By the slopes of its logarithm; white stays, brighter values too are read, and nothing gets out of order."""
    radiance = np.concatenate([-np.geomspace(1e-4, 2, 30)[::-1], np.geomspace(1e-5, 4, 200)])
    value = curved(radiance, response, shoulder)
    assert (np.diff(value) > 0).all()
    np.testing.assert_allclose(straight(value, response, shoulder), radiance, rtol=1e-9)
    assert curved(np.ones(1), response, shoulder) == 1
    dark, white = (np.log(curved(at * np.array([1.0, 1.0001]), response, shoulder)) for at in (1e-30, 0.9999))
    assert (dark[1] - dark[0]) / (white[1] - white[0]) == pytest.approx(shoulder, rel=1e-2)


def test_a_file_with_a_shoulder_is_read_as_radiance(view: View, radiance: F32) -> None:
    """By the formula of docs/shooting.md; and looked at again without it."""
    path = view.image.with_name("curve.exr")
    power = (radiance.astype(np.float64) * 2**EXPOSURE * GAIN / 8) ** POWER
    write_image(path, (6 * power / (1 + 5 * power)).astype(np.float32) + np.array(BLACK, np.float32), kind="exr",
                color=True)
    made = replace(view, image=path, exposure=EXPOSURE - 3, shoulder=6.0)
    np.testing.assert_allclose(read_reference(made).rgb, radiance, rtol=2e-2)  # half floats in the file
    kept, plain = KeptImages(read_reference), replace(made, shoulder=1.0)
    for of in (plain, made):
        np.testing.assert_allclose(kept(of).rgb, read_reference(of).rgb, rtol=1e-4)
    np.testing.assert_allclose(straightened(as_read(radiance, made), made), radiance, rtol=1e-4)
