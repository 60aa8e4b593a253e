"""What every block of a large map has in common: found once on a small map, before the first block."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ..data import F32, F64, Bool, Bounced, Maps, SceneData, Solution
from ..params import SolveSettings
from . import uv_blocks

LEAST_SIGMA = 0.01  # standard error of roughness that the small map is believed to have, at the least


def cells_of(window: uv_blocks.UvBlock) -> int:
    """Coarse cells on a side of what is solved of a block."""
    return -(-window.side // uv_blocks.CELL)


@dataclass(frozen=True)
class Typical:
    """What the roughness of a cell is taken to be before its texels and its neighbours are asked: a normal prior."""

    roughness: float
    variance: float
    colour: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of cells whose square root of base colour is nearest to it


@dataclass(frozen=True)
class Noise:
    """What a search has found of its data as a whole."""

    variance: float  # median, relative
    neighbours: bool  # whether texels need theirs
    alike: float = 0.0  # 0..1: which part of it neighbours have in common
    typical: tuple[Typical, ...] = ()  # of all texels, or of each kind of base colour
    tilt: float = 1.0  # standard deviation of a normal's tilt, in radians for a relative noise of 1


@dataclass(frozen=True)
class PriorKnowledge:
    """What is known of a part of a map before it is searched."""

    noise: Mapping[int, Noise] = field(default_factory=dict)  # of the whole, by the number of lobes
    # (h, w, 4) of the part's cells, whose width is a power of two in texels: roughness, its variance, 0, 1 where known
    roughness: F32 | None = None
    apart: bool = False  # whether the cells come from here and there, and say nothing of each other


@dataclass(frozen=True)
class Plan:
    """Whoever has this and the developed pictures can solve any block."""

    scene: SceneData  # cameras and exposures put right
    settings: SolveSettings
    udims: tuple[int, ...]
    block: int  # texels, see core/tiled/uv_blocks.py
    halo: int
    memory: float  # GB that pictures and observations of a block may take
    kernels: str  # "fragment" or "compute": the same on all machines
    scales: F64  # (V, 3) of each view: by what its picture was divided when it was developed
    solution: Solution  # the small map, `layout` tells of which squares
    level: float  # typical radiance of the views
    noise: Mapping[int, Noise]  # by the number of lobes
    robust: bool  # whether outliers are disbelieved
    bounced: Mapping[int, Bounced] | None  # indirect light by the view's place in the scene
    stride: int = 1  # every how many-th texel is solved, see core/maps/stride.py
    blend: str = ""  # fingerprint of the .blend in which that was rendered
    tilt: F32 | None = None  # (m, m, 3) over the small map: what is added to the mesh's unit normals; None: they stay

    @property
    def blocks(self) -> list[uv_blocks.UvBlock]:
        """All blocks."""
        return uv_blocks.all_blocks(self.settings.size, self.udims, self.block, self.halo)

    @property
    def layout(self) -> uv_blocks.Layout:
        """Where the small map holds each square."""
        return uv_blocks.layout(self.settings.size, self.udims)

    def around(self, window: uv_blocks.UvBlock) -> Maps:
        """The small maps at a block's cells of `uv_blocks.CELL` texels; arrays of flags are left as they are."""
        maps, count = self.solution.maps, cells_of(window)

        def at(values: F32) -> F32:
            return self.layout.sampled(values, window, count)

        return Maps(at(maps.base_color), at(maps.roughness), maps.confidence, maps.error, maps.filled, maps.coverage,
                    maps.roughness_sigma, maps.base_sigma, None if maps.lobes is None else at(maps.lobes),
                    None if maps.specular is None else at(maps.specular))

    def paint(self, window: uv_blocks.UvBlock) -> Bool | None:
        """(side, side): which of a block's texels the small map has as paint beside metal; None: there is none."""
        metallic = self.solution.maps.metallic
        if metallic is None:
            return None
        return self.layout.sampled((metallic == 0).astype(np.float32), window, window.side) > 0.5

    def tilts(self, window: uv_blocks.UvBlock) -> F32 | None:
        """(side, side, 3): what is added to the unit normals of a block's texels, world; None: they stay."""
        return None if self.tilt is None else self.layout.sampled(self.tilt, window, window.side)

    def before(self, window: uv_blocks.UvBlock) -> PriorKnowledge:
        """What the search of a block knows of it."""
        maps = self.solution.maps
        known = (~maps.filled).astype(np.float32)
        values = np.stack([maps.roughness, np.maximum(maps.roughness_sigma**2, LEAST_SIGMA**2), 0 * known, known], -1)
        return PriorKnowledge(self._noise(), self.layout.sampled(values, window, cells_of(window)))

    def _noise(self) -> Mapping[int, Noise]:
        """Where materials are searched apart, one's roughness says nothing of another's."""
        models, priors = self.solution.model, self.solution.priors
        if len(models) < 2 or not (priors or len(set(models.values())) > 1):
            return self.noise
        return {lobes: replace(noise, typical=()) for lobes, noise in self.noise.items()}

    def level_map(self, window: uv_blocks.UvBlock, slots: np.ndarray) -> F32 | None:
        """(side, side) Specular IOR Level of a block's texels; None: 0.5.  slots: material of each, -1: none."""
        specular = self.solution.maps.specular
        if specular is None:
            return None
        if self.settings.specular == "texel":
            return self.layout.sampled(specular, window, window.side)
        result = np.full(slots.shape, 0.5, np.float32)
        for slot, name in enumerate(self.scene.mesh.slot_names):
            result[slots == slot] = self.solution.levels.get(name, 0.5)
        return result
