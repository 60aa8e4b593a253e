"""The command line end to end, on real files: results, exit codes, one line for each complaint.

A solve that succeeds, what meets a terminal, a signal or a limit, and a case of each exit code run as programs; all
else runs in this process (``irpso_here``).
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import fields
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from irpso_addon.core.params import SolveSettings
from tests.blender.ball import BASE, FILES, ROLES, ROUGH, fingerprint, read

ROOT = Path(__file__).resolve().parents[2]
GIVEN = ("--lamps", "given", "--exposures", "given", "--registration", "given")  # to put them right takes seconds


@pytest.fixture(scope="session")
def solved(scenes, irpso, tmp_path_factory):
    """One good solve, looked at by several tests."""
    out = tmp_path_factory.mktemp("solved")
    before = fingerprint(scenes / "good")
    done = irpso("solve", scenes / "good" / "scene.blend", "--captures", scenes / "good" / "captures.json",
                 "--size", 128, "--out", out)
    assert done.returncode == 0, done.stderr
    assert fingerprint(scenes / "good") == before
    return out, done


def test_solve_writes_the_contracted_files(solved):
    out, done = solved
    assert {p.name for p in out.iterdir()} == FILES
    assert re.search(r"^Ball: one-lobe, [\d,]+ of [\d,]+ texels from 10 views in ", done.stdout, re.M)


def test_a_part_is_solved_beside_the_maps_that_the_file_has(solved, scenes, irpso_here, tmp_path):
    """White is the upper half of the UV map: the lower half stays, bit by bit."""
    folder, _ = solved
    part = np.zeros((64, 4, 3), np.float32)
    part[:32] = 1
    image = oiio.ImageOutput.create(str(tmp_path / "part.png"))
    assert image.open(str(tmp_path / "part.png"), oiio.ImageSpec(4, 64, 3, "uint8")) and image.write_image(part)
    image.close()
    out = tmp_path / "out"
    done = irpso_here("solve", folder / "scene_irpso.blend", "--captures", scenes / "good" / "captures.json",
                      "--size", 128, "--part-image", tmp_path / "part.png", "--start", "last", "--seed", 3,
                      "--out", out)
    assert done.returncode == 0, done.stderr
    texels, before = (json.loads((f / "report.json").read_text())["texels"] for f in (out, folder))
    assert texels["solved"] + texels["kept"] + texels["filled"] == texels["covered"] == before["covered"]
    assert texels["kept"] > 0.2 * before["solved"] and texels["solved"] > 0.3 * before["solved"]
    for role in ("basecolor", "roughness", "confidence"):
        now, was = read(out / f"Ball_{role}.exr"), read(folder / f"Ball_{role}.exr")
        known = read(folder / "Ball_confidence.exr")[..., 0] > 0
        row = np.arange(128)[:, None]
        np.testing.assert_array_equal(now[known & (row > 72)], was[known & (row > 72)])
        sure = read(folder / "Ball_confidence.exr")[..., 0] > 0.25  # one value for all: at most 0.5
        assert np.median(np.abs(now - was)[sure & (row < 64)]) < 1e-3


def test_solve_finds_the_constant_paint(solved):
    """Constant truth, so every confident texel can be judged without any mapping."""
    out, _ = solved
    confident = read(out / "Ball_confidence.exr")[..., 0] > 0.25  # one value for all: at most 0.5
    sigma = read(out / "Ball_roughness_sigma.exr")[..., 0]
    assert confident.sum() > 2000
    assert (sigma[confident] < 0.05).all()
    base, rough = read(out / "Ball_basecolor.exr")[confident], read(out / "Ball_roughness.exr")[confident]
    assert np.median(np.abs(base - np.array(BASE))) < 0.01
    assert np.median(np.abs(rough - ROUGH)) < 0.02
    assert (rough[:, 0] == rough[:, 1]).all() and (rough[:, 0] == rough[:, 2]).all()


def test_report_has_its_keys(solved):
    out, _ = solved
    report = json.loads((out / "report.json").read_text())
    assert set(report) == {field.name for field in fields(SolveSettings)} | {
        "versions", "command", "models", "seconds", "texels", "texels_per_second",
        "views", "residual", "warnings", "calibration", "cameras", "refined_normals", "normals_given_because", "checks",
        "device", "peak_memory_bytes", "cancelled", "stride"}
    assert report["models"]["Paint"]["model"] == "one-lobe" and report["models"]["Paint"]["why"]
    assert set(report["seconds"]) == {
        "scene", "gbuffer", "observe", "cameras", "calibrate", "normals", "solve", "maps", "write", "total"}
    assert {"covered", "observed", "solved", "filled", "kept"} == set(report["texels"])
    assert report["texels"]["solved"] + report["texels"]["filled"] == report["texels"]["covered"]
    assert len(report["views"]["used"]) == 10 and report["views"]["skipped"] == []
    assert report["versions"]["blender"] and report["device"]["renderer"]
    assert report["command"][:2] == ["irpso", "solve"]


def test_same_seed_same_bytes(solved, scenes, irpso_here, tmp_path):
    """In another process, that has solved other things before."""
    out, _ = solved
    done = irpso_here("solve", scenes / "good" / "scene.blend", "--captures", scenes / "good" / "captures.json",
                      "--size", 128, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    maps = sorted(FILES - {"report.json", "scene_irpso.blend"})
    assert [read(out / name).tobytes() for name in maps] == [read(tmp_path / name).tobytes() for name in maps]


def test_solved_scene_carries_the_maps(solved, tmp_path):
    """The saved copy is opened by a Blender that knows nothing of IRPSO, and renders with the maps."""
    code = """
