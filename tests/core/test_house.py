"""What stands in two places of the repository says the same."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.data import Maps, Solution
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.reporting.report import build_report

pytestmark = pytest.mark.one_python

ROOT = Path(__file__).resolve().parents[2]
PAGES = [*ROOT.glob("docs/**/*.md"), *ROOT.glob("shaders/**/*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
# Paths start at the root or, for the library's rooms, at irpso_addon/ (docs/architecture.md).
TOPS = ("docs", "irpso_addon", "operators", "presets", "shaders", "studies", "tests", "tools")
ROOMS = ("blender", "cli", "compare", "core", "gpu", "process", "solve")
SOURCES = (".py", ".glsl", ".frag", ".vert", ".kernel")
MANIFEST = tomllib.loads((ROOT / "blender_manifest.toml").read_text())


def test_parameters_page_is_fresh():
    done = subprocess.run([sys.executable, "tools/make_docs.py", "--check"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_wheels_are_those_we_test_with():
    pins = dict(re.findall(r"^(\w+)==([\d.]+)$", (ROOT / "requirements-dev.txt").read_text(), re.M))
    wheels = [Path(name).stem.split("-") for name in MANIFEST["wheels"]]
    assert {(name, version) for name, version, *_ in wheels} == {
        (name, pins[name]) for name in ("moderngl", "glcontext", "rawpy", "threadpoolctl")}
    systems = {(python, re.split(r"\d*_", platform)[0]) for _, _, python, _, platform in wheels}
    assert systems == {(p, s) for p in ("cp311", "cp313") for s in ("manylinux", "win", "macosx")} | {("py3", "any")}
    assert len(wheels) == 19


def test_everything_is_pinned():
    lines = [line for name in ("dev", "docs") for line in (ROOT / f"requirements-{name}.txt").read_text().splitlines()]
    for line in lines:
        assert re.fullmatch(r"(#.*)?|[\w.-]+==[\w.]+(; python_version == \"3\.1[13]\")?", line), line


def test_changelog_knows_the_version():
    first = re.search(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert first and first[1] in (MANIFEST["version"], "Unreleased")


def test_report_page_names_every_key():
    page = (ROOT / "docs" / "report.md").read_text()
    blank = np.zeros((2, 2), np.float32)
    maps = Maps(np.zeros((2, 2, 3), np.float32), blank, blank, blank, blank > 0, blank > 0, blank, blank)
    solution = Solution(maps, {}, {}, {}, {}, 0.0, (), (), (), {})
    settings = {field.name for field in fields(SolveSettings)}
    keys = build_report(solution, SolveSettings(), []).keys() - settings
    assert {"versions", "seconds", "texels", "checks", "warnings"} <= keys
    assert [key for key in keys if f"`{key}`" not in page] == []


def test_the_site_builds(tmp_path):
    """mkdocs.yml is strict: each page stands in the navigation; each link, anchor and picture is there."""
    done = subprocess.run([sys.executable, "-m", "mkdocs", "build", "--site-dir", str(tmp_path)], cwd=ROOT,
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "guide.html").exists()


def test_no_link_beside_the_docs_is_broken():
    for page in ROOT.glob("*.md"):
        for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_every_path_in_the_docs_exists():
    for page in PAGES:
        for quoted in re.findall(r"`([^`\n]+)`", page.read_text()):
            for path in re.findall(r"(?<![\w./-])[\w*-][\w./*-]*", quoted):
                assert _is_there(path.rstrip(".")), f"{page.relative_to(ROOT)}: {path}"


def _is_there(path: str) -> bool:
    """Also where it is no path of ours, but a command, an identifier or a file of the user's."""
    top, *rest = path.split("/")
    if rest and top in (*TOPS, *ROOMS):
        return any(any(base.glob(path)) for base in (ROOT, ROOT / "irpso_addon"))
    if path.endswith(SOURCES) and path != "blender_ext.py":  # Blender's
        return not rest and any(any((ROOT / folder).rglob(path)) for folder in TOPS)
    return True


def test_every_module_that_the_docs_run_exists():
    for page in PAGES:
        for module in re.findall(r"-m ((?:irpso_addon|studies|tests|tools)[\w.]*)", page.read_text()):
            path = ROOT / module.rstrip(".").replace(".", "/")
            assert path.with_suffix(".py").exists() or (path / "__main__.py").exists(), f"{page.name}: {module}"
