"""Start, cancel, undo, reload at random moments: python -m tests.gui.monkey [--runs 50] [--seed 0]

Some runs to a Blender, both back ends in turn.  Ends with status 1 at the first crash, hang, error or lost datum; the
seed that is printed plays it again.
"""

from __future__ import annotations

import argparse
import collections
import time

from . import program, window

RUNS_OF_ONE = 5  # in one Blender


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--size", type=int, default=512, help="texels")
    asked = parser.parse_args()
    blender, scene = program.blender(), program.ball()
    counts: collections.Counter[str] = collections.Counter()
    began, done = time.monotonic(), 0
    for seed in range(asked.seed, asked.seed + -(-asked.runs // RUNS_OF_ONE)):
        gpu = ("opengl", "vulkan")[seed % 2]
        print(f"seed {seed}, {gpu}", flush=True)
        try:
            told = blender.run("monkey:play", window.WORK / "monkey" / str(seed), gpu=gpu, limit=180,
                               scene=str(scene), size=asked.size, seed=seed, runs=RUNS_OF_ONE).told
        except AssertionError as wrong:
            raise SystemExit(f"after {done} runs, seed {seed}: {wrong}") from None
        counts.update(told["counts"])
        done += RUNS_OF_ONE
    print(f"{done} runs in {time.monotonic() - began:.0f} s, nothing wrong: "
          + ", ".join(f"{name} {count}" for name, count in counts.most_common()))


if __name__ == "__main__":
    main()
