"""Pixels that are not data, noise that is, and files that cannot be used."""

from __future__ import annotations

import os
import resource

import numpy as np
import pytest

from irpso_addon.core.errors import BadInput
from irpso_addon.core.images.reference_image import read_reference
from tests.support.picture_files import error_of, save, view
from tests.support.random_pictures import RNG, noise

# --- clipping and noise


def test_clipped_pixels_of_integer_files(tmp_path):
    stored = RNG.integers(0, 65535, (20, 30, 3)).astype(np.uint16)
    stored[3, 4, 1] = 65535
    found = read_reference(view(save(tmp_path / "a.png", stored, "uint16")))
    assert not found.valid[::-1][3, 4] and found.valid.sum() == 599
    assert found.clipped_share == pytest.approx(1 / 600)


def test_clipped_pixels_of_float_files(tmp_path):
    pixels = noise(60, 90) * np.float32([2, 1.2, 0.9])
    cut = np.minimum(pixels, 1)
    found = read_reference(view(save(tmp_path / "a.exr", cut)))
    np.testing.assert_array_equal(found.valid[::-1], (pixels < 1).all(-1))
    assert found.clipped_share == pytest.approx((cut >= 1).any(-1).mean())
    white_balanced = cut * np.float32([1.9, 1, 1.5])
    found = read_reference(view(save(tmp_path / "b.exr", white_balanced)))
    np.testing.assert_array_equal(found.valid[::-1], (pixels < 1).all(-1))


def test_clipped_pixels_hold_what_is_there_at_least(tmp_path):
    """Exposure, black level and response are undone; what is not valid for another reason holds 0."""
    light = noise(60, 90) * np.float32([2, 1.2, 0.9])
    levels = np.float32([0.1, 0.05, 0.02])
    path = save(tmp_path / "a.exr", np.minimum(light, 1) ** np.float32(0.8) * np.float32(0.7) + levels)
    found = read_reference(view(path, exposure=1.0, response=0.8, black_level=(0.1, 0.05, 0.02)))
    clipped = ~found.valid[::-1]
    assert clipped.mean() > 0.2
    np.testing.assert_array_equal(clipped, (light >= 1).any(-1))
    least = found.rgb[::-1][clipped]
    np.testing.assert_allclose(least, 0.7 ** 1.25 * np.minimum(light, 1)[clipped] / 2, rtol=1e-4)


def test_a_clipped_channel_bounds_those_that_rise_with_it(tmp_path):
    """In a wide colour space more red is less green of Rec.709: of a pixel whose red is clipped, green is unknown."""
    stored = RNG.uniform(0.2, 0.6, (20, 30, 3))
    stored[3, 4, 0], stored[5, 6] = 1.0, 1.0
    levels = np.round(stored * 65535).astype(np.uint16)
    found = read_reference(view(save(tmp_path / "a.png", levels, "uint16"), colorspace="Linear Rec.2020"))
    assert sorted(map(tuple, np.argwhere(~found.valid[::-1]).tolist())) == [(3, 4), (5, 6)]
    red, white = found.rgb[::-1][3, 4], found.rgb[::-1][5, 6]
    from_rec2020 = np.array([[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]])
    assert red[0] == pytest.approx(float((from_rec2020 @ (levels[3, 4] / 65535))[0]), abs=1e-3)
    assert red[1] == red[2] == 0
    np.testing.assert_allclose(white, 1, atol=1e-3)


