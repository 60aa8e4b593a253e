"""The files of a set of maps: names, values, and all or nothing."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.data import Maps
from irpso_addon.core.errors import BadInput
from irpso_addon.core.maps.export import LAYERS, earlier_maps, layers, safe_stem, share_files, write_maps

oiio = pytest.importorskip("OpenImageIO")

SUFFIXES = ["basecolor", "roughness", "confidence", "error", "filled", "roughness_sigma", "basecolor_sigma"]


def make_maps(size: int = 8) -> Maps:
    rng = np.random.default_rng(7)
    return Maps(
        base_color=rng.uniform(0, 1, (size, size, 3)).astype("f4"),
        roughness=rng.uniform(0, 1, (size, size)).astype("f4"),
        confidence=rng.uniform(0, 1, (size, size)).astype("f4"), error=rng.uniform(0, 1, (size, size)).astype("f4"),
        filled=rng.uniform(size=(size, size)) > 0.5, coverage=np.ones((size, size), bool),
        roughness_sigma=rng.uniform(0, 0.1, (size, size)).astype("f4"),
        base_sigma=rng.uniform(0, 0.1, (size, size)).astype("f4"))


def read(path: Path) -> np.ndarray:
    """Pixels as another program sees them, turned so that row 0 is the bottom."""
    return np.asarray(oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT))[::-1]


def srgb(linear: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1."""
    linear = linear.astype("f8")
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize("kind", ["exr", "png", "tiff"])
def test_values(tmp_path: Path, kind: str) -> None:
    maps = make_maps()
    paths = write_maps(maps, "Cow", tmp_path / "new" / "folder", kind)
    assert [p.name for p in paths] == [f"Cow_{suffix}.{kind}" for suffix in SUFFIXES]
    assert sorted(os.listdir(tmp_path / "new" / "folder")) == sorted(p.name for p in paths)
    base, rough, confidence, error, filled, rough_sigma, base_sigma = (read(path) for path in paths)
    step = 0.0 if kind == "exr" else 0.6 / 65535  # 16 bits, rounded
    np.testing.assert_allclose(base[..., :3], maps.base_color if kind == "exr" else srgb(maps.base_color), atol=step)
    assert rough.shape[2] >= 3
    for channel in range(3):
        np.testing.assert_allclose(rough[..., channel], maps.roughness, atol=step)
    np.testing.assert_allclose(confidence[..., 0], maps.confidence, atol=step)
    np.testing.assert_allclose(error[..., 0], maps.error, atol=step)
    np.testing.assert_array_equal(filled[..., 0], maps.filled)
    np.testing.assert_allclose(rough_sigma[..., 0], maps.roughness_sigma, atol=step)
    np.testing.assert_allclose(base_sigma[..., 0], maps.base_sigma, atol=step)


@pytest.mark.parametrize("kind", ["exr", "png", "tiff"])
def test_two_lobes_and_the_specular_level(tmp_path: Path, kind: str) -> None:
    """Data, never colour-encoded; a standard error above 1 is whole in EXR and cut off in 16 bits."""
    rng = np.random.default_rng(3)
    lobes, specular = (rng.uniform(0, 1, shape).astype("f4") for shape in ((8, 8, 3), (8, 8)))
    maps = replace(make_maps(), lobes=lobes, specular=specular, base_sigma=np.full((8, 8), 2.5, "f4"))
    paths = {p.stem.removeprefix("Cow_"): p for p in write_maps(maps, "Cow", tmp_path, kind)}
    assert list(paths) == [*SUFFIXES, "specular"]
    step = 0.0 if kind == "exr" else 0.6 / 65535
    np.testing.assert_allclose(read(paths["roughness"]), lobes, atol=step)
    np.testing.assert_allclose(read(paths["specular"])[..., 0], specular, atol=step)
    np.testing.assert_array_equal(read(paths["basecolor_sigma"]), 2.5 if kind == "exr" else 1.0)


@pytest.mark.parametrize(("name", "stem"), [
    ("Cow", "Cow"),
    ("a/b\\c\0d:e", "a_b_c_d_e"),
    ("../../etc/passwd", "_.._etc_passwd"),
    (".hidden", "hidden"),
    ("...", "object"),
    ("trailing. ", "trailing"),
    ("Kühe 牛 🐄", "Kühe 牛 🐄"),
    ("line\nbreak", "line_break"),
    ("Cube.001", "Cube.001"),
    ("CON", "_CON"),  # devices of Windows
    ("nul.001", "_nul.001"),
    ("Com1 .x", "_Com1 .x"),
    ("Lpt¹", "_Lpt¹"),
    ("Console", "Console"),
    ("COM10", "COM10"),
    ("a.nul", "a.nul"),
])
def test_names_become_file_names(name: str, stem: str) -> None:
    assert safe_stem(name) == stem


