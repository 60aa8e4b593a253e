"""Meshes that glow on cameras' pixels: patches and their shadow maps, as `environment_light` sums directions.

A patch has one map, of the subject's sphere; one that is near the subject has six, the faces of a cube around it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import moderngl
import numpy as np

from ...core.data import F32, F64, Emitter
from ...core.shading import emitters as model
from ..device.context import Device, Inputs
from ..gbuffer.projection import Projection
from .visibility import FAR_TEXEL, Frustum, LightVisibility, frusta

SIDE = 256  # texels of a shadow map
COLUMNS = 8  # maps side by side in a sheet, and rows of them
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
        device = self.device
        single = device.texture(SIDE, SIDE, 1)
        with device.target([single]) as target:
            for number, plan in enumerate(self.plans):
                self.sheets.append(device.texture(SIDE * COLUMNS, SIDE * COLUMNS, 1, dtype="f2"))
                with device.target([self.sheets[-1]]) as sheet:
                    for n, frustum in enumerate(plan.frusta):
                        self._draw_shadow(target, frustum)
                        corner = SIDE * (n % COLUMNS), SIDE * (n // COLUMNS)
                        device.draw("observe/copy.frag", sheet, Inputs({"u_map": single}, {"u_corner": corner}),
                                    viewport=(*corner, SIDE, SIDE))
                yield (number + 1) / len(self.plans)

    def _draw_shadow(self, target: moderngl.Framebuffer, frustum: Frustum) -> None:
        """Depth from the subject's centre on: half floats are finest there."""
        target.clear(red=FAR_TEXEL)
        x, y, z, _ = frustum.plane
        plane = x, y, z, -float(np.array([x, y, z]) @ self.visibility.center)
        projection, uniforms = Projection(frustum.clip), {"u_depth_plane": plane}
        with self.device.keeping_least():
            self.visibility.mesh.draw_positions(target, "gbuffer/shadow.frag", projection, uniforms)
            self.visibility.occluders.draw(target, "gbuffer/shadow.frag", projection, uniforms)

    def batches(self) -> Iterator[Inputs]:
        """What shaders/observe/environment.frag needs of each sheet's patches, beside what it needs of pixels."""
        for plan, sheet in zip(self.plans, self.sheets, strict=True):
            yield Inputs({"u_directions": self.data, "u_sights": self.sights, "u_shadow": sheet}, {
                "u_first": plan.first, "u_count": plan.count, "u_all": len(self.patches.place),
                "u_center": tuple(self.visibility.center.tolist()), "u_radius": self.visibility.radius,
            }, {"EMITTERS": "1", "NEAR": repr(model.NEAR), "PARTS_0": str(model.PARTS[0]),
                "PARTS_1": str(model.PARTS[1]), "DATA_WIDTH": str(DATA_WIDTH), "SHADOW_SIDE": str(SIDE),
                "SHADOW_COLUMNS": str(COLUMNS)})


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
