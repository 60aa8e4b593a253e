"""Photographs: turned as their tag says, ambient light and the lens's fall-off taken out."""

from __future__ import annotations

import math
import struct
import zlib

import numpy as np
import pytest

from irpso_addon.core.capture.captures import parse_captures
from irpso_addon.core.errors import BadInput
from irpso_addon.core.images import image_file
from irpso_addon.core.images.colour import srgb_to_linear
from irpso_addon.core.images.image_file import open_image
from irpso_addon.core.images.reference_image import read_reference
from tests.support.dng_files import Shot, save_dng
from tests.support.picture_files import save, view
from tests.support.random_pictures import RNG, noise


def turned(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """By the table of EXIF (CIPA DC-008, tag 274): where row 0 and column 0 of the file are seen."""
    h, w = pixels.shape[:2]
    row, column = np.mgrid[:h, :w]
    up, left, swap = {
        1: ("top", "left", 0), 2: ("top", "right", 0), 3: ("bottom", "right", 0), 4: ("bottom", "left", 0),
        5: ("left", "top", 1), 6: ("right", "top", 1), 7: ("right", "bottom", 1), 8: ("left", "bottom", 1)}[orientation]
    from_edge = {up: row, left: column}
    size = (w, h) if swap else (h, w)
    y = from_edge["top"] if "top" in from_edge else size[0] - 1 - from_edge["bottom"]
    x = from_edge["left"] if "left" in from_edge else size[1] - 1 - from_edge["right"]
    out = np.empty((*size, pixels.shape[2]), pixels.dtype)
    out[y, x] = pixels
    return out


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize(("suffix", "form"), [("tif", "uint16"), ("png", "uint8"), ("exr", "float")])
def test_a_picture_and_its_mask_are_turned_each_by_its_own_tag(tmp_path, monkeypatch, suffix, form, orientation):
    pixels = noise()
    stored = pixels if form == "float" else (pixels * np.iinfo(form).max).astype(form)
    path = save(tmp_path / f"a.{suffix}", stored, form, Orientation=orientation)
    upright = turned(stored, orientation)
    mask = RNG.uniform(0, 1, (*upright.shape[:2], 1)).astype(np.float32)
    shown = view(path, upright.shape[1] / upright.shape[0], colorspace="Non-Color",
                 mask=save(tmp_path / "m.exr", turned(mask, 6), names="Y", Orientation=8))  # 8 undoes 6
    found = read_reference(shown)
    scale = 1 if form == "float" else np.iinfo(form).max
    np.testing.assert_allclose(found.rgb[::-1], upright / scale, rtol=1e-6)
    np.testing.assert_allclose(found.coverage[::-1], mask[..., 0], rtol=1e-6)
    monkeypatch.setattr(image_file, "TURNED", 3000)  # some rows at a time
    np.testing.assert_array_equal(read_reference(shown).rgb, found.rgb)
    file = open_image(path)
    np.testing.assert_array_equal(file.read(3, 11), file.read(0, file.height)[3:11])


def test_jpeg(tmp_path):
    pixels = np.zeros((32, 48, 3), np.uint8)
    pixels[:16] = 200  # the upper half, as it is stored
    path = save(tmp_path / "a.jpg", pixels, "uint8", "RGB", Orientation=8, ExposureTime=0.01, FNumber=4.0,
                Exif__PhotographicSensitivity=400, Make="Acme", Model="Three")
    file = open_image(path)
    assert (file.width, file.height) == (32, 48)
    assert file.shot.exposure_value == pytest.approx(math.log2(0.01 * 4 / 16), abs=1e-3)
    found = read_reference(view(path, aspect=2 / 3)).rgb
    assert found[:, :12].min() > 0.5 and found[:, 20:].max() < 0.01  # row 0 of the file is seen at the left


def test_a_cropped_picture_is_turned_in_its_frame(tmp_path):
    inside = noise(6, 9)
    path = save(tmp_path / "a.exr", inside, x=4, y=5, full_x=0, full_y=0, full_width=30, full_height=20, Orientation=6)
    frame = np.zeros((20, 30, 3), np.float32)
    frame[5:11, 4:13] = inside
    np.testing.assert_array_equal(read_reference(view(path, aspect=2 / 3)).rgb[::-1], turned(frame, 6))


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("late", [False, True])
def test_a_png_has_its_exif_before_or_after_its_pixels(tmp_path, order, late):
    """A file by the PNG and EXIF standards alone, its pixels in several chunks; tools that add EXIF may append it."""
    stored = RNG.integers(0, 255, (20, 30, 3)).astype(np.uint8)
    pixels = zlib.compress(b"".join(b"\0" + row.tobytes() for row in stored))
    first = struct.pack(f"{order}HHHIHHHHIIII", 2, 274, 3, 1, 6, 0, 34665, 4, 1, 38, 0, 0)[:2 + 24 + 4]
    rational = struct.pack(f"{order}HHHII", 1, 33434, 5, 1, 56) + struct.pack(f"{order}III", 0, 1, 125)
    exif = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}I", 8) + first + rational
    parts = [chunk(b"IDAT", pixels[:500]), chunk(b"IDAT", pixels[500:])]
    parts.insert(2 if late else 0, chunk(b"eXIf", exif))
    path = tmp_path / "a.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", 30, 20, 8, 2, 0, 0, 0))
                     + b"".join(parts) + chunk(b"IEND", b""))
    file = open_image(path)
    assert (file.width, file.height, file.orientation) == (20, 30, 6)
    assert file.shot.time == pytest.approx(1 / 125)
    np.testing.assert_array_equal(np.concatenate(list(file.bands())), turned(stored, 6))


