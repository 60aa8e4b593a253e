"""Photographs: turned as their tag says, exposed as EXIF says, ambient light and the lens's fall-off taken out."""

from __future__ import annotations

import io
import math
import struct
import time
import zlib
from statistics import median_low

import numpy as np
import pytest

from irpso_addon.core.capture.captures import parse_captures
from irpso_addon.core.checks.warnings import grouped
from irpso_addon.core.errors import BadInput
from irpso_addon.core.images import image_file
from irpso_addon.core.images.colour import SPACES, known_space
from irpso_addon.core.images.icc_profile import space_of_profile
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
from tests.support.picture_files import RNG, noise, save, view

oiio = pytest.importorskip("OpenImageIO")


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


def test_words_that_are_no_text_do_no_harm(tmp_path):
    """The name of a colour profile is the word that is read: of ICC.1:2001, a header and a 'desc' tag."""
    words = b"\xc4\xff\xfee RGB\0"
    tag = b"desc" + bytes(4) + struct.pack(">I", len(words)) + words + bytes(79)
    profile = struct.pack(">I", 144 + len(tag)) + bytes(4) + b"\2\0\0\0mntrRGB XYZ " + bytes(12) + b"acsp" + bytes(88)
    profile += struct.pack(">I4sII", 1, b"desc", 144, len(tag)) + tag
    spec = oiio.ImageSpec(48, 32, 3, "uint8")
    spec.attribute("ICCProfile", oiio.TypeDesc(f"uint8[{len(profile)}]"), np.frombuffer(profile, np.uint8))
    spec.attribute("FNumber", 4.0)
    output = oiio.ImageOutput.create(str(tmp_path / "a.jpg"))
    assert output.open(str(tmp_path / "a.jpg"), spec) and output.write_image(np.full((32, 48, 3), 99, np.uint8))
    output.close()
    file = open_image(tmp_path / "a.jpg")
    assert file.colorspace is not None and file.colorspace.isprintable() and file.colorspace.endswith("e RGB")
    assert file.shot.f_number == 4


def test_profiles_that_are_known_are_colour_spaces():
    assert (known_space("sRGB IEC61966-2.1"), known_space("Adobe RGB (1998)"), known_space("Display P3")) == (
        "sRGB", "Gamma 2.2 Encoded AdobeRGB", "Display P3")
    assert known_space("ProPhoto RGB") is None


# Of each space's profile: the columns in XYZ of D50 (Lindbloom's tables; Display P3: Apple's profile), and the curve
PROFILES = {
    "Linear Rec.709": ([[0.4360747, 0.3850649, 0.1430804], [0.2225045, 0.7168786, 0.0606169],
                        [0.0139322, 0.0971045, 0.7141733]], b"curv" + bytes(8)),
    "sRGB": ([[0.4360747, 0.3850649, 0.1430804], [0.2225045, 0.7168786, 0.0606169], [0.0139322, 0.0971045, 0.7141733]],
             b"para" + bytes(4) + struct.pack(">HH5i", 3, 0, *(round(value * 65536) for value in (
                 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)))),
    "Gamma 2.2 Encoded AdobeRGB": ([[0.6097559, 0.2052401, 0.1492240], [0.3111242, 0.6256560, 0.0632197],
                                    [0.0194811, 0.0608902, 0.7448387]],
                                   b"curv" + bytes(4) + struct.pack(">IH", 1, round(2.19921875 * 256))),
    "Display P3": ([[0.51512, 0.29198, 0.15710], [0.24120, 0.69225, 0.06657], [-0.00105, 0.04189, 0.78407]],
                   b"curv" + bytes(4) + struct.pack(">I1001H", 1001, *(round(65535 * (
                       x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4)) for x in np.arange(1001) / 1000))),
    "Linear Rec.2020": ([[0.6734241, 0.1656411, 0.1251286], [0.2790177, 0.6753402, 0.0456377],
                         [-0.0019300, 0.0299784, 0.7973330]], b"para" + bytes(4) + struct.pack(">HHi", 0, 0, 65536)),
    None: ([[0.7976749, 0.1351917, 0.0313534], [0.2880402, 0.7118741, 0.0000857], [0.0, 0.0, 0.8252100]],
           b"curv" + bytes(4) + struct.pack(">IH", 1, round(1.8 * 256))),  # ProPhoto RGB
}