@pytest.mark.parametrize(("one", "other", "shared"), [
    ("Pot/1", "Pot:1", True), ("Pot", "pot", True), ("CON", "_con", True), ("Pot.", "Pot", True),
    ("K\u00fche", "Ku\u0308he", True),  # one letter, or a letter and its accent
    ("Pot", "Pot.001", False), ("Pot/1", "Pot-1", False), ("牛" * 120 + "a", "牛" * 120 + "b", False),
])
def test_names_that_share_files(one: str, other: str, shared: bool) -> None:
    assert share_files(one, other) == share_files(other, one) == shared


def test_long_names_are_cut_and_stay_distinct(tmp_path: Path) -> None:
    names = ["牛" * 120 + end for end in ("a", "b")]
    for name in names:
        assert all(p.exists() for p in write_maps(make_maps(), name, tmp_path, "tiff"))
    assert len(os.listdir(tmp_path)) == 2 * len(SUFFIXES)


def test_writing_again_replaces(tmp_path: Path) -> None:
    write_maps(make_maps(8), "Cow", tmp_path, "exr")
    paths = write_maps(make_maps(16), "Cow", tmp_path, "exr")
    assert all(read(path).shape[:2] == (16, 16) for path in paths)
    assert len(os.listdir(tmp_path)) == len(SUFFIXES)


def refuses(out: Path, *words: str, kind: str = "exr") -> None:
    with pytest.raises(BadInput) as caught:
        write_maps(make_maps(), "Cow", out, kind)
    message = str(caught.value)
    assert "\n" not in message and ".irpso-" not in message
    assert all(word in message for word in words), message


def test_a_file_where_the_folder_should_be(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    refuses(tmp_path / "file", "file")
    refuses(tmp_path / "file" / "below", "file")
    assert os.listdir(tmp_path) == ["file"]


def test_all_or_nothing(tmp_path: Path) -> None:
    """The last target cannot be replaced: the older files keep their contents."""
    paths = write_maps(make_maps(), "Cow", tmp_path, "exr")
    before = {p: p.read_bytes() for p in paths[:-1]}
    paths[-1].unlink()
    paths[-1].mkdir()
    with pytest.raises(BadInput, match="Cow_basecolor_sigma"):
        write_maps(make_maps(16), "Cow", tmp_path, "exr")
    assert {p: p.read_bytes() for p in paths[:-1]} == before
    assert len(os.listdir(tmp_path)) == len(SUFFIXES)


@pytest.mark.skipif(not os.path.exists("/dev/full") or os.geteuid() != 0, reason="needs a small file system")
def test_a_full_disk_leaves_nothing(tmp_path: Path) -> None:
    """A file system of 64 KiB, mounted for this test."""
    import subprocess
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", disk], capture_output=True).returncode:
        pytest.skip("cannot mount here")
    try:
        with pytest.raises(BadInput, match="disk"):
            write_maps(make_maps(256), "Cow", disk, "exr")
        assert os.listdir(disk) == []
    finally:
        subprocess.run(["umount", disk], check=True)


def test_an_unknown_format() -> None:
    refuses(Path("unused"), "bmp", kind="bmp")


def test_maps_of_an_earlier_solve_are_named(tmp_path):
    """Of the same object alone; what is not a map stays unnamed."""
    whole = replace(make_maps(), specular=np.zeros((8, 8), np.float32), metallic=np.zeros((8, 8), np.float32),
                    normal=np.zeros((8, 8, 3), np.float32))
    assert tuple(layers(whole)) == LAYERS
    write_maps(whole, "A.B", tmp_path, "exr")
    write_maps(whole, "A.B 2", tmp_path, "exr")
    (tmp_path / "A.B_notes.exr").touch()
    (tmp_path / "A.B_basecolor.1002.exr").touch()
    written = write_maps(make_maps(), "A.B", tmp_path, "exr")
    assert earlier_maps(tmp_path, "A.B", written) == [
        "A.B_basecolor.1002.exr", "A.B_metallic.exr", "A.B_normal.exr", "A.B_specular.exr"]
    assert len(earlier_maps(tmp_path, "A.B", write_maps(make_maps(), "A.B", tmp_path, "png"))) == 11
