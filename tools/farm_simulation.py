"""A farm in thought: which tasks wait, start and work when, on any number of workers, from measured task times."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

KINDS = ("solve", "merge", "plan", "start", "slow", "wait")  # what workers spend their time with


@dataclass(frozen=True)
class Costs:
    """Seconds on one worker."""

    plan: float  # reading the scene, developing the pictures, planning: before there are any tasks
    session: float  # from a worker's first task being given to it until it begins
    dispatch: float  # between two tasks of a worker
    start: float  # of a Solve task's process until it works at its first block
    blocks: tuple[float, ...]  # of some blocks that were solved
    merge_start: float  # of a Merge task's process
    merge: float  # of each block that is merged
    slowness: tuple[float, ...]  # the same task done several times: each time over the shortest; 1 or more


@dataclass(frozen=True)
class Work:
    """A job: ``squares`` UDIM squares of ``across`` x ``across`` blocks, in tasks of ``tile`` x ``tile`` of them."""

    squares: int
    across: int
    tile: int


@dataclass(frozen=True)
class Outcome:
    """What becomes of it."""

    seconds: float  # from the beginning of the plan to the last map
    spent: dict[str, float]  # worker-seconds of each of `KINDS`; their sum is seconds times workers

    @property
    def efficiency(self) -> float:
        """Share of the workers' time that a single machine would have needed too."""
        useful = sum(self.spent[kind] for kind in ("solve", "merge")) + self.planned
        return useful / sum(self.spent.values())

    planned: float = 0.0  # seconds of the plan itself; while one worker makes it, the others wait ("plan" holds both)


def simulate(costs: Costs, work: Work, workers: int, seed: int = 0) -> Outcome:
    """Tasks go, in order, to the worker that is free first; Merge begins when all of Solve is done."""
    rng = np.random.default_rng(seed)
    blocks = rng.choice(costs.blocks, (work.squares, work.across, work.across))  # the same whatever the tile
    tasks = tile_sums(blocks, work.tile).ravel()
    slow = rng.choice(costs.slowness, len(tasks)) - 1.0
    free = [costs.session] * workers
    _schedule(free, costs.dispatch + costs.start + tasks * (1 + slow))
    solved = max(free)
    free = [solved] * workers
    merged = work.across**2 * costs.merge
    merge_slow = rng.choice(costs.slowness, work.squares) - 1.0
    _schedule(free, costs.dispatch + costs.merge_start + merged * (1 + merge_slow))
    seconds = costs.plan + max(free)
    spent = {
        "solve": float(tasks.sum()), "merge": merged * work.squares, "plan": costs.plan * workers,
        "start": costs.session * workers + len(tasks) * (costs.dispatch + costs.start)
        + work.squares * (costs.dispatch + costs.merge_start),
        "slow": float((tasks * slow).sum() + merged * merge_slow.sum()),
    }
    return Outcome(seconds, spent | {"wait": seconds * workers - sum(spent.values())}, costs.plan)


def tile_sums(blocks: np.ndarray, tile: int) -> np.ndarray:
    """(squares, tiles, tiles) sums over tile x tile of (squares, across, across); the last row may hold fewer."""
    edges = range(0, blocks.shape[1], tile)
    return np.add.reduceat(np.add.reduceat(blocks, edges, axis=1), edges, axis=2)


def _schedule(free: list[float], tasks: Iterable[float]) -> None:
    """Give each task to the worker that is free first; ``free``: when each is, a heap."""
    heapq.heapify(free)
    for seconds in tasks:
        heapq.heapreplace(free, free[0] + float(seconds))


def alone(costs: Costs, work: Work, seed: int = 0) -> float:
    """Seconds of the same solve by a single machine, in one process."""
    blocks = np.random.default_rng(seed).choice(costs.blocks, (work.squares, work.across, work.across))
    return costs.plan + costs.start + float(blocks.sum()) + work.squares * work.across**2 * costs.merge


def most(outcome: Outcome) -> str:
    """On what most of the time is lost."""
    return max((kind for kind in KINDS if kind not in ("solve", "merge")), key=lambda kind: outcome.spent[kind])


def knee(outcomes: Sequence[tuple[int, Outcome]], share: float = 0.8) -> int:
    """The most workers of which ``share`` of the time is still useful."""
    return max((workers for workers, outcome in outcomes if outcome.efficiency >= share), default=1)
