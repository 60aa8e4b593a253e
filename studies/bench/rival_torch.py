"""Rivals in PyTorch, all texels in one batch: Levenberg-Marquardt with variable projection, and Adam.

Runs on the CPU, on CUDA where there is one.  Everything that depends on geometry alone is made before the clock
starts.  Both see the model that made the data (core/shading/brdf.py).  ``compiled``: through torch.compile.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from irpso_addon.core.shading import brdf
from irpso_addon.core.shading.tables import SIZE
from tests.support.texel_problem import Estimate, Problem

LEAST, MOST = 0.05, 1.0  # roughness
STARTS = (0.14, 0.26, 0.42, 0.65, 0.20, 0.34, 0.52, 0.80)  # spread over the truth's range: known to nobody else
PAIRS = ((0.14, 0.30), (0.20, 0.50), (0.28, 0.42), (0.32, 0.65), (0.14, 0.60), (0.24, 0.36), (0.40, 0.70), (0.18, 0.40))
RATE = 0.05  # of Adam.  Tried: .01, .02, .03, .05, .1, each with plain and with relative squared errors; with .05 and
# plain errors the albedo is within .01 after 290 steps on the patch and 260 on the plane, on both among the soonest.
Point = tuple[int, float, Estimate]  # steps, seconds, what was found


def device() -> torch.device:
    """CUDA where there is one."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def machine() -> str:
    """What it runs on, for the table."""
    where = torch.cuda.get_device_name() if torch.cuda.is_available() else f"{torch.get_num_threads()} CPU threads"
    return f"PyTorch {torch.__version__}, {where}"


def relative_weights(f: np.ndarray, quality: np.ndarray) -> np.ndarray:
    """1 / max(f, typical)^2, typical being the texel's own: noise grows with the signal.  (K, N) from (K, N)."""
    typical = np.zeros(f.shape[1:])
    for _ in range(4):
        weight = quality / np.maximum(np.maximum(f, typical), 1e-4)
        typical = (weight * f).sum(0) / np.maximum(weight.sum(0), 1e-12)
    return np.asarray(quality / np.maximum(np.maximum(f, typical), 1e-4) ** 2)