def test_a_png_with_a_damaged_exif_is_read(tmp_path):
    huge = b"II*\0" + struct.pack("<IHHHIIHHIII", 8, 2, 274, 4, 1, 2**32 - 1, 34855, 4, 1, 2**32 - 1, 0)
    for data in (b"", b"II*", b"MM\0*\xff\xff\xff\xff", RNG.bytes(300), b"x" * 70_000, huge):
        path = save(tmp_path / "a.png", RNG.integers(0, 255, (20, 30, 3)).astype(np.uint8), "uint8")
        whole = path.read_bytes()
        path.write_bytes(whole[:-12] + chunk(b"eXIf", data) + whole[-12:])
        file = open_image(path)
        assert (file.width, file.height, file.orientation) == (30, 20, 1) and file.shot.time is None


# --- ambient and flat field


def test_ambient_is_subtracted_in_linear_light(tmp_path):
    flash, ambient = noise() * np.float32(0.5), noise() * np.float32(0.3)
    path = save(tmp_path / "a.exr", flash + ambient)
    found = read_reference(view(path, exposure=1.0, ambient=save(tmp_path / "b.exr", ambient)))
    np.testing.assert_allclose(found.rgb[::-1], flash / 2, atol=1e-6)

    def encoded(linear: np.ndarray) -> np.ndarray:
        return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)

    both, alone = ((encoded(x) * 65535).round().astype(np.uint16) for x in (flash + ambient, ambient))
    dark = save(tmp_path / "d.png", alone, "uint16")
    found = read_reference(view(save(tmp_path / "c.png", both, "uint16"), ambient=dark))
    np.testing.assert_allclose(found.rgb[::-1], flash, atol=1e-4)


def test_an_ambient_picture_of_another_exposure_is_scaled(tmp_path):
    """RAW: the flash's picture at 1/125 s, the other one at 1/250 s, with a white balance of its own."""
    one, half = Shot(), Shot(exposure=(1 / 250, 8.0, 200), neutral=(0.9, 1.0, 0.3))
    light = RNG.integers(0, 4000, (40, 60))
    path = save_dng(tmp_path / "a.dng", (light + 2000 + one.black).astype(np.uint16), one)
    dark = save_dng(tmp_path / "b.dng", np.full((40, 60), 1000 + one.black, np.uint16), half)
    want = read_reference(view(save_dng(tmp_path / "c.dng", (light + one.black).astype(np.uint16), one))).rgb
    np.testing.assert_allclose(read_reference(view(path, ambient=dark)).rgb, want, atol=1e-5)


@pytest.mark.parametrize(("apertures", "scaled"), [((0.0, 0.0), True), ((8.0, 0.0), False)])
def test_an_ambient_picture_by_a_lens_without_contacts(tmp_path, apertures, scaled):
    """Cameras write an aperture of 0 then: time and ISO count where neither picture has one."""
    one, half = (Shot(exposure=(time, aperture, 200))
                 for time, aperture in zip((1 / 125, 1 / 250), apertures, strict=True))
    light = RNG.integers(0, 4000, (40, 60))
    path = save_dng(tmp_path / "a.dng", (light + 2000 + one.black).astype(np.uint16), one)
    dark = save_dng(tmp_path / "b.dng", np.full((40, 60), 1000 + one.black, np.uint16), half)
    left = light if scaled else light + 1000
    want = read_reference(view(save_dng(tmp_path / "c.dng", (left + one.black).astype(np.uint16), one))).rgb
    np.testing.assert_allclose(read_reference(view(path, ambient=dark)).rgb, want, atol=1e-5)


