"""A solve of a map too large for memory: the demo's vase from large pictures, solved in blocks, against its truth.

    python tools/large_run.py [--size 8192] [--views 12] [--pixels 2048] [--memory GB] [--docs]

The pictures are rendered by Cycles once, into the folder's `scene`.  The solve runs as a process of its own, whose
resident memory (with all that it starts) is read ten times a second.  Prints a table; --docs keeps it.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from irpso_addon.core.data import F32  # noqa: E402
from irpso_addon.core.evaluation.metrics import psnr  # noqa: E402
from irpso_addon.core.resampling import linear  # noqa: E402
from irpso_addon.core.samples import vase  # noqa: E402  # the checkout is no installed package
from irpso_addon.core.tiled.uv_blocks import BLOCK, ONE_PIECE  # noqa: E402
from studies import pages  # noqa: E402

PAINTED = 4096  # texels of the truth that Cycles renders
SAMPLES = 4  # of a pixel
CAMERAS, LIGHTS = 4, 5  # 12 of their pairs are on the same side of the vase
STRIP = 256  # rows of the maps that are read at a time
OFTEN = 0.1  # seconds between two looks at the memory
NEAR = 8  # texels: borders between blocks are compared with lines so far beside them
PAGE = pages.DOCS / "large.md"
NAMES = {"basecolor": 3, "roughness": 1}


def main() -> int:
    """Make the scene if it is not there, solve it, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=8192)
    parser.add_argument("--views", type=int, default=12, help="at most 12")
    parser.add_argument("--pixels", type=int, default=2048, help="width and height of a picture")
    parser.add_argument("--memory", type=float, default=None, metavar="GB", help="as of 'irpso solve'")
    parser.add_argument("--model", default="one-lobe")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "large")
    parser.add_argument("--docs", action="store_true", help="put the table into docs/large.md")
    parser.add_argument("--make", action="store_true", help=argparse.SUPPRESS)  # in the process that renders
    arguments = parser.parse_args()
    scene: Path = arguments.out / f"scene_{arguments.pixels}"
    if arguments.make:
        _make(scene, arguments.pixels)
        return 0
    if not (scene / "captures.json").exists():
        started = time.perf_counter()
        # Cycles' memory must not be counted as the solve's.
        subprocess.run([sys.executable, __file__, *sys.argv[1:], "--make"], check=True)
        print(f"rendered in {time.perf_counter() - started:.0f} s", flush=True)
    run = solve(scene, arguments)
    rows = [("command", " ".join(run.command)), ("seconds", f"{run.seconds:.0f}"),
            ("peak resident memory of the processes", f"{max(run.memory.values()) / 1e9:.2f} GB"),
            *((f"    in stage '{stage}'", f"{peak / 1e9:.2f} GB") for stage, peak in run.memory.items()),
            *_figures(run.out, arguments.size)]
    for name, value in rows:
        print(f"{name:42} {value}")
    if arguments.docs:
        lines = [f"| {name.strip()} | {value} |" for name, value in rows if name != "command"]
        table = "\n".join([f"`{' '.join(sys.argv)}`: {arguments.views} pictures of {arguments.pixels} x "
                           f"{arguments.pixels} pixels.", pages.measured(), "", "| | |", "|---|---|", *lines])
        pages.fill(PAGE, {"large_run": table})
    return 0


# ---- the scene


def _make(folder: Path, pixels: int) -> None:
    """The vase, painted finely, its pictures, and what a solve may know."""
    from irpso_addon.blender.sample import demo

    strips = [vase.truth(PAINTED, y, y + STRIP) for y in range(0, PAINTED, STRIP)]
    base, rough = (np.concatenate([strip[i] for strip in strips]) for i in range(2))
    del strips
    folder.mkdir(parents=True, exist_ok=True)
    plan = demo.Plan(texels=PAINTED, cameras=CAMERAS, lights=LIGHTS, pixels=pixels, samples=SAMPLES)
    steps = demo.painted(folder, plan, base, rough)
    while True:
        try:
            print(next(steps).message, flush=True)
        except StopIteration as stop:
            references = stop.value
            break
    demo.unpaint()
    demo.save(folder / "scene.blend")
    views = [{"image": it.image, "camera": it.camera.name, "lights": [it.light.name]} for it in references]
    (folder / "captures.json").write_text(json.dumps({"views": views}, indent=1) + "\n", encoding="utf-8")


# ---- the solve


@dataclass
class Run:
    """A solve as a process."""

    command: list[str]
    out: Path
    seconds: float = 0.0
    memory: dict[str, int] = field(default_factory=dict)  # stage as printed -> peak bytes


def solve(scene: Path, arguments: argparse.Namespace) -> Run:
    """Solve in a process of its own, its memory read meanwhile."""
    out: Path = arguments.out / f"maps_{arguments.size}"
    known = json.loads((scene / "captures.json").read_text(encoding="utf-8"))["views"]
    captures = scene / f"captures_{arguments.views}.json"
    kept = sorted(known[:arguments.views], key=lambda view: str(view["image"]))
    captures.write_text(json.dumps({"views": kept}), encoding="utf-8")
    flags = ["--size", str(arguments.size), "--model", arguments.model, "--indirect", "off"]
    flags += ["--memory", str(arguments.memory)] if arguments.memory is not None else []
    command = ["irpso", "solve", str(scene / "scene.blend"), "--captures", str(captures), "--out", str(out), *flags]
    run, started = Run(command, out), time.perf_counter()
    process = subprocess.Popen([sys.executable, "-m", "irpso_addon", *command[1:]], cwd=ROOT, text=True,
                               stderr=subprocess.PIPE)
    stage = ["start"]
    watcher = threading.Thread(target=_watch, args=(process, stage, run.memory), daemon=True)
    watcher.start()
    assert process.stderr is not None
    for line in process.stderr:
        print(f"{time.perf_counter() - started:7.1f} s  {line}", end="", flush=True)
        words = line.split()  # "irpso:  35% solve ..."
        if len(words) > 2 and words[1].endswith("%"):
            stage[0] = words[2]
    if process.wait():
        raise SystemExit(process.returncode)
    watcher.join()
    run.seconds = time.perf_counter() - started
    return run


