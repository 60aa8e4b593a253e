"""Environments on cameras' pixels: irradiance, and what the specular lobe returns at nodes of roughness.

One shadow map for each direction; a draw takes a batch of them.  Meshes that glow add theirs (`emitter_light`).  The
nodes are kept as half floats in one texture, part by part, each of the picture's size.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Protocol

import moderngl
import numpy as np

from ...core.data import F32, F64, Emitter
from ...core.shading import environment as model
from ...core.shading.environment import SHADOW_SIDE as SIDE
from ..device.context import Device, Inputs
from ..gbuffer.gbuffer import GBufferMaps
from .emitter_light import LitByEmitters
from .shadow_sheet import COLUMNS, draw_sheet
from .visibility import Frustum, LightVisibility, parallel_frustum

BATCH = COLUMNS * COLUMNS
TOGETHER = 16  # directions of an output of observe/environment_lit.frag
DATA_WIDTH = 2048  # texels


@dataclass(frozen=True)
class EnvironmentLight:
    """One environment at one camera's pixels."""

    irradiance: moderngl.Texture  # RGBA32F: W/m^2, and of the channels' mean what soft shadows leave in doubt
    nodes: moderngl.Texture  # RGBA16F, NODES parts: see shaders/observe/environment_nodes.frag


class Pixels(Protocol):
    """A camera's pixels, as they are lit."""

    maps: GBufferMaps
    uniforms: dict[str, object]

    @property
    def defines(self) -> dict[str, str]:
        """Of include/pixel.glsl."""
        ...


