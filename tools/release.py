"""Make a release: the zips for all platforms and for each, a software bill of materials, and their checksums.

    python -m tools.release [--output-dir dist]

Refuses where CHANGELOG.md's top section is not that of the manifest's version, or is empty.  What still stands against
publishing (no date there, changes that are not committed) is told; docs/release.md says what else a release takes.
"""

from __future__ import annotations

import argparse
import email
import hashlib
import io
import json
import re
import shutil
import subprocess
import sys
import uuid
import zipfile
from email.message import Message
from pathlib import Path
from typing import Any

from tools import build

# Libraries of others in the wheels, by how their files' names begin (on Windows LibRaw's holds some of them).
# Their licences, as SPDX expressions: https://www.libraw.org/about, and the licence files of each.
LIBRARIES = {
    "libraw_r": (("LibRaw", "LGPL-2.1-only OR CDDL-1.0"),),
    "raw_r": (("LibRaw", "LGPL-2.1-only OR CDDL-1.0"), ("libjpeg-turbo", "IJG AND BSD-3-Clause AND Zlib"),
              ("Little CMS", "MIT"), ("zlib", "Zlib")),
    "libjpeg": (("libjpeg-turbo", "IJG AND BSD-3-Clause AND Zlib"),),
    "libjasper": (("JasPer", "JasPer-2.0"),),
    "liblcms2": (("Little CMS", "MIT"),),
    "libgomp": (("libgomp", "GPL-3.0-or-later WITH GCC-exception-3.1"),),
    "vcomp140": (("Microsoft Visual C++ OpenMP Runtime", "LicenseRef-Microsoft-Visual-Cpp-Runtime"),),
}
LIBRARY = re.compile(r"([a-z0-9_]+)[^/]*\.(?:so|dylib|dll)(?:[.0-9]*)")  # a file's name; not Python's own modules
SPACE = uuid.uuid5(uuid.NAMESPACE_URL, "https://cyclonedx.org/")  # of serial numbers, which follow from the zip's bytes


def main() -> int:
    """Zips, bill of materials, checksums."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output-dir", type=Path, default=build.ROOT / "dist")
    out: Path = parser.parse_args().output_dir.resolve()
    version = build.manifest()["version"]
    date = changelog((build.ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), version)
    out.mkdir(parents=True, exist_ok=True)
    for old in (*out.glob("irpso-*.zip"), *out.glob("irpso-*.cdx.json")):  # of another version
        old.unlink()
    files = build.build(out, split=True)
    whole = out / f"irpso-{version}.zip"
    files.append(out / f"irpso-{version}.cdx.json")
    files[-1].write_text(json.dumps(bill(whole), indent=2) + "\n", encoding="utf-8", newline="\n")
    repository(out, [path for path in files if path.suffix == ".zip" and path != whole])
    sums = "".join(f"{build.sha256(path)}  {path.name}\n" for path in sorted(files))
    (out / "SHA256SUMS").write_text(sums, encoding="utf-8", newline="\n")
    print(sums, end="")
    if not re.fullmatch(r"\d{4}-\d\d-\d\d", date):
        print("release: not for publishing: CHANGELOG.md's top section has no date")
    if changed():
        print("release: not for publishing: there are changes that are not committed")
    return 0


def repository(out: Path, zips: list[Path]) -> None:
    """``out``/repository: an extension repository that a web server can offer as it is; Blender's own tool lists it."""
    folder = out / "repository"
    folder.mkdir(exist_ok=True)
    for old in folder.glob("irpso-*.zip"):
        old.unlink()
    for path in zips:
        shutil.copyfile(path, folder / path.name)
    build.blender_ext("server-generate", "--repo-dir", str(folder))