def profile_of(columns: list[list[float]], curve: bytes, name: str = "My own name") -> bytes:
    """ICC.1:2001: a header, and tags of a matrix and three curves."""
    words = name.encode() + b"\0"
    tags = {b"desc": b"desc" + bytes(4) + struct.pack(">I", len(words)) + words + bytes(79)}
    for colour, column in zip(b"rgb", np.array(columns).T, strict=True):
        tags[bytes([colour]) + b"XYZ"] = b"XYZ " + bytes(4) + struct.pack(">3i", *np.rint(column * 65536).astype(int))
        tags[bytes([colour]) + b"TRC"] = curve
    table, body, start = struct.pack(">I", len(tags)), b"", 132 + 12 * len(tags)
    for key, data in tags.items():
        table += struct.pack(">4sII", key, start + len(body), len(data))
        body += data + bytes(-len(data) % 4)
    white = struct.pack(">3i", *(round(value * 65536) for value in (0.9642, 1.0, 0.8249)))
    return (struct.pack(">I", start + len(body)) + bytes(4) + b"\2\x10\0\0mntrRGB XYZ " + bytes(12) + b"acsp"
            + bytes(28) + white + bytes(48) + table + body)


def save_with_profile(path, pixels, profile: bytes, form: str):
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, form)
    spec.attribute("ICCProfile", oiio.TypeDesc(f"uint8[{len(profile)}]"), np.frombuffer(profile, np.uint8))
    spec.attribute("CompressionQuality", 100)
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), spec) and file.write_image(pixels) and file.close()
    return path


@pytest.mark.parametrize("space", PROFILES)
@pytest.mark.parametrize(("suffix", "form"), [("tif", "uint16"), ("jpg", "uint8")])
def test_a_profile_is_known_by_its_numbers(tmp_path, space, suffix, form):
    """Raw developers and cameras give one space many names."""
    profile = profile_of(*PROFILES[space])
    assert len(profile) == int.from_bytes(profile[:4], "big")
    pixels = np.full((16, 24, 3), (0.7, 0.5, 0.4)) * np.iinfo(form).max
    file = open_image(save_with_profile(tmp_path / f"a.{suffix}", pixels.astype(form), profile, form))
    assert file.colorspace == (space or "My own name")


def test_a_known_profile_is_converted_as_little_cms_does(tmp_path):
    """To sRGB's 8 bits, of which lcms rounds by one."""
    cms, image = pytest.importorskip("PIL.ImageCms"), pytest.importorskip("PIL.Image")
    pixels = RNG.integers(90, 170, (16, 24, 3)).astype(np.uint8)
    for space, parts in PROFILES.items():
        if space is None:
            continue
        profile = profile_of(*parts)
        path = save_with_profile(tmp_path / "a.tif", pixels, profile, "uint8")
        opened = cms.ImageCmsProfile(io.BytesIO(profile))
        theirs = np.array(cms.profileToProfile(image.fromarray(pixels), opened, cms.createProfile("sRGB")), float)
        linear = read_reference(view(path)).rgb[::-1].astype(float)
        ours = 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.abs(linear) ** (1 / 2.4) - 0.055)
        inside = (theirs > 0).all(-1) & (theirs < 255).all(-1)
        assert inside.mean() > 0.5 and np.abs(ours - theirs)[inside].max() < 1.5, space


