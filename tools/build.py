"""Build the extension: dist/irpso-VERSION.zip, with the wheels that blender_manifest.toml names.

    python tools/build.py [--output-dir dist] [--python 3.14]

pip downloads the wheels into wheels/ (not kept in git); Blender's own blender_ext.py, as it lies in the bpy
module, validates and zips.  The same sources and wheels give the same zip name; nothing else is changed.

``--python`` is for a Blender that a distribution built with a Python of its own (Debian): the same zip, with
wheels of that Python instead, as dist/irpso-VERSION-cp314.zip.  It is not for publishing.
"""

from __future__ import annotations

import argparse
import importlib.util
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# pip's --platform is matched against every tag, so the oldest tag of a Linux wheel does for all.
PIP_PLATFORMS = {"win_amd64": ["win_amd64"], "macosx_11_0_arm64": ["macosx_11_0_arm64"]}
LINUX = ["manylinux_2_28_x86_64", "manylinux_2_17_x86_64", "manylinux2014_x86_64"]


def main() -> int:
    """Download, check, build."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output-dir", type=Path, default=ROOT / "dist")
    parser.add_argument("--python", metavar="VERSION", help="wheels of this Python, unless the manifest names them")
    arguments = parser.parse_args()
    out: Path = arguments.output_dir.resolve()
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text())
    source, suffix = ROOT, ""
    tag = f"cp{arguments.python.replace('.', '')}" if arguments.python else ""
    if not any(tag in name for name in manifest["wheels"]):
        source, suffix = copy_for(tag), f"-{tag}"
        manifest = tomllib.loads((source / "blender_manifest.toml").read_text())
    wheels = [source / name for name in manifest["wheels"]]
    for wheel in wheels:
        if not wheel.exists():
            download(wheel)
    for stray in set((source / "wheels").glob("*.whl")) - set(wheels):
        stray.unlink()  # of an earlier version; would be zipped although the manifest does not name it
    out.mkdir(parents=True, exist_ok=True)
    target = out / f"{manifest['id']}-{manifest['version']}{suffix}.zip"
    blender_ext("build", "--source-dir", str(source), "--output-filepath", str(target))
    blender_ext("validate", str(target))
    print(f"{target}: {target.stat().st_size / 1e6:.2f} MB")
    return 0


def copy_for(tag: str) -> Path:
    """The sources in build/TAG, with a manifest that names the same wheels of the Python ``tag`` ("cp314") alone."""
    copy = ROOT / "build" / tag
    for old in copy.glob("*"):
        if old.name != "wheels":  # downloaded already
            shutil.rmtree(old) if old.is_dir() else old.unlink()
    ignored = shutil.ignore_patterns(".*", "__pycache__", "build", "dist", "wheels", "tests", "docs", "tools")
    shutil.copytree(ROOT, copy, ignore=ignored, dirs_exist_ok=True)
    manifest = copy / "blender_manifest.toml"
    lines = [line for line in manifest.read_text().splitlines() if "-cp311-" not in line]
    manifest.write_text("\n".join(lines).replace("cp313", tag) + "\n")
    return copy


def download(wheel: Path) -> None:
    """Fetch one wheel by the parts of its file name: name-version-python-abi-platforms.whl."""
    name, version, python, abi, platforms = wheel.stem.split("-")
    options = [f"--platform={p}" for p in PIP_PLATFORMS.get(platforms, LINUX)]
    subprocess.run([
        sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps",
        "--only-binary=:all:", f"--python-version={python.removeprefix('cp')}", f"--abi={abi}", *options,
        "--dest", str(wheel.parent), f"{name}=={version}",
    ], check=True)
    if not wheel.exists():
        raise SystemExit(f"build: pip found another file than {wheel.name}; correct blender_manifest.toml")


def blender_ext(*arguments: str) -> None:
    """Run Blender's extension tool from the bpy module, without loading Blender."""
    found = importlib.util.find_spec("bpy")
    if found is None or found.origin is None:
        raise SystemExit("build: no bpy module in this Python; run 'make setup'")
    script = next(Path(found.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))
    subprocess.run([sys.executable, str(script), *arguments], check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    sys.exit(main())
