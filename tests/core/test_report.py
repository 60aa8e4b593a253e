"""report.json: whole, readable by any JSON parser, and nothing left behind where it cannot be written."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.check_records import Checks, LightResidual, MaterialCheck, Misfit, Residual, Slope, ViewCheck
from irpso_addon.core.checks.warnings import grouped
from irpso_addon.core.data import Coat, Maps, Solution
from irpso_addon.core.errors import BadInput
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.reporting.report import build_report, peak_memory, write_report
from irpso_addon.core.versions import version

ROOT = Path(__file__).resolve().parents[2]
NOTHING = np.zeros((1, 1), np.float32)
SOLUTION = Solution(
    maps=Maps(np.zeros((1, 1, 3), np.float32), NOTHING, NOTHING, NOTHING, NOTHING > 0, NOTHING > 0, NOTHING, NOTHING),
    model={"Glaze": "one-lobe", "": "lambert"}, why={"Glaze": "chosen"},
    texels={"covered": 90, "observed": 80, "solved": 60, "filled": 30}, seconds={"observe": 1.0, "solve": 2.0},
    residual=0.02, views_used=("a.exr",), views_skipped=(("b.exr", "sees nothing"),), warnings=("Töpfe: wärm",),
    device={"renderer": "none"})


def test_figures_follow_from_the_solution():
    report = build_report(SOLUTION, SolveSettings(size=64, seed=7), ["irpso", "solve"], blender="5.2")
    assert report["seconds"] == {"observe": 1.0, "solve": 2.0, "total": 3.0}
    assert report["texels_per_second"] == {"solve": 30.0, "total": 20.0}
    assert report["models"] == {
        "Glaze": {"model": "one-lobe", "why": "chosen"}, "": {"model": "lambert", "why": ""}}
    assert report["views"] == {"used": ["a.exr"], "skipped": [{"view": "b.exr", "why": "sees nothing"}]}
    assert (report["size"], report["seed"], report["method"], report["model"]) == (64, 7, "refined", "auto")
    assert report["versions"]["blender"] == "5.2" and report["cancelled"] is False


def test_each_model_says_what_only_it_has():
    model = {"Cup": "one-lobe-specular", "Jug": "one-lobe-specular", "Skin": "two-lobe", "Chalk": "lambert",
             "Tin": "one-lobe-metallic", "Toy": "one-lobe-metallic"}
    solution = replace(SOLUTION, model=model, why={}, levels={"Cup": np.float32(0.25)}, ndf="beckmann",
                       metallic={"Tin": np.float32(0.75), "Toy": 1.0}, coats={"Tin": Coat(0.5, 0.25)},
                       paint={"Toy": 0.25}, diffuse_roughness={"Cup": 0.75})
    models = build_report(solution, SolveSettings(), [])["models"]
    assert models == {
        "Cup": {"model": "one-lobe-specular", "why": "", "level": 0.25, "diffuse_roughness": 0.75},
        "Jug": {"model": "one-lobe-specular", "why": "", "level": None},  # a map
        "Skin": {"model": "two-lobe", "why": "", "ndf": "beckmann"}, "Chalk": {"model": "lambert", "why": ""},
        "Tin": {"model": "one-lobe-metallic", "why": "", "metallic": 0.75, "level": 0.5,
                "coat": {"weight": 0.5, "roughness": 0.25}},
        "Toy": {"model": "one-lobe-metallic", "why": "", "metallic": 1.0, "level": 0.5, "paint": 0.25}}
    json.dumps(models, allow_nan=False)


def test_not_a_number_becomes_null(tmp_path):
    """JSON has no NaN: a parser other than Python's would refuse the file."""
    device = {"limit": np.float32(np.inf), "size": np.int64(3)}
    odd = replace(SOLUTION, residual=float("nan"), device=device, seconds={})
    write_report(tmp_path / "r.json", build_report(odd, SolveSettings(), []))
    def refuse(name):
        raise AssertionError(name)
    report = json.loads((tmp_path / "r.json").read_text(encoding="utf-8"), parse_constant=refuse)
    assert report["residual"] is None and report["device"] == {"limit": None, "size": 3}
    assert report["texels_per_second"] == {"solve": None, "total": None}
    assert report["warnings"] == ["Töpfe: wärm"]


def test_checks_of_a_view_stand_together(tmp_path):
    """Whatever was found of a view, of it and of its camera, in one record that is JSON."""
    slope = Slope(0.99, 0.001)
    figures = Residual(900, 1.05, 0.002, 0.02, 0.01, 0.003, None, 0)
    view = ViewCheck("a.exr", "Cam", ("Key",), 0.02, figures, slope)
    misfit = Misfit(Path("refs/a.exr"), "Cam", (64, 48), (0.5, -0.25), 0.01, 1.05, 0.002, False)
    light = LightResidual("Key", 1, 1.05, float("inf"), (0.1, 0.0, 0.0), 0.03, 0.02, 0.9)
    checks = Checks(
        name="Cup", views=(view,), lights=(light,), materials=(MaterialCheck("Glaze", "one-lobe", 5.0, 3.0, 0.0),),
        noise=0.01, structure=0.003, highlight=0.0, slope=slope, unlit_share=float("nan"), clipped=0.02,
        no_highlight=0.1, nearest=1.0, doubtful=0.01, sure=True, pixels_per_texel=0.5, registration=(misfit,))
    write_report(tmp_path / "r.json", build_report(replace(SOLUTION, checks=checks), SolveSettings(), []))
    found = json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))["checks"]
    record, = found["views"]
    assert record["view"] == "a.exr" and record["shift"] == [0.5, -0.25] and record["exponent"] == 0.99
    assert record["gain"] == record["exposure"] == 1.05 and record["clipped"] == 0.02
    assert found["unlit_share"] is None and found["lights"][0]["gain_error"] is None
    assert found["materials"][0]["material"] == "Glaze" and found["exponent"] == 0.99


def test_warnings_that_differ_in_the_name_alone_are_one():
    lines = [f"{n}.png: has 8 bits" for n in "abcd"] + ["Cup: has no UVs"]
    assert grouped(lines) == ("a.png, b.png, c.png and 1 more: has 8 bits", "Cup: has no UVs")


def test_unwritable_report_leaves_nothing(tmp_path):
    (tmp_path / "r.json").mkdir()
    for path in (tmp_path / "r.json", tmp_path / "no" / "r.json"):
        with pytest.raises(BadInput, match=r"r\.json: cannot be written"):
            write_report(path, {})
    assert [p.name for p in tmp_path.iterdir()] == ["r.json"]


def test_version_is_the_manifests():
    assert version() == tomllib.loads((ROOT / "blender_manifest.toml").read_text())["version"]


def test_peak_memory_grows_with_use():
    before = peak_memory()
    if before is None:
        pytest.skip("this system does not tell")
    block = np.ones(40_000_000, np.uint8)  # 40 MB on top of whatever was the peak: at least it is counted in bytes
    assert block.size < peak_memory() < 1 << 40
