"""Bad input to the command line: one line that names it, exit 3, nothing written, nothing of the user's changed."""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import subprocess
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from tests.blender.ball import FILES, fingerprint, read


def assert_bad(done: subprocess.CompletedProcess[str], *words: str) -> None:
    """Exit 3 and one last line that names the culprit; warnings may stand before it."""
    assert done.returncode == 3, f"{done.returncode}\n{done.stdout}\n{done.stderr}"
    assert "Traceback" not in done.stderr
    complaint = [line for line in done.stderr.splitlines() if not re.match(r"irpso: (warning:| *\d+ % )", line)]
    assert len(complaint) == 1 and complaint[0].startswith("irpso: "), done.stderr
    for word in words:
        assert word in complaint[0], done.stderr


def solve_bad(irpso, folder: Path, *words: str, size: int = 32, **options) -> None:
    """Solve a folder that holds something bad."""
    before, out = fingerprint(folder), folder / "new" / "out"
    captures = ["--captures", folder / "captures.json"] if (folder / "captures.json").exists() else []
    assert_bad(irpso("solve", folder / "scene.blend", *captures, "--size", size, "--out", out, **options), *words)
    assert fingerprint(folder) == before
    assert not (folder / "new").exists()


@pytest.fixture
def capture(scenes, tmp_path) -> Path:
    """A copy of the good capture with two views, to be spoiled."""
    folder = shutil.copytree(scenes / "good", tmp_path / "capture")
    views = json.loads((folder / "captures.json").read_text())["views"][:2]
    (folder / "captures.json").write_text(json.dumps({"views": views}))
    return folder


def change_view(folder: Path, **values: object) -> dict:
    """Change the first view of the capture file."""
    content = json.loads((folder / "captures.json").read_text())
    content["views"][0].update(values)
    (folder / "captures.json").write_text(json.dumps(content))
    return content["views"][0]


