"""Colour spaces of pictures, by the profiles and tags of their files."""

from __future__ import annotations

import io
import struct

import numpy as np
import pytest

from irpso_addon.core.checks.warnings import grouped
from irpso_addon.core.images.colour import SPACES, known_space
from irpso_addon.core.images.icc_profile import space_of_profile
from irpso_addon.core.images.image_file import open_image
from irpso_addon.core.images.reference_image import read_reference
from tests.support.picture_files import save, view
from tests.support.random_pictures import RNG, noise

oiio = pytest.importorskip("OpenImageIO")


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


def test_one_warning_for_all_tiffs_without_a_colour_space(tmp_path):
    stored = RNG.integers(0, 65535, (20, 30, 3)).astype(np.uint16)
    paths = [save(tmp_path / f"{n}.tif", stored, "uint16") for n in range(5)]
    lines = grouped([line for path in paths for line in read_reference(view(path)).warnings])
    assert len(lines) == 1 and "and 2 more" in lines[0] and "set the colour space" in lines[0]
    assert not read_reference(view(paths[0], colorspace="sRGB")).warnings