import sys, bpy
bpy.ops.wm.open_mainfile(filepath=sys.argv[-1])
principled = bpy.data.materials["Paint"].node_tree.nodes["Principled BSDF"]
for socket in ("Base Color", "Roughness"):
    image = principled.inputs[socket].links[0].from_node.image
    print(socket, image.size[0], image.colorspace_settings.name, image.packed_file is not None)
"""
    done = subprocess.run([sys.executable, "-c", code, str(solved[0] / "scene_irpso.blend")],
                          capture_output=True, text=True)
    assert "Base Color 128 Linear Rec.709 True" in done.stdout, done.stdout + done.stderr
    assert "Roughness 128 Non-Color True" in done.stdout


@pytest.mark.parametrize("kind", ["png", "tiff"])
def test_export_gives_the_same_maps_again(solved, irpso_here, tmp_path, kind):
    out, _ = solved
    done = irpso_here("export", out / "scene_irpso.blend", "--out", tmp_path, "--format", kind)
    assert done.returncode == 0, done.stderr
    assert {p.name for p in tmp_path.iterdir()} == {f"Ball_{role}.{kind}" for role in ROLES}
    linear = read(out / "Ball_basecolor.exr").clip(0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.abs(read(tmp_path / f"Ball_basecolor.{kind}") - encoded).max() < 2e-4
    for role in ("roughness", "roughness_sigma", "basecolor_sigma"):
        values = read(out / f"Ball_{role}.exr").clip(0, 1)
        assert np.abs(read(tmp_path / f"Ball_{role}.{kind}") - values).max() < 2e-5
    assert oiio.ImageInput.open(str(tmp_path / f"Ball_roughness.{kind}")).spec().format.basetype == oiio.UINT16


# ---- exit codes


@pytest.mark.parametrize(("arguments", "code", "words"), [
    ((), 2, "usage"),
    (("--help",), 0, "exit codes"),
    (("solve", "nowhere.blend"), 3, "nowhere.blend: cannot be opened"),
])
def test_exit_code(irpso, arguments, code, words):
    assert_told(irpso(*arguments), code, words)


@pytest.mark.parametrize(("arguments", "code", "words"), [
    (("solve", "--help"), 0, "--captures"),
    (("solve",), 2, "SCENE.blend"),
    (("paint", "x.blend"), 2, "invalid choice"),
    (("solve", "x.blend", "--size", "4"), 2, "must be between 16 and 8192"),
    (("solve", "x.blend", "--size", "many"), 2, "invalid int value"),
    (("solve", "x.blend", "--method", "guess"), 2, "refined"),
    (("export", "nowhere.blend"), 3, "nowhere.blend: cannot be opened"),
    (("solve", "README.md"), 3, "is not a .blend file"),
    (("solve", "."), 3, "cannot be opened"),
])
def test_exit_code_in_this_process(irpso_here, arguments, code, words):
    assert_told(irpso_here(*arguments), code, words)


def assert_told(done: subprocess.CompletedProcess[str], code: int, words: str) -> None:
    assert done.returncode == code, done.stderr
    assert words in done.stdout + done.stderr
    if code == 3:
        assert re.fullmatch(r"irpso: [^\n]+\n", done.stderr), done.stderr


# ---- Ctrl-C


def test_cancel_keeps_what_was_found(scenes, tmp_path):
    """Ctrl-C in the middle of the solve stage: exit 130, and either whole partial maps or nothing."""
    out = tmp_path / "out"
    command = [sys.executable, "-m", "irpso_addon", "solve", scenes / "good" / "scene.blend", "--captures",
               scenes / "good" / "captures.json", "--size", "512", "--out", out]
    process = subprocess.Popen(
        list(map(str, command)), cwd=ROOT, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    for line in process.stderr:
        if " solving" in line:
            break
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    _, rest = process.communicate(timeout=120)
    assert process.returncode == 130, rest
    assert "Traceback" not in rest
    last = rest.splitlines()[-1]
    if out.exists():
        assert last == "irpso: cancelled; the maps found so far are kept"
        assert {p.name for p in out.iterdir()} == FILES
        assert json.loads((out / "report.json").read_text())["cancelled"] is True
    else:
        assert last == "irpso: cancelled; nothing was written"


def test_cancel_while_blender_is_loaded(scenes, tmp_path):
    out = tmp_path / "out"
    command = ["solve", str(scenes / "good" / "scene.blend"), "--out", str(out)]
    pressed = ("import os, signal; from irpso_addon import __main__ as cli; load = cli._import_blender; "
               "cli._import_blender = lambda name: (os.kill(os.getpid(), signal.SIGINT), load(name)); "
               f"raise SystemExit(cli.main({command!r}))")
    done = subprocess.run([sys.executable, "-c", pressed], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (130, "irpso: cancelled; nothing was written\n")
    assert not out.exists()


def test_cancel_while_the_demo_is_rendered(tmp_path):
    process = subprocess.Popen([sys.executable, "-m", "irpso_addon", "demo", "--out", str(tmp_path / "demo")], cwd=ROOT,
                               stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    for line in process.stderr:
        if " render: view" in line:
            break
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=120)
    assert process.returncode == 130, said
    assert said.splitlines()[-1].startswith("irpso: cancelled")


# ---- the other commands


def test_doctor_finds_this_machine_well(irpso):
    done = irpso("doctor", "--kernels", "fragment")
    assert done.returncode == 0, done.stderr
    lines = dict(re.split(r"  +", line, maxsplit=1) for line in done.stdout.splitlines() if "  " in line.strip())
    assert lines["blender"] and lines["renderer"] and int(lines["largest map (texels)"]) >= 4096
    assert lines["kernels"] == "fragment"
    assert float(lines["self-test, roughness error"]) < 0.002
    assert done.stdout.endswith("all is well\n")


@pytest.mark.one_python
def test_demo(irpso, tmp_path):
    done = irpso("demo", "--out", tmp_path / "demo")
    assert done.returncode == 0, done.stderr
    figures = dict(re.findall(r"^(.+?)  +([\d.]+)%?$", done.stdout, re.M))
    assert float(figures["base colour, PSNR (dB)"]) > 28, done.stdout
    assert float(figures["roughness, median error"]) < 0.01, done.stdout
    assert float(figures["new light and camera, PSNR (dB)"]) > 32, done.stdout
    picture = read(tmp_path / "demo" / "demo.jpg")
    assert picture.shape[1] > 700 and (tmp_path / "demo" / "demo.jpg").stat().st_size < 400_000
    header = picture[:30, :260]  # where the first label stands: ink on a dark ground
    assert header.max() > 0.7 and np.median(header) < 0.2
    assert {"scene.blend", "captures.json", "refs", "scene_irpso.blend", "report.json", "truth"} <= {
        p.name for p in (tmp_path / "demo").iterdir()}
    truth = read(tmp_path / "demo" / "truth" / "Vase_roughness.exr")
    assert truth.shape == (*read(tmp_path / "demo" / "Vase_roughness.exr").shape[:2], 1)


def test_progress_bar_on_a_terminal(scenes, tmp_path):
    """With a terminal as stderr the bar is drawn there, and stdout still holds the result alone."""
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "irpso_addon", "solve", scenes / "good" / "scene.blend", "--captures",
               scenes / "good" / "captures.json", "--size", "64", *GIVEN, "--out", tmp_path]
    process = subprocess.Popen(list(map(str, command)), cwd=ROOT, stdout=subprocess.PIPE, stderr=theirs, text=True)
    os.close(theirs)
    drawn = b""
    try:
        while chunk := os.read(ours, 4096):
            drawn += chunk
    except OSError:  # Linux's way of saying that the other end has closed
        pass
    os.close(ours)
    told = process.communicate()[0]
    assert process.returncode == 0
    assert "━".encode() in drawn and b"solving" in drawn
    lines = told.splitlines()
    assert lines[0].startswith("Ball: ") and "left-out lamps predicted" in lines[1] and len(lines) == 3


def test_works_without_rich(scenes, irpso, tmp_path):
    """Blender ships no rich; this terminal asks for its bar."""
    code = ("import sys; sys.modules['rich'] = None; sys.stderr.isatty = lambda: True; "
            "from irpso_addon.__main__ import main; sys.exit(main(sys.argv[1:]))")
    done = subprocess.run(
        [sys.executable, "-c", code, "solve", str(scenes / "good" / "scene.blend"), "--captures",
         str(scenes / "good" / "captures.json"), "--size", "32", "--model", "one-lobe", *GIVEN, "--out", str(tmp_path)],
        cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert re.search(r"^irpso: +\d+ % solving", done.stderr, re.M)