@pytest.mark.parametrize("seed", range(200))
def test_damaged_profiles_do_no_harm(seed):
    profile, rng = bytearray(profile_of(*PROFILES["sRGB"])), np.random.default_rng(seed)
    for at in rng.integers(0, len(profile), 4):
        profile[at] = rng.integers(0, 256)
    assert space_of_profile(bytes(profile)) in (None, *SPACES)
    assert space_of_profile(bytes(profile[:rng.integers(0, len(profile))])) in (None, *SPACES)


@pytest.mark.parametrize("value", ["no profile", 3.5, -7, (1.0, 2.0)])
def test_what_is_only_called_a_profile_does_no_harm(tmp_path, value):
    """EXR files hold attributes of any name and type."""
    spec = oiio.ImageSpec(30, 20, 3, "float")
    if isinstance(value, tuple):
        spec.attribute("ICCProfile", oiio.TypeDesc("float[2]"), value)
    else:
        spec.attribute("ICCProfile", value)
    file = oiio.ImageOutput.create(str(tmp_path / "a.exr"))
    assert file.open(str(tmp_path / "a.exr"), spec) and file.write_image(noise()) and file.close()
    assert open_image(tmp_path / "a.exr").colorspace is None


@pytest.mark.parametrize(("said", "gamma", "space"), [
    (65535, 2.2, "Gamma 2.2 Encoded AdobeRGB"), (65535, None, None), (1, 2.2, None), (1, None, None)])
def test_cameras_that_are_set_to_adobe_rgb_write_no_profile(tmp_path, said, gamma, space):
    """DCF 2.0: "uncalibrated", with a gamma of 2.2."""
    more = {} if gamma is None else {"Exif__Gamma": gamma}
    pixels = np.full((16, 24, 3), (90, 140, 80), np.uint8)
    path = save(tmp_path / "a.jpg", pixels, "uint8", "RGB", Exif__ColorSpace=said, FNumber=4.0, **more)
    assert open_image(path).colorspace == space


def test_a_tiff_with_a_profile_says_its_colour_space(tmp_path):
    cms = pytest.importorskip("PIL.ImageCms")
    profile = np.frombuffer(cms.ImageCmsProfile(cms.createProfile("sRGB")).tobytes(), np.uint8)
    stored = RNG.integers(0, 65000, (20, 30, 3)).astype(np.uint16)
    spec = oiio.ImageSpec(30, 20, 3, "uint16")
    spec.attribute("ICCProfile", oiio.TypeDesc(f"uint8[{len(profile)}]"), profile)
    file = oiio.ImageOutput.create(str(tmp_path / "a.tif"))
    assert file.open(str(tmp_path / "a.tif"), spec) and file.write_image(stored) and file.close()
    assert not read_reference(view(tmp_path / "a.tif")).warnings
    other = profile.tobytes().replace("sRGB built-in".encode("utf-16-be"), "ProPhoto room".encode("utf-16-be"))
    other = other.replace(b"rXYZ", b"bXYZ")  # its numbers are no longer sRGB's
    (tmp_path / "b.tif").write_bytes((tmp_path / "a.tif").read_bytes().replace(profile.tobytes(), other))
    (line,) = read_reference(view(tmp_path / "b.tif")).warnings
    assert "'ProPhoto room', which is unknown; it is read as sRGB" in line


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


# --- exposure


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


# --- colour spaces


def test_one_warning_for_all_tiffs_without_a_colour_space(tmp_path):
    stored = RNG.integers(0, 65535, (20, 30, 3)).astype(np.uint16)
    paths = [save(tmp_path / f"{n}.tif", stored, "uint16") for n in range(5)]
    lines = grouped([line for path in paths for line in read_reference(view(path)).warnings])
    assert len(lines) == 1 and "and 2 more" in lines[0] and "set the colour space" in lines[0]
    assert not read_reference(view(paths[0], colorspace="sRGB")).warnings


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
    assert (found.rgb[~found.valid] == 0).all()


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
