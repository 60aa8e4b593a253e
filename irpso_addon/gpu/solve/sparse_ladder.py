"""The solve stage on a part of the texels, where the pictures are too coarse to tell all of them apart."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from functools import partial

import moderngl
import numpy as np

from ...core.data import F32
from ...core.job import Progress, mapped
from ...core.live_maps import Live
from ...core.maps.stride import SparseTexels
from ...core.resampling import nearest
from ..device.context import Device
from ..observe.observation_atlas import TexelSurface
from .ladder_records import EarlierResult, LadderResult
from .texel_records import SolvedTexels


@dataclass(frozen=True)
class Surface:
    """Where some texels lie, as of `TexelSurface`."""

    position: moderngl.Texture
    normal: moderngl.Texture


@dataclass(frozen=True)
class SparseLadder:
    """What the solve stage gives of some texels."""

    texels: SparseTexels
    ladder: LadderResult  # arrays (m, m): of the solved texels alone

    def everywhere(self, base: F32 | None = None) -> LadderResult:
        """The same of all texels.  ``base``: (n, n, 3) base colour, by which they choose among the solved ones."""
        ladder, found = self.ladder, self.ladder.texels
        around = self.texels.among(found.solved)
        if base is not None:
            around = around.guided(base)
        values = {name: around.spread(values) for name, values in vars(found).items() if name != "solved"}
        plain, paint = (None if array is None else around.spread(array.astype(np.float32)) > 0.5
                        for array in (ladder.plain, ladder.paint))
        return replace(ladder, plain=plain, paint=paint, texels=SolvedTexels(solved=around.known, **values),
                       lobes=None if ladder.lobes is None else around.spread(ladder.lobes),
                       level=None if ladder.level is None else around.spread(ladder.level))


def surface_of(device: Device, whole: TexelSurface, texels: SparseTexels) -> Surface:
    """The solved texels alone."""
    side = len(texels.rows)
    position, normal = (device.texture(side, side, data=texels.picked(device.read(texture)))
                        for texture in (whole.position, whole.normal))
    return Surface(position, normal)


def picked(last: EarlierResult, texels: SparseTexels) -> EarlierResult:
    """What is taken over from an earlier result, for the solved texels alone."""
    return replace(last, level=None if last.level is None else texels.picked(last.level),
                   lobes=None if last.lobes is None else texels.picked(last.lobes),
                   paint=None if last.paint is None else texels.picked(last.paint))


def looked(
    steps: Generator[Progress, None, LadderResult], texels: SparseTexels,
) -> Generator[Progress, None, LadderResult]:
    """The steps of the solve stage, whose looks show the whole map."""

    def grown(step: Progress) -> Progress:
        return replace(step, look=None if step.look is None else partial(_grown, step.look, texels.size))

    return mapped(steps, grown)


def _grown(look: Callable[[], Live], size: int) -> Live:
    live = look()
    return replace(live, maps={role: nearest(values, size) for role, values in live.maps.items()})