def test_the_mean_of_pixels_some_of_which_are_clipped(tmp_path):
    """A reduced pixel shows at least the mean of what those under it show at least."""
    stored = RNG.integers(0, 60000, (20, 30, 3)).astype(np.uint16)
    stored[4, 6], stored[10:12, 10:12] = 65535, 65535
    path = save(tmp_path / "a.png", stored, "uint16")
    found = read_reference(view(path, colorspace="Linear Rec.709"), 150)
    assert found.rgb.shape == (10, 15, 3) and np.argwhere(~found.valid[::-1]).tolist() == [[2, 3], [5, 5]]
    means = (stored / 65535).reshape(10, 2, 15, 2, 3).mean((1, 3))
    np.testing.assert_allclose(found.rgb[::-1], means, rtol=1e-5)


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_numbers_of_12_bits_in_files_of_16(tmp_path, suffix):
    """As cameras for machines write them: white is 4095, of 65535."""
    light = noise(60, 90) * np.float32([2, 1.2, 0.9]) * 4095
    stored = np.minimum(light, 4095).astype(np.uint16)
    found = read_reference(view(save(tmp_path / f"a.{suffix}", stored, "uint16"), colorspace="Linear Rec.709"))
    np.testing.assert_array_equal(found.valid[::-1], (stored < 4095).all(-1))
    assert found.clipped_share == pytest.approx((stored == 4095).any(-1).mean()) and found.clipped_share > 0.3
    dark = (light / 4).astype(np.uint16)
    assert read_reference(view(save(tmp_path / f"b.{suffix}", dark, "uint16"))).valid.all()


@pytest.mark.parametrize(("brightest", "clipped"), [(3.0, True), (1.0, False)])
@pytest.mark.parametrize("gamma", [2.2, 1.8])
def test_clipped_pixels_of_pictures_of_8_bits_that_were_made_linear_and_scaled(tmp_path, brightest, clipped, gamma):
    """Few values, all common: of means of four, those of which most are white are white."""
    y, x = np.mgrid[:240, :360] / 100.0
    light = (0.1 + brightest * np.exp(-((x - 1.5) ** 2 + (y - 1.2) ** 2) * 6))[..., None] * np.float32([1, 0.9, 0.8])
    light *= 1 + 0.05 * (noise(240, 360) - 0.5)
    light *= 1.0 if clipped else 1 / light.max()
    stored = np.round(255 * np.minimum(light, 1) ** (1 / gamma)) / 255
    means = (stored**gamma).reshape(120, 2, 180, 2, 3).mean((1, 3)).astype(np.float32)
    found = read_reference(view(save(tmp_path / "a.exr", means)))
    lost = (means >= 0.99).any(-1) & clipped
    np.testing.assert_array_equal(found.valid[::-1], ~lost)
    assert found.clipped_share == pytest.approx(lost.mean()) and (lost.mean() > 0.02) == clipped


def test_flat_surfaces_are_not_clipped(tmp_path):
    flat = np.full((40, 60, 3), 0.6, np.float32)
    assert read_reference(view(save(tmp_path / "a.exr", flat))).valid.all()
    flat[:, 30:] = 0.2
    flat[5:9, 5:9] = 0.9
    assert read_reference(view(save(tmp_path / "b.exr", flat))).valid.all()
    black = np.zeros((40, 60, 3), np.float32)
    assert read_reference(view(save(tmp_path / "c.exr", black))).valid.all()


def test_half_float_ceiling(tmp_path):
    pixels = noise()
    pixels[2, 3] = 65504
    found = read_reference(view(save(tmp_path / "a.exr", pixels, "half")))
    assert not found.valid[::-1][2, 3] and found.valid.sum() == 599


def test_everything_clipped(tmp_path):
    assert "clipped" in error_of(view(save(tmp_path / "a.png", np.full((20, 30, 3), 255, np.uint8), "uint8")))


def test_slightly_negative_values_are_data(tmp_path):
    pixels = noise()
    pixels[2, 3] = -0.04 * np.quantile(pixels.max(-1), 0.995)
    found = read_reference(view(save(tmp_path / "a.exr", pixels)))
    assert found.valid.all()
    np.testing.assert_array_equal(found.rgb, pixels[::-1])
    pixels[2, 3] *= 1.5
    assert "negative" in error_of(view(save(tmp_path / "b.exr", pixels)))


