"""What the rest of a map says of the squares of a sample, which lack the neighbours that the map has."""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from ...core.data import F32, Bool
from ...core.job import Progress
from ...core.params import SolveSettings
from ...core.tiled.tiled_plan import PriorKnowledge
from ..device.context import Device
from ..observe.observation_atlas import Source
from .material_sample import WIDTH, MaterialSample, Squares, Thinned, packed
from .solver import Solver

SIDE = 64  # texels: of a map that is thinned
LEAST_SIGMA = 0.01  # of what is said of a square's roughness, whose texels differ


class MapAround:
    """A material's texels, of which one in so many is solved for one lobe."""

    def __init__(self, device: Device, source: Source, texels: Bool, squares: Squares, settings: SolveSettings) -> None:
        """``texels``: (h, w) those of the material.  ``squares``: of which something is to be said."""
        self.device, self.source, self.texels, self.squares, self.settings = device, source, texels, squares, settings
        self._sample: MaterialSample | None = None  # once it is needed
        self._solver: Solver | None = None
        self.step = max(source.size[0] // SIDE, 1)

    @property
    def cancelled(self) -> bool:
        """Whether the search was stopped."""
        return self._solver is not None and self._solver.cancelled

    def without(self, left_out: Bool, level: float) -> Generator[Progress, None, PriorKnowledge]:
        """What it says of the squares without some layers, (V,).  ``level``: Specular IOR Level of all texels."""
        if self._sample is None or self._solver is None:
            self._sample = packed(self.device, self.source, self.texels, Thinned(self.step))
            self._solver = Solver(self.device, self._sample, self.settings)
            self._solver.shown = False
            self._solver.use_level(np.full(self._sample.size[::-1], level, np.float32) if level != 0.5 else None)
        self._sample.left_out = left_out
        maps = yield from self._solver.solve()
        roughness = self.device.read(maps.roughness)
        maps.release()
        return PriorKnowledge(roughness=self._of_squares(roughness), apart=True)

    def _of_squares(self, roughness: F32) -> F32:
        """As of PriorKnowledge, of (h, w, 4) as in RoughnessMaps."""
        side, columns = self.squares.side, WIDTH // self.squares.side
        rows, width = (size // side for size in self.squares.shape)
        result = np.zeros((rows, width, 4), np.float32)
        for n, (x, y) in enumerate(self.squares.corners):
            own = np.s_[y // self.step:-(-(y + side) // self.step), x // self.step:-(-(x + side) // self.step)]
            values, sigma, _, solved = np.moveaxis(roughness[own], -1, 0)
            known = solved > 0.5
            if known.any():
                weight = np.maximum(sigma[known], LEAST_SIGMA) ** -2.0
                result[n // columns, n % columns] = (
                    np.average(values[known], weights=weight), 1 / weight.mean(), 0.0, 1.0)
        return result
