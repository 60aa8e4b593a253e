"""The benchmark itself: its problems against the twin, each rival on a problem it must solve, chart and page."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.shading import brdf
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.observe.observation_atlas import ATLAS_ROWS
from studies.bench import gpu_report, special
from studies.bench.entrants import ENTRANTS, Stage, set_up
from studies.bench.verdict import judge
from tests.support.texel_problem import CAMERAS, Estimate, Problem, Spec, make

TINY = Spec("one-lobe", 12, 8)


@pytest.fixture(scope="module")
def device() -> Iterator[Device]:
    made = Device()
    yield made
    made.release()


@pytest.fixture(scope="module")
def stage(device: Device) -> Iterator[Stage]:
    made = set_up(device, TINY, {})
    yield made
    for worker in made.workers.values():
        worker.close()
    made.bench.release()


def observed_from_arrays(p: Problem) -> np.ndarray:
    """f of R, G, B from the arrays that a solver gets, and the true maps."""
    sin2h, _, cos_l, factor = np.moveaxis(p.lobes[..., 0, :].astype(np.float64), -1, 0)
    cos_v = p.cos_v.astype(np.float64)
    lobes = [(p.truth.roughness, 1.0)]
    if p.truth.roughness2 is not None and p.truth.weight is not None:
        lobes = [(p.truth.roughness, p.truth.weight[..., None]), (p.truth.roughness2, 1 - p.truth.weight[..., None])]
    value = np.zeros(p.rgb.shape)
    for r, share in lobes:
        r = r[..., None]
        comp, dim = np.moveaxis(brdf.principled_energy(r, cos_v), -1, 0)
        roots = np.sqrt(1 + r**4 * (1 / cos_l**2 - 1)) + np.sqrt(1 + r**4 * (1 / cos_v**2 - 1))
        s = comp * brdf.D_ggx(r**4, sin2h) * factor / roots
        value += np.asarray(share * 1.0)[..., None] * (
            p.truth.base[:, :, None] * ((1 - dim) / np.pi)[..., None] + s[..., None])
    return value


@pytest.mark.parametrize("spec", [TINY, Spec("two-lobe", 6, 8, cameras=3), Spec("one-lobe", 6, 8, plane=True)])
def test_arrays_hold_what_the_model_makes_of_the_truth(spec: Spec) -> None:
    p = make(spec)
    seen = p.quality > 0
    np.testing.assert_allclose(p.rgb[seen], observed_from_arrays(p)[seen], rtol=2e-4)
    assert seen.mean() > 0.9 and not p.rgb[~seen].any()


def test_observation_is_the_brdf_of_the_scene() -> None:
    p = make(replace(TINY, views=3, cameras=3))
    at = (np.arange(8) + 0.5) / 8 * 2 - 1
    place = np.array([at[5], at[2], np.sqrt(4 - at[5] ** 2 - at[2] ** 2) - 2])
    # The normal is not given out; three observations of known directions leave but one with the right cosines.
    light, view = p.lamps - place, CAMERAS - place
    light, view = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (light, view))
    normal = np.linalg.lstsq(np.concatenate([light, view]),
                             np.concatenate([p.lobes[2, 5, :, 0, 2], p.cos_v[2, 5]]), rcond=None)[0]
    assert np.linalg.norm(normal) == pytest.approx(1, abs=1e-5)
    for k in range(3):
        value = brdf.principled(p.truth.base[2, 5], p.truth.roughness[2, 5], light[k], view[k], normal)
        np.testing.assert_allclose(p.rgb[2, 5, k], value, rtol=1e-3)


def test_noise_and_outliers_are_as_told_and_leave_the_truth() -> None:
    spec = Spec("one-lobe", 6, 48)
    clean, noisy = make(spec), make(replace(spec, noise=0.02))
    seen = clean.quality > 0
    ratio = noisy.rgb[seen] / clean.rgb[seen] - 1
    assert ratio.std() == pytest.approx(0.02, rel=0.03) and abs(np.corrcoef(ratio[:, 0], ratio[:, 1])[0, 1]) < 0.05
    np.testing.assert_array_equal(clean.truth.roughness, noisy.truth.roughness)
    spoilt = make(replace(spec, outliers=0.1))
    assert (spoilt.rgb[seen] != clean.rgb[seen]).all(-1).mean() == pytest.approx(0.1, abs=0.02)


def test_score_sorts_lobes_and_takes_the_worse() -> None:
    p = make(Spec("two-lobe", 6, 8))
    t = p.truth
    assert t.roughness2 is not None
    swapped = Estimate(t.base + 0.01, t.roughness2, t.roughness, t.weight)
    assert p.score(swapped).roughness == 0 and p.score(swapped).albedo == pytest.approx(0.01)
    off = Estimate(t.base, t.roughness, t.roughness2 + 0.2, t.weight)
    assert p.score(off).roughness == pytest.approx(0.2) and p.score(off).failures == 1


# What each must reach on 64 clean texels: half of them right where one start is all it has, nearly all else.
GOALS = {"refined": 0.0, "swarm": 0.02, "single": 0.5, "adam": 0.5, "golden": 0.05, "torch-lm": 0.0, "torch-lm-c": 0.0,
         "torch-adam": 0.9, "torch-adam-c": 0.9, "scipy": 0.1, "paper": 0.6, "none": 1.0}


@pytest.mark.parametrize("entrant", [e for e in ENTRANTS if e.key in GOALS], ids=lambda e: e.key)
def test_entrant_solves_a_clean_problem(entrant: Any, stage: Stage) -> None:
    if entrant.missing:
        pytest.skip(f"{entrant.needs} is not installed")
    if entrant.key in ("torch-lm-c", "torch-adam-c"):
        pytest.skip("compiling takes longer than all else here")
    points = list(entrant.run(stage, False))
    assert points[-1].errors.failures <= GOALS[entrant.key]
    assert points[-1].errors.albedo < 0.05
    if len(points) > 1:
        assert points[-1].errors.albedo <= points[0].errors.albedo + 1e-3
    assert all(p.seconds > 0 for p in points)


def test_two_lobes_are_told_apart(device: Device) -> None:
    made = set_up(device, Spec("two-lobe", 24, 8), {})
    found = made.bench.solve(made.bench.knobs("refined"))[1]
    made.bench.release()
    assert np.median(made.problem.roughness_error(found)) < 1e-3


def test_ranks_correlate_and_borders_are_found() -> None:
    x = np.random.default_rng(0).random(500)
    assert special.rank_correlation(x, x**3) == pytest.approx(1)
    assert special.rank_correlation(x, -x) == pytest.approx(-1)
    edge = np.zeros((9, 9))
    edge[:, 5:] = 1
    assert special.near_border(edge).all(0).tolist() == [False] * 3 + [True] * 4 + [False] * 2


def test_chart_and_page(tmp_path: Any) -> None:
    chart = pytest.importorskip("studies.bench.chart", reason="matplotlib is not installed", exc_type=ImportError)
    from studies.bench.page import write

    point = {"setting": "refined", "seconds": 0.01, "runs": 3, "default": True, "albedo": 1e-4, "roughness": 1e-5,
             "failures": 0.0}
    slow = {**point, "setting": "1600 passes", "seconds": 5.0, "roughness": 0.1}
    spec = Spec()
    curves = [{"problem": vars(spec), "title": spec.title, "method": m, "label": m, "family": "irpso", "compile": 0.5,
               "points": [p]} for m, p in (("refined", point), ("paper", slow))]
    machine = dict.fromkeys(("cpu", "gl", "gl_version", "compute", "system", "packages", "commit", "date"), "x")
    record = json.loads(json.dumps({"size": 128, "machine": machine, "curves": curves, "tables": {}}))
    earlier = {"machine": {**machine, "commit": "abc1234"}, "curves": record["curves"]}
    png, svg = chart.draw(record["curves"], machine, tmp_path / "front", earlier)
    assert png.stat().st_size > 10_000 and "</svg>" in svg.read_text() and "IRPSO at abc1234" in svg.read_text()
    row, = judge(record)
    assert row.met and row.reached.startswith("500 times")
    record["curves"][1]["points"][0]["seconds"] = 2.0
    assert not judge(record)[0].met
    assert "**below**" in write(record, tmp_path).read_text()


def test_gpu_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """In small: every section has its figures, no folder is named, and a section that fails leaves the others."""
    monkeypatch.setattr(gpu_report, "doctor", lambda: {"code": 0, "says": []})  # a process of its own; tested by itself
    monkeypatch.setattr(gpu_report, "SWITCHES", ("", "ROBUST"))
    sizes = gpu_report.Sizes(problem=16, counts=(12,), pixels=48, whole=32, large=64, block=32, halo=16,
                             views=40, small=24, model="one-lobe")
    assert gpu_report.main(tmp_path / "report.json", sizes) == 0
    text = (tmp_path / "report.json").read_text(encoding="utf-8")
    found = json.loads(text)
    assert not [name for name, section in found.items() if isinstance(section, dict) and "error" in section]
    assert found["device"]["renderer"] and found["device"]["limits"]["GL_MAX_TEXTURE_SIZE"] >= 1024
    for path in ("fragment", "compute"):
        if path == "fragment" or found["device"]["opengl"] >= 430:
            assert not found["kernels"][path]["refused"] and found["kernels"][path]["compiled"] > 10
    assert {(row["path"], row["lobes"]) for row in found["rates"]["search"] if row.get("rate", 0) > 0} >= {
        ("fragment", 1), ("fragment", 2)}
    assert found["solve"]["seconds"] > 0 and found["solve"]["budget of the first"]["GPU: search"] > 0
    assert sum(found["solve"]["budget of the first"].values()) == pytest.approx(found["solve"]["first"], rel=1e-2)
    assert found["large solve"]["texels"] == 64 and "merge" in found["large solve"]["stages"]
    assert found["many views"]["K"] == 40 and found["many views"]["seconds"] > 0
    assert str(tmp_path) not in text and str(Path.home()) not in text
    line, written = capsys.readouterr().out.splitlines()
    assert found["device"]["renderer"] in line and "M evaluations/s" in line and "64 x 64 of 12 views in" in line
    assert "report.json" in written

    def fails(_: object) -> Any:
        raise RuntimeError(f"{tmp_path}/driver.so gave up")

    monkeypatch.setattr(gpu_report, "rates", fails)
    monkeypatch.setattr(gpu_report, "kernels", lambda: fails(None))
    for name in ("solve", "solve_large", "solve_many"):
        monkeypatch.setattr(gpu_report, name, lambda _: {"texels": 1, "K": 1, "seconds": 1.0})
    assert gpu_report.main(tmp_path / "again.json", sizes) == 0
    found = json.loads((tmp_path / "again.json").read_text(encoding="utf-8"))
    assert found["rates"] == {"error": "RuntimeError: driver.so gave up"} and found["solve"]["texels"] == 1
    assert "rates failed" in capsys.readouterr().out


def test_one_tile_holds_the_search_that_is_timed() -> None:
    """Three blocks of the atlas for each view."""
    for sizes in (gpu_report.GPU, gpu_report.SOFTWARE):
        assert sizes.problem * 3 * max(sizes.counts) <= ATLAS_ROWS


def test_gpu_report_without_opengl(tmp_path: Path) -> None:
    """One line, and the command line's code for bad input."""
    out = tmp_path / "report.json"
    done = subprocess.run(
        [sys.executable, "-m", "studies.bench", "--gpu-report", str(out)], capture_output=True, text=True, timeout=120,
        cwd=gpu_report.pages.ROOT, env={**os.environ, "__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent"})
    assert done.returncode == 3 and not out.exists()
    line, = done.stderr.splitlines()
    assert line.startswith("no report: OpenGL 3.3: no context can be made")
