"""The log: what it holds, what it never holds, and that it is in nobody's way."""

from __future__ import annotations

import io
import json
import string
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from irpso_addon.core import log
from irpso_addon.core.cpu_solver import solver
from irpso_addon.core.errors import BadInput, Cancelled
from irpso_addon.core.params import DeviceSettings, SolveSettings
from irpso_addon.core.samples import selftest

NAMES = st.text(string.ascii_letters + string.digits + " _-.,;é東(+", min_size=1, max_size=12).map(
    lambda s: s.strip() or "x")


@pytest.fixture
def written(tmp_path):
    """What is in the log's file."""
    file = tmp_path / "configuration" / log.FILE
    log.to_file(file)
    yield lambda: [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    log.close()


@given(folders=st.lists(NAMES, min_size=1, max_size=4), name=NAMES, start=st.sampled_from(["/", "C:\\", "//", "\\\\"]))
@example(folders=["Max Muster", "a b"], name="x.exr", start="C:\\")
def test_no_folder_of_a_path_is_left(folders, name, start):
    separator = "\\" if "\\" in start else "/"
    path = start + separator.join([*folders, name])
    for text in (path, f"{path}: cannot be read (No such file); give another", f"'{path}' and '{path}'"):
        left = log.without_folders(text)
        assert "/" not in left and "\\" not in left
        for folder in folders:
            hidden = left.replace(name, "").replace(": cannot be read (No such file); give another", "")
            assert len(folder) < 4 or folder not in hidden.replace("' and '", "")


@pytest.mark.parametrize(("argument", "left"), [
    ("solve", "solve"), ("--size", "--size"), ("--size=64", "--size=64"), ("1.5", "1.5"), ("", ""),
    ('/data/Kunde: "Meier & Co" (geheim)/wand 3.blend', "wand 3.blend"),
    ("--out=/data/Max Muster's/a: b/maps", "--out=maps"), ("C:\\Users\\Max Muster\\a.blend", "a.blend"),
    ("//server/share <old>/x\ny/a.exr", "a.exr"), ("geheim|2/", ""), ("--out=geheim/x=y/", "--out="),
])
def test_arguments_are_cut_whatever_their_folders_are_called(argument, left, written):
    assert log.name_alone(argument) == left
    log.info("command", arguments=[log.name_alone(argument)])
    assert written()[-1]["arguments"] == [left]
    if argument.startswith("/data"):
        log.info("path", path=Path(argument))
        assert written()[-1]["path"] == left


@pytest.mark.parametrize("home", ["/", "/home/max"])
def test_the_home_folder_does_not_matter(monkeypatch, home):
    monkeypatch.setenv("HOME", home)
    assert log.without_folders("/home/max/secret/a.exr: broken") == "a.exr: broken"


def test_a_rotation_that_fails_is_not_tried_again(tmp_path, monkeypatch):
    """As on Windows while another Blender has the file open."""
    tried = []

    def refused(*paths: object) -> None:
        tried.append(paths)
        raise PermissionError

    monkeypatch.setattr(log.os, "rename", refused)
    monkeypatch.setattr(log, "MOST_BYTES", 1000)
    log.to_file(tmp_path / log.FILE)
    for i in range(30):
        log.info("line", number=i, text="x" * 100)
    log.close()
    assert len(tried) == 1
    told = [json.loads(line) for line in (tmp_path / log.FILE).read_text().splitlines()]
    assert [line["number"] for line in told] == list(range(30))


def test_names_that_are_no_text_are_told_all_the_same(written):
    log.info("odd", name="a\udcff.exr")
    assert written()[-1]["name"] == "a\udcff.exr"


def test_words_without_folders_stay():
    for text in ("Vase: 20 % of its texels are lit in no view", "no", "", "view_01.exr: clipped, 3.4 %"):
        assert log.without_folders(text) == text


def test_a_bug_is_told_without_source_and_folders(written):
    def inner() -> None:
        raise ValueError("/home/somebody/private/pic.exr is odd")

    try:
        try:
            inner()
        except ValueError as error:
            raise KeyError("lost") from error
    except KeyError as error:
        log.failure("bug", error)
    line = written()[-1]
    assert (line["level"], line["event"], line["error"]) == ("ERROR", "bug", "KeyError")
    assert line["trace"][-1] == "KeyError: 'lost'" and "ValueError: pic.exr is odd" in line["trace"]
    assert any(part.endswith("inner") and "test_log.py" in part for part in line["trace"])
    assert "somebody" not in json.dumps(line) and "raise" not in json.dumps(line)


def test_bad_input_is_one_line(written):
    log.failure("refused", BadInput("/x/y.exr: is empty; choose another"))
    assert written()[-1]["message"] == "y.exr: is empty; choose another" and "trace" not in written()[-1]


def test_what_json_does_not_know_becomes_text(written):
    log.info("odd", nan=float("nan"), inf=np.inf, number=np.float32(1.5), path=Path("/a/b.exr"), array=np.arange(2),
             none=None, nested={"x": ("/a/b", True)})
    line = written()[-1]
    assert (line["nan"], line["inf"], line["path"], line["none"], line["nested"]) == (
        "nan", "inf", "b.exr", None, {"x": ["b", True]})


def test_it_does_not_grow_without_end(tmp_path):
    file = tmp_path / log.FILE
    log.to_file(file)
    for i in range(800):
        log.info("line", number=i, text="x" * 4000)
    log.close()
    kept = sorted(tmp_path.iterdir())
    assert [path.name for path in kept] == [log.FILE, f"{log.FILE}.1", f"{log.FILE}.2"]
    assert sum(path.stat().st_size for path in kept) <= 3 * log.MOST_BYTES
    assert json.loads(file.read_text().splitlines()[-1])["number"] == 799


def test_a_place_that_cannot_be_written_disturbs_nobody(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    for place in (tmp_path / "file" / "below" / log.FILE, Path("/dev/full"), tmp_path):
        log.to_file(place)
        log.info("lost")
        log.close()
    assert capsys.readouterr() == ("", "")


def test_one_file_is_written_once(written, tmp_path):
    log.to_file(tmp_path / "configuration" / log.FILE)
    log.info("once")
    assert [line["event"] for line in written()] == ["once"]


def test_a_solve_is_told_from_its_start_to_its_end():
    square, stream = selftest.build(16), io.StringIO()
    log.to_stream(stream)
    settings = SolveSettings(size=16, model="one-lobe")

    def told(read_image=square.read_image) -> list[dict]:
        stream.truncate(0)
        stream.seek(0)
        solving = solver.solve(square.scene, settings, read_image)
        steps = log.watched(square.scene, settings, DeviceSettings(), solving)
        try:
            for _ in steps:
                if read_image is None:
                    steps.throw(Cancelled())
        except (BadInput, Cancelled):
            pass
        return [json.loads(line) for line in stream.getvalue().splitlines()]

    def broken(view):
        raise BadInput(f"/private/{view.image}: broken")

    begin, end = told()
    assert (begin["event"], end["event"]) == ("solve", "solved")
    assert begin["lights"] == {"POINT": 16} and begin["settings"]["size"] == 16
    assert end["texels"]["solved"] == 256 and set(end["seconds"]) == {"gbuffer", "observe", "solve", "maps"}
    assert [line["event"] for line in told(broken)] == ["solve", "solve failed"]
    assert [line["event"] for line in told(None)] == ["solve", "stopped"]
    log.close()
