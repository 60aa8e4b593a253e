"""What is shipped: the zip, built, installed into a Blender of its own, and used there, without any network."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from tools import build

ROOT = Path(__file__).resolve().parents[2]
MANIFEST = tomllib.loads((ROOT / "blender_manifest.toml").read_text())

USE_IT = """
import sys, pathlib, traceback
asked = []
def watch(event, arguments):
    if event.startswith(("socket.", "urllib.")) and event != "socket.gethostname":  # of a lock: it asks nobody
        asked.extend((event, place.filename) for place in traceback.extract_stack() if "irpso" in place.filename)
sys.addaudithook(watch)
import bpy
zip_path, capture, out = sys.argv[-3:]
bpy.ops.extensions.package_install_files(filepath=zip_path, repo="user_default", enable_on_install=True)
bpy.ops.wm.open_mainfile(filepath=capture + "/scene.blend")
settings = bpy.context.scene.irpso
settings.captures, settings.size, settings.out = capture + "/captures.json", 64, out
bpy.context.view_layer.objects.active = bpy.data.objects["Ball"]
print("solve", bpy.ops.irpso.solve())
print("export", bpy.ops.irpso.export_maps())
principled = bpy.data.materials["Paint"].node_tree.nodes["Principled BSDF"]
print("linked", [principled.inputs[name].is_linked for name in ("Base Color", "Roughness")])
print("plain", "irpso_addon" in sys.modules)
from bl_ext.user_default.irpso.irpso_addon.__main__ import main
print("command", main(["solve", capture + "/scene.blend", "--captures", capture + "/captures.json", "--size", "32",
                       "--out", out + "/command"]))
site = pathlib.Path(bpy.utils.user_resource("EXTENSIONS")) / ".local" / "lib"
print("wheels", sorted(path.name for path in site.glob("python*/site-packages/*") if path.suffix != ".dist-info"))
bpy.ops.preferences.addon_disable(module="bl_ext.user_default.irpso")
print("network", asked)
print("gone", not hasattr(bpy.types.Scene, "irpso"))
"""


@pytest.fixture(scope="module")
def zips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of one for all platforms and one for each."""
    return build.build(tmp_path_factory.mktemp("dist"), split=True)[0].parent


@pytest.fixture(scope="module")
def built(zips: Path) -> Path:
    return zips / f"irpso-{MANIFEST['version']}.zip"


def test_zip_holds_the_extension_and_nothing_else(built):
    with zipfile.ZipFile(built) as archive:
        names = set(archive.namelist())
    assert {"blender_manifest.toml", "__init__.py", "LICENSE", "README.md", "irpso_addon/__main__.py",
            "irpso_addon/solve/pipeline.py", "irpso_addon/core/shading/principled_ior15.npz",
            "operators/solve.py"} <= names
    assert {n for n in names if n.endswith(".whl")} == {name.removeprefix("./") for name in MANIFEST["wheels"]}
    assert {n.split("/")[0] for n in names} == {
        "blender_manifest.toml", "__init__.py", "LICENSE", "README.md", "CHANGELOG.md", "irpso_addon", "operators",
        "presets", "shaders", "wheels"}
    assert {p.relative_to(ROOT).as_posix() for p in (ROOT / "presets").rglob("*.py")} <= names
    shaders = {p.relative_to(ROOT).as_posix() for p in (ROOT / "shaders").rglob("*.*") if p.suffix != ".md"}
    assert shaders <= names
    assert not [n for n in names if "__pycache__" in n or n.endswith((".pyc", ".blend", ".so"))]
    assert built.stat().st_size < 17e6  # 12 MB of it rawpy's six wheels, of which each system unpacks one


def alone() -> list[str]:
    """What starts a program without any network, children too; nothing where that is not allowed."""
    if not shutil.which("unshare"):
        return []
    command = ["unshare", "--net", *([] if os.getuid() == 0 else ["--map-root-user"])]
    return command if subprocess.run([*command, "true"], capture_output=True).returncode == 0 else []


def test_installed_zip_solves(built, zips, scenes, tmp_path):
    """The zip of this platform on one Python, the one of all platforms on the other: the same files but for wheels."""
    if sys.version_info < (3, 13) and sys.platform.startswith("linux"):
        built = zips / f"{built.stem}-linux_x64.zip"
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(tmp_path / "user")}
    done = subprocess.run(
        [*alone(), sys.executable, "-c", USE_IT, str(built), str(scenes / "good"), str(tmp_path / "maps")],
        cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)
    told = done.stdout + done.stderr
    assert done.returncode == 0, told
    lines = dict(line.split(" ", 1) for line in done.stdout.splitlines() if " " in line)
    assert lines["solve"] == "{'FINISHED'}" and lines["export"] == "{'FINISHED'}", told
    assert lines["linked"] == "[True, True]"
    assert lines["plain"] == "False"  # every import stayed inside bl_ext.user_default.irpso
    assert lines["command"] == "0", told
    assert all(name in lines["wheels"] for name in ("glcontext", "moderngl", "rawpy", "threadpoolctl")), told
    assert lines["network"] == "[]"
    assert lines["gone"] == "True"
    assert (tmp_path / "maps" / "Ball_basecolor.exr").exists()
    assert (tmp_path / "maps" / "command" / "report.json").exists()
    assert "Traceback" not in told
