"""The pictures of docs/guide.md, made by a person's clicks on the sample scene: docs/images/guide.

    BLENDER=$(bash tools/gui_setup.sh) python -m tests.gui.screenshots
"""

from __future__ import annotations

import sys

from PIL import Image

from . import program, window

PICTURES = window.ROOT / "docs" / "images" / "guide"
LIMIT, SIZE = 400, (1440, 900)  # seconds, pixels
QUALITY = 82
CROPS = {"01_install": (176, 280, 1440, 620)}  # pixels from the upper left: without the path of the installed file


def main() -> int:
    """Play the scenario, keep its screenshots."""
    outcome = program.blender().run("guide:guide", window.WORK / "runs" / "screenshots",
                                    limit=LIMIT, screen_size=SIZE)
    PICTURES.mkdir(parents=True, exist_ok=True)
    for path in sorted(outcome.folder.glob("[0-9][0-9]_*.png")):
        target = PICTURES / f"{path.stem}.jpg"
        picture = Image.open(path)
        picture = picture.crop(CROPS.get(path.stem, (0, 0, *picture.size)))
        picture.save(target, quality=QUALITY, optimize=True, progressive=True)
        print(target)
    return 0


if __name__ == "__main__":
    sys.exit(main())
