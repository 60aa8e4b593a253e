"""How long the window stands still while it solves: python -m tests.gui.stalls [--size 1024] [--shading SOLID]

A table: an idle window, a window that is shown a new picture eight times a second (what showing costs on this machine,
whoever does it), and a solve.  Then the sample scene from nothing to maps.  Run it when the machine does nothing else.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from . import program, window


def table(told: Mapping[str, Any]) -> str:
    """What `inside/stalls.py` measured, for a person."""
    lines = [f"{'':22}{'longest block':>15}{'95 of 100':>12}"]
    for name, title in (("idle", "idle"), ("redraw", "redrawing 8/s"), ("solve", "solving")):
        lines.append(f"{title:22}{told[name]['longest']:12.0f} ms{told[name]['p95']:9.0f} ms")
    lines.append(f"{'of that the add-on':22}{told['modal']['longest']:12.0f} ms{told['modal']['p95']:9.0f} ms")
    lines.append(f"the click on Solve takes {told['invoke']:.0f} ms of the add-on's")
    lines.append(f"first picture after {told['first']:.2f} s; {told['updates']} updates in {told['seconds']:.1f} s, "
                 f"{told['rate']:.1f}/s; longest time between two {told['longest_between']:.2f} s")
    return "\n".join(lines)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=1024, help="texels")
    parser.add_argument("--shading", default="SOLID", choices=["SOLID", "MATERIAL", "RENDERED"])
    parser.add_argument("--gpu", default="opengl", choices=["opengl", "vulkan"])
    asked = parser.parse_args()
    blender = program.blender()
    done = blender.run("stalls:measure", window.WORK / "stalls", gpu=asked.gpu, limit=180, scene=str(program.ball()),
                       size=asked.size, shading=asked.shading, clicks=False)
    print(f"{asked.size} x {asked.size}, {asked.shading.title()}, {asked.gpu}")
    print(table(done.told))
    told = blender.run("sample:timed", window.WORK / "sample", gpu=asked.gpu, screen_size=(1600, 900),
                       clicks=False).told
    print(f"sample scene: made and opened in {told['opening']:.1f} s, solved and on the material after "
          f"{told['solving']:.1f} s more")


if __name__ == "__main__":
    main()
