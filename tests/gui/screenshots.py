"""The pictures of docs/guide.md, made by a person's clicks on the sample scene: docs/images/guide.

made.json beside them keeps what they show (tests/support/pictured.py), with date, commit and Blender's version.

    BLENDER=$(bash tools/gui_setup.sh) python -m tests.gui.screenshots
"""

from __future__ import annotations

import json
import subprocess
import sys
from datetime import UTC, datetime

from PIL import Image

from tests.support import pictured

from . import program, window

PICTURES = window.ROOT / "docs" / "images" / "guide"
LIMIT, SIZE = 900, (1440, 900)  # seconds, pixels
QUALITY = 82
LEFT, RIGHT, SIDE, TOP, BOTTOM = 0, 1440, 504, 28, 876  # of the window; its sidebar's left edge; its areas' heights
MIDDLE = 793  # between the viewport with its sidebar and the Image Editor
CROPS = {  # to what each picture shows: left, top, right, bottom, pixels from the window's upper left
    "01_install": (176, 280, RIGHT, 648),  # without the path of the installed file
    "02_scene": (LEFT, TOP, MIDDLE, 690),
    "03_views": (LEFT, TOP, MIDDLE, 790),
    "04_missing": (LEFT, TOP, MIDDLE, 836),
    "05_settings": (SIDE, 82, MIDDLE, 500),
    "06_live": (LEFT, TOP, RIGHT, 900),
    "07_wipe": (MIDDLE, TOP, RIGHT, BOTTOM),
    "08_confidence": (SIDE, TOP, RIGHT, BOTTOM),
    "09_results": (MIDDLE, TOP, RIGHT, 680),
    "10_export": (LEFT, TOP, MIDDLE, 836),
}


def main() -> int:
    """Play the scenario, keep its screenshots."""
    shows = pictured.shown()  # before the run: it takes minutes, in which the code may be edited
    outcome = program.blender().run("guide:guide", window.WORK / "runs" / "screenshots",
                                    limit=LIMIT, screen_size=SIZE)
    PICTURES.mkdir(parents=True, exist_ok=True)
    for old in PICTURES.glob("*.jpg"):
        old.unlink()
    for path in sorted(outcome.folder.glob("[0-9][0-9]_*.png")):
        target = PICTURES / f"{path.stem}.jpg"
        picture = Image.open(path)
        picture = picture.crop(CROPS.get(path.stem, (0, 0, *picture.size)))
        picture.save(target, quality=QUALITY, optimize=True, progressive=True)
        print(target)
    pictured.MADE.write_text(json.dumps({
        "date": datetime.now(UTC).date().isoformat(), "commit": _commit(), "blender": outcome.told["blender"],
        "seconds": outcome.told["seconds"], "pictures": sorted(path.name for path in PICTURES.glob("*.jpg")),
        "shows": shows}, indent=1, ensure_ascii=False) + "\n")
    return 0


def _commit() -> str:
    """The one that the pictures were made on top of; "" outside a checkout."""
    done = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=window.ROOT, capture_output=True, text=True)
    return done.stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
