"""Large solves as a program: files for each UDIM, work that goes on after Ctrl-C, exports, refusals."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from irpso_addon.core.errors import BadInput
from irpso_addon.core.reporting.estimates import check_disk
from tests.blender.ball import BASE, ROLES, ROUGH, read

ROOT = Path(__file__).resolve().parents[2]
SIZE = 64
MAPS = {f"Ball_{role}.{udim}.exr" for role in ROLES for udim in (1001, 1002)}


def command(scenes: Path, out: Path) -> list[object]:
    return ["solve", scenes / "udims" / "scene.blend", "--captures", scenes / "good" / "captures.json",
            "--size", SIZE, "--udim", "all", "--model", "one-lobe", "--out", out]


@pytest.fixture(scope="module")
def solved(scenes, irpso, tmp_path_factory):
    """One that nothing disturbs."""
    out = tmp_path_factory.mktemp("large")
    done = irpso(*command(scenes, out))
    assert done.returncode == 0, done.stderr
    return out, done


def test_each_udim_has_its_files(solved) -> None:
    out, done = solved
    assert {path.name for path in out.iterdir()} == MAPS | {"report.json", "scene_irpso.blend"}
    assert re.search(r"^irpso:   0 % about .* GPU memory, .* memory, .* of disk$", done.stderr, re.M)
    assert "ndirect" not in done.stderr and "plan: \n" not in done.stderr  # its shadows are dark
    report = json.loads((out / "report.json").read_text())
    assert report["udim"] == "all" and {"plan", "pictures", "observe", "solve", "merge"} <= set(report["seconds"])
    texels, seen = report["texels"], 0
    for udim in (1001, 1002):
        base, rough, filled, confidence = (
            read(out / f"Ball_{role}.{udim}.exr") for role in ("basecolor", "roughness", "filled", "confidence"))
        assert base.shape == (SIZE, SIZE, 3)
        seen += int((filled < 0.5).sum())
        sure = confidence[..., 0] > 0.25  # one value for all: at most 0.5
        if udim == 1001:  # the cameras look at this half
            assert sure.sum() > 300
            assert np.median(np.abs(base[sure] - np.array(BASE))) < 0.01
            assert np.median(np.abs(rough[sure] - ROUGH)) < 0.02
    assert seen == texels["solved"]


def test_the_scene_points_to_them(solved) -> None:
    """By relative paths, in a Blender that knows nothing of IRPSO."""
    code = """
import sys, bpy
bpy.ops.wm.open_mainfile(filepath=sys.argv[-1])
principled = bpy.data.materials["Paint"].node_tree.nodes["Principled BSDF"]
for socket in ("Base Color", "Roughness"):
    image = principled.inputs[socket].links[0].from_node.image
    print(socket, image.source, [(t.number, t.size[0]) for t in image.tiles], image.filepath, image.packed_file)
"""
    done = subprocess.run([sys.executable, "-c", code, str(solved[0] / "scene_irpso.blend")],
                          capture_output=True, text=True)
    for socket, end in (("Base Color", "basecolor"), ("Roughness", "roughness")):
        line = f"{socket} TILED [(1001, {SIZE}), (1002, {SIZE})] //Ball_{end}.<UDIM>.exr None"
        assert line in done.stdout, done.stdout + done.stderr


def test_ctrl_c_keeps_the_work_and_the_same_command_goes_on(solved, scenes, tmp_path: Path) -> None:
    """Same bytes in the end as without."""
    run = [sys.executable, "-m", "irpso_addon", *map(str, command(scenes, tmp_path))]
    process = subprocess.Popen(run, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 120
    while not (tmp_path / "irpso_work_Ball" / "plan.npz").exists() and time.monotonic() < deadline:
        time.sleep(0.005)
    process.send_signal(signal.SIGINT)
    _, told = process.communicate(timeout=120)
    assert process.returncode == 130, told
    assert re.search(r"cancelled; the plan and \d finished blocks are kept in .*irpso_work_Ball; the same", told)
    assert {path.name for path in tmp_path.iterdir()} == {"irpso_work_Ball"}
    again = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert again.returncode == 0, again.stderr
    assert "plan:" not in again.stderr
    assert {path.name for path in tmp_path.iterdir()} == MAPS | {"report.json", "scene_irpso.blend"}
    for name in MAPS:
        assert (tmp_path / name).read_bytes() == (solved[0] / name).read_bytes(), name


def test_export_copies_the_files(solved, irpso_here, tmp_path: Path) -> None:
    out, _ = solved
    done = irpso_here("export", out / "scene_irpso.blend", "--out", tmp_path, "--format", "png")
    assert done.returncode == 0, done.stderr
    names = {name.replace(".exr", ".png") for name in MAPS}
    assert {path.name for path in tmp_path.iterdir()} == names
    assert oiio.ImageInput.open(str(tmp_path / "Ball_basecolor.1002.png")).spec().format == oiio.UINT16
    np.testing.assert_allclose(read(tmp_path / "Ball_roughness.1001.png"), read(out / "Ball_roughness.1001.exr"),
                               atol=1e-5)


def test_what_blocks_cannot_do_is_refused(scenes, irpso_here, tmp_path: Path) -> None:
    for extra in (["--start", "last"], ["--selected-faces"], ["--device", "numpy"]):
        done = irpso_here(*command(scenes, tmp_path / "out"), *extra)
        assert done.returncode == 3 and len(done.stderr.strip().splitlines()) == 1, done.stderr
        assert "Ball" in done.stderr and not (tmp_path / "out").exists()
        assert done.stderr.endswith(", or set UDIM to First\n")  # its maps are small


def test_a_disk_that_is_too_small_is_told_before_the_solve(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"none.*: the solve may take .* GB of disk there, and .* are free"):
        check_disk(tmp_path / "none" / "deeper", 10**18)
    check_disk(tmp_path / "none", 10**18, there=10**18)
    assert not (tmp_path / "none").exists()
