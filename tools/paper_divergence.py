"""What equation (2) of the paper does as printed, and what makes it converge: figure and table of docs/paper.md.

    python tools/paper_divergence.py [--passes 4800]

Needs matplotlib (requirements-bench.txt).  Takes about a minute; no Blender.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from irpso_addon.core.params import SolveSettings  # noqa: E402  # the checkout is no installed package
from irpso_addon.core.shading.tables import principled_table  # noqa: E402
from irpso_addon.gpu.device.context import Device  # noqa: E402
from irpso_addon.gpu.observe.observation_atlas import ArraySource, ObservedTexels  # noqa: E402
from irpso_addon.gpu.solve.paper_swarm import Limits, Swarms  # noqa: E402
from studies import pages  # noqa: E402
from studies.bench.measure import machine  # noqa: E402
from tests.support.texel_problem import Estimate, Problem, Spec, make  # noqa: E402

FIGURE = ROOT / "docs" / "images" / "paper_divergence.png"
PAGE = ROOT / "docs" / "paper.md"
SPEC = Spec(views=6, size=64)
ANY = 1e30  # a speed that no float32 particle has
FIRST, BOTTOM = 10, 0.02  # passes and |x| where the figure begins


@dataclass(frozen=True)
class Variant:
    """One way to move particles."""

    label: str
    limits: Limits
    c: float = 2.0  # c1 and c2
    c3: float = 0.05
    style: tuple[str, str] | None = None  # colour and dashes in the figure; None: in the table only


PRINTED = Limits(constriction=1.0, velocity=ANY, bounded=False)
VARIANTS = (
    Variant("as printed, c = 2", PRINTED, 2.0, style=("#D55E00", "-")),
    Variant("as printed, c = 1", PRINTED, 1.0, style=("#E69F00", "-")),
    Variant("as printed, c = 0.5", PRINTED, 0.5, style=("#CC79A7", "-")),
    Variant("box alone, c = 2", Limits(constriction=1.0, velocity=ANY), 2.0, style=("#0072B2", "--")),
    Variant("speed limit and box, c = 2", Limits(constriction=1.0), 2.0),
    Variant("constriction alone, c = 2.05", Limits(velocity=ANY, bounded=False), 2.05),
    Variant("constriction and box, c = 2.05", Limits(velocity=ANY), 2.05),
    Variant("method `paper`: constriction, speed limit, box; c = 2.05", Limits(), 2.05, style=("#009E73", "-")),
    Variant("the same without neighbours, c3 = 0", Limits(), 2.05, 0.0),
)


@dataclass(frozen=True)
class Sample:
    """The swarms of all texels after some passes."""

    passes: int
    position: float  # median of |x| over particles, numbers and texels
    spread: float  # median over numbers and texels of the standard deviation within a swarm
    error: float  # median over texels of the best's relative error: root of the fitness
    roughness: float  # mean absolute error
    failures: float  # share of texels whose roughness is off by more than 0.1


def run(device: Device, source: ArraySource, problem: Problem, variant: Variant, at: list[int]) -> list[Sample]:
    """Samples after so many passes each."""
    settings = SolveSettings(size=SPEC.size, method="paper", c1=variant.c, c2=variant.c, c3=variant.c3)
    swarms = Swarms(device, source, settings, "one-lobe", variant.limits)
    for _ in swarms.gather((0, 0)):
        pass
    samples = []
    for passes in at:
        while swarms.passes < passes:
            swarms.step()
        positions = swarms.positions().astype(np.float64)
        best, more = (device.read(texture) for texture in swarms.best)
        score = problem.score(Estimate(best[..., :3].astype(np.float64), best[..., 3].astype(np.float64)))
        samples.append(Sample(passes, float(np.median(np.abs(positions))), float(np.median(positions.std(axis=0))),
                              float(np.sqrt(np.median(more[..., 2]))), score.roughness, score.failures))
    swarms.release()
    return samples


def draw(results: dict[Variant, list[Sample]], caption: str) -> None:
    """Median |x| and median error against passes."""
    figure, axes = plt.subplots(1, 2, figsize=(9.6, 5.4))
    for variant, samples in results.items():
        if variant.style is None:
            continue
        colour, dashes = variant.style
        passes = [max(s.passes, 1) for s in samples]
        for axis, values in zip(axes, ([s.position for s in samples], [s.error for s in samples]), strict=True):
            axis.plot(passes, values, color=colour, linestyle=dashes, linewidth=2, label=variant.label.replace("`", ""))
    axes[0].axhspan(BOTTOM, 1.0, color="#000000", alpha=0.07, linewidth=0)
    axes[0].text(12, 0.045, "the box of sensible values", fontsize=9, color="#444444")
    axes[0].set_title("Where the particles are: median of |x|", fontsize=11)
    axes[1].set_title("How well the texels' bests fit: median relative error", fontsize=11)
    for axis in axes:
        axis.set(xscale="log", yscale="log", xlabel="passes (each moves one of 16 particles)", xlim=(FIRST, None))
        axis.grid(which="major", color="#dddddd", linewidth=0.6)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylim(bottom=BOTTOM)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=2, frameon=False, fontsize=9.5,
                  bbox_to_anchor=(0.5, 0.07), title="Equation (2), c1 = c2 = c", title_fontsize=9.5)
    figure.text(0.5, 0.015, caption, ha="center", fontsize=7.5, color="#555555", linespacing=1.4)
    figure.tight_layout(rect=(0, 0.26, 1, 1))
    FIGURE.parent.mkdir(exist_ok=True)
    figure.savefig(FIGURE, dpi=100, facecolor="white")
    plt.close(figure)


def table(results: dict[Variant, list[Sample]], caption: str) -> str:
    """The last samples, as the page shows them."""
    last = next(iter(results.values()))[-1].passes
    rows = [f"After {last} passes; {SPEC.title}, {SPEC.size} x {SPEC.size} texels, m = 16, H = 3, c3 = 0.05 but for",
            "the last row. Spread: standard deviation within a swarm. Medians over texels, but for the last two",
            "columns; failures: roughness wrong by more than 0.1.", "",
            "| equation (2), c1 = c2 = c | abs x | spread | relative error | roughness MAE | failures |",
            "|---|---|---|---|---|---|"]
    for variant, samples in results.items():
        s = samples[-1]
        rows.append(f"| {variant.label} | {s.position:.2g} | {s.spread:.2g} | {s.error:.2g} | {s.roughness:.3f} "
                    f"| {s.failures:.3f} |")
    return "\n".join([*rows, "", caption])


def main() -> int:
    """Run all variants, draw the figure, write the table into the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--passes", type=int, default=4800)
    last = parser.parse_args().passes
    at = sorted({0, *np.unique(np.geomspace(1, last, 40).astype(int)).tolist()})
    device, problem = Device(), make(SPEC)
    source = ArraySource(device, ObservedTexels(
        problem.rgb, problem.quality, problem.cos_v, problem.lobes, problem.groups), principled_table())
    results = {}
    for variant in VARIANTS:
        results[variant] = run(device, source, problem, variant, at)
        print(variant.label, results[variant][-1], flush=True)
    facts = machine(device)
    caption = (f"{SPEC.title}, {SPEC.size} x {SPEC.size} texels, m = 16, H = 3, c3 = 0.05; seed 0.\n"
               f"{facts['cpu']}; {facts['gl']}, {facts['gl_version']}; numpy {np.__version__}; {facts['date']}")
    draw(results, caption)
    pages.fill(PAGE, {"divergence": table(results, pages.measured(facts["gl"], f"moderngl {version('moderngl')}"))})
    return 0


if __name__ == "__main__":
    sys.exit(main())
