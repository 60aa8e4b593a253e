"""Time and error of every method on the demo's scene at several sizes: docs/benchmark.md.

    python tools/benchmark.py [--sizes 256 512 1024]

The references are rendered once into build/bench.  Each solve runs in this one process, after a small one that
compiles the shaders, so the figures are those of the stages alone.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from irpso_addon.blender import demo  # noqa: E402  # the checkout is no installed package
from irpso_addon.cli.demo import make, score  # noqa: E402
from irpso_addon.cli.solve import Request, solve  # noqa: E402
from irpso_addon.core import report, vase  # noqa: E402
from irpso_addon.core.params import SolveSettings  # noqa: E402

METHODS = [key for key, _ in SolveSettings.__dataclass_fields__["method"].metadata["choices"]]
HEAD = """\
# Benchmark

Made by `make bench`. The demo's vase ({views} views of {pixels} pixels, Cycles), one-lobe model. Machine: {machine};
OpenGL: {renderer}. Errors are those of the solved texels against the truth.
`solve` is that stage alone, `total` all of the command.

| method | size | solve (s) | total (s) | texels/s of solve | base colour (dB) | roughness mean | median |
|---|---|---|---|---|---|---|---|
"""


def main() -> int:
    """Render, solve, write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[256, 512, 1024])
    sizes = parser.parse_args().sizes
    out = ROOT / "build" / "bench"
    out.mkdir(parents=True, exist_ok=True)
    made = make(out)
    rows = []
    for method in METHODS:
        run(made, out, method, 64)
        for size in sizes:
            solution, scores = run(made, out, method, size)
            solving, total = solution.seconds["solve"], sum(solution.seconds.values())
            speed = solution.texels["solved"] / solving
            rows.append(f"| {method} | {size} | {solving:.1f} | {total:.1f} | {speed:,.0f} | {scores.albedo_psnr:.1f} "
                        f"| {scores.rough_mae:.4f} | {scores.rough_median:.4f} |\n")
    head = HEAD.format(views=len(solution.views_used), pixels=demo.PIXELS, renderer=solution.device["renderer"],
                       machine=f"{os.cpu_count()} CPU cores, {platform.system()} {platform.machine()}")
    page = head + "".join(rows) + f"\nPeak memory: {report.peak_memory() or 0:,} bytes.\n"
    (ROOT / "docs" / "benchmark.md").write_text(page, encoding="utf-8")
    print(page)
    return 0


def run(made: demo.Demo, out: Path, method: str, size: int):  # type: ignore[no-untyped-def]
    """One solve and its scores against the truth at that size."""
    settings = SolveSettings(size=size, method=method, model="one-lobe")
    solution = solve(Request(made.scene, out / f"{method}_{size}", settings, made.captures))
    return solution, score(vase.truth(size), solution.maps)


if __name__ == "__main__":
    sys.exit(main())
