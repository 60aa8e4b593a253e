"""Build the extension: dist/irpso-VERSION.zip, with the wheels that blender_manifest.toml names.

    python -m tools.build [--output-dir dist] [--python 3.14]

pip downloads the wheels into wheels/ (not kept in git); each must have the hash that tools/wheels.sha256 pins.
Blender's own blender_ext.py, as it lies in the bpy module, packs and validates, with Blender's list of tags.  Then the
zip is written anew so that the same sources give the same bytes, whatever the folder, the clock and the builder's zlib.

``--python`` is for a Blender that a distribution built with a Python of its own (Debian): the same zip, with
wheels of that Python instead, as dist/irpso-VERSION-cp314.zip.  It is not for publishing.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
WHEELS = ROOT / "wheels"
PINS = Path(__file__).with_name("wheels.sha256")
# pip's --platform is matched against every tag, so the oldest tag of a Linux wheel does for all.
PIP_PLATFORMS = {"win_amd64": ["win_amd64"], "macosx_11_0_arm64": ["macosx_11_0_arm64"]}
LINUX = ["manylinux_2_28_x86_64", "manylinux_2_17_x86_64", "manylinux2014_x86_64"]
SKIPPED = (".*", "__pycache__", "build", "dist", "wheels")  # where git cannot say what belongs to the sources
EPOCH = (1980, 1, 1, 0, 0, 0)  # the first moment that a zip can tell


def main() -> int:
    """One zip for all platforms."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output-dir", type=Path, default=ROOT / "dist")
    parser.add_argument("--python", metavar="VERSION", help="wheels of this Python, unless the manifest names them")
    arguments = parser.parse_args()
    tag = f"cp{arguments.python.replace('.', '')}" if arguments.python else ""
    for path in build(arguments.output_dir.resolve(), "" if any(tag in w for w in manifest()["wheels"]) else tag):
        print(f"{path}: {path.stat().st_size / 1e6:.2f} MB")
    return 0


def manifest(folder: Path = ROOT) -> dict[str, Any]:
    """blender_manifest.toml: the only place of the version."""
    return tomllib.loads((folder / "blender_manifest.toml").read_text(encoding="utf-8"))


def build(out: Path, tag: str = "", split: bool = False) -> list[Path]:
    """Write the zip into ``out``; with ``split`` also one for each platform.

    ``tag`` ("cp314") replaces the Python of the wheels.
    """
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="irpso-build-") as temporary:
        source, made = Path(temporary) / "source", Path(temporary) / "made"
        made.mkdir()
        stage(source, tag)
        about = manifest(source)
        name = f"{about['id']}-{about['version']}{f'-{tag}' if tag else ''}.zip"
        blender_ext("build", "--source-dir", str(source), "--output-filepath", str(made / name))
        if split:
            blender_ext("build", "--source-dir", str(source), "--output-dir", str(made), "--split-platforms")
        zips = []
        for path in sorted(made.glob("*.zip")):
            normalise(path)
            blender_ext("validate", str(path))
            zips.append(out / path.name)
            shutil.move(path, zips[-1])
    return zips


def stage(folder: Path, tag: str) -> None:
    """Copy the sources and the verified wheels into ``folder``; nothing else that lies in the checkout."""
    for name in sources():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, folder / name)
    if tag:
        about = folder / "blender_manifest.toml"
        lines = [line for line in about.read_text(encoding="utf-8").splitlines() if "-cp311-" not in line]
        about.write_text("\n".join(lines).replace("cp313", tag) + "\n", encoding="utf-8")
    (folder / "wheels").mkdir()
    for name in manifest(folder)["wheels"]:
        shutil.copyfile(wheel(Path(name).name), folder / name)


def sources() -> list[str]:
    """The files that belong to the checkout, from its root; as git knows them, where it does."""
    listed = subprocess.run(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], cwd=ROOT,
                            capture_output=True, text=True, encoding="utf-8").stdout if shutil.which("git") else ""
    names = listed.split("\0")
    if "blender_manifest.toml" not in names:  # an unpacked archive of the sources
        names = [path.relative_to(ROOT).as_posix() for path in ROOT.rglob("*")]
        names = [name for name in names if not any(fnmatch(part, no) for part in name.split("/") for no in SKIPPED)]
    return sorted(name for name in names if (ROOT / name).is_file())  # git also lists what is gone but not committed


def pins() -> dict[str, str]:
    """Wheel file name -> sha256."""
    rows = (line.split() for line in PINS.read_text(encoding="utf-8").splitlines())
    return {name: digest for digest, name in rows}


def wheel(name: str) -> Path:
    """The wheel of that name in wheels/, downloaded where it is missing; ends the program if its bytes are others."""
    path = WHEELS / name
    if not path.exists():
        download(path)
    digest = sha256(path)
    if digest != pins().get(name):
        raise SystemExit(f"build: {path} has sha256 {digest}, tools/wheels.sha256 says {pins().get(name)}; "
                         "delete the file, and build again")
    return path


def sha256(path: Path) -> str:
    """Of a file's bytes, in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def download(wheel: Path) -> None:
    """Fetch one wheel by the parts of its file name: name-version-python-abi-platforms.whl."""
    name, version, python, abi, platforms = wheel.stem.split("-")
    options = [] if platforms == "any" else [
        f"--python-version={python.removeprefix('cp')}", f"--abi={abi}",
        *(f"--platform={p}" for p in PIP_PLATFORMS.get(platforms, LINUX))]
    wheel.parent.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".", dir=wheel.parent) as temporary:  # two builds may run at once
        subprocess.run([
            sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps",
            "--only-binary=:all:", *options, "--dest", temporary, f"{name}=={version}",
        ], check=True)
        found = Path(temporary) / wheel.name
        if not found.exists():
            raise SystemExit(f"build: pip found another file than {wheel.name}; correct blender_manifest.toml")
        os.replace(found, wheel)


def normalise(path: Path) -> None:
    """Write a zip anew: names in order, one time, one mode, stored.

    Not deflated, because zlib's output differs from release to release and from maker to maker; the wheels, most of
    the zip, are compressed already.
    """
    with zipfile.ZipFile(path) as old:
        content = {name: old.read(name) for name in sorted(old.namelist()) if not name.endswith("/")}
    with zipfile.ZipFile(path, "w") as new:
        for name, data in content.items():
            entry = zipfile.ZipInfo(name, EPOCH)
            entry.create_system, entry.external_attr = 3, 0o100644 << 16  # Unix: -rw-r--r--
            new.writestr(entry, data)


def blender_ext(command: str, *arguments: str) -> None:
    """Run Blender's extension tool from the bpy module, without loading Blender; ends the program where it fails."""
    found = importlib.util.find_spec("bpy")
    if found is None or found.origin is None:
        raise SystemExit("build: no bpy module in this Python; run 'make setup'")
    scripts = next(Path(found.origin).parent.glob("*/scripts"))
    # Without this list the tool checks no tags.  The public command, `blender --command extension`, reads the same
    # file, but needs Blender's executable, which the bpy module lacks.
    tags = scripts / "modules" / "_bpy_internal" / "extensions" / "tags.py"
    checked = ["--valid-tags", str(tags)] if command in ("build", "validate") else []
    done = subprocess.run(
        [sys.executable, str(scripts / "addons_core" / "bl_pkg" / "cli" / "blender_ext.py"), command,
         *checked, *arguments], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"build: Blender's '{command}' refuses:\n{done.stdout}{done.stderr}")


if __name__ == "__main__":
    sys.exit(main())