def test_noise_of_a_dark_ambient_picture_is_data(tmp_path):
    dark = RNG.normal(0, 0.001, (20, 30, 3)).astype(np.float32)
    pixels = noise()
    found = read_reference(view(save(tmp_path / "a.exr", pixels), ambient=save(tmp_path / "b.exr", dark)))
    np.testing.assert_allclose(found.rgb[::-1], pixels - dark, atol=1e-6)


@pytest.mark.parametrize("masked", [False, True])
def test_an_ambient_picture_that_is_brighter_is_refused(tmp_path, masked):
    """The two are swapped; all of it, or what the mask shows."""
    flash = noise(40, 60)
    bright, dark = save(tmp_path / "a.exr", flash), save(tmp_path / "b.exr", np.float32(0.1) * flash)
    more = {"mask": save(tmp_path / "m.png", np.eye(40, 60)[..., None], "uint8", "Y")} if masked else {}
    read_reference(view(bright, ambient=dark, **more))
    with pytest.raises(BadInput, match=r"a\.exr: is brighter than b\.exr, from which it is to be subtracted"):
        read_reference(view(dark, ambient=bright, **more))


def test_the_flat_field_is_divided_out(tmp_path):
    y, x = np.mgrid[-1:1:20j, -1:1:30j]
    fall = (1 - 0.4 * (x * x + y * y) / 2).astype(np.float32)[..., None]
    pixels, tint = noise(), np.float32([0.9, 0.8, 0.5])
    path, flat = save(tmp_path / "a.exr", pixels * fall), save(tmp_path / "b.exr", 0.7 * fall * tint)
    found = read_reference(view(path, flat=flat, exposure=1.0)).rgb[::-1]
    np.testing.assert_allclose(found * 2 / pixels, (found * 2 / pixels)[0, 0, 0], rtol=1e-5)
    assert found[0, 0, 0] * 2 / pixels[0, 0, 0] == pytest.approx(1, abs=0.01)  # 1 at the 99 % point of the fall-off


def test_clipped_in_either_is_not_valid(tmp_path):
    stored = RNG.integers(100, 60000, (20, 30, 3)).astype(np.uint16)
    ambient, flat = stored // 10, np.full_like(stored, 40000)
    stored[1, 1], ambient[2, 2], flat[3, 3], flat[4, 4] = 65535, 65535, 65535, 0
    files = [save(tmp_path / f"{n}.png", pixels, "uint16") for n, pixels in enumerate((stored, ambient, flat))]
    found = read_reference(view(files[0], ambient=files[1], flat=files[2]))
    assert np.argwhere(~found.valid[::-1]).tolist() == [[1, 1], [2, 2], [3, 3], [4, 4]]
    rgb = found.rgb[::-1]
    assert (rgb[[2, 3, 4], [2, 3, 4]] == 0).all()  # nobody knows how much of the light to take away, or of what
    np.testing.assert_allclose(rgb[1, 1], 1 - srgb_to_linear(ambient[1, 1] / 65535), rtol=1e-5)  # at least


def test_companions_that_do_not_fit(tmp_path):
    path = save(tmp_path / "a.exr", noise(40, 60))
    small = save(tmp_path / "b.exr", noise())
    black = save(tmp_path / "c.exr", np.zeros((40, 60, 3), np.float32))
    upright = save(tmp_path / "d.exr", noise(60, 40))
    spot = np.zeros((40, 60, 3), np.float32)
    spot[10:25, 10:30] = 0.5  # the object before black cloth
    spot = save(tmp_path / "e.exr", spot)
    for key, other, words in (("ambient", small, "30 x 20"), ("flat", small, "30 x 20"), ("flat", black, "not a flat"),
                              ("flat", upright, r"is 40 x 60 pixels, a\.exr 60 x 40; take both"),
                              ("flat", spot, r"not a flat field \(88 % of it is black\)"),
                              ("ambient", tmp_path / "x.exr", "not found")):
        with pytest.raises(BadInput, match=words) as caught:
            read_reference(view(path, **{key: other}))
        assert "\n" not in str(caught.value) and str(caught.value).startswith(f"{other}: ")


def test_captures_name_them(tmp_path):
    entry = '{"image": "a.dng", "camera": "c", "lights": ["l"], "ambient": "dark/a.dng", "flat": "flat.dng"}'
    (found,) = parse_captures(f'{{"views": [{entry}]}}', tmp_path / "captures.json")
    assert (found.ambient, found.flat) == (tmp_path / "dark" / "a.dng", tmp_path / "flat.dng")
    with pytest.raises(BadInput, match='"ambient" is not a name'):
        parse_captures(f'{{"views": [{entry.replace(chr(34) + "dark/a.dng" + chr(34), "3")}]}}', tmp_path / "c.json")
