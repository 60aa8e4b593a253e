"""``python -m studies.joint_search``: makes docs/joint_search.md, which search finds a material's joint values best.

A material's roughness, Specular IOR Level and Metallic are three numbers for all texels of a sample; two parts of a
material have six.  Base colour is in closed form.  The materials are drawn at random.  A second lobe and a diffuse that
is not Lambert's make sure that no search can explain one exactly.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from irpso_addon.core.data import F64
from irpso_addon.core.evaluation.descent import METAL_BASE
from irpso_addon.core.evaluation.joint_material import LEVELS, METALLIC, ROUGHNESS
from irpso_addon.core.evaluation.lobe_values import fresnel_ratio, lobe_values, metal_values
from irpso_addon.core.evaluation.sampled_texels import SampledTexels, metal_gain
from irpso_addon.core.shading import brdf
from studies import pages
from studies.stability.measured import rig

OUT = Path(__file__).resolve().parents[1] / "docs"
TEXELS, MATERIALS = 30, 6
BUDGET = {3: 400, 6: 1200}  # evaluations, by numbers that are searched
CHI, PULL = 0.7298, 2.05  # Clerc and Kennedy 2002
PRODUCT = "nodes, then Levenberg-Marquardt (the product)"
Search = Callable[["Problem", np.random.Generator], None]


@dataclass
class Problem:
    """Texels of one material, and how well numbers between 0 and 1 explain them."""

    texels: SampledTexels
    numbers: int  # 3, or 6 of two parts
    best: list[float] = field(default_factory=list)  # the least cost so far, evaluation by evaluation

    def __post_init__(self) -> None:
        unit = np.maximum(self.texels.reflected, self.texels.typical())
        self.root = np.sqrt(self.texels.quality[..., None] * self.texels.irradiance ** (2 / 3) / unit ** (4 / 3))

    def residuals(self, x: F64) -> F64:
        """(T, V, C) weighted; of two parts each texel's is that of the part that suits it."""
        parts = [self._part(*x[k:k + 3]) for k in range(0, self.numbers, 3)]
        costs = np.stack([(part**2).sum((1, 2)) for part in parts])
        return np.asarray(np.take_along_axis(np.stack(parts), costs.argmin(0)[None, :, None, None], 0)[0])

    def evaluate(self, x: F64) -> tuple[F64, float]:
        """(residuals, their sum of squares); counts."""
        left = self.residuals(np.clip(x, 0, 1))
        value = float((left**2).sum())
        self.best.append(min(value, self.best[-1]) if self.best else value)
        return left, value

    def cost(self, x: F64) -> float:
        """Sum of squares; counts as an evaluation."""
        return self.evaluate(x)[1]

    def _part(self, rough: float, level: float, metallic: float) -> F64:
        at = self.texels
        r = np.full(len(at.cos_v), ROUGHNESS[0] * (ROUGHNESS[-1] / ROUGHNESS[0]) ** rough)
        level = LEVELS[0] + (1 - LEVELS[0]) * level
        energy = brdf.principled_energy_level(r[:, None], at.cos_v, level)
        lobe = (lobe_values(at.lobes, at.cos_v, r) * fresnel_ratio(at.lobes, at.cos_v, np.asarray(level))).sum(-1)
        gain = metal_gain(r, at.cos_v, np.full((len(r), 1), METAL_BASE))[..., 0]
        own, edge = metal_values(at.lobes, at.cos_v, r)
        white = (1 - metallic) * (1 - energy[..., 1]) / np.pi + metallic * own * gain
        rest = (1 - metallic) * lobe * energy[..., 0] + metallic * edge * gain
        a, d = self.root * white[..., None], self.root * (at.reflected - rest[..., None])
        base = np.clip((a * d).sum(1) / np.maximum((a * a).sum(1), 1e-12), 0, 1)
        return np.asarray(d - base[:, None] * a)


