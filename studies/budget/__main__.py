"""``python -m studies.budget``: makes docs/budget.md, where the seconds of a command go.

Each case is solved by the command line in a process of its own: with an empty cache of compiled shaders, again with
that cache, and once without being measured.  Needs Blender as a module and matplotlib; scenes are kept in build/budget.
--cases or --scene: these alone, printed, and no page.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from irpso_addon.blender.files import blender_version
from irpso_addon.blender.oiio import ensure_openimageio

from . import page
from .needs import needs, rates
from .scenes import CASES, Case, of_folder

ROOT = Path(__file__).resolve().parents[2]
CACHES = ("MESA_SHADER_CACHE_DIR", "__GL_SHADER_DISK_CACHE_PATH")


def main() -> int:
    """Command line."""
    names = [case.name for case in CASES]
    parser = argparse.ArgumentParser(prog="python -m studies.budget", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", choices=names, metavar="NAME", help=f"of {', '.join(names)}")
    parser.add_argument("--scene", type=Path, help="a folder with scene.blend and, if need be, captures.json")
    parser.add_argument("--size", type=int, default=1024, help="texels across the maps of --scene")
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "budget", help="where scenes are kept")
    options = parser.parse_args()
    ensure_openimageio()
    cases = [of_folder(options.scene.resolve(), options.size)] if options.scene else [
        case for case in CASES if case.name in (options.cases or names)]
    found = [measured(case, options.folder / case.name) for case in cases]
    renderer, rate = rates()
    found = [replace(case, needs=needs(case.again.record, rate)) for case in found]
    if options.cases or options.scene:
        print("\n\n".join([page.runs(found), page.table(found), page.traffic(found), page.needed(found, rate)]))
    else:
        page.write(found, renderer, [f"Blender {blender_version()}"], rate)
        print(f"{page.PAGE.relative_to(ROOT)} written")
    return 0


def measured(case: Case, folder: Path) -> page.Measured:
    """All runs of a case, whose scene is made if it is not there."""
    done = folder / "made"
    if not done.exists():
        folder.mkdir(parents=True, exist_ok=True)
        case.make(folder)
        done.touch()
    with tempfile.TemporaryDirectory() as place:
        found = []
        for kind in ("first", "again", "plain"):
            case.reset(folder)
            out = Path(place, kind)
            out.mkdir()
            found.append(run(case.command(folder, out), Path(place), is_measured=kind != "plain"))
            print(f"{case.name}, {kind}: {found[-1].wall:.1f} s, {found[-1].cpu:.1f} CPU s", flush=True)
        return page.Measured(case.name, case.words, *found)


def run(command: Sequence[str], place: Path, *, is_measured: bool) -> page.Run:
    """A command in a process of its own; ``place``: keeps compiled shaders from run to run.

    Raises CalledProcessError.
    """
    record, cache = place / "record.json", place / "shaders"
    cache.mkdir(exist_ok=True)
    environment = {**os.environ, **dict.fromkeys(CACHES, str(cache))}
    started, before = time.time(), os.times()
    module = ["studies.budget.command", str(record), repr(started)] if is_measured else ["irpso_addon"]
    subprocess.run([sys.executable, "-m", *module, *command], cwd=ROOT, env=environment, check=True,
                   stdout=subprocess.DEVNULL)
    wall, after = time.time() - started, os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return page.Run(wall, cpu, json.loads(record.read_text(encoding="utf-8")) if is_measured else {})


if __name__ == "__main__":
    raise SystemExit(main())