class Data:
    """A problem as tensors, (K, N) each: everything that does not change while searching."""

    def __init__(self, problem: Problem) -> None:
        h, w, views, _ = problem.rgb.shape
        self.shape = h, w

        def tensor(a: np.ndarray) -> Tensor:
            return torch.tensor(np.ascontiguousarray(a), dtype=torch.float32, device=device())

        def flat(a: np.ndarray) -> np.ndarray:
            return np.moveaxis(a.astype(np.float64).reshape(h * w, views, *a.shape[3:]), 1, 0)

        rgb, quality, cos_v, lobe = (flat(a) for a in (problem.rgb, problem.quality, problem.cos_v,
                                                       problem.lobes[:, :, :, 0]))
        self.rgb, self.f = tensor(rgb), tensor(rgb.mean(-1))
        self.w, self.seen = tensor(relative_weights(rgb.mean(-1), quality)), tensor(quality)
        self.sin2h, self.factor = tensor(lobe[..., 0]), tensor(lobe[..., 3])
        self.tan2l = tensor(1 / lobe[..., 2] ** 2 - 1)
        # What depends on the view alone is worked out once a camera.
        self.cameras = [problem.groups.index(g) for g in sorted(set(problem.groups))]
        self.group = torch.tensor(problem.groups, device=device())
        seen = np.stack([cos_v[k] for k in self.cameras])
        self.tan2v = tensor(1 / seen**2 - 1)
        at = np.clip(seen, 0, 1) * (SIZE - 1)
        column = np.minimum(at.astype(np.int64), SIZE - 2)
        self.column, self.along = torch.tensor(column, device=device()), tensor(at - column)
        nodes = np.linspace(0, 1, SIZE)
        table = brdf.principled_energy(nodes[:, None], nodes[None])
        # A cell's corners lie together: (comp, A) at low row, high row, and their differences along the cosine.
        cells = [table[:-1, :-1], table[1:, :-1], table[:-1, 1:] - table[:-1, :-1], table[1:, 1:] - table[1:, :-1]]
        self.cells = tensor(np.stack(cells, 2).reshape(-1, 8))

    def each(self, a: Tensor) -> Tensor:
        """A value per camera, (cameras, N), as one per view; one camera's is left to broadcasting."""
        return a if len(self.cameras) == 1 else a[self.group]

    def energy(self, r: Tensor) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
        """(comp, A) and their slopes by roughness, (cameras, N) each."""
        at = r * (SIZE - 1)
        row = at.detach().long().clamp(max=SIZE - 2)
        cell = torch.index_select(self.cells, 0, (row * (SIZE - 1) + self.column).reshape(-1)).T
        low_comp, low_a, high_comp, high_a = cell[:4] + self.along.reshape(-1) * cell[4:]
        part = (at - row).expand(self.along.shape)
        steps = [(high - low).reshape(self.along.shape) for low, high in ((low_comp, high_comp), (low_a, high_a))]
        values = [low.reshape(part.shape) + part * step for low, step in zip((low_comp, low_a), steps, strict=True)]
        return (values[0], values[1]), (steps[0] * (SIZE - 1), steps[1] * (SIZE - 1))

    def lobe(self, r: Tensor) -> tuple[Tensor, Tensor]:
        """Diffuse a and specular s of f = base a + s at roughness (N,)."""
        a2 = r**4
        value, _ = self.energy(r)
        q = self.sin2h * (1 - a2) + a2
        roots = torch.sqrt(1 + a2 * self.tan2l) + self.each(torch.sqrt(1 + a2 * self.tan2v))
        s = self.factor * self.each(value[0]) * (a2 / np.pi) / (q * q * roots)
        return self.each((1 - value[1]) / np.pi), s

    def lobe_slope(self, r: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """(a, s, da/dr, ds/dr)."""
        a2 = r**4
        value, slope = self.energy(r)
        q = self.sin2h * (1 - a2) + a2
        root_l, root_v = torch.sqrt(1 + a2 * self.tan2l), torch.sqrt(1 + a2 * self.tan2v)
        inverse = 1 / (root_l + self.each(root_v))
        s = self.factor * self.each(value[0] * (a2 / np.pi)) * inverse / (q * q)
        masking = 0.5 * (self.tan2l / root_l + self.each(self.tan2v / root_v)) * inverse
        by_a2 = 1 / a2 - 2 * (1 - self.sin2h) / q - masking
        ds = s * (by_a2 * (4 * r**3) + self.each(slope[0] / value[0]))
        return self.each((1 - value[1]) / np.pi), s, self.each(-slope[1] / np.pi), ds

    def base(self, a: Tensor, s: Tensor) -> Tensor:
        """The base colour that fits best, (N, 3)."""
        wa = self.w * a
        sums = (wa[..., None] * (self.rgb - s[..., None])).sum(0)
        return (sums / (wa * a).sum(0).clamp(min=1e-12)[:, None]).clamp(0, 1)

    def estimate(self, base: Tensor, *rest: Tensor) -> Estimate:
        """As maps."""
        maps = [t.detach().cpu().numpy().astype(np.float64).reshape(*self.shape, *t.shape[1:]) for t in (base, *rest)]
        return Estimate(*maps)


def wait() -> None:
    """Until the GPU is done."""
    if torch.cuda.is_available():
        torch.cuda.synchronize()


def lm(data: Data, model: str, budgets: Iterable[int], compiled: bool = False) -> Iterator[Point]:
    """Eight starts, each so many steps; a fresh run for every budget."""
    step, starts = (_step_two, PAIRS) if model == "two-lobe" else (_step_one, STARTS)
    for steps in budgets:
        wait()
        start = time.perf_counter()
        with torch.no_grad():
            found = _race(data, _compile(step) if compiled else step, starts, steps)
            shape = found[1:4] if model == "two-lobe" else found[1:2]
            base = data.base(*(_mix(data, *shape) if model == "two-lobe" else data.lobe(*shape)))
        wait()
        yield steps, time.perf_counter() - start, data.estimate(base, *shape)


@cache
def _compile(function: Callable[..., Any]) -> Callable[..., Any]:
    return torch.compile(function, dynamic=False)


def _race(data: Data, step: Callable[..., Any], starts: Sequence[Any], steps: int) -> tuple[Tensor, ...]:
    """The best of all starts: its state after so many steps."""
    best: tuple[Tensor, ...] = ()
    for begin in starts:
        state = _begin(data, begin)
        for _ in range(steps + 1):  # the first only evaluates
            state = step(data, *state)
        if best:
            better = state[0] < best[0]
            state = tuple(torch.where(better, new, old) for new, old in zip(state, best, strict=True))
        best = state
    return best


def _begin(data: Data, begin: float | tuple[float, float]) -> tuple[Tensor, ...]:
    """The state of a start not yet evaluated: endlessly bad, and its step is none."""
    n = data.f.shape[1]

    def full(value: float) -> Tensor:
        return torch.full((n,), value, device=device())

    if isinstance(begin, float):  # residual, r, gradient, curvature, damping
        return full(1e30), full(begin), full(0.0), full(1.0), full(5e-3)
    # residual, r1, r2, weight, base colour, gradient (2), curvature (3), damping
    return (full(1e30), full(begin[0]), full(begin[1]), full(0.5), data.f.mean(0) * np.pi,
            *(full(x) for x in (0.0, 0.0, 1.0, 0.0, 1.0)), full(5e-3))


def _step_one(data: Data, cost: Tensor, r: Tensor, down: Tensor, bend: Tensor, damping: Tensor) -> tuple[Tensor, ...]:
    """One step of all texels: the albedo is linear and drops out (Golub and Pereyra 1973, Kaufman 1975)."""
    to = (r + (down / (bend * (1 + damping) + 1e-12)).clamp(-0.15, 0.15)).clamp(LEAST, MOST)
    a, s, da, ds = data.lobe_slope(to)
    wa = data.w * a
    norm = (wa * a).sum(0).clamp(min=1e-12)
    rho = (wa * (data.f - s)).sum(0) / norm
    e = data.f - s - rho * a
    j = ds + rho * da
    wj = data.w * j
    aj = (wa * j).sum(0)
    there = (data.w * e * e).sum(0), to, (wj * e).sum(0), (wj * j).sum(0) - aj * aj / norm
    return _accept(there, (cost, r, down, bend), damping)


def _accept(there: tuple[Tensor, ...], here: tuple[Tensor, ...], damping: Tensor) -> tuple[Tensor, ...]:
    """The better of two states (their first is the residual), and the damping for the next step."""
    good = there[0] < here[0]
    kept = (torch.where(good, new, old) for new, old in zip(there, here, strict=True))
    return *kept, torch.where(good, (damping * 0.2).clamp(min=1e-6), damping * 8)


def _mix(data: Data, r1: Tensor, r2: Tensor, w: Tensor) -> tuple[Tensor, Tensor]:
    (a1, s1), (a2, s2) = data.lobe(r1), data.lobe(r2)
    return w * a1 + (1 - w) * a2, w * s1 + (1 - w) * s2


def _step_two(
    data: Data, cost: Tensor, r1: Tensor, r2: Tensor, w: Tensor, rho: Tensor, g1: Tensor, g2: Tensor, h11: Tensor,
    h12: Tensor, h22: Tensor, damping: Tensor,
) -> tuple[Tensor, ...]:
    """One step of both roughnesses; albedo and weight are linear but for one small product, and drop out."""
    here = (cost, r1, r2, w, rho, g1, g2, h11, h12, h22)
    d11, d22 = h11 * (1 + damping) + 1e-12, h22 * (1 + damping) + 1e-12
    det = (d11 * d22 - h12 * h12).clamp(min=1e-20)
    t1 = (r1 + ((d22 * g1 - h12 * g2) / det).clamp(-0.15, 0.15)).clamp(LEAST, MOST)
    t2 = (r2 + ((d11 * g2 - h12 * g1) / det).clamp(-0.15, 0.15)).clamp(LEAST, MOST)
    a1, s1, da1, ds1 = data.lobe_slope(t1)
    a2, s2, da2, ds2 = data.lobe_slope(t2)
    y = data.f - s2
    for _ in range(2):  # rho in the product is the last one: exact once it stands
        u = s1 - s2 + rho * (a1 - a2)
        saa, sau, suu = ((data.w * p).sum(0) for p in (a2 * a2, a2 * u, u * u))
        say, suy = (data.w * a2 * y).sum(0), (data.w * u * y).sum(0)
        w = ((saa * suy - sau * say) / (saa * suu - sau * sau).clamp(min=1e-20)).clamp(0, 1)
        rho = (say - w * sau) / saa.clamp(min=1e-12)
    a = w * a1 + (1 - w) * a2
    e = data.f - w * s1 - (1 - w) * s2 - rho * a
    j1, j2 = w * (ds1 + rho * da1), (1 - w) * (ds2 + rho * da2)
    # Off the span of a and, where the weight is free, of the part of u across a.
    norm = (data.w * a * a).sum(0).clamp(min=1e-12)
    across = ((w > 0) & (w < 1)).float() * (u - a * (data.w * a * u).sum(0) / norm)
    size = (data.w * across * across).sum(0).clamp(min=1e-12)
    w1, w2 = data.w * j1, data.w * j2
    p1, p2, q1, q2 = (w1 * a).sum(0), (w2 * a).sum(0), (w1 * across).sum(0), (w2 * across).sum(0)
    there = ((data.w * e * e).sum(0), t1, t2, w, rho, (w1 * e).sum(0), (w2 * e).sum(0),
             (w1 * j1).sum(0) - p1 * p1 / norm - q1 * q1 / size, (w1 * j2).sum(0) - p1 * p2 / norm - q1 * q2 / size,
             (w2 * j2).sum(0) - p2 * p2 / norm - q2 * q2 / size)
    return _accept(there, here, damping)


def adam(data: Data, model: str, budgets: Iterable[int], compiled: bool = False, rate: float = RATE) -> Iterator[Point]:
    """All parameters of all texels by Adam and automatic differentiation; snapshots are outside the clock."""
    n = data.f.shape[1]
    two = model == "two-lobe"
    begins = [0.3, 0.6, 0.5] if two else [0.5]
    base = torch.full((n, 3), 0.5, device=device(), requires_grad=True)
    shape = [torch.full((n,), x, device=device(), requires_grad=True) for x in begins]
    limits = [(LEAST, MOST), (LEAST, MOST), (0.0, 1.0)]
    optimiser = torch.optim.Adam([base, *shape], lr=rate)
    loss = _loss_two if two else _loss_one
    steps, seconds = 0, 0.0
    for budget in budgets:
        wait()
        start = time.perf_counter()
        while steps < budget:
            optimiser.zero_grad(set_to_none=True)
            (_compile(loss) if compiled else loss)(data, base, *shape).backward()
            optimiser.step()
            with torch.no_grad():
                base.clamp_(0, 1)
                for p, (low, high) in zip(shape, limits, strict=False):
                    p.clamp_(low, high)
            steps += 1
        wait()
        seconds += time.perf_counter() - start
        yield steps, seconds, data.estimate(base, *shape)


def _loss_one(data: Data, base: Tensor, r: Tensor) -> Tensor:
    return _squares(data, base, *data.lobe(r))


def _loss_two(data: Data, base: Tensor, r1: Tensor, r2: Tensor, w: Tensor) -> Tensor:
    return _squares(data, base, *_mix(data, r1, r2, w))


def _squares(data: Data, base: Tensor, a: Tensor, s: Tensor) -> Tensor:
    e = base * a[..., None] + s[..., None] - data.rgb
    return (data.seen[..., None] * e * e).sum()