def dim(lit, sigma, black=0.0):
    """(60, 90, 3): the right half lit by ``lit``, the left half by nothing; read noise, and a black level taken off."""
    radiance = np.zeros((60, 90, 3), np.float32)
    radiance[:, 45:] = lit * np.linspace(0.2, 1, 45)[:, None]
    return (radiance - black + sigma * np.random.default_rng(5).normal(size=radiance.shape)).astype(np.float32)


@pytest.mark.parametrize("lit", [0.0, 0.1, 1.0])
def test_noise_about_black_is_data(tmp_path, lit):
    pixels = dim(lit, 0.02)
    assert pixels.min() < -0.05 * np.quantile(pixels.max(-1), 0.995)
    found = read_reference(view(save(tmp_path / "a.exr", pixels)))
    assert found.valid.all()
    np.testing.assert_array_equal(found.rgb, pixels[::-1])


@pytest.mark.parametrize(("lit", "black"), [(0.0, 0.02), (0.1, 0.02), (1.0, 0.06)])
def test_a_black_level_beneath_the_noise_is_not(tmp_path, lit, black):
    assert "negative" in error_of(view(save(tmp_path / "a.exr", dim(lit, 0.02, black))))
    pixels = dim(1.0, 0.02)
    pixels[7, 9] = -0.3  # a bad pixel among noise
    assert "negative" in error_of(view(save(tmp_path / "b.exr", pixels)))


def test_noise_at_an_edge_is_not_divided_by_alpha(tmp_path):
    pixels = noise(c=4)
    pixels[..., 3] = 1
    pixels[2, 3] = -0.001, 0.001, 0.001, 1e-4  # read noise beside the object, where resampling left a trace of alpha
    found = read_reference(view(save(tmp_path / "a.exr", pixels)))
    assert found.valid.all() and found.clipped_share == 0
    np.testing.assert_allclose(found.coverage[::-1][2, 3], 1e-4)
    pixels[2, 3] = -0.5, 0.5, 0.5, 1
    assert "negative" in error_of(view(save(tmp_path / "b.exr", pixels)))


# --- what cannot be used


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -0.5])
@pytest.mark.parametrize("suffix", ["exr", "tif"])
def test_not_radiance(tmp_path, value, suffix):
    pixels = noise(c=4)
    pixels[5, 6, 1], pixels[..., 3] = value, 1
    path = save(tmp_path / f"a.{suffix}", pixels)
    assert ("negative" if value == -0.5 else "1 of 600") in error_of(view(path))
    mask = np.ones((20, 30, 1), np.float32)
    mask[5, 6] = 0
    found = read_reference(view(path, mask=save(tmp_path / "m.exr", mask, names="Y")))
    assert np.isfinite(found.rgb).all() and (found.rgb[found.coverage > 0] >= 0).all()


def test_wrong_aspect_names_camera_and_sizes(tmp_path):
    message = error_of(view(save(tmp_path / "a.exr", noise()), aspect=1.0))
    assert "30 x 20" in message and "'Cam'" in message
    read_reference(view(tmp_path / "a.exr", aspect=1.507))


def test_nothing_covered(tmp_path):
    pixels = noise(c=4)
    pixels[..., 3] = 0
    assert "covered" in error_of(view(save(tmp_path / "a.exr", pixels)))
    pixels[..., 3] = np.nan
    assert "alpha" in error_of(view(save(tmp_path / "b.exr", pixels)))


def test_missing_and_foreign_files(tmp_path):
    assert "image not found" in error_of(view(tmp_path / "none.exr"))
    assert "folder" in error_of(view(tmp_path))
    for name, content in (("text.exr", b"hello"), ("empty.png", b""), ("odd.xyz", os.urandom(500))):
        (tmp_path / name).write_bytes(content)
        assert "cannot be read" in error_of(view(tmp_path / name))
    (tmp_path / "b\u00e9ta\U0001f3a8.exr").write_bytes(b"x")
    error_of(view(tmp_path / "b\u00e9ta\U0001f3a8.exr"))


