"""Output appears whole or not at all."""

from __future__ import annotations

import os
import secrets
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from irpso_addon.core.errors import BadInput
from irpso_addon.core.storage.output_transaction import SET, OutputTransaction

ROOT = Path(__file__).parents[2]


def test_publish_moves_everything(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    with OutputTransaction(tmp_path) as staging:
        (staging.folder / "a.txt").write_text("new")
        staging.beside("b.blend").write_text("beside")
        assert (tmp_path / "a.txt").read_text() == "old"
        assert staging.publish() == [tmp_path / "a.txt", tmp_path / "b.blend"]
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {"a.txt": "new", "b.blend": "beside"}


@pytest.mark.parametrize("error", [ValueError("x"), KeyboardInterrupt(), BadInput("x")])
def test_failure_leaves_nothing(tmp_path, error):
    out = tmp_path / "deep" / "er"
    with pytest.raises(type(error)), OutputTransaction(out) as staging:
        (staging.folder / "a.txt").write_text("new")
        staging.beside("b.blend").write_text("beside")
        raise error
    assert list(tmp_path.iterdir()) == []


def test_failure_leaves_what_was_there(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises(ValueError), OutputTransaction(tmp_path) as staging:
        (staging.folder / "a.txt").write_text("new")
        raise ValueError
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {"a.txt": "old"}


def test_messages_name_the_users_folder(tmp_path):
    with pytest.raises(BadInput) as caught, OutputTransaction(tmp_path) as staging:
        raise BadInput(f"{staging.folder}/a.exr: disk is full")
    assert str(caught.value) == f"{tmp_path}/a.exr: disk is full"
    with pytest.raises(BadInput, match="No space left"), OutputTransaction(tmp_path):
        raise OSError(28, "No space left on device")


def test_a_folder_in_the_way(tmp_path):
    (tmp_path / "a.txt").mkdir()
    with pytest.raises(BadInput, match=r"a\.txt: is a folder"), OutputTransaction(tmp_path) as staging:
        (staging.folder / "b.txt").write_text("new")
        (staging.folder / "a.txt").write_text("new")
        staging.publish()
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_cannot_enter(tmp_path):
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/irpso")):
        with pytest.raises(BadInput, match="choose another folder"), OutputTransaction(out):
            raise AssertionError("entered")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def left_by_a_kill(out: Path, at: str) -> None:
    """A run that publishes three files into ``out`` and is killed when it calls ``at`` for the second time."""
    code = """
import os, signal, sys
import os
import signal
import subprocess
import sys
from pathlib import Path
from irpso_addon.core.storage import output_transaction as staging
place, name = sys.argv[2].split(".")
place = {"os": os, "staging": staging, "shutil": staging.shutil}[place]
real, calls = getattr(place, name), []
def killed(*arguments, **named):
    calls.append(1)
    if len(calls) == int(sys.argv[3]):
        os.kill(os.getpid(), signal.SIGKILL)
    return real(*arguments, **named)
with staging.OutputTransaction(Path(sys.argv[1])) as s:
    (s.folder / "a.txt").write_text("new")
    (s.folder / "b.txt").write_text("new")
    s.beside("c.blend").write_text("new")
    setattr(place, name, killed)
    s.publish()
"""
    name, _, count = at.partition(" ")
    done = subprocess.run([sys.executable, "-c", code, str(out), name, count or "1"], cwd=ROOT)
    assert done.returncode == -signal.SIGKILL


@pytest.mark.parametrize(("at", "published"), [
    ("staging.flush", False), ("staging.flush 3", False), ("staging.flush_folder", True), ("os.replace", True),
    ("os.replace 2", True), ("os.replace 3", True), ("staging.flush_folder 3", True), ("shutil.rmtree", True)])
def test_the_next_run_ends_what_a_killed_one_began(tmp_path, at, published):
    (tmp_path / "a.txt").write_text("old")
    left_by_a_kill(tmp_path, at)
    with OutputTransaction(tmp_path) as staging:
        (staging.folder / "d.txt").write_text("mine")
        staging.publish()
    new = {"a.txt": "new", "b.txt": "new", "c.blend": "new"} if published else {"a.txt": "old"}
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == new | {"d.txt": "mine"}


def test_a_second_run_is_told_who_is_there(tmp_path):
    with OutputTransaction(tmp_path) as staging:
        (staging.folder / "a.txt").write_text("first")
        with pytest.raises(BadInput, match=rf"another irpso \(process {os.getpid()} on .*\) is working there"):
            OutputTransaction(tmp_path).__enter__()
        staging.publish()
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_a_set_that_cannot_be_published_to_its_end_is_kept(tmp_path, monkeypatch):
    real = os.replace

    def held(source: Path, target: Path) -> None:
        if target.name == "b.txt":
            raise PermissionError(13, "Permission denied")
        real(source, target)

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", held)
        with pytest.raises(BadInput, match=r"b\.txt: cannot be written \(Permission denied\); close or move it"), \
                OutputTransaction(tmp_path) as staging:
            for name in "abc":
                (staging.folder / f"{name}.txt").write_text(name)
            staging.publish()
    with OutputTransaction(tmp_path):
        pass
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {f"{n}.txt": n for n in "abc"}


def test_the_folder_is_made_as_any_other(tmp_path, monkeypatch):
    """With the rights of a plain one, under a name that is free."""
    (tmp_path / "plain").mkdir()
    (tmp_path / f"{SET}{'0' * 8}").write_text("taken")
    drawn = iter(["0" * 8, "1" * 8])
    monkeypatch.setattr(secrets, "token_hex", lambda _: next(drawn))
    monkeypatch.setattr(OutputTransaction, "_finish_others", lambda _: None)  # a share without locks
    with OutputTransaction(tmp_path) as staging:
        assert staging.folder.name == f"{SET}{'1' * 8}"
        assert staging.folder.stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_links_and_things_of_others_stay(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "mine").write_text("x")
    (tmp_path / ".irpso-set-abcdefgh").symlink_to(tmp_path / "elsewhere")
    (tmp_path / ".irpso-notes").write_text("x")
    with OutputTransaction(tmp_path):
        pass
    assert (tmp_path / "elsewhere" / "mine").exists() and (tmp_path / ".irpso-notes").exists()