def change_pixels(folder: Path, value: float) -> str:
    """Write a value into the middle of the first reference; the file's name."""
    path = folder / json.loads((folder / "captures.json").read_text())["views"][0]["image"]
    pixels = read(path).copy()
    h, w, channels = pixels.shape
    pixels[h // 2 - 5:h // 2 + 5, w // 2 - 5:w // 2 + 5, :3] = value
    buffer = oiio.ImageBuf(oiio.ImageSpec(w, h, channels, "float"))
    buffer.set_pixels(oiio.ROI(), pixels)
    assert buffer.write(str(path))
    return path.name


def test_truncated_blend(scenes, irpso_here, tmp_path):
    broken = tmp_path / "broken.blend"
    broken.write_bytes((scenes / "good" / "scene.blend").read_bytes()[:20000])
    assert_bad(irpso_here("solve", broken), "broken.blend")


def test_export_of_an_unsolved_scene(scenes, irpso_here, tmp_path):
    assert_bad(irpso_here("export", scenes / "good" / "scene.blend", "--out", tmp_path), "irpso solve")
    assert_bad(irpso_here("export", scenes / "good" / "scene.blend", "--object", "Ball"), "'Ball'", "irpso solve")
    assert_bad(irpso_here("export", scenes / "good" / "scene.blend", "--object", "Cup"), "'Cup'")
    assert list(tmp_path.iterdir()) == []


def test_missing_image(irpso_here, capture):
    change_view(capture, image="refs/lost.exr")
    solve_bad(irpso_here, capture, "lost.exr")


def test_no_image_is_there(irpso_here, capture):
    """As where a scene was copied without its pictures."""
    shutil.rmtree(capture / "refs")
    solve_bad(irpso_here, capture, "not found", "check the path")


def test_corrupt_image(irpso_here, capture):
    path = capture / change_view(capture)["image"]
    path.write_bytes(path.read_bytes()[:3000])
    solve_bad(irpso_here, capture, path.name)


def test_image_that_is_text(irpso_here, capture):
    path = capture / change_view(capture)["image"]
    path.write_text("no picture")
    solve_bad(irpso_here, capture, path.name)


def test_image_of_another_aspect(irpso_here, capture):
    path = capture / change_view(capture)["image"]
    pixels = read(path)
    buffer = oiio.ImageBuf(oiio.ImageSpec(64, 32, 4, "float"))
    buffer.set_pixels(oiio.ROI(), np.ascontiguousarray(pixels[:32, :64]))
    assert buffer.write(str(path))
    solve_bad(irpso_here, capture, path.name, "64 x 32", "aspect")


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_impossible_pixels(irpso_here, capture, value):
    solve_bad(irpso_here, capture, change_pixels(capture, value))


def test_unknown_camera_and_light(irpso_here, capture):
    change_view(capture, camera="Tripod")
    solve_bad(irpso_here, capture, "Tripod")
    change_view(capture, camera="Camera 0", lights=["Torch"])
    solve_bad(irpso_here, capture, "Torch")


@pytest.mark.parametrize("text", ["", "{", "[]", '{"views": []}', '{"views": [{"camera": "Camera 0"}]}'])
def test_bad_capture_file(irpso_here, capture, text):
    (capture / "captures.json").write_text(text)
    solve_bad(irpso_here, capture, "captures.json")


def test_missing_capture_file(irpso_here, capture):
    assert_bad(irpso_here("solve", capture / "scene.blend", "--captures", capture / "none.json"), "none.json")


@pytest.mark.parametrize(("name", "words"), [
    ("no_uvs", ("Ball", "UV")), ("no_light", ("light",)), ("no_camera", ("camera",)),
    ("no_views", ("captures.json",)), ("no_mesh", ("mesh",)),
    ("two_meshes", ("'Ball'", "'Second'")),
])
def test_bad_scene(irpso_here, scenes, tmp_path, name, words):
    folder = shutil.copytree(scenes / "good", tmp_path / "scene")
    shutil.copy(scenes / name / "scene.blend", folder / "scene.blend")
    if name in ("no_light", "no_camera", "no_views"):
        (folder / "captures.json").unlink()  # the views must come from the scene, then
    solve_bad(irpso_here, folder, *words)


def test_unknown_object(irpso_here, capture):
    for name in ("Cup", "Camera 0"):
        assert_bad(irpso_here("solve", capture / "scene.blend", "--object", name), name)


def test_a_lamp_to_keep_that_is_not_there(capture, irpso_here) -> None:
    assert_bad(irpso_here("solve", capture / "scene.blend", "--keep", "Light 1", "--keep", "Ball"),
               "'Ball': is not a lamp or camera of this file; there are: 'Camera 0', 'Camera 1', 'Light 0', ")


# ---- places that cannot be written


def test_folder_below_a_file(irpso_here, capture, tmp_path):
    (tmp_path / "file").write_text("")
    done = irpso_here("solve", capture / "scene.blend", "--captures", capture / "captures.json", "--out",
                      tmp_path / "file" / "out")
    assert_bad(done, "file", "choose another")


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs Linux's /proc, where not even root may write")
def test_unwritable_folder(irpso_here, capture):
    for out in ("/proc", "/proc/irpso"):
        done = irpso_here("solve", capture / "scene.blend", "--captures", capture / "captures.json", "--out", out)
        assert_bad(done, out, "choose another")


def test_report_into_a_missing_folder(irpso_here, capture, tmp_path):
    done = irpso_here("solve", capture / "scene.blend", "--captures", capture / "captures.json", "--out",
                      tmp_path / "o", "--report", tmp_path / "no" / "report.json")
    assert_bad(done, "report.json")
    assert not (tmp_path / "o").exists()


def test_full_disk(irpso, capture):
    """No file may grow beyond 10 kB: what a full disk does in the middle of a write."""
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))

    solve_bad(irpso, capture, "out", size=64, preexec_fn=limit)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can mount")
def test_really_full_disk(irpso_here, capture, tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "irpso", str(disk)], capture_output=True).returncode:
        pytest.skip("this machine lets nobody mount")
    try:
        done = irpso_here("solve", capture / "scene.blend", "--captures", capture / "captures.json", "--size", 64,
                          "--out", disk / "out")
        assert_bad(done, str(disk / "out"))
        assert list(disk.iterdir()) == []
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_older_results_survive_a_failure(irpso_here, capture, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    for name in FILES:
        (out / name).write_text("older")
    change_pixels(capture, np.nan)
    assert_bad(irpso_here("solve", capture / "scene.blend", "--captures", capture / "captures.json", "--out", out))
    assert {p.name: p.read_text() for p in out.iterdir()} == dict.fromkeys(FILES, "older")
