"""Worlds whose picture is poor: fewer pixels than the light has, or a sun that is clipped."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from irpso_addon.core.data import Environment
from irpso_addon.core.shading.environment import texel_directions
from studies.environment.recover import Change, Recovered, recover
from studies.environment.shoot import RIGS

WIDTHS = (256, 128, 64, 32)  # pixels
CLIPPED = (0.3, 0.1, 0.03, 0.01)  # of the brightest channel of all pixels


@dataclass(frozen=True)
class Poor:
    """One such world, and what a solve finds."""

    words: str
    lost: float  # share of the light, summed over all directions
    found: Recovered


def cases() -> list[tuple[str, Change]]:
    """What is wrong with each picture."""
    return [("as it is", lambda environment: environment),
            *((f"{width} pixels wide", partial(coarser, width=width)) for width in WIDTHS),
            *((f"clipped at {share:g} of the brightest", partial(clipped, share=share)) for share in CLIPPED)]


def coarser(environment: Environment, width: int) -> Environment:
    """Means over solid angle: as much light arrives."""
    height, wide = environment.radiance.shape[:2]
    block = wide // width
    _, solid = texel_directions(height, wide)
    weight = np.broadcast_to(np.reshape(solid, (height, -1, 1)), environment.radiance.shape).astype(np.float64)

    def summed(values: np.ndarray) -> np.ndarray:
        return np.asarray(values.reshape(height // block, block, width, block, 3).sum((1, 3)))

    return replace(environment, radiance=(summed(weight * environment.radiance) / summed(weight)).astype(np.float32))


def clipped(environment: Environment, share: float) -> Environment:
    """As a camera's picture ends."""
    return replace(environment, radiance=np.minimum(environment.radiance, share * environment.radiance.max()))


def light(environment: Environment) -> float:
    """Summed over all directions and channels."""
    _, solid = texel_directions(*environment.radiance.shape[:2])
    return float((environment.radiance * np.reshape(solid, (len(environment.radiance), -1, 1))).sum(dtype=np.float64))


def measured(pictures: Path) -> Iterator[Poor]:
    """The bottle under one HDRI, with each."""
    rig = RIGS[0]
    for words, change in cases():
        lost: list[float] = []

        def changed(given: Environment, change: Change = change, lost: list[float] = lost) -> Environment:
            made = change(given)
            lost.append(max(1 - light(made) / light(given), 0.0))
            return made

        found, _ = recover(rig, pictures / rig.name, change=changed)
        yield Poor(words, lost[0], found)
