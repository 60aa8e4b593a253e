"""A computer without OpenGL, and what a bug report is made of: the command line as a program, without a driver."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from irpso_addon.cli import doctor, options
from irpso_addon.core import log
from irpso_addon.core.errors import DeviceLost
from irpso_addon.process import remote
from irpso_addon.process.messages import Configure, Order
from tests.blender.ball import ROUGH

PRIVATE = "secret project"  # a folder that no log may name


@pytest.fixture
def home(tmp_path):
    """Where Blender keeps this user's configuration."""
    return tmp_path / PRIVATE / "user"


@pytest.fixture
def environment(home):
    """That, and no OpenGL: EGL finds no driver."""
    return {**os.environ, "BLENDER_USER_RESOURCES": str(home), "__EGL_VENDOR_LIBRARY_FILENAMES": os.devnull}


def lines(text: str) -> list[dict]:
    return [json.loads(line) for line in text.splitlines()]


def log_of(home: Path) -> str:
    return (home / "config" / log.FILE).read_text(encoding="utf-8")


def test_doctor_says_what_to_do_without_opengl(irpso, environment, home):
    done = irpso("doctor", env=environment)
    assert done.returncode == 3
    assert re.search(r"^device numpy +works, self-test [\d.]+ s$", done.stdout, re.M)
    assert re.search(rf"^log +\S.*{log.FILE}$", done.stdout, re.M)
    assert len(done.stderr.splitlines()) == 1
    assert [line["event"] for line in lines(log_of(home))] == ["command", "solve", "solved", "refused", "end"]
    for words in ("OpenGL 3.3", "libgl1-mesa-dri", "--device numpy"):
        assert words in done.stderr


def test_doctor_survives_a_driver_that_crashes(monkeypatch, capsys):
    """What was found until then is printed, and the slower path is tried."""
    class Crashing(remote.Worker):
        def order(self, order: Order) -> None:
            super().order(order)
            if isinstance(order, Configure) and order.settings.device == "opengl":
                self._process.kill()

    monkeypatch.setattr(doctor, "Worker", Crashing)
    with pytest.raises(DeviceLost, match="the worker process ended"):
        doctor.run(options.parser().parse_args(["doctor"]))
    said = capsys.readouterr().out
    for row in ("blender", "processors", "log", "OpenGL +not usable, see below", "device numpy +works, self-test"):
        assert re.search(f"^{row}\\b", said, re.M), said
    assert "all is well" not in said


@pytest.mark.parametrize("home", ["/", None])
def test_where_the_log_lies_is_told_without_a_home_too(monkeypatch, home):
    def nowhere() -> Path:
        if home is None:
            raise RuntimeError("Could not determine home directory.")
        return Path(home)

    monkeypatch.setattr(Path, "home", nowhere)
    assert doctor._from_home(Path("/home/max/log.jsonl")) == "/home/max/log.jsonl"


def test_solve_offers_the_slower_path_and_takes_it(irpso, scenes, environment, home, tmp_path):
    scene, out = scenes / "good" / "scene.blend", tmp_path / PRIVATE / "out"
    what = ("solve", scene, "--captures", scenes / "good" / "captures.json", "--out", out, "--size", 32)
    refused = irpso(*what, "--verbose", env=environment)
    assert refused.returncode == 3 and not out.exists()
    loud = [line for line in refused.stderr.splitlines() if line.startswith("{")]
    quiet = [line for line in refused.stderr.splitlines() if not line.startswith("{")]
    assert quiet and "--device numpy" in quiet[-1]
    done = irpso(*what, "--device", "numpy", "--log", tmp_path / "log.jsonl", env=environment)
    assert done.returncode == 0, done.stderr
    assert "{" not in done.stderr  # quiet
    report = json.loads((out / "report.json").read_text())
    assert report["device"]["renderer"].startswith("numpy") and report["models"]["Paint"]["model"] == "one-lobe"
    maps = {role: oiio.ImageBuf(str(out / f"Ball_{role}.exr")).get_pixels(oiio.FLOAT)[..., 0]
            for role in ("roughness", "confidence")}
    assert maps["roughness"].shape == (32, 32)
    assert np.median(abs(maps["roughness"] - ROUGH)[maps["confidence"] > 0.9]) < 0.02
    assert (out / "scene_irpso.blend").exists()

    text = log_of(home)
    told = lines(text)
    assert told[:len(loud)] == lines("\n".join(loud))
    assert told[0]["arguments"][:4] == ["solve", "scene.blend", "--captures", "captures.json"]
    assert told[3]["level"] == "ERROR" and "--device numpy" in told[3]["message"] and "trace" not in told[3]
    assert [line["event"] for line in told if line["level"] != "WARNING"] == [
        "command", "solve", "solve failed", "refused", "end", "command", "solve", "solved", "end"]
    assert lines((tmp_path / "log.jsonl").read_text())[-1]["peak_memory_bytes"] > 1e7
    solved = told[-2]
    assert solved["device"] == report["device"] and solved["texels"] == report["texels"]
    assert solved["seconds"]["solve"] == pytest.approx(report["seconds"]["solve"], abs=1e-6)
    assert {"irpso", "blender", "python", "platform", "numpy"} <= set(told[0])
    assert told[-3]["settings"]["size"] == 32 and told[-3]["views"] == 10
    for private in (PRIVATE, str(Path.home()), str(scenes), os.sep + "irpso_addon"):
        assert private not in text
    assert "/" not in re.sub(r"numpy\S*|glibc\S*|Mesa/X.org", "", text), "a path"
