"""The stages of a solve: their seconds and their share of the progress."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

from ..core.data import Bool
from ..core.job import Progress, mapped
from ..core.live_maps import Live

Result = TypeVar("Result")
STAGES = {  # share of a round's progress
    "pictures": (0.0, 1.0), "gbuffer": (0.0, 0.05), "observe": (0.05, 0.3), "cameras": (0.3, 0.3),
    "calibrate": (0.3, 0.33), "normals": (0.33, 0.35),
    "solve": (0.35, 0.85), "maps": (0.85, 1.0), "indirect": (0.0, 1.0), "indirect_test": (0.0, 1.0)}


@dataclass
class Clock:
    """Seconds per stage, and the coverage that every look at the job shows beside its maps."""

    seconds: dict[str, float] = field(default_factory=dict)
    coverage: Bool | None = None

    def stage(
        self, name: str, steps: Generator[Progress, None, Result], again: tuple[float, float] | None = None,
    ) -> Generator[Progress, None, Result]:
        """Steps whose seconds are this stage's.  ``again``: share of the progress where the stage comes twice."""
        start = time.perf_counter()
        low, high = again or STAGES[name]
        reached = 0.0

        def placed(step: Progress) -> Progress:
            nonlocal reached
            reached = max(reached, step.fraction)  # a model tried on the way starts from 0 again
            return Progress(low + (high - low) * reached, name, step.message, step.look and partial(
                self._covered, step.look))

        try:
            return (yield from mapped(steps, placed))
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def _covered(self, look: Callable[[], Live]) -> Live:
        return replace(look(), coverage=self.coverage)
