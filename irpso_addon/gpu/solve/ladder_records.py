"""What the solve stage is given of materials and earlier results, and what it gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ...core.data import F32, I32, Bool, Coat, JointPrior, MaterialPrediction
from ...core.tiled.tiled_plan import Noise
from .texel_records import SolvedTexels


@dataclass(frozen=True)
class Materials:
    """Which material each texel has."""

    slots: I32  # (h, w) material slot, -1 where there is none
    names: tuple[str, ...]  # of the slots' materials

    def masks(self) -> dict[str, Bool]:
        """(h, w) texels of each material: slots that share one decide together."""
        return {name: np.isin(self.slots, [slot for slot, other in enumerate(self.names) if other == name])
                for name in dict.fromkeys(self.names)}


@dataclass(frozen=True)
class EarlierResult:
    """What is taken over from an earlier result, by material."""

    model: Mapping[str, str] = field(default_factory=dict)  # instead of choosing
    levels: Mapping[str, float] = field(default_factory=dict)  # Specular IOR Level to begin at
    fixed: frozenset[str] = frozenset()  # materials whose level must stay ...
    level: F32 | None = None  # ... (h, w) as it is here; None: 0.5
    lobes: F32 | None = None  # (h, w, 4) where the search begins: roughness1, roughness2, weight; whether known
    priors: Mapping[str, JointPrior] = field(default_factory=dict)  # of materials whose ``model`` is given
    metallic: Mapping[str, float] = field(default_factory=dict)  # of materials whose Metallic was solved for
    painted: frozenset[str] = frozenset()  # materials that are in part paint beside metal ...
    paint: Bool | None = None  # ... (h, w) which texels were
    coats: Mapping[str, Coat] = field(default_factory=dict)  # of materials that have one
    diffuse_roughness: Mapping[str, float] = field(default_factory=dict)  # of materials where it is not 0
    predictions: Mapping[str, MaterialPrediction] = field(default_factory=dict)  # of materials whose ``model`` is given


@dataclass
class LadderResult:
    """What the solve stage gives; arrays on the texel grid."""

    texels: SolvedTexels
    model: dict[str, str] = field(default_factory=dict)  # by material
    why: dict[str, str] = field(default_factory=dict)
    levels: dict[str, float] = field(default_factory=dict)
    metallic: dict[str, float] = field(default_factory=dict)  # of materials whose model has it
    coats: dict[str, Coat] = field(default_factory=dict)  # of materials that have one
    diffuse_roughness: dict[str, float] = field(default_factory=dict)  # of materials where it is not 0
    lobes: F32 | None = None  # (h, w, 3) roughness1, roughness2, weight
    level: F32 | None = None  # (h, w) Specular IOR Level
    base: F32 | None = None  # (h, w, 3) where the method searches it itself
    noise: dict[int, Noise] = field(default_factory=dict)  # of the data, by the number of lobes
    predictions: dict[str, MaterialPrediction] = field(default_factory=dict)  # by material
    priors: dict[str, JointPrior] = field(default_factory=dict)  # by material, where there is one
    robust: bool = False  # whether outliers were disbelieved
    painted: frozenset[str] = frozenset()  # materials that are in part paint beside metal ...
    paint: Bool | None = None  # ... (h, w) these texels, whose Metallic is 0; None: there are none
    plain: Bool | None = None  # (h, w) texels of metals that look like paint, or cannot be told from it; None: no metal
    cancelled: bool = False

    def take(self, part: LadderResult, inside: Bool) -> None:
        """Take over what another model found for the (h, w) texels ``inside``."""
        inside = inside & part.texels.solved
        if part.lobes is not None:
            r = self.texels.roughness
            self.lobes = np.where(inside[..., None], part.lobes, np.stack([r, r, np.ones_like(r)], -1))
        if part.level is not None:
            before = np.full_like(part.level, 0.5) if self.level is None else self.level
            self.level = np.where(inside, part.level, before)
        self.texels = self.texels.where(inside, part.texels)
        self.levels |= part.levels
        self.metallic |= part.metallic
        self.coats |= part.coats
        self.diffuse_roughness |= part.diffuse_roughness