def problem(numbers: int, seed: int) -> Problem:
    """A material drawn at random on a sphere under 12 lamps and 2 cameras."""
    rng = np.random.default_rng(seed)
    seen = rig.geometry(rig.views(rig.sphere(16), rig.CAMERAS, rig.lamps(rig.LAMPS)))
    covered = np.flatnonzero((seen.quality > 0).sum(-1).ravel() >= 6)
    chosen = rng.choice(covered, TEXELS, replace=False)
    parts = numbers // 3
    part = rng.integers(parts, size=TEXELS)
    rough, level, metallic = rng.uniform(0.1, 0.9, parts), rng.uniform(0.05, 1, parts), rng.uniform(0, 1, parts)
    metallic *= rng.random(parts) < 0.5
    base, bend = rng.uniform(0.05, 0.8, (TEXELS, 3)), rng.uniform(0, 1)
    f = np.zeros((TEXELS, len(seen.groups), 3))
    for k, view in enumerate(seen.views):
        L, V = (direction.reshape(-1, 3)[chosen] for direction in (view.L, view.V))
        sharp, wide = (brdf.principled(base, np.clip(scale * rough[part], 0.05, 1), L, V, rig.NORMAL, level[part],
                                       metallic[part]) for scale in (1.0, 1.6))
        schlick = np.prod([1 - (1 - np.clip(w[:, 2], 0, 1) / 2) ** 5 for w in (L, V)], 0)[:, None]
        f[:, k] = 0.8 * sharp + 0.2 * wide + 0.3 * bend * base * (28 / 23 * schlick - 1) / np.pi
    quality, cos_v = (a.reshape(-1, len(seen.groups))[chosen].astype(np.float64) for a in (seen.quality, seen.cos_v))
    f = np.where(quality[..., None] > 0, np.maximum(f, 1e-4), 0) * (1 + 0.01 * rng.standard_normal(f.shape))
    lobes = seen.lobes.reshape(-1, len(seen.groups), 1, 4)[chosen].astype(np.float64)
    light = np.repeat(seen.irradiance.reshape(-1, len(seen.groups), 1)[chosen].astype(np.float64), 3, 2)
    return Problem(SampledTexels(f, quality, np.maximum(cos_v, 1e-3), lobes, light, np.array(seen.groups, np.int32),
                                 np.zeros(len(seen.groups), np.int32), np.array(seen.lamps, np.int32)), numbers)


# ---- searches


def descend(task: Problem, x: F64, steps: int) -> tuple[F64, float]:
    """Levenberg-Marquardt, derivatives by differences: each step costs an evaluation for each number and one more."""
    (here, cost), damping = task.evaluate(x), 1e-2
    for _ in range(steps):
        h = np.where(x > 0.5, -1e-4, 1e-4)
        columns = []
        for k in range(task.numbers):
            moved, _ = task.evaluate(x + h * (np.arange(task.numbers) == k))
            columns.append((moved - here).ravel() / h[k])
        J = np.stack(columns, 1)
        A = J.T @ J
        trial = np.clip(x - np.linalg.solve(A + damping * np.diag(np.diag(A) + 1e-12), J.T @ here.ravel()), 0, 1)
        left, there = task.evaluate(trial)
        if there < cost:
            gain = 1 - there / cost
            x, here, cost, damping = trial, left, there, damping / 5
            if gain < 1e-6:
                break
        else:
            damping *= 8
    return x, cost


def levenberg_marquardt(task: Problem, rng: np.random.Generator) -> None:
    """From random starts until the budget is spent."""
    while len(task.best) < BUDGET[task.numbers]:
        descend(task, rng.random(task.numbers), 12)


def _fly(task: Problem, rng: np.random.Generator, particles: int, moves: int) -> tuple[F64, F64]:
    """Equations (2) and (3) with constriction, each particle led by the best of a ring of three."""
    x = rng.random((particles, task.numbers))
    v = 0.2 * (rng.random(x.shape) - 0.5)
    own, fitness = x.copy(), np.array([task.cost(p) for p in x])
    for _ in range(moves):
        for i in range(particles):
            ring = np.array([i, i - 1, (i + 1) % particles])
            leader = ring[fitness[ring].argmin()]
            u1, u2 = rng.random((2, task.numbers))
            v[i] = np.clip(CHI * (v[i] + PULL * u1 * (own[i] - x[i]) + PULL * u2 * (own[leader] - x[i])), -0.3, 0.3)
            moved = x[i] + v[i]
            x[i] = np.clip(moved, 0, 1)
            v[i][x[i] != moved] = 0.0
            cost = task.cost(x[i])
            if cost < fitness[i]:
                own[i], fitness[i] = x[i], cost
    return own, fitness