def _watch(process: subprocess.Popen[str], stage: list[str], memory: dict[str, int]) -> None:
    """The peak of each stage, until the process ends."""
    while process.poll() is None:
        found = sum(map(_resident, _family(process.pid)))
        memory[stage[0]] = max(memory.get(stage[0], 0), found)
        time.sleep(OFTEN)


def _family(pid: int) -> Iterator[int]:
    """A process and all that it started."""
    yield pid
    try:
        for task in os.listdir(f"/proc/{pid}/task"):
            for child in Path(f"/proc/{pid}/task/{task}/children").read_text().split():
                yield from _family(int(child))
    except OSError:  # it has ended
        return


def _resident(pid: int) -> int:
    """Bytes in memory; what it shares with others counts in proportion."""
    try:
        for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                return 1024 * int(line.split()[1])
    except OSError:
        pass
    return 0


# ---- against the truth


def _figures(out: Path, size: int) -> Iterator[tuple[str, str]]:
    """Errors and seams, name and value."""
    squares, borders, count = dict.fromkeys(NAMES, 0.0), {name: _Seams(size) for name in NAMES}, 0
    absolute = 0.0
    previous: dict[str, F32] = {}
    for y in range(0, size, STRIP):
        filled = _strip(out / "Vase_filled.exr", y, size)[..., 0] > 0.5
        coverage = ~filled
        truth = dict(zip(NAMES, _truth(size, y), strict=True))
        for name in NAMES:
            error = _strip(out / f"Vase_{name}.exr", y, size)[..., :NAMES[name]] - truth[name]
            error[~coverage] = np.nan
            squares[name] += float(np.nansum(error.astype(np.float64)**2)) / NAMES[name]
            borders[name].add(y, error, previous.get(name))
            if name == "roughness":
                absolute += float(np.nansum(np.abs(error.astype(np.float64))))
            previous[name] = error[-1:]
        count += int(coverage.sum())
    yield "texels that were solved", f"{count:,} of {size**2:,}"
    yield "base colour, PSNR", f"{psnr(squares['basecolor'] / count):.1f} dB"
    yield "roughness, mean error", f"{absolute / count:.4f}"
    for name, seams in borders.items():
        if size > BLOCK:
            yield f"{name}: step of the error at borders", f"{seams.ratio():.3f} times that {NEAR} texels beside"
    yield "one piece" if size <= ONE_PIECE else "blocks", f"{(-(-size // BLOCK))**2}"


class _Seams:
    """Mean step of the error from one texel to the next, at each border between blocks and beside it."""

    def __init__(self, size: int) -> None:
        inner = np.arange(BLOCK, size, BLOCK)
        self._lines = np.stack([inner, inner - NEAR, inner + NEAR])
        shape = 2, *self._lines.shape  # columns, rows
        self._sums, self._counts = np.zeros(shape), np.zeros(shape)

    def add(self, y: int, error: F32, below: F32 | None) -> None:
        """A strip of (rows, size, channels) from row ``y``; ``below``: the row under it."""
        across = np.abs(np.diff(error, axis=1))
        rows = error if below is None else np.concatenate([below, error])
        first = y + 1 if below is None else y  # of the steps' upper rows
        along = np.abs(np.diff(rows, axis=0))
        for at in np.ndindex(self._lines.shape):
            line = self._lines[at]
            self._take((0, *at), across[:, line - 1])
            if first <= line < first + len(along):
                self._take((1, *at), along[line - first])

    def _take(self, at: tuple[int, ...], steps: F32) -> None:
        self._sums[at] += np.nansum(steps, dtype=np.float64)
        self._counts[at] += np.isfinite(steps).sum()

    def ratio(self) -> float:
        """At a border over beside it, the median of all: the paint has edges of its own along some."""
        mean = self._sums / np.maximum(self._counts, 1)
        return float(np.median(2 * mean[:, 0] / np.maximum(mean[:, 1] + mean[:, 2], 1e-12)))


def _strip(path: Path, y: int, size: int) -> F32:
    """(STRIP, size, channels) of a map's rows from ``y``, row 0 at the bottom."""
    import OpenImageIO

    file = OpenImageIO.ImageInput.open(str(path))
    end = min(y + STRIP, size)
    pixels = file.read_scanlines(size - end, size - y, 0, 0, file.spec().nchannels, OpenImageIO.FLOAT)
    file.close()
    return np.asarray(pixels)[::-1].copy()


def _truth(size: int, y: int) -> tuple[F32, F32]:
    """What was rendered: the painted maps, as Cycles interpolates them, at the texels' middles of a strip."""
    end = min(y + STRIP, size)
    scale = PAINTED / size
    rows = (np.arange(y, end) + 0.5) * scale - 0.5
    low = max(0, int(np.floor(rows[0])) - 1)
    high = min(PAINTED, int(np.ceil(rows[-1])) + 2)
    base, rough = vase.truth(PAINTED, low, high)
    columns = (np.arange(size) + 0.5) * scale - 0.5
    return (linear(linear(base, rows - low, axis=0), columns, axis=1).astype(np.float32),
            linear(linear(rough[..., None], rows - low, axis=0), columns, axis=1).astype(np.float32))


if __name__ == "__main__":
    sys.exit(main())
