"""Texels for method `paper`, and runs of its swarms on them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading.tables import principled_table
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.observe import observation_atlas
from irpso_addon.gpu.solve.paper_swarm import PaperMaps, PaperSwarm

SIZE = 24
COUNT = 5  # observations of the random texels
OnGL = Callable[[Callable[[Device], Any]], Any]


def random_arrays(seed: int = 3, lights: int = 2) -> dict[str, Any]:
    """Observations of (SIZE, SIZE) texels that no material explains: two cameras, some not observed, one corner not."""
    rng = np.random.default_rng(seed)
    shape = (SIZE, SIZE, COUNT)
    quality = rng.choice([0.0, 0.3, 1.0], shape, p=[0.2, 0.3, 0.5])
    quality[:5, :7] = 0.0
    lobes = np.stack([rng.uniform(0, 0.4, (*shape, lights)), rng.uniform(0, 0.05, (*shape, lights)),
                      rng.uniform(0.2, 1, (*shape, lights)), rng.uniform(0.01, 0.2, (*shape, lights))], axis=-1)
    camera = np.array([0, 0, 1, 1, 1])
    return {
        "rgb": rng.uniform(0.02, 0.5, (*shape, 3)).astype(np.float32), "quality": quality.astype(np.float32),
        "cos_v": rng.uniform(0.2, 1.0, (SIZE, SIZE, 2))[:, :, camera].astype(np.float32),
        "lobes": lobes.astype(np.float32), "groups": (0, 0, 1, 1, 1),
    }


def settings(**chosen: Any) -> SolveSettings:
    return SolveSettings(**{"size": SIZE, "method": "paper", "particles": 8, "iterations": 100, **chosen})


def source_of(device: Device, arrays: dict[str, Any]) -> observation_atlas.ArraySource:
    return observation_atlas.ArraySource(device, observation_atlas.ObservedTexels(**arrays), principled_table())


def finish(steps: Any) -> Any:
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


def run(on_gl: OnGL, arrays: dict[str, Any], model: str = "one-lobe", tile: tuple[int, int] = observation_atlas.TILE,
        **chosen: Any) -> tuple[np.ndarray, np.ndarray, int]:
    """(best, more, evaluations) of a whole run."""

    def job(device: Device) -> tuple[np.ndarray, np.ndarray, int]:
        source = source_of(device, arrays)
        solver = PaperSwarm(device, source, settings(**chosen), model, tile=tile)
        maps: PaperMaps = finish(solver.solve())
        return device.read(maps.best).copy(), device.read(maps.more).copy(), maps.evaluations

    return on_gl(job)