def changelog(text: str, version: str) -> str:
    """What follows the version in the heading of the top section: a date, or "unreleased".

    Ends the program where that section is another version's, or says nothing.
    """
    heading, _, body = text.partition("\n## ")[2].partition("\n")
    found = re.fullmatch(r"\[(.+)\] - (\S+)", heading.strip())
    if not found or found[1] != version:
        raise SystemExit(f"release: CHANGELOG.md begins with '## {heading}', blender_manifest.toml says {version}; "
                         f"begin with '## [{version}] - YYYY-MM-DD'")
    if not re.search(r"^- \S", body.split("\n## ")[0], re.MULTILINE):
        raise SystemExit(f"release: CHANGELOG.md says nothing of {version}; write what users will notice")
    return found[2]


def changed() -> bool:
    """Whether the zip may differ from the commit that is checked out."""
    try:
        done = subprocess.run(["git", "status", "--porcelain"], cwd=build.ROOT, capture_output=True, text=True)
    except OSError:
        return True
    return bool(done.returncode or done.stdout)


def bill(path: Path) -> dict[str, Any]:
    """A CycloneDX 1.6 document of what a zip holds beside our own code: wheels, by package, with the
    libraries of others that they hold.  Same zip, same text.
    """
    about = build.manifest()
    packages: dict[str, dict[str, Any]] = {}
    with zipfile.ZipFile(path) as archive:
        for name in sorted(name for name in archive.namelist() if name.endswith(".whl")):
            content = archive.read(name)
            wheel = zipfile.ZipFile(io.BytesIO(content))
            told = metadata(wheel)
            reference = f"pkg:pypi/{told['Name']}@{told['Version']}"
            package = packages.setdefault(reference, {
                "type": "library", "bom-ref": reference, "name": told["Name"], "version": told["Version"],
                "licenses": [{"license": {"id": told["License-Expression"] or told["License"]}}],
                "purl": reference, "components": []})
            package["components"].append({
                "type": "file", "bom-ref": name, "name": Path(name).name,
                "hashes": [{"alg": "SHA-256", "content": hashlib.sha256(content).hexdigest()}],
                "components": libraries(name, wheel)})
    own = f"{about['id']}@{about['version']}"
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json", "bomFormat": "CycloneDX", "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{uuid.uuid5(SPACE, build.sha256(path))}", "version": 1,
        "metadata": {"component": {
            "type": "application", "bom-ref": own, "name": about["id"], "version": about["version"],
            "description": about["tagline"], "hashes": [{"alg": "SHA-256", "content": build.sha256(path)}],
            "licenses": [{"license": {"id": licence.removeprefix("SPDX:")}} for licence in about["license"]]}},
        "components": list(packages.values()),
        "dependencies": [{"ref": own, "dependsOn": list(packages)}, *({"ref": name} for name in packages)],
    }


def libraries(name: str, wheel: zipfile.ZipFile) -> list[dict[str, Any]]:
    """Those of others in the wheel ``name``, each once.  Ends the program where the licence of one is not known."""
    found: dict[str, dict[str, Any]] = {}
    for path in sorted(wheel.namelist()):
        file = path.rsplit("/", 1)[-1]
        match = LIBRARY.fullmatch(file)
        if not match or ".cpython-" in file:  # Python's modules are the package's own code
            continue
        if match[1] not in LIBRARIES:
            raise SystemExit(f"release: {name} holds {path}, whose licence LIBRARIES in tools/release.py does not say")
        for library, licence in LIBRARIES[match[1]]:
            found.setdefault(library, {
                "type": "library", "bom-ref": f"{name}#{library}", "name": library,
                "licenses": [{"expression": licence}],
                "hashes": [{"alg": "SHA-256", "content": hashlib.sha256(wheel.read(path)).hexdigest()}],
                "properties": [{"name": "irpso:file", "value": path}]})
    return list(found.values())


def metadata(wheel: zipfile.ZipFile) -> Message:
    """The wheel's own METADATA."""
    (name,) = [name for name in wheel.namelist() if name.endswith(".dist-info/METADATA")]
    return email.message_from_bytes(wheel.read(name))


if __name__ == "__main__":
    sys.exit(main())
