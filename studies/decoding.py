"""What decoding in another process costs, and how much memory reading takes.

    python -m studies.decoding [--megapixels 24]           files that OpenImageIO writes: seconds of processor, peaks
    python -m studies.decoding --solve build/demo/scene.blend --captures build/demo/captures.json
                                                         headless solves with these arguments, here and there by turns

Seconds of processor rather than of a clock, because they hardly depend on what else runs: of this process and of
those that decode.  Decoding in this process is decode.py called directly.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
FILES: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("half.exr", "half", {"compression": "zip"}), ("float.exr", "float", {"compression": "zip"}),
    ("tiles.exr", "half", {"compression": "zip", "tile_width": 64, "tile_height": 64}),
    ("dwab.exr", "half", {"compression": "dwab"}), ("16bit.png", "uint16", {}), ("16bit.tif", "uint16", {}),
    ("8bit.jpg", "uint8", {}),
)
MEASURE = """
import os, resource, sys, time
from pathlib import Path
from irpso_addon.core.images import decoder_pool as decoder, oiio_reader as decode, reference_image as image
from irpso_addon.core.tiled import reference_cache as pictures
from tests.support.picture_files import view
way, path = sys.argv[1], Path(sys.argv[2])
if way == "here":
    decoder.header, decoder.bands = decode.header, decode.bands
    decode.header(path)
else:
    decoder.header(path)
shown = view(path, 1.5)
def seconds():
    total = sum(os.times()[:2])
    for process in decoder._pool.idle:
        fields = Path(f"/proc/{process.number}/stat").read_text().rsplit(")", 1)[1].split()
        total += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return total

def peak(number):
    lines = Path(f"/proc/{number}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if "VmHWM" in line) / 1000

before = peak("self")
start, clock = seconds(), time.perf_counter()
if sys.argv[3] == "read":
    found = image.read_reference(shown)
    size = sum(a.nbytes for a in (found.rgb, found.coverage, found.valid)) / 1e6
elif sys.argv[3] == "reduced":
    found = image.read_reference(shown, 1_000_000)
    size = sum(a.nbytes for a in (found.rgb, found.coverage, found.valid)) / 1e6
else:
    pictures.cache_reference(shown, path.with_suffix(".developed"))
    size = 0.0
print(seconds() - start, time.perf_counter() - clock, peak("self") - before - size,
      max((peak(p.number) for p in decoder._pool.idle), default=0))
"""


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--megapixels", type=float, default=24.0)
    parser.add_argument("--pairs", type=int, default=3, help="how often each is measured")
    parser.add_argument("--solve", nargs=argparse.REMAINDER, metavar="ARGUMENTS")
    options = parser.parse_args()
    if options.solve:
        _solves(options.solve, options.pairs)
    else:
        _files(options.megapixels, options.pairs)


def _files(megapixels: float, pairs: int) -> None:
    from tests.support.picture_files import save

    height = int((megapixels * 1e6 / 1.5) ** 0.5) // 2 * 2
    width = height * 3 // 2
    rng = np.random.default_rng(1)
    waves = np.add.outer(np.sin(np.arange(height) / 70), np.cos(np.arange(width) / 50)).astype(np.float32)
    grain = rng.standard_normal((height, width), np.float32)
    pixels = np.repeat((0.4 + 0.1 * waves + 0.01 * grain)[..., None], 3, -1).clip(0, 1)
    print(f"{width} x {height} pixels; memory in MB beside the result and what Python had before\n")
    print("| file | processor s: here | with a decoder | ratio | memory: read | reduced | developed | decoder |")
    print("|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name, form, attributes in FILES:
            top = {"uint8": 255, "uint16": 65535}.get(form, 1)
            path = save(Path(folder) / name, (pixels * top).astype(form if top > 1 else np.float32), form, "RGB",
                        **attributes)
            told = {way: [_one(way, path, "read") for _ in range(pairs)] for way in ("here", "decoder")}
            here, there = (statistics.median(t[0] for t in told[way]) for way in ("here", "decoder"))
            memory = [_one("decoder", path, what)[2:] for what in ("read", "reduced", "developed")]
            print(f"| {name} | {here:.2f} | {there:.2f} | {there / here:.2f} | "
                  + " | ".join(f"{m[0]:.0f}" for m in memory) + f" | {max(m[1] for m in memory):.0f} |", flush=True)
            for made in Path(folder).iterdir():
                made.unlink()


def _one(way: str, path: Path, what: str) -> list[float]:
    told = subprocess.run([sys.executable, "-c", MEASURE, way, str(path), what], cwd=ROOT, check=True,
                          capture_output=True, text=True)
    return [float(word) for word in told.stdout.split()]


SOLVE = """
import sys
from irpso_addon.__main__ import main
if sys.argv.pop(1) == "here":
    from irpso_addon.core.images import decoder_pool as decoder, oiio_reader as decode
    decoder.header, decoder.bands = decode.header, decode.bands
sys.exit(main(sys.argv[1:]))
"""


def _solves(arguments: list[str], pairs: int) -> None:
    seconds: dict[str, list[tuple[float, float]]] = {"here": [], "decoder": []}
    with tempfile.TemporaryDirectory() as folder:
        for pair in range(pairs):
            for way in ("here", "decoder")[::1 if pair % 2 else -1]:
                before, start = os.times(), time.perf_counter()
                subprocess.run([sys.executable, "-c", SOLVE, way, "solve", *arguments, "--out", f"{folder}/{way}"],
                               cwd=ROOT, check=True, capture_output=True)
                after = os.times()
                seconds[way].append((sum(after[2:4]) - sum(before[2:4]), time.perf_counter() - start))
                print(f"{way}: {seconds[way][-1][0]:.1f} s of processor, {seconds[way][-1][1]:.1f} s", flush=True)
    here, there = (statistics.median(s for s, _ in seconds[way]) for way in ("here", "decoder"))
    print(f"with a decoder: {there / here:.3f} of the processor's seconds")


if __name__ == "__main__":
    main()