def test_a_jpeg_file_may_have_a_tone_curve(tmp_path):
    """One line, which names it; of other files with 8 bits another one."""
    grey = np.full((20, 30, 3), 90, np.uint8)
    (jpeg,) = read_reference(view(save(tmp_path / "a.jpg", grey, "uint8"))).warnings
    (png,) = read_reference(view(save(tmp_path / "a.png", grey, "uint8"))).warnings
    assert jpeg.startswith("a.jpg: is a JPEG file (8 bits") and "tone curve" in jpeg and "tone curve" not in png


@pytest.mark.parametrize(("suffix", "form"), [
    ("exr", "float"), ("exr", "half"), ("png", "uint16"), ("tif", "uint16"), ("tif", "float"), ("hdr", "float"),
    ("jpg", "uint8"),
])
@pytest.mark.parametrize("share", [0.05, 0.5, 0.97])
def test_truncated_files(tmp_path, suffix, form, share):
    pixels = noise(80, 120)
    pixels = pixels if form in {"float", "half"} else (pixels * (200 if form == "uint8" else 60000)).astype(form)
    path = save(tmp_path / f"a.{suffix}", pixels, form)
    content = path.read_bytes()
    path.write_bytes(content[:int(len(content) * share)])
    error_of(view(path))


@pytest.mark.parametrize("size", [(20_001, 10), (30_000, 30_000), (10, 30_000)])
def test_a_huge_header_is_refused_before_memory_is_taken(tmp_path, size):
    """A header that claims gigabytes over a file of some bytes."""
    path = save(tmp_path / "a.hdr", noise(), "float")
    content = path.read_bytes()
    assert b"-Y 20 +X 30" in content
    path.write_bytes(content.replace(b"-Y 20 +X 30", b"-Y %d +X %d" % size[::-1]))
    start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    message = error_of(view(path, aspect=size[0] / size[1]))
    assert "pixels; scale it" in message or "claims a" in message  # ours, or OpenImageIO's own
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - start < 100_000  # kB


@pytest.mark.parametrize("options", [
    {}, {"form": "half", "compression": "piz"}, {"tile_width": 16, "tile_height": 16},
    {"suffix": "png", "form": "uint16"}, {"suffix": "tif"}, {"suffix": "hdr"},
])
def test_damaged_bytes_are_bad_input_or_read(tmp_path, options):
    suffix, form = options.pop("suffix", "exr"), options.pop("form", "float")
    pixels = noise(40, 60, 3 if suffix == "hdr" else 4)
    pixels = pixels if form != "uint16" else (pixels * 60000).astype(form)
    path = save(tmp_path / f"a.{suffix}", pixels, form, **options)
    content = path.read_bytes()
    for seed in range(60):
        rng = np.random.default_rng(seed)
        damaged = bytearray(content)
        for at in rng.integers(0, 600 if seed % 3 else len(content), 4):
            damaged[at] = rng.integers(256)
        path.write_bytes(damaged)
        try:
            found = read_reference(view(path))
        except BadInput as error:
            assert "\n" not in str(error)
        else:
            assert np.isfinite(found.rgb).all()


def test_bytes_between_the_segments_of_a_jpeg_do_no_harm(tmp_path):
    """As some cameras leave them.  Where bytes of the pixels are missing, the file is damaged."""
    path = save(tmp_path / "a.jpg", noise(40, 60), "uint8")
    right, content = read_reference(view(path)).rgb, path.read_bytes()
    tables = content.index(b"\xff\xdb")
    path.write_bytes(content[:tables] + bytes(5) + content[tables:])
    np.testing.assert_array_equal(read_reference(view(path)).rgb, right)
    path.write_bytes(content[:-200] + content[-2:])
    assert "damaged" in error_of(view(path))


def test_radiance_beyond_float_is_not_valid(tmp_path):
    pixels = noise() + np.float32(1e30)
    pixels[0, 0] = 1e-10
    found = read_reference(view(save(tmp_path / "a.exr", pixels), exposure=-60))
    assert found.valid.sum() == 1 and np.isfinite(found.rgb).all()
