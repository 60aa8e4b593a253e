"""The scenes that are measured: formulas, rendered by Cycles once, and the commands that solve them."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from irpso_addon.core.data import F64
from studies.intervals.assets import Asset, sheet, waves

MAP, BLOCK = 4096, 27  # texels of the large map, and the number of its tile of one block: in the vase's middle
LAMPS = 22  # of the dome; each of three cameras sees each, and the last views are left out


@dataclass(frozen=True)
class Case:
    """One command on one scene."""

    name: str
    words: str  # what it is, for the page
    make: Callable[[Path], None]  # into a folder
    command: Callable[[Path, Path], Sequence[str]]  # (the scene's folder, an empty one for its files) -> arguments
    reset: Callable[[Path], None] = lambda folder: None  # before each run


def solve(folder: Path, out: Path, size: int) -> Sequence[str]:
    """Of a scene with its list of views."""
    captures = folder / "captures.json"
    return ["solve", str(folder / "scene.blend"), *(["--captures", str(captures)] if captures.exists() else []),
            "--out", str(out), "--size", str(size)]


def of_folder(folder: Path, size: int) -> Case:
    """Somebody's own scene: scene.blend and, where views are not in it, captures.json."""
    return Case(folder.name, f"a scene of one's own, {size} x {size} texels", lambda _: None,
                lambda _, out: solve(folder, out, size))


def _demo(folder: Path) -> None:
    _rendered(folder, texels=512)


def _asset(folder: Path) -> None:
    _rendered(folder, texels=1024, cameras=6, lights=12, pixels=512)
    keep_views(folder, 36)


def _rendered(folder: Path, **plan: int) -> None:
    from irpso_addon.blender.sample import demo
    from irpso_addon.cli.demo import make

    make(folder, demo.Plan(**plan))


def dome(u: F64, v: F64) -> F64:
    """Half an ellipsoid towards +Z; a square's grid on a disc."""
    x, y = 2 * u - 1, 2 * v - 1
    across, along = x * np.sqrt(1 - y * y / 2), y * np.sqrt(1 - x * x / 2)
    return np.stack([across, along, 0.7 * np.sqrt(np.maximum(1 - across**2 - along**2, 0))], -1)


def dome_paint(u: F64, v: F64) -> tuple[F64, F64]:
    """Clouds of two paints, and a roughness of 0.2 to 0.6."""
    share = np.clip(0.5 + 0.4 * waves(u, v, 51, 6), 0, 1)[..., None]
    base = share * np.array([0.5, 0.2, 0.08]) + (1 - share) * np.array([0.1, 0.3, 0.5])
    return base, np.clip(0.38 + 0.1 * waves(u, v, 52, 5), 0.2, 0.6)


def _dome(folder: Path) -> None:
    from studies.intervals import capture

    paint = Asset("dome", "", (sheet(dome, (96, 96), (0.01, 0.99, 0.01, 0.99)),), dome_paint, pixels=288)
    capture.make(paint, folder, LAMPS)
    keep_views(folder, 64)


def keep_views(folder: Path, count: int) -> None:
    """Only so many, evenly chosen, stay in the list of views."""
    path = folder / "captures.json"
    views = json.loads(path.read_text(encoding="utf-8"))["views"]
    if len(views) < count:
        raise ValueError(f"{path}: has {len(views)} views, {count} are wanted")
    chosen = [views[i] for i in np.linspace(0, len(views) - 1, count).round().astype(int)]
    path.write_text(json.dumps({"views": chosen}, indent=1), encoding="utf-8")


def _block(folder: Path) -> None:
    _asset(folder)
    subprocess.run([sys.executable, "-m", "irpso_addon", "job", str(folder / "scene.blend"), "--captures",
                    str(folder / "captures.json"), "--out", str(folder / "job"), "--size", str(MAP), "--any-worker"],
                   check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _without_blocks(folder: Path) -> None:
    blocks = folder / "job" / "work" / "blocks"
    shutil.rmtree(blocks, ignore_errors=True)
    blocks.mkdir()


CASES = (
    Case("demo", "`irpso solve` of the demo's vase: 32 views of 288 x 288 pixels, 512 x 512 texels", _demo,
         lambda folder, out: solve(folder, out, 512)),
    Case("asset", "the same of the vase from six cameras: 36 views of 512 x 512 pixels, 1024 x 1024 texels", _asset,
         lambda folder, out: solve(folder, out, 1024)),
    Case("dome", "the same of half an ellipsoid, which shades no part of itself: 64 views of 288 x 288 pixels from "
         "three cameras, 512 x 512 texels, 1 % noise", _dome, lambda folder, out: solve(folder, out, 512)),
    Case("block", f"`irpso tile`: one block of {MAP} x {MAP} texels of the second scene, 576 x 576 texels with its "
         "halo; without Blender", _block,
         lambda folder, out: ["tile", str(folder / "job" / "work"), "--udim", "1001", "--tile", str(BLOCK),
                              "--tile-size", "512"], _without_blocks),
)
