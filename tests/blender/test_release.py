"""`make release`: the same bytes from anywhere, nothing in them that is not pinned, nothing unsaid in the changelog."""

from __future__ import annotations

import ast
import hashlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from tools import build, release

pytestmark = pytest.mark.one_python

ROOT = Path(__file__).resolve().parents[2]
MANIFEST = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
VERSION = MANIFEST["version"]
PLATFORMS = {"linux_x64": "manylinux", "windows_x64": "win_amd64", "macos_arm64": "macosx"}
ZIPS = {f"irpso-{VERSION}.zip", *(f"irpso-{VERSION}-{name}.zip" for name in PLATFORMS)}
NETWORK = {"socket", "socketserver", "ssl", "urllib", "urllib3", "http", "requests", "ftplib", "smtplib", "poplib",
           "imaplib", "telnetlib", "xmlrpc", "webbrowser", "asyncio", "pip", "ensurepip"}
SHIPPED = [path for folder in ("irpso_addon", "operators", "presets") for path in sorted((ROOT / folder).rglob("*.py"))]


def make(root: Path, out: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "tools.release", "--output-dir", str(out)], cwd=root,
                          env={**os.environ, **environment}, capture_output=True, text=True)


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sources in another folder, without git, as other files: of now, and not readable by all."""
    there = tmp_path_factory.mktemp("elsewhere") / "Quelltexte und mehr"
    build.stage(there, "")
    for path in there.rglob("*.py"):
        path.chmod(0o600)
    (there / "irpso_addon" / "__pycache__").mkdir()
    (there / "irpso_addon" / "__pycache__" / "stray.pyc").write_bytes(b"of a run here")
    return there


@pytest.fixture(scope="module")
def made(copy: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("release")
    done = make(copy, out, TZ="Asia/Tokyo", LC_ALL="C")
    assert done.returncode == 0, done.stdout + done.stderr
    return out


def test_the_same_bytes_from_another_folder(made: Path, tmp_path: Path) -> None:
    """There, and here: other paths, times, modes and clock, git's list of files or none, something that lies about."""
    done = make(ROOT, tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert {path.name for path in made.iterdir()} == {
        *ZIPS, "SHA256SUMS", f"irpso-{VERSION}.cdx.json", "repository"}
    for path in (path for path in made.rglob("*") if path.is_file()):
        assert (tmp_path / path.relative_to(made)).read_bytes() == path.read_bytes(), path.name


def test_checksums_are_those_of_the_files(made: Path) -> None:
    rows = dict(reversed(line.split("  ")) for line in (made / "SHA256SUMS").read_text().splitlines())
    assert set(rows) == {path.name for path in made.iterdir() if path.is_file()} - {"SHA256SUMS"}
    for name, digest in rows.items():
        assert hashlib.sha256((made / name).read_bytes()).hexdigest() == digest


def test_the_extension_repository_lists_a_zip_for_each_system(made: Path) -> None:
    """As Blender's own tool reads it: the list, the files beside it, their sizes and hashes."""
    listed = json.loads((made / "repository" / "index.json").read_text(encoding="utf-8"))["data"]
    assert {tuple(entry["platforms"]) for entry in listed} == {(name.replace("_", "-"),) for name in PLATFORMS}
    for entry in listed:
        content = (made / "repository" / entry["archive_url"]).read_bytes()
        assert (entry["id"], entry["version"], entry["archive_size"]) == ("irpso", VERSION, len(content))
        assert entry["archive_hash"] == f"sha256:{hashlib.sha256(content).hexdigest()}"


def test_each_platform_gets_its_wheels_of_both_pythons(made: Path) -> None:
    with zipfile.ZipFile(made / f"irpso-{VERSION}.zip") as archive:
        whole = {entry.filename: entry for entry in archive.infolist()}
    assert {entry.date_time for entry in whole.values()} == {build.EPOCH}
    assert list(whole) == sorted(whole)
    for name, tag in PLATFORMS.items():
        with zipfile.ZipFile(made / f"irpso-{VERSION}-{name}.zip") as archive:
            own = set(archive.namelist())
            about = tomllib.loads(archive.read("blender_manifest.toml").decode())
        wheels = {file for file in own if file.endswith(".whl")}
        assert wheels == {file for file in whole if file.endswith(".whl") and (tag in file or "-any" in file)}
        assert {re.split("[/-]", wheel)[1] + wheel.split("-")[2] for wheel in wheels} == {
            "glcontextcp311", "glcontextcp313", "moderngl" "cp311", "moderngl" "cp313", "rawpycp311", "rawpycp313",
            "threadpoolctlpy3"}
        assert own - wheels == {file for file in whole if not file.endswith(".whl")}
        assert about["build"]["generated"]["platforms"] == [name.replace("_", "-")]


def test_the_bill_of_materials_is_of_what_is_in_the_zip(made: Path) -> None:
    bill = json.loads((made / f"irpso-{VERSION}.cdx.json").read_text())
    whole = made / f"irpso-{VERSION}.zip"
    assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.6")
    own = bill["metadata"]["component"]
    assert (own["name"], own["version"]) == ("irpso", VERSION)
    assert own["hashes"][0]["content"] == hashlib.sha256(whole.read_bytes()).hexdigest()
    assert {(c["name"], c["version"], c["purl"], c["licenses"][0]["license"]["id"]) for c in bill["components"]} == {
        ("moderngl", "5.13.0", "pkg:pypi/moderngl@5.13.0", "MIT"),
        ("glcontext", "3.1.0", "pkg:pypi/glcontext@3.1.0", "MIT"),
        ("rawpy", "0.28.0", "pkg:pypi/rawpy@0.28.0", "MIT"),
        ("threadpoolctl", "3.8.0", "pkg:pypi/threadpoolctl@3.8.0", "BSD-3-Clause")}
    with zipfile.ZipFile(whole) as archive:
        there = {name.split("/")[1]: hashlib.sha256(archive.read(name)).hexdigest()
                 for name in archive.namelist() if name.endswith(".whl")}
    told = {file["name"]: file["hashes"][0]["content"] for c in bill["components"] for file in c["components"]}
    assert told == there
    assert len(told) == 19


def test_the_libraries_in_the_wheels_have_licences(made: Path) -> None:
    """Each library file of each wheel, found here by its first bytes: ELF, Mach-O, PE."""
    bill = json.loads((made / f"irpso-{VERSION}.cdx.json").read_text())
    told = {file["name"]: file["components"] for c in bill["components"] for file in c["components"]}
    raw = {name: {each["name"]: each["licenses"][0]["expression"] for each in libraries}
           for name, libraries in told.items() if name.startswith("rawpy")}
    assert len(raw) == 6 and all(each["LibRaw"] == "LGPL-2.1-only OR CDDL-1.0" for each in raw.values())
    assert all("libjpeg-turbo" in each for each in raw.values())
    with zipfile.ZipFile(made / f"irpso-{VERSION}.zip") as archive:
        for name in (name for name in archive.namelist() if name.endswith(".whl")):
            wheel = zipfile.ZipFile(io.BytesIO(archive.read(name)))
            digests = {hashlib.sha256(wheel.read(path)).hexdigest() for path in wheel.namelist()
                       if wheel.read(path)[:4] in (b"\x7fELF", b"\xcf\xfa\xed\xfe", b"MZ\x90\0", b"MZ\x78\0")
                       and not re.search(r"\.(cpython-|cp3)\d", path)}
            files = {each["hashes"][0]["content"] for each in told[name.split("/")[1]]}
            assert files <= digests and (bool(files) == bool(digests)), name


def test_a_library_without_a_licence_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.whl", "w") as wheel:
        wheel.writestr("a.libs/libsecret-1234.so.2", b"\x7fELF")
    with zipfile.ZipFile(tmp_path / "a.whl") as wheel, pytest.raises(SystemExit, match=r"libsecret-1234\.so\.2, whose"):
        release.libraries("a.whl", wheel)
    with zipfile.ZipFile(tmp_path / "b.whl", "w") as wheel:
        wheel.writestr("b/_b.cpython-313-x86_64-linux-gnu.so", b"\x7fELF")
        wheel.writestr("b/sounds.py", b"")
    with zipfile.ZipFile(tmp_path / "b.whl") as wheel:
        assert release.libraries("b.whl", wheel) == []


def test_a_wheel_of_other_bytes_is_refused(copy: Path, tmp_path: Path) -> None:
    victim = copy / MANIFEST["wheels"][0]
    spoilt = tmp_path / "spoilt"
    shutil.copytree(copy, spoilt)
    with (spoilt / victim.relative_to(copy)).open("ab") as file:
        file.write(b"\0")
    done = make(spoilt, tmp_path / "out")
    assert done.returncode
    assert f"{victim.name} has sha256" in done.stderr
    assert "Traceback" not in done.stderr
    assert not list((tmp_path / "out").glob("*.zip"))


def test_a_tag_that_blender_does_not_know_is_refused(copy: Path, tmp_path: Path) -> None:
    spoilt = tmp_path / "spoilt"
    shutil.copytree(copy, spoilt)
    about = spoilt / "blender_manifest.toml"
    about.write_text(about.read_text().replace('"Bake"', '"Baking"'))
    done = make(spoilt, tmp_path / "out")
    assert done.returncode
    assert "Baking" in done.stderr


def test_every_wheel_is_pinned() -> None:
    assert {Path(name).name for name in MANIFEST["wheels"]} <= set(build.pins())
    assert all(re.fullmatch("[0-9a-f]{64}", digest) for digest in build.pins().values())


def test_the_changelog_begins_with_this_version() -> None:
    date = release.changelog((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), VERSION)
    assert date == "unreleased" or re.fullmatch(r"\d{4}-\d\d-\d\d", date)


@pytest.mark.parametrize(("text", "said"), [
    ("# Changelog\n\n## [0.0.9] - 2026-01-01\n\n- Things.\n", r"\[0\.0\.9\].* says 1\.2\.3"),
    ("# Changelog\n\n## [1.2.3] - 2026-01-01\n\n### Added\n\n## [0.0.9] - 2025-01-01\n\n- Things.\n",
     "says nothing of 1.2.3"),
    ("# Changelog\n\n## [Unreleased]\n\n- Things.\n", "Unreleased"),
    ("# Changelog\n", "begins with"),
])
def test_a_changelog_that_lags_behind_is_refused(text: str, said: str) -> None:
    with pytest.raises(SystemExit, match=said):
        release.changelog(text, "1.2.3")


def test_the_version_stands_in_one_place() -> None:
    """Whoever wants it reads the manifest; the changelog's heading is held to it above."""
    quoted = re.compile(rf"""["']{re.escape(VERSION)}["']""")
    names = build.sources()
    names.remove("blender_manifest.toml")
    for name in names:
        if name.endswith((".py", ".toml", ".md", ".txt", ".yml", ".sh", "Makefile")):
            assert not quoted.search((ROOT / name).read_text(encoding="utf-8")), name


def test_files_are_all_that_is_asked_for() -> None:
    assert set(MANIFEST["permissions"]) == {"files"}


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_nothing_imports_the_network(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names = [node.module or ""]
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant) and (
                ast.unparse(node.func) in ("__import__", "importlib.import_module")):
            names = [str(node.args[0].value)]
        assert not {name.split(".")[0] for name in names} & NETWORK, f"line {node.lineno}"
        if isinstance(node, ast.Attribute):
            assert node.attr not in ("url_open", "url_open_preset"), f"line {node.lineno}"
