"""What some passes need at least: operations and bytes, and how long this device takes for so many of them.

Operations of an evaluation are those that studies/bench/peak.py counts: one lobe, point lamps, one camera a texel.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from irpso_addon.core.job import Progress
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.device.context import Device, Inputs
from studies.bench.peak import OPERATIONS, PER_EVALUATION, PER_OBSERVATION, Probe

TEXEL = 16  # bytes of a texture's four numbers
COPIED = 2048  # texels across a texture that is copied
ROUNDS = 5
NODES = 32  # roughnesses of a table, shaders/solve/table.kernel
STARTS = 3  # of a polish, shaders/solve/polish.kernel
# Of a pixel or texel that a draw covers: (fetches, bytes that are read or written once).
DRAWS = {
    # albedo, weight, uv, slope, position, 16 bilinear looks at the texture; written once
    "maps/albedo_residual.frag": (5 + 16 * 4, 6 * TEXEL + 8),
    # position, normal, which pixels show it, and four pixels' residuals, which neighbours share; added to what is there
    "maps/albedo_backproject.frag": (3 + 4, 5 * TEXEL + 1),
    "maps/albedo_update.frag": (2, 3 * TEXEL),
}
KERNELS = {"search": "solve/search.kernel", "tables": "solve/table.kernel", "polish": "solve/polish.kernel"}


@dataclass(frozen=True)
class Need:
    """Of one pass in one case."""

    name: str
    evaluations: float  # of the residual, at most; 0: it makes none
    observations: float  # of a texel; 0: it looks at none
    operations: float  # multiply-adds, divisions, roots and fetches
    bytes: float
    arithmetic: float  # least seconds for the operations ...
    memory: float  # ... and for the bytes
    seconds: float  # that it took
    unskipped: float = 0.0  # least seconds for the operations if views that do not show a texel count like others

    @property
    def share(self) -> float:
        """Of its seconds that the dearer of the two needs."""
        return max(self.arithmetic, self.memory) / self.seconds if self.seconds else 0.0


def rates() -> tuple[str, dict[str, float]]:
    """The device's name, and its best rates: operations of each kind, and bytes copied, a second."""
    def job() -> Generator[Progress, None, tuple[str, dict[str, float]]]:
        device = thread.device()
        yield Progress(0.0, "device")
        probe = Probe(device)
        for _ in range(ROUNDS):
            probe.measure()
        probe.release()
        return device.name, {**probe.rates, "bytes": copied(device)}

    found: tuple[str, dict[str, float]] = thread.run(job)
    return found


def copied(device: Device, size: int = COPIED) -> float:
    """Bytes read and written a second, where a texture is copied."""
    taken = []
    with device.scope():
        source, target = device.texture(size, size, 4, np.ones((size, size, 4), np.float32)), device.texture(size, size)
        with device.target([target]) as frame:
            for _ in range(ROUNDS + 1):
                device.budget.finish()
                start = time.perf_counter()
                device.draw("observe/copy.frag", frame, Inputs({"u_map": source}, {"u_corner": (0, 0)}))
                device.budget.finish()
                taken.append(time.perf_counter() - start)
    return 2 * TEXEL * size**2 / min(taken[1:])


def evaluations(kernel: str, work: Mapping[str, float]) -> float:
    """Of the residual for one texel, at most: a search that has converged stops sooner."""
    if kernel == KERNELS["search"]:
        moves = work["u_particles"] * (work["u_moves"] + 1) if work["u_moves"] else 0
        return moves + work["u_particles"] * (work["u_race_steps"] + 1) + 2 * work["u_final_steps"] + 1
    return NODES if kernel == KERNELS["tables"] else STARTS * (work["u_steps"] + 1)


def needs(record: Mapping[str, Any], rate: Mapping[str, float]) -> list[Need]:
    """Of the passes that can be counted simply, from a ledger's record."""
    seconds = {(part, shader): (taken, units) for part, shader, taken, _, units in record["shaders"]}
    found = []
    for name, kernel in KERNELS.items():
        work = record["work"].get(f"{kernel} 1")
        if work is not None and f"{kernel} 2" not in record["work"] and work["observations"] > 0:
            found.append(_of_kernel(name, work, evaluations(kernel, work), seconds[name, kernel][0], rate))
    drawn = [(shader, *seconds["back-projection", shader]) for shader in DRAWS
             if ("back-projection", shader) in seconds]
    if drawn:
        fetches = sum(DRAWS[shader][0] * units for shader, _, units in drawn)
        traffic = sum(DRAWS[shader][1] * units for shader, _, units in drawn)
        found.append(Need("back-projection", 0, 0, fetches, traffic, fetches / rate["fetch"], traffic / rate["bytes"],
                          sum(taken for _, taken, _ in drawn)))
    return found


def _of_kernel(
    name: str, work: Mapping[str, float], each: float, seconds: float, rate: Mapping[str, float],
) -> Need:
    texels, observations = work["texels"], work["observations"]
    counts, every = ({kind: each * (seen * PER_OBSERVATION[kind] + texels * PER_EVALUATION[kind])
                      for kind in OPERATIONS} for seen in (observations, texels * work["layers"]))
    # Position, what each layer says of itself, the lobes of those that are observed, and what is written.
    traffic = TEXEL * (texels * (1 + work["layers"] + work["outputs"]) + observations * work["lights"])
    return Need(name, each * texels, observations / texels, sum(counts.values()), traffic,
                sum(count / rate[kind] for kind, count in counts.items()), traffic / rate["bytes"], seconds,
                sum(count / rate[kind] for kind, count in every.items()))