class LitByEnvironment:
    """One environment's directions and their shadow maps; all belongs to the scope."""

    def __init__(
        self, device: Device, visibility: LightVisibility, directions: model.Directions,
        emitters: tuple[Emitter, ...] = (),
    ) -> None:
        self.device, self.visibility, self.directions = device, visibility, directions
        data = _rows(self.directions)
        self.data = device.texture(data.shape[1], data.shape[0], 4, data)
        self.sheets: list[moderngl.Texture] = []
        self.emitters = LitByEmitters(device, visibility, emitters) if emitters else None

    def draw_shadows(self) -> Iterator[float]:
        """All maps; yields the share that is done."""
        count = len(self.directions.toward)
        for first in range(0, count, BATCH):
            frusta = map(self._frustum, self.directions.toward[first:first + BATCH])
            self.sheets.append(draw_sheet(self.device, self.visibility, frusta, SIDE, self.visibility.is_closed))
            yield min(first + BATCH, count) / count
        if self.emitters is not None:
            yield from self.emitters.draw_shadows()

    def _frustum(self, toward: F64) -> Frustum:
        """Depth from the subject's centre on: half floats are finest there."""
        frustum = parallel_frustum(toward, self.visibility.center, self.visibility.radius, self.visibility.bounds, SIDE)
        x, y, z = (-toward).tolist()
        return Frustum(frustum.clip, (x, y, z, float(toward @ self.visibility.center)), frustum.texel, True)

    def light(self, camera: Pixels) -> Iterator[EnvironmentLight | None]:
        """The light on a camera's pixels; the last item, after None between draws."""
        device, size = self.device, camera.maps.position.size
        with device.scope() as owned:
            sums = [device.texture(*size) for _ in range(1 + model.NODES)]
            for _ in self._sum(camera, sums, 0):
                yield None
            made = EnvironmentLight(sums[0], self._divided(camera.maps, sums[0], sums[1:]))
            owned.hand_over(made.irradiance, made.nodes)
        yield made

    def irradiance(self, camera: Pixels) -> Iterator[moderngl.Texture | None]:
        """The irradiance of a camera's pixels alone; the last item, after None between draws."""
        device, size = self.device, camera.maps.position.size
        with device.scope() as owned:
            made = device.texture(*size)
            for _ in self._sum(camera, [made], model.NODES - 1):  # directions are divided as for the roughest node
                yield None
            owned.hand_over(made)
        yield made

    def _sum(self, camera: Pixels, sums: Sequence[moderngl.Texture], first: int) -> Iterator[None]:
        """Of all batches: irradiance, and nodes from ``first`` on, a few at once."""
        device, maps, each = self.device, camera.maps, model.NODES_AT_ONCE
        width, height = maps.position.size
        lit = tuple(device.texture(width, height, dtype="u4") for _ in range(BATCH // TOGETHER))
        groups = [(first, sums[:1 + each]), *((n, sums[1 + n:1 + n + each]) for n in range(each, len(sums) - 1, each))]
        with ExitStack() as open_targets:
            seen = open_targets.enter_context(device.target(lit))
            targets = [open_targets.enter_context(device.target(outputs, clear=True)) for _, outputs in groups]
            for inputs, shadows in (*self._batches(), *(self.emitters.batches() if self.emitters is not None else ())):
                self._see(camera, seen, inputs, shadows)
                for (node, outputs), target in zip(groups, targets, strict=True):
                    irradiance = outputs[0] is sums[0]
                    count = len(outputs) - irradiance
                    defines = {"FIRST_NODE": str(node), "NODE_COUNT": str(count), "EACH_NODE": f"NODES_{count}",
                               "SHARP": str(model.SHARP),
                               "NODE_ALPHA2": ", ".join(repr(r**4) for r in model.NODE_ROUGHNESS),
                               **({"IRRADIANCE": "1"} if irradiance else {})}
                    with device.adding():
                        device.draw("observe/environment.frag", target, Inputs(
                            {"u_position": maps.position, "u_normal": maps.normal, "u_lit": lit, **inputs.textures},
                            {**camera.uniforms, **inputs.uniforms},
                            {**camera.defines, **inputs.defines, **defines}), cells=maps.cells)
                    yield None

    def _see(self, camera: Pixels, seen: moderngl.Framebuffer, inputs: Inputs, shadows: Inputs) -> None:
        """Which of a batch's directions light the pixels, for all nodes."""
        maps = camera.maps
        self.device.draw("observe/environment_lit.frag", seen, Inputs(
            {"u_position": maps.position, "u_normal": maps.normal, "u_facet": maps.facet, **inputs.textures,
             **shadows.textures},
            {**camera.uniforms, **inputs.uniforms, **shadows.uniforms},
            {**camera.defines, **inputs.defines, **shadows.defines}), cells=maps.cells)

    def _batches(self) -> Iterator[tuple[Inputs, Inputs]]:
        """What the shaders need of each sheet's directions, beside what they need of pixels; and of their shadows."""
        count, visibility = len(self.directions.toward), self.visibility
        for batch, sheet in enumerate(self.sheets):
            yield Inputs({"u_directions": self.data}, {
                "u_first": BATCH * batch, "u_count": min(BATCH, count - BATCH * batch), "u_all": count,
            }, {"PARTS": str(model.PARTS), "LEVELS": str(model.LEVELS), "DATA_WIDTH": str(DATA_WIDTH)}), Inputs(
                {"u_shadow": sheet},
                {"u_center": tuple(visibility.center.tolist()), "u_half_width": 1.01 * visibility.radius},
                {"SHADOW_SIDE": str(SIDE), "SHADOW_COLUMNS": str(COLUMNS)})

    def _divided(
        self, maps: GBufferMaps, irradiance: moderngl.Texture, nodes: Sequence[moderngl.Texture],
    ) -> moderngl.Texture:
        """The nodes, from their sums."""
        device, (width, height) = self.device, maps.position.size
        made = node_texture(device, width, height)
        with device.target([made], clear=True) as target:
            for place, node in zip(node_places(width, height), nodes, strict=True):
                device.draw("observe/environment_nodes.frag", target, Inputs(
                    {"u_sums": node, "u_irradiance": irradiance}, {"u_corner": place[:2]}),
                    viewport=place, cells=maps.cells)
        return made


def share_of(
    device: Device, maps: GBufferMaps, light: EnvironmentLight, irradiance: moderngl.Texture,
    bounced: moderngl.Texture | None,
) -> moderngl.Texture:
    """The nodes relative to the irradiance of all lights of a view."""
    width, height = maps.position.size
    nodes = node_texture(device, width, height)
    with device.target([nodes], clear=True) as target:
        for place in node_places(width, height):
            device.draw("observe/environment_share.frag", target, Inputs(
                {"u_nodes": light.nodes, "u_environment": light.irradiance, "u_irradiance": irradiance,
                 **({"u_bounced": bounced} if bounced else {})}, {"u_corner": place[:2]},
                {"BOUNCED": "1"} if bounced else {}), viewport=place, cells=maps.cells)
    return nodes


def node_texture(device: Device, width: int, height: int) -> moderngl.Texture:
    """For the nodes of a picture."""
    return device.texture(model.NODE_COLUMNS * width, model.NODE_ROWS * height, dtype="f2")


def node_places(width: int, height: int) -> list[tuple[int, int, int, int]]:
    """Viewport of each node."""
    columns = model.NODE_COLUMNS
    return [(n % columns * width, n // columns * height, width, height) for n in range(model.NODES)]


def _rows(directions: model.Directions) -> F32:
    """(h, DATA_WIDTH, 4): two texels for each direction and part, as shaders/observe/environment.frag reads them."""
    levels: list[F64] = []
    level: model.Directions | None = directions
    while level is not None:
        first = np.concatenate([level.toward, level.spread[:, None]], -1)
        second = np.concatenate([level.power, np.zeros_like(level.spread)[:, None]], -1)
        levels.append(np.stack([first, second], 1).reshape(-1, 4))
        level = level.parts
    texels = np.concatenate(levels)
    height = max(-(-len(texels) // DATA_WIDTH), 1)
    padded = np.zeros((height * DATA_WIDTH, 4), np.float32)
    padded[:len(texels)] = texels
    return padded.reshape(height, DATA_WIDTH, 4)
