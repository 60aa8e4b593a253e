"""Which texels of a material are metal and which are paint: by which of the two explains them far better."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.data import F64, Bool
from .ladder_records import LadderResult
from .specular_level import box
from .texel_records import SolvedTexels

BETTER = 0.5  # of the error: a texel that another model explains so much better is of another material ...
SHOWN = 0.01  # ... where the error is as large: relative, of all its observations
LEAST_SHARE, LEAST_TEXELS = 0.02, 50  # of a material that are paint, from which on they are a part of it
# Ratio of a metal's error to that of paint, in the median of the texels that seem paint, from which on they are: real
# paint has 7 and more, a metal whose detail is finer than its texels 2.  The same of metal in paint.
TWO_KINDS = 3.0
METAL = 0.5  # Metallic from which on texels that stand out of paint are metal
FINEST = 0.003  # relative: what a model leaves below this is the forward model's own error
WINDOWS = (3, 9, 27)  # texels: widths over which evidence is summed, up to the first in which it is clear
CLEAR = 5.0  # nats


@dataclass(frozen=True)
class Parts:
    """A material whose texels are metal or paint, (h, w) each."""

    metal: Bool
    paint: Bool
    unclear: Bool  # of either: its own observations do not show which

    @property
    def inner_metal(self) -> Bool:
        """(h, w): metal by which a model can be judged: at the border pixels show paint too."""
        return _inside(self.metal)

    @property
    def inner_paint(self) -> Bool:
        """The same of the paint."""
        return _inside(self.paint)


def _inside(part: Bool) -> Bool:
    inside = part & (box(part.astype(np.float64), 3) > 8.5)
    return inside if inside.sum() >= LEAST_TEXELS else part


def explains_better(one: SolvedTexels, other: SolvedTexels, texels: Bool) -> Bool:
    """(h, w) where one model leaves less than half of an error that another one shows, of 3 x 3 of some ``texels``.

    Both have as many numbers a texel.
    """
    counted = texels & one.solved & other.solved
    left, more, seen = (box(np.where(counted, values, 0.0).astype(np.float64), 3)
                        for values in (one.residual, other.residual, other.observations))
    return np.asarray(counted & (left < BETTER**2 * more) & (more > SHOWN**2 * seen))


def parts_of(without: SolvedTexels, metal: SolvedTexels, texels: Bool, before: Bool | None = None) -> Parts | None:
    """Metal and paint among some ``texels``, (h, w), of a material; None: there is hardly any of one.

    ``without``: solved without Metallic.  ``metal``: with that of the material.  ``before``: (h, w) paint of an earlier
    result, which may be all or nothing here.
    """
    texels = texels & without.solved & metal.solved
    least = _least(texels)
    if before is None and explains_better(without, metal, texels).sum() < least:
        return None
    evidence = _evidence(without, metal, texels)
    summed = box(evidence, WINDOWS[0])
    unclear = np.abs(summed) < CLEAR
    if before is not None:
        summed = np.where(unclear, np.where(before, -CLEAR, CLEAR), summed)
    for width in WINDOWS[1:]:
        summed = np.where(np.abs(summed) < CLEAR, box(evidence, width), summed)
    paint = texels & (summed < 0)
    # No texel departs from most of those around it.
    paint = texels & (2 * box(paint.astype(np.float64), 3) > box(texels.astype(np.float64), 3))
    if before is None and ((texels & ~paint).sum() < least or _ratio(without, metal, paint) < TWO_KINDS):
        return None
    return Parts(texels & ~paint, paint, texels & (unclear | (paint != (summed < 0))))


def unexplained(without: SolvedTexels, texels: Bool) -> Bool | None:
    """(h, w) of some ``texels`` of a material, those that may be metal in paint; None: there are hardly any.

    What is left of 3 x 3 of them without Metallic is far more than of most.
    """
    texels = texels & without.solved
    left, seen = (box(np.where(texels, values, 0.0).astype(np.float64), 3)
                  for values in (without.residual, without.observations))
    error = left / np.maximum(seen, 1.0)
    odd = texels & (error > max(TWO_KINDS**2 * float(np.median(error[texels])), SHOWN**2)) if texels.any() else texels
    return odd if odd.sum() >= _least(texels) else None


def metal_of(without: SolvedTexels, metal: SolvedTexels, texels: Bool) -> Parts | None:
    """Metal and paint among some ``texels``, (h, w), of a material that is not all metal; None: there is hardly any.

    ``without``: solved without Metallic.  ``metal``: some of them solved with one.
    """
    found = explains_better(metal, without, texels)
    if found.sum() < _least(texels) or _ratio(metal, without, found) < TWO_KINDS:
        return None
    return Parts(found, texels & ~found, np.zeros_like(texels))


def take_parts(result: LadderResult, name: str, texels: Bool, parts: Parts) -> None:
    """Note that the (h, w) ``texels`` of a material are metal and paint, and forget the level of the metal."""
    none = np.zeros_like(texels)
    result.painted |= {name}
    result.paint = parts.paint | (none if result.paint is None else result.paint)
    result.plain = np.where(texels, parts.unclear, none if result.plain is None else result.plain)
    result.levels.pop(name, None)
    if result.level is not None:
        result.level = np.where(texels, np.float32(0.5), result.level)
        if np.all(result.level == 0.5):
            result.level = None


def _least(texels: Bool) -> float:
    """How many of some texels make a part."""
    return max(LEAST_TEXELS, LEAST_SHARE * float(texels.sum()))


def _ratio(right: SolvedTexels, wrong: SolvedTexels, part: Bool) -> float:
    """Of the error that a wrong model leaves to that of the right one, in the median of the texels of a ``part``."""
    left, more = (_variance(solved)[part] for solved in (right, wrong))
    return float(np.median(np.sqrt(more / left))) if part.any() else 0.0


def _variance(solved: SolvedTexels) -> F64:
    """(h, w) mean squared relative error of a texel's observations, and what the forward model itself is off by."""
    return np.asarray(solved.residual / np.maximum(solved.observations.astype(np.float64), 1.0) + FINEST**2)


def _evidence(without: SolvedTexels, metal: SolvedTexels, texels: Bool) -> F64:
    """(h, w) nats by which Metallic explains a texel's observations better; 0 elsewhere.

    Both models find base colour and roughness.  Errors are taken to be normal, of a size that is not known.
    """
    count = np.maximum(without.observations.astype(np.float64), 1.0)
    left, more = _variance(metal), _variance(without)
    return np.where(texels, 0.5 * count * np.log(more / left), 0.0)
