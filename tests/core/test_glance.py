"""What a list shows of a file, and that whoever asks never waits for the disk."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.capture import file_preview as glances
from irpso_addon.core.capture.file_preview import ImagePreview, Watcher, preview_captures, preview_image
from irpso_addon.core.images import oiio_reader
from irpso_addon.core.images.image_writer import write_image


def until(said, seconds: float = 5.0):
    """Waits until ``said`` is true."""
    end = time.monotonic() + seconds
    while not said() and time.monotonic() < end:
        time.sleep(0.01)
    assert said()


def test_a_thumbnail_is_the_picture_made_small(tmp_path: Path) -> None:
    """Means over squares of a wide gradient, row 0 at the bottom; stored values, whatever the file's type."""
    ramp = np.linspace(0, 1, 512, dtype=np.float32)
    across, up = np.tile(ramp, (256, 1)), np.tile(ramp[::2, None], (1, 512))
    picture = np.stack([across, up, np.full((256, 512), 0.25, "f4")], 2)
    for kind, bits, integer in (("exr", 32, False), ("png", 16, True)):
        write_image(tmp_path / f"p.{kind}", picture, kind=kind, color=False)
        found = preview_image(tmp_path / f"p.{kind}")
        assert (found.problem, found.width, found.height, found.bits, found.integer) == ("", 512, 256, bits, integer)
        assert found.thumbnail.shape == (32, 64, 4)
        exact = picture.reshape(32, 8, 64, 8, 3).mean((1, 3))
        np.testing.assert_allclose(found.thumbnail[..., :3], exact, atol=0.003)  # 4 x 4 of the 8 x 8 pixels are read
        np.testing.assert_allclose(found.thumbnail[..., 3], 1)


def test_a_large_picture_is_read_in_strips(tmp_path: Path, monkeypatch) -> None:
    picture = np.random.default_rng(1).random((300, 200, 3), np.float32)
    write_image(tmp_path / "p.exr", picture, kind="exr", color=False)
    whole = preview_image(tmp_path / "p.exr").thumbnail
    monkeypatch.setattr(oiio_reader, "BAND", 200 * 7)
    np.testing.assert_array_equal(preview_image(tmp_path / "p.exr").thumbnail, whole)


@pytest.mark.parametrize(("name", "content", "words"), [
    ("none.exr", None, "Image not found"), ("text.exr", b"no image", "Cannot be read as an image"),
    ("folder", "folder", "Is a folder"), ("cut.exr", "cut", "damaged or cut short"),
])
def test_what_is_wrong_is_short(tmp_path: Path, name, content, words) -> None:
    path = tmp_path / name
    if content == "folder":
        path.mkdir()
    elif content == "cut":
        write_image(path, np.random.default_rng(1).random((64, 64, 3), np.float32), kind="exr", color=False)
        path.write_bytes(path.read_bytes()[:9000])
    elif content is not None:
        path.write_bytes(content)
    problem = preview_image(path).problem
    assert words in problem and str(tmp_path) not in problem and len(problem) < 60 and problem[0].isupper()


def test_capture_files(tmp_path: Path) -> None:
    good, bad = tmp_path / "good.json", tmp_path / "bad.json"
    good.write_text('{"views": [{"image": "a.exr", "camera": "C", "lights": ["L"]}]}')
    bad.write_text("{")
    assert [view.camera for view in preview_captures(good).views] == ["C"]
    assert preview_captures(bad).problem == "Is not JSON"


def test_the_watcher_never_waits_and_sees_changes(tmp_path: Path, monkeypatch) -> None:
    """The reader is held up by a lock as by a slow disk: all that is asked is answered before it comes free."""
    monkeypatch.setattr(glances, "AGAIN", 0.05)
    held, gate, read = threading.Event(), threading.Event(), []

    def look(path: Path) -> ImagePreview:
        held.set()
        assert gate.wait(60)  # who asks and waits for it waits in vain
        read.append(path.name)
        return ImagePreview(width=len(path.read_bytes()))

    watcher: Watcher[ImagePreview] = Watcher(look, ImagePreview(problem="gone"))
    path = tmp_path / "file"
    path.write_bytes(b"1234")
    assert watcher.of(str(path)) is None and held.wait(60)
    assert [watcher.of(str(path)) for _ in range(1000)] == [None] * 1000
    assert watcher.busy and read == []
    gate.set()
    until(lambda: not watcher.busy)
    assert watcher.of(str(path)).width == 4 and watcher.changes == 1
    time.sleep(0.1)
    watcher.of(str(path))
    until(lambda: not watcher.busy)
    assert read == ["file"]  # unchanged: looked at, not read
    path.write_bytes(b"123456")
    until(lambda: watcher.of(str(path)).width == 6)
    path.unlink()
    until(lambda: watcher.of(str(path)).problem == "gone")
    watcher.stop()
    assert not watcher.busy and "irpso-file-preview" not in [thread.name for thread in threading.enumerate()]