def swarm(task: Problem, rng: np.random.Generator) -> None:
    """The swarm alone."""
    _fly(task, rng, 16, BUDGET[task.numbers] // 16 - 1)


def refined(task: Problem, rng: np.random.Generator) -> None:
    """A short flight, then Levenberg-Marquardt from the best particles' bests."""
    own, fitness = _fly(task, rng, 16, 6)
    for i in fitness.argsort():
        if len(task.best) < BUDGET[task.numbers]:
            descend(task, own[i], 12)


def cma_es(task: Problem, rng: np.random.Generator) -> None:
    """Hansen 2016, "The CMA Evolution Strategy: A Tutorial", with its settings; restarted when it has converged."""
    n = task.numbers
    size = 4 + int(3 * np.log(n))
    w = np.log(size / 2 + 0.5) - np.log(np.arange(1, size // 2 + 1))
    w /= w.sum()
    mu = 1 / (w**2).sum()
    cs, cc = (mu + 2) / (n + mu + 5), (4 + mu / n) / (n + 4 + 2 * mu / n)
    c1, ds = 2 / ((n + 1.3) ** 2 + mu), 1 + 2 * max(0.0, ((mu - 1) / (n + 1)) ** 0.5 - 1) + cs
    cm = min(1 - c1, 2 * (mu - 2 + 1 / mu) / ((n + 2) ** 2 + mu))
    chi = n**0.5 * (1 - 1 / (4 * n) + 1 / (21 * n * n))
    while len(task.best) < BUDGET[n]:
        mean, sigma, C, ps, pc = rng.random(n), 0.3, np.eye(n), np.zeros(n), np.zeros(n)
        while len(task.best) < BUDGET[n] and sigma * np.sqrt(np.diag(C)).max() > 1e-4:
            values, axes = np.linalg.eigh(C)
            scale = np.sqrt(np.maximum(values, 1e-20))
            y = (rng.standard_normal((size, n)) * scale) @ axes.T
            cost = np.array([task.cost(mean + sigma * step) + 1e3 * ((mean + sigma * step
                             - np.clip(mean + sigma * step, 0, 1)) ** 2).sum() for step in y])
            y = y[cost.argsort()[: len(w)]]
            step = w @ y
            mean = mean + sigma * step
            ps = (1 - cs) * ps + np.sqrt(cs * (2 - cs) * mu) * (axes @ ((axes.T @ step) / scale))
            pc = (1 - cc) * pc + np.sqrt(cc * (2 - cc) * mu) * step
            C = (1 - c1 - cm) * C + c1 * np.outer(pc, pc) + cm * (y.T * w) @ y
            sigma *= float(np.exp(cs / ds * (np.linalg.norm(ps) / chi - 1)))


def nodes(task: Problem, rng: np.random.Generator) -> None:
    """All nodes, each an evaluation here (there they share their sums), then parabolas."""
    task.cost(_between_nodes(task))


def product(task: Problem, rng: np.random.Generator) -> None:
    """The product's: nodes, and a descent from the best."""
    descend(task, _between_nodes(task), 10)


def _between_nodes(task: Problem) -> F64:
    grid = np.stack(np.meshgrid(
        np.linspace(0, 1, len(ROUGHNESS)), (LEVELS - LEVELS[0]) / (1 - LEVELS[0]), METALLIC, indexing="ij"), -1)
    costs = np.array([task.cost(x) for x in grid.reshape(-1, 3)]).reshape(grid.shape[:3])
    at = np.unravel_index(costs.argmin(), costs.shape)
    x = grid[at].copy()
    for axis in range(3):
        line = np.moveaxis(costs, axis, 0)[(slice(None), *np.delete(at, axis))]
        places = np.moveaxis(grid[..., axis], axis, 0)[(slice(None), *np.delete(at, axis))]
        k = at[axis]
        if 0 < k < len(line) - 1:
            bend, slope, _ = np.polyfit(places[k - 1:k + 2] - places[k], line[k - 1:k + 2], 2)
            x[axis] = np.clip(places[k] - slope / (2 * bend), places[k - 1], places[k + 1])
    return x


SEARCHES: dict[str, Search] = {
    "swarm": swarm, "swarm, refined": refined, "Levenberg-Marquardt, restarted": levenberg_marquardt, "CMA-ES": cma_es,
    "nodes and parabolas": nodes, PRODUCT: product,
}


# ---- chart and page


def measure(numbers: int, count: int) -> dict[str, F64]:
    """Search -> (materials, evaluations) cost over the least that any search found."""
    found: dict[str, list[list[float]]] = {}
    for seed in range(count):
        traces = {}
        for name, search in SEARCHES.items():
            if numbers == 3 or name not in ("nodes and parabolas", PRODUCT):
                task = problem(numbers, seed)
                search(task, np.random.default_rng(1000 + seed))
                traces[name] = task.best
        least = min(trace[-1] for trace in traces.values())
        for name, trace in traces.items():
            found.setdefault(name, []).append([cost / least for cost in trace])
    longest = {name: max(map(len, traces)) for name, traces in found.items()}
    return {name: np.array([trace + trace[-1:] * (longest[name] - len(trace)) for trace in traces])
            for name, traces in found.items()}


def draw(results: dict[int, dict[str, F64]], out: Path) -> None:
    """Excess of the cost against evaluations, the median and the worst tenth."""
    figure = Figure(figsize=(11, 4.2))
    FigureCanvasAgg(figure)
    for panel, (numbers, found) in zip(figure.subplots(1, 2), results.items(), strict=True):
        for n, (name, excess) in enumerate(found.items()):
            for quantile, style in ((0.5, "-"), (0.9, ":")):
                line = np.maximum(np.quantile(excess, quantile, axis=0) - 1, 1e-6)
                panel.plot(np.arange(1, len(line) + 1), line, style, color=f"C{n}",
                           label=name if style == "-" else None)
        panel.set(xscale="log", yscale="log", xlabel="evaluations", ylabel="cost above the least found",
                  title=f"{numbers} numbers: {'one material' if numbers == 3 else 'two parts'}", ylim=(1e-6, 30))
        panel.grid(alpha=0.3)
    figure.axes[0].legend(fontsize=8, frameon=False)
    figure.tight_layout()
    figure.savefig(out, dpi=90, facecolor="white")


HEAD = """\
| numbers | search | evaluations | found | evaluations until found (median) | left in the end: median | worst |
|---|---|---|---|---|---|---|"""


def write(results: dict[int, dict[str, F64]], count: int, out: Path) -> None:
    """The figures of the page."""
    rows = []
    for numbers, found in results.items():
        for name, excess in found.items():
            enough = [int(np.argmax(row <= 1.01)) + 1 if (row <= 1.01).any() else 0 for row in excess]
            solved = [e for e in enough if e]
            median = f"{np.median(solved):.0f}" if len(solved) * 2 > len(enough) else "-"
            rows.append(f"| {numbers} | {name} | {excess.shape[1]} | {len(solved)} of {count} | {median} | "
                        f"{np.median(excess[:, -1]) - 1:.1e} | {excess[:, -1].max() - 1:.1e} |")
    pages.fill(pages.DOCS / "joint_search.md", {"made": pages.measured(), "table": "\n".join([HEAD, *rows])}, out)


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m studies.joint_search", description=__doc__)
    parser.add_argument("--materials", type=int, default=MATERIALS)
    parser.add_argument("--out", type=Path, default=OUT, help="folder for joint_search.md and .png")
    options = parser.parse_args()
    results = {numbers: measure(numbers, options.materials) for numbers in BUDGET}
    draw(results, options.out / "joint_search.png")
    write(results, options.materials, options.out / "joint_search.md")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
