"""A newcomer's path by real clicks, with what the panel says after each and the seconds: docs/newcomer.md.

    BLENDER=$(bash tools/gui_setup.sh) python -m tests.gui.newcomer
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from textwrap import wrap
from typing import Any

from PIL import Image

from irpso_addon.core.versions import version

from . import program, window

PAGE = window.ROOT / "docs" / "newcomer.md"
PICTURES = window.ROOT / "docs" / "images" / "newcomer"
SIZE, LIMIT = (1440, 900), 900  # pixels; seconds
VIEWS, PIXELS = 16, 240  # of the shoot
QUALITY = 80
WIDTH = 120  # letters of a line
SHOWN = (  # which step of which part, what of it, and the caption
    ("first", "The tab", (0, 28, 1180, 780), "The tab in a new file: what to do is in the panels"),
    ("own", "Unfold", (880, 80, 1180, 780), "Shoot, unfolded: the first thing that is missing is red"),
    ("own", "*Import Shoot*", (0, 28, 1180, 900), "After the import: the mesh is in sight, the check is next"),
    ("own", "*Show in Viewport*", (0, 28, 1180, 812), "The own shoot is solved: exporting is next"),
)
HEAD = """# A newcomer's path, click by click

**Verdict.** {clicks} steps ({first_seconds:.0f} s) lead from the zip to exported maps of the sample scene, and {own}
steps ({own_seconds:.0f} s) from the files of a shoot to its maps. After each step in the tab *IRPSO*, one message or
one button is highlighted and names the next step.

Made by `python -m tests.gui.newcomer` (IRPSO {version}, Blender {blender}, Python {python}, {machine}, {cores}
cores without a GPU, {date}, on top of commit {commit}). The mouse and the keyboard are simulated: Blender gets
the same events as from a person. Other programs used the two cores at the same time, so the seconds
are upper limits.

The seconds of a step begin with its first click and end when the window shows its result. They contain the
pauses of the simulated hand (0.05 to 0.7 s for a click, 0.01 s for a letter) but no time for reading. *The
panel then shows* is the line in red, or else the highlighted button (in brackets), or else the first note. It
is empty where Blender's own windows are in sight. File names in file browsers are put in without typing.
"""
FIRST = """
## First result

From a Blender that has never had the add-on: install from the zip, open the sample scene, solve, look, export.
"""
OWN = """
## First own shoot

Cycles photographed the demo's vase as for [the flash shoot](flash_shoot.md): {views} pictures of {pixels}
pixels through a lens with distortion, with a flash 60 mm to the right of the lens. The person has a folder with
the pictures, `transforms.json` and `mesh.obj`, and begins with Blender's start file.
"""


def main() -> int:
    """Both parts, then the page."""
    shoot = photographs()
    blender = program.blender()
    empty = window.WORK / "new_user"
    shutil.rmtree(empty, ignore_errors=True)
    empty.mkdir(parents=True)
    zipped = next((window.WORK / "zip").glob("*.zip"))
    runs = window.WORK / "runs"
    first = replace(blender, user=empty).run("newcomer:first", runs / "newcomer_first", limit=LIMIT, screen_size=SIZE,
                                             zipped=str(zipped))
    own = blender.run("newcomer:own", runs / "newcomer_own", limit=LIMIT, screen_size=SIZE, data=str(shoot))
    write({"first": first, "own": own})
    print(PAGE)
    return 0


def write(outcomes: Mapping[str, window.Outcome]) -> None:
    """The page and its pictures."""
    shutil.rmtree(PICTURES, ignore_errors=True)
    PICTURES.mkdir(parents=True)
    for number, (part, begins, crop, _) in enumerate(SHOWN, 1):
        row = next(row for row in outcomes[part].told[part] if row["step"].startswith(begins))
        picture = Image.open(outcomes[part].shot(row["name"])).crop(crop)
        picture.save(PICTURES / f"{number:02}.jpg", quality=QUALITY, optimize=True, progressive=True)
    PAGE.write_text(page(outcomes["first"].told, outcomes["own"].told))


def photographs() -> Path:
    """A shoot's folder, without what an earlier run left in it."""
    folder = window.WORK / "newcomer_shoot"
    if not (folder / "mesh.obj").exists():
        subprocess.run([sys.executable, "-m", "tests.support.photo_shoot", str(folder), "--views", str(VIEWS),
                        "--pixels", str(PIXELS)], cwd=window.ROOT, check=True, stdout=subprocess.DEVNULL)
    shutil.rmtree(folder / "irpso", ignore_errors=True)
    for left in folder.glob("own.blend*"):
        left.unlink()
    return folder


def page(first: Mapping[str, Any], own: Mapping[str, Any]) -> str:
    """docs/newcomer.md."""
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=window.ROOT, capture_output=True, text=True)
    head = HEAD.format(
        clicks=len(first["first"]), own=len(own["own"]), first_seconds=together(first["first"]),
        own_seconds=together(own["own"]), version=version(), blender=first["blender"],
        python=platform.python_version(), machine=platform.machine(), cores=os.cpu_count(),
        date=datetime.now(UTC).date().isoformat(), commit=commit.stdout.strip())
    return "".join([head, FIRST, *table(first["first"]), result(first), *pictures("first"),
                    OWN.format(views=VIEWS, pixels=PIXELS), *table(own["own"]), result(own), *pictures("own")])


def table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """A row for each step; then their sum."""
    lines = ["\n| | step | the panel then shows | seconds |\n|---|---|---|---|\n"]
    lines += [f"| {number} | {row['step']} | {row['says']} | {row['seconds']:.1f} |\n"
              for number, row in enumerate(rows, 1)]
    return [*lines, f"| | together | | {together(rows):.1f} |\n"]


def together(rows: Sequence[Mapping[str, Any]]) -> float:
    """Seconds of all steps."""
    return sum(float(row["seconds"]) for row in rows)


def result(told: Mapping[str, Any]) -> str:
    """What came out."""
    texels, warnings = told["texels"], told["warnings"]
    files = ", ".join(f"`{name}`" for name in told["files"])
    lines = ["", *wrap(f"Solved: {texels['solved']:,} of {texels['covered']:,} texels. Files: {files}."
                       + (" Warnings of the solve:" if warnings else ""), WIDTH), ""]
    for warning in warnings:
        lines += wrap(f"* {warning}", WIDTH, subsequent_indent="  ")
    return "\n".join(lines) + "\n"


def pictures(part: str) -> list[str]:
    """Those of a part."""
    return [f"\n![{caption}](images/newcomer/{number:02}.jpg)\n\n*{caption}.*\n"
            for number, (of, _, _, caption) in enumerate(SHOWN, 1) if of == part]


if __name__ == "__main__":
    sys.exit(main())
