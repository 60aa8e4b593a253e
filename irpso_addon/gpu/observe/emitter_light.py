"""Meshes that glow on cameras' pixels: patches and their shadow maps, as `environment_light` sums directions.

A patch has one map, of the subject's sphere; one that is near the subject has six, the faces of a cube around it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import moderngl
import numpy as np

from ...core.data import F32, F64, Emitter
from ...core.shading import emitters as model
from ..device.context import Device, Inputs
from .shadow_sheet import COLUMNS, draw_sheet
from .visibility import Frustum, LightVisibility, frusta

SIDE = 256  # texels of a shadow map
DATA_WIDTH = 2046  # texels: a multiple of three


@dataclass(frozen=True)
class _Sheet:
    """Shadow maps of some patches, one after the other."""

    first: int  # patch
    count: int
    frusta: list[Frustum]


class LitByEmitters:
    """Patches of some emitters and their shadow maps; all belongs to the scope."""

    def __init__(self, device: Device, visibility: LightVisibility, emitters: Sequence[Emitter]) -> None:
        self.device, self.visibility = device, visibility
        self.patches = model.patches(emitters, visibility.center, visibility.radius)
        self.plans, sights = _planned(self.patches.sight, visibility)
        self.data, self.sights = _texture(device, _rows(self.patches)), _texture(device, sights)
        self.sheets: list[moderngl.Texture] = []

    def draw_shadows(self) -> Iterator[float]:
        """All maps; yields the share that is done."""
        for number, plan in enumerate(self.plans):
            frusta = map(self._from_center, plan.frusta)
            self.sheets.append(draw_sheet(self.device, self.visibility, frusta, SIDE))
            yield (number + 1) / len(self.plans)

    def _from_center(self, frustum: Frustum) -> Frustum:
        """Depth from the subject's centre on: half floats are finest there."""
        x, y, z, _ = frustum.plane
        return replace(frustum, plane=(x, y, z, -float(np.array([x, y, z]) @ self.visibility.center)))

    def batches(self) -> Iterator[tuple[Inputs, Inputs]]:
        """As of an environment's directions, of each sheet's patches."""
        for plan, sheet in zip(self.plans, self.sheets, strict=True):
            yield Inputs({"u_directions": self.data}, {
                "u_first": plan.first, "u_count": plan.count, "u_all": len(self.patches.place),
            }, {"EMITTERS": "1", "NEAR": repr(model.NEAR), "PARTS": str(model.PARTS),
                "LEVELS": str(model.LEVELS), "DATA_WIDTH": str(DATA_WIDTH)}), Inputs(
                {"u_sights": self.sights, "u_shadow": sheet},
                {"u_center": tuple(self.visibility.center.tolist()), "u_radius": self.visibility.radius},
                {"SHADOW_SIDE": str(SIDE), "SHADOW_COLUMNS": str(COLUMNS)})


def _planned(sights: F64, visibility: LightVisibility) -> tuple[list[_Sheet], F32]:
    """Sheets, and (N, 4) each sight with its first map in the sheet, or, of six maps, -1 minus that."""
    plans: list[_Sheet] = []
    rows = np.zeros((len(sights), 4), np.float32)
    for n, sight in enumerate(sights):
        found = frusta(np.append(sight, 1.0), visibility.center, visibility.radius, visibility.bounds, SIDE)
        if not plans or len(plans[-1].frusta) + len(found) > COLUMNS * COLUMNS:
            plans.append(_Sheet(n, 0, []))
        first = len(plans[-1].frusta)
        rows[n] = *sight, first if len(found) == 1 else -1 - first
        plans[-1] = _Sheet(plans[-1].first, plans[-1].count + 1, plans[-1].frusta + found)
    return plans, rows


def _rows(patches: model.Patches) -> F32:
    """(N, 4): three texels for each patch and part: place, size; normal, 0; power, 0."""
    levels: list[F64] = []
    level: model.Patches | None = patches
    while level is not None:
        none = np.zeros_like(level.size)[:, None]
        levels.append(np.stack([np.concatenate([level.place, level.size[:, None]], -1), np.concatenate(
            [level.normal, none], -1), np.concatenate([level.power, none], -1)], 1).reshape(-1, 4))
        level = level.parts
    return np.concatenate(levels).astype(np.float32)


def _texture(device: Device, rows: F32) -> moderngl.Texture:
    height = max(-(-len(rows) // DATA_WIDTH), 1)
    padded = np.zeros((height * DATA_WIDTH, 4), np.float32)
    padded[:len(rows)] = rows
    return device.texture(DATA_WIDTH, height, 4, padded.reshape(height, DATA_WIDTH, 4))
