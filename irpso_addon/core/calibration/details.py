"""What is to be changed, beside a mesh that is wrong in detail too: that may hide what is off."""

from __future__ import annotations

import numpy as np

from ..job import Steps
from .choice import Chosen, begun_of, chosen, everything_of
from .finish import Judged, Larger, judged_of
from .rig_sample import RigSample

MESH = 0.003  # of the radiance, that neighbours leave over in common: more may be a mesh that is wrong in detail
MOST = 0.1  # the same: more is no detail, but lamps that are far off
TILTED = 0.9  # of what predictions are off by: below it, lamps are found beside tilts
CLEARLY = 0.5  # the same where numbers without tilts have not been looked for in every way


def with_details(
    sample: RigSample, lamps: bool, exposures: bool, more: Larger, normals: bool,
) -> Steps[Judged | None]:
    """What is to be changed, of `calibrate`.

    Where all numbers leave more in common than an exact mesh does, the mesh comes first, and numbers without it are
    told apart only if that leads nowhere.  Where a fit of all numbers runs away, the mesh comes before the other ways
    to fit them, too.
    """
    begun = yield from begun_of(sample, lamps, exposures, False)
    if begun is None:
        return None
    mesh = _BesideMesh(sample, lamps, exposures, more) if normals else None
    if mesh is not None and (begun.from_afar or begun.away) and MESH < begun.common < MOST:
        judged = yield from mesh.below(CLEARLY * begun.quick.foretold())
        if judged is not None:
            return judged
    every = yield from everything_of(begun)
    if mesh is not None and (every is None or every.found.common[1] > MESH):
        judged = yield from mesh.below(np.inf if every is None else TILTED * every.foretold())
        if judged is not None:
            return judged
    return None if every is None else (yield from _told_apart((yield from chosen(every)), mesh, more))


def _told_apart(plain: Chosen | None, mesh: _BesideMesh | None, more: Larger) -> Steps[Judged | None]:
    """The change without tilts, or that beside them.  ``mesh``: None: it is right."""
    if plain is not None and not (mesh is not None and plain.found.common[1] > MESH):
        judged = yield from judged_of(plain, more)
        if judged is not None:
            return judged
        plain = None
    if mesh is not None:
        judged = yield from mesh.below(np.inf if plain is None else TILTED * plain.left)
        if judged is not None:
            return judged
    return None if plain is None else (yield from judged_of(plain, more))


class _BesideMesh:
    """What is to be changed beside tilts of the texels' normals, looked for and judged once."""

    def __init__(self, sample: RigSample, lamps: bool, exposures: bool, more: Larger) -> None:
        self.sample, self.lamps, self.exposures, self.more = sample, lamps, exposures, more
        self.sought = False
        self.chosen: Chosen | None = None

    def below(self, most: float) -> Steps[Judged | None]:
        """The change, if under it predictions are off by less than ``most``."""
        if not self.sought:
            self.chosen, self.sought = (yield from self._chosen()), True
        if self.chosen is None or self.chosen.left >= most:
            return None
        taken, self.chosen = self.chosen, None
        return (yield from judged_of(taken, self.more))

    def _chosen(self) -> Steps[Chosen | None]:
        begun = yield from begun_of(self.sample, self.lamps, self.exposures, True)
        every = None if begun is None else (yield from everything_of(begun))
        return None if every is None else (yield from chosen(every))
