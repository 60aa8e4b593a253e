"""Output appears whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from irpso_addon.core.errors import BadInput
from irpso_addon.core.staging import Staging


def test_publish_moves_everything(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    with Staging(tmp_path) as staging:
        (staging.folder / "a.txt").write_text("new")
        staging.beside("b.blend").write_text("beside")
        assert (tmp_path / "a.txt").read_text() == "old"
        assert staging.publish() == [tmp_path / "a.txt", tmp_path / "b.blend"]
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {"a.txt": "new", "b.blend": "beside"}


@pytest.mark.parametrize("error", [ValueError("x"), KeyboardInterrupt(), BadInput("x")])
def test_failure_leaves_nothing(tmp_path, error):
    out = tmp_path / "deep" / "er"
    with pytest.raises(type(error)), Staging(out) as staging:
        (staging.folder / "a.txt").write_text("new")
        staging.beside("b.blend").write_text("beside")
        raise error
    assert list(tmp_path.iterdir()) == []


def test_failure_leaves_what_was_there(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises(ValueError), Staging(tmp_path) as staging:
        (staging.folder / "a.txt").write_text("new")
        raise ValueError
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {"a.txt": "old"}


def test_messages_name_the_users_folder(tmp_path):
    with pytest.raises(BadInput) as caught, Staging(tmp_path) as staging:
        raise BadInput(f"{staging.folder}/a.exr: disk is full")
    assert str(caught.value) == f"{tmp_path}/a.exr: disk is full"
    with pytest.raises(BadInput, match="No space left"), Staging(tmp_path):
        raise OSError(28, "No space left on device")


def test_a_folder_in_the_way(tmp_path):
    (tmp_path / "a.txt").mkdir()
    with pytest.raises(BadInput, match=r"a\.txt: is a folder"), Staging(tmp_path) as staging:
        (staging.folder / "b.txt").write_text("new")
        (staging.folder / "a.txt").write_text("new")
        staging.publish()
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_cannot_enter(tmp_path):
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/irpso")):
        with pytest.raises(BadInput, match="choose another folder"), Staging(out):
            raise AssertionError("entered")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
