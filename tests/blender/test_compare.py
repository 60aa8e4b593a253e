"""irpso compare as a program, on a ball of constant paint: whose errors are known, and which method must win."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from irpso_addon.core.images.image_writer import write_image
from tests.blender.ball import BASE, ROUGH

PASSES = (5, 400)
METHODS = ["no solver", "draft", "refined", "swarm", *(f"paper, {n} passes" for n in PASSES)]
GIVEN = ("--lamps", "given", "--exposures", "given", "--registration", "given")  # to put them right takes seconds
FILES = {"compare.json", "compare.png", "compare.svg"}


def write_truth(folder: Path, kind: str = "exr", name: str = "Ball") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    ones = np.ones((8, 8, 3), np.float32)
    write_image(folder / f"{name}_basecolor.{kind}", ones * np.array(BASE, np.float32), kind=kind, color=True)
    write_image(folder / f"{name}_roughness.{kind}", ones * np.float32(ROUGH), kind=kind, color=False)
    return folder


def command(scenes: Path, out: Path, *more: object) -> list[object]:
    folder = scenes / "good"
    return ["compare", folder / "scene.blend", "--captures", folder / "captures.json", "--out", out, "--size", 48,
            *more]


@pytest.fixture(scope="module")
def compared(scenes, irpso, tmp_path_factory):
    """One good run, looked at by several tests."""
    work = tmp_path_factory.mktemp("compared")
    out = work / "out"
    truth = write_truth(work / "truth")
    done = irpso(*command(scenes, out, "--truth", truth, "--passes", *PASSES))
    assert done.returncode == 0, done.stderr
    return out, done, json.loads((out / "compare.json").read_text())


def rows(report):
    return {row["method"]: row for row in report["rows"]}


def test_folder_holds_table_and_chart(compared):
    out, done, report = compared
    assert {path.name for path in out.iterdir()} == FILES
    assert list(rows(report)) == METHODS
    lines = done.stdout.splitlines()
    for method in METHODS:
        assert sum(line.startswith(method) for line in lines) == 1


def test_views_are_parted(compared):
    _, _, report = compared
    held, used = set(report["views"]["held_out"]), set(report["views"]["solved_from"])
    assert len(held) == 2 and len(used) == 8 and not held & used


def test_solvers_find_the_paint_and_predict_the_views_held_out(compared):
    """The forward model is good to a per cent or two at this size; division alone leaves the highlights."""
    found = rows(compared[2])
    for method in ("refined", "draft", "swarm"):
        assert found[method]["truth"]["albedo_rmse"] < 0.01
        assert found[method]["truth"]["rough_mae_informed"] < 0.02
        assert found[method]["held_out"] < 0.03
        assert found[method]["from_refined"]["rough_mae"] < 0.02
    assert found["no solver"]["truth"]["rough_mae"] == pytest.approx(0.05, abs=1e-6)  # 0.5 against 0.45
    assert found["no solver"]["held_out"] > 2 * found["refined"]["held_out"]
    assert found["refined"]["from_refined"] == {"base_rmse": 0.0, "rough_mae": 0.0}


def test_what_a_solve_expected_stands_beside_what_was_measured(scenes, irpso_here, tmp_path):
    """Model auto leaves lamps out; methods that do not have no such figure, and other models no such column."""
    done = irpso_here(*command(scenes, tmp_path / "out", "--model", "auto", *GIVEN, "--passes"))
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "out" / "compare.json").read_text())
    found = rows(report)
    assert found["draft"]["predicted"] is None and found["no solver"]["predicted"] is None
    predicted, measured = found["refined"]["predicted"], found["refined"]["held_out_error"]
    assert predicted["left_out"] == "lamps" and predicted["material"] == "Paint"
    assert predicted["relative_rms"] < 0.1 and measured["relative_rms"] < 0.1
    assert predicted["lightness"] < 3 and measured["lightness"] < 3
    table = [line.split() for line in done.stdout.splitlines()]
    row = next(cells for cells in table if cells and cells[0] == "refined")
    assert f"{100 * measured['relative_rms']:.2f}," in row and f"{100 * predicted['relative_rms']:.2f}," in row
    assert "-" in next(cells for cells in table if cells and cells[0] == "draft")
    assert "hollow: predicted" in (tmp_path / "out" / "compare.svg").read_text()


def test_nothing_predicts_better_than_the_truth(compared):
    """The judge blames the true maps for less than any estimate: what is left is its own error."""
    report = compared[2]
    assert report["truth_held_out"] < 0.02
    assert report["truth_held_out"] <= 1.01 * min(row["held_out"] for row in report["rows"])
    assert "the true maps are off by" in compared[1].stdout
    assert "predicted" not in compared[1].stdout and "hollow" not in (compared[0] / "compare.svg").read_text()


def test_more_passes_find_more(compared):
    few, more = (rows(compared[2])[f"paper, {n} passes"] for n in PASSES)
    assert more["held_out"] < 0.2 * few["held_out"]  # 0.014 and 0.197; seconds depend on what else runs


def test_times_are_told_by_stage(compared):
    for method, row in rows(compared[2]).items():
        stages = {"total"} if method == "no solver" else {
            "gbuffer", "observe", "cameras", "calibrate", "solve", "maps", "total"}
        assert set(row["seconds"]) == stages
        assert row["seconds"]["total"] == pytest.approx(sum(row["seconds"][s] for s in stages - {"total"})) or not (
            stages - {"total"})


def test_chart_names_every_curve_machine_and_date(compared):
    out, _, report = compared
    svg = (out / "compare.svg").read_text()
    ElementTree.fromstring(svg)
    for word in ("refined", "draft", "swarm", "paper", "no solver", report["date"], report["machine"]["processor"]):
        assert word in svg, word
    picture = oiio.ImageBuf(str(out / "compare.png"))
    assert picture.spec().width > 1000 and np.asarray(picture.get_pixels(oiio.FLOAT)).std() > 0.02


def test_without_matplotlib_table_and_json_remain(scenes, irpso, tmp_path):
    """As inside Blender: an import that fails costs the chart alone, and one line says so."""
    (tmp_path / "matplotlib").mkdir()
    (tmp_path / "matplotlib" / "__init__.py").write_text("raise ImportError('none here')\n")
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); from irpso_addon.__main__ import main; "
    arguments = [str(a) for a in command(scenes, tmp_path / "out", *GIVEN, "--passes")]
    done = subprocess.run([sys.executable, "-c", f"{code}sys.exit(main({arguments!r}))"], cwd=Path(__file__).parents[2],
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"compare.json"}
    assert done.stderr.splitlines()[-1].startswith("irpso: no chart: ")
    report = json.loads((tmp_path / "out" / "compare.json").read_text())
    assert list(rows(report)) == METHODS[:4] and all(row["truth"] is None for row in report["rows"])


def test_png_truth_alone_judges(scenes, irpso_here, tmp_path):
    """--hold-out 0: all views are solved from, and 16-bit sRGB truth is decoded."""
    truth = write_truth(tmp_path / "truth", "png")
    done = irpso_here(*command(scenes, tmp_path / "out", "--truth", truth, "--hold-out", 0, *GIVEN, "--passes"))
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "out" / "compare.json").read_text())
    assert report["views"]["held_out"] == [] and rows(report)["refined"]["held_out"] is None
    assert rows(report)["refined"]["truth"]["albedo_rmse"] < 0.01


@pytest.mark.parametrize(("more", "code", "words"), [
    (["--hold-out", 0], 3, "--hold-out 0: leaves nothing to judge by"),
    (["--hold-out", 1], 3, "--hold-out 1: leaves no view to solve from"),
    (["--hold-out", -1], 2, "must be at least 0"),
    (["--passes", 0], 2, "must be at least 1"),
    (["--truth", "nowhere"], 3, "nowhere: has no Ball_basecolor.exr"),
    (["--object", "Nobody"], 3, "Nobody"),
    (["--method", "paper"], 2, "unrecognized arguments"),
])
def test_what_cannot_be(scenes, irpso_here, tmp_path, more, code, words):
    done = irpso_here(*command(scenes, tmp_path / "out", *more))
    assert done.returncode == code and words in done.stderr, done.stderr
    assert code == 2 or len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_what_the_scene_lacks_is_told(scenes, irpso_here, tmp_path):
    """As `irpso solve` does: of half of the faces no method makes a map."""
    done = irpso_here("compare", scenes / "udims" / "scene.blend", "--captures", scenes / "good" / "captures.json",
                      "--out", tmp_path / "out", "--size", 32, *GIVEN, "--passes")
    assert done.returncode == 0, done.stderr
    assert "warning: Ball: 50.0 % of its faces are outside the 0-1 UV square and are not compared" in done.stderr


def test_too_few_views(scenes, irpso_here, tmp_path):
    shutil.copytree(scenes / "good", tmp_path / "few")
    captures = tmp_path / "few" / "captures.json"
    views = json.loads(captures.read_text())["views"][:3]
    captures.write_text(json.dumps({"views": views}))
    done = irpso_here("compare", tmp_path / "few" / "scene.blend", "--captures", captures, "--out", tmp_path / "out")
    assert done.returncode == 3 and "has 3 usable views" in done.stderr
    assert not (tmp_path / "out").exists()


def test_older_results_survive_a_failure(scenes, irpso_here, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "compare.json").write_text("old")
    shutil.copytree(scenes / "good", tmp_path / "broken")
    next((tmp_path / "broken" / "refs").iterdir()).write_bytes(b"no picture")
    done = irpso_here(*command(tmp_path / "broken" / "..", out)[:1], tmp_path / "broken" / "scene.blend", "--captures",
                      tmp_path / "broken" / "captures.json", "--out", out, "--size", 48)
    assert done.returncode == 3, done.stderr
    assert (out / "compare.json").read_text() == "old" and {p.name for p in out.iterdir()} == {"compare.json"}


def test_cancel_leaves_nothing(scenes, tmp_path):
    arguments = [str(a) for a in command(scenes, tmp_path / "out", *GIVEN, "--passes", 1_000_000)]
    with subprocess.Popen([sys.executable, "-m", "irpso_addon", *arguments], stderr=subprocess.PIPE, text=True,
                          stdout=subprocess.DEVNULL, cwd=Path(__file__).parents[2]) as process:
        for line in process.stderr:
            if line.startswith("irpso: paper, 1000000"):
                time.sleep(1.0)
                process.send_signal(signal.SIGINT)
                break
        rest = process.stderr.read()
    assert process.returncode == 130, rest
    assert rest.splitlines()[-1] == "irpso: cancelled; nothing was written"
    assert not (tmp_path / "out").exists()
