"""Files that come from another system, and names that it would not take.

What types can say of Windows and macOS, `make lint-systems` asks (.ci/run does).
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.capture.captures import read_captures
from irpso_addon.core.errors import BadInput
from irpso_addon.core.images.image_writer import write_image
from irpso_addon.core.maps.export import FORBIDDEN, safe_stem

ROOT = Path(__file__).resolve().parents[2]
VIEW = {"image": "refs\\first\\a b.exr", "camera": "Cam", "lights": ["Key"], "mask": "refs\\first\\mask.png"}
DEVICES = ("CON", "PRN", "AUX", "NUL", "COM1", "LPT1")  # no file names on Windows, in any case, with any suffix


def written(folder: Path, ending: str = "\n") -> Path:
    path = folder / "captures.json"
    path.write_bytes(json.dumps({"views": [VIEW]}, indent=1).replace("\n", ending).encode("utf-8-sig"))
    return path


@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_captures_written_on_windows(tmp_path: Path, ending: str) -> None:
    """Backslashes, a byte order mark, CRLF."""
    (tmp_path / "refs" / "first").mkdir(parents=True)
    for name in ("a b.exr", "mask.png"):
        (tmp_path / "refs" / "first" / name).write_bytes(b"")
    (view,) = read_captures(written(tmp_path, ending))
    assert view.image == tmp_path / "refs" / "first" / "a b.exr"
    assert view.mask == tmp_path / "refs" / "first" / "mask.png"


@pytest.mark.skipif(sys.platform == "win32", reason="a backslash separates there")
def test_a_name_with_a_backslash_is_a_name(tmp_path: Path) -> None:
    """Where there is such a file."""
    (tmp_path / VIEW["image"]).write_bytes(b"")
    (view,) = read_captures(written(tmp_path))
    assert view.image == tmp_path / VIEW["image"]


def test_a_lone_backslash_is_told_by_its_name(tmp_path: Path) -> None:
    r"""``"refs\a.exr"`` is no JSON."""
    path = tmp_path / "captures.json"
    path.write_text('{"views": [\n{"image": "refs\\a.exr", "camera": "Cam", "lights": ["Key"]}]}', encoding="utf-8")
    with pytest.raises(BadInput, match=r"captures\.json: is not JSON \(line 2\); write / in paths, not \\$"):
        read_captures(path)


@pytest.mark.parametrize("name", [*DEVICES, *map(str.lower, DEVICES), "a:b", 'a"b', "a<b>|c?*", "dot.", "blank "])
def test_an_object_of_any_name_gets_files_that_windows_takes(name: str) -> None:
    file = f"{safe_stem(name)}_basecolor.exr"
    assert not set(file) & FORBIDDEN
    assert file.split(".")[0].upper() not in DEVICES
    assert file == file.strip(". ")


def test_a_deep_folder_with_blanks_and_letters_of_all_kinds(tmp_path: Path) -> None:
    """Longer than Windows' 260 characters, which Python there exceeds where the system lets it."""
    folder = tmp_path.joinpath(*["Größe und Fläche 日本語 " + "x" * 30] * 6)
    folder.mkdir(parents=True)
    assert len(str(folder)) > 300
    write_image(folder / "map.exr", np.ones((2, 2, 3), np.float32), kind="exr", color=True)
    assert [path.name for path in folder.iterdir()] == ["map.exr"]


def test_sources_have_one_kind_of_line_end() -> None:
    """And git writes no other: a zip built on Windows has the same bytes."""
    told = subprocess.run(["git", "ls-files", "--eol"], cwd=ROOT, capture_output=True, text=True)
    if told.returncode:
        pytest.skip("not a git checkout")
    for line in told.stdout.splitlines():
        index, work, attributes, *_ = line.split()
        assert (index, work) in {("i/lf", "w/lf"), ("i/-text", "w/-text"), ("i/none", "w/none")} or work == "w/", line
        assert attributes == "attr/text=auto", line


def test_no_two_files_differ_in_case_alone() -> None:
    told = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    names = told.stdout.splitlines()
    assert len({name.lower() for name in names}) == len(names)
