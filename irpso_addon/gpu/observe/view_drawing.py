"""What a view's pixels observe, drawn: radiance over irradiance and the geometry of each light's lobe."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import moderngl

from ...core.data import Light
from ...core.observation_quality import DARK_SHARE, EDGE_WEIGHT
from ...core.shading import lights as light_model
from ..device.context import Device, Inputs
from ..gbuffer.gbuffer import GBufferMaps
from .environment_light import EnvironmentLight, share_of
from .visibility import SOFT_ANGLE

# Sample points on an emitter that is not a point, for the spread of half vectors, at each of a footprint's four points:
# of a ring, or, where the emitter's parts send different light, of a lattice (decision 0002).
RING_POINTS, LATTICE_POINTS = 4, 16


class SeenThrough(Protocol):
    """A camera's pixels, as `ViewDrawer` needs them."""

    maps: GBufferMaps
    uniforms: dict[str, object]

    @property
    def defines(self) -> dict[str, str]:
        """Of include/pixel.glsl."""
        ...


class ViewDrawer:
    """Draws the views of one camera."""

    def __init__(
        self, device: Device, camera: SeenThrough, rim: moderngl.Texture, level: float, channels: int,
    ) -> None:
        """``rim``: what surrounds each pixel; ``level``: typical radiance; ``channels``: 1, or 3, each by itself."""
        self.device, self.rim, self.channels = device, rim, channels
        self._maps, self._defines = camera.maps, camera.defines
        self._common = {**camera.uniforms, "u_level": level, "u_edge_weight": EDGE_WEIGHT, "u_dark": DARK_SHARE}

    def draw(
        self, lights: Sequence[Light], image: moderngl.Texture, lit: list[moderngl.Texture],
        indirect: tuple[moderngl.Texture, moderngl.Texture] | None, around: EnvironmentLight | None = None,
    ) -> tuple[moderngl.Texture, list[moderngl.Texture], moderngl.Texture | None]:
        """Radiance over irradiance with its quality, a lobe for each light and channel, and an environment's nodes.

        ``lit``: how much of each light arrives; ``indirect``: irradiance, and what highlights of it add to the picture;
        ``around``: the view's environment.
        """
        if len(lit) == 1 and self.channels == 1 and around is None:
            colour, lobe = self.device.texture(*image.size), self.device.texture(*image.size)
            more = {"u_bounced": indirect[0], "u_glossy": indirect[1]} if indirect else {}
            self._draw("observe/view.frag", [colour, lobe], Inputs(
                {"u_image": image, "u_lit": lit[0], "u_rim": self.rim, **more},
                {**self._common, **_lamp(lights[0])},
                _lamp_defines(lights[0]) | ({"BOUNCED": "1"} if more else {})))
            return colour, [lobe], None
        return self._several(lights, image, lit, indirect, around)

    def _draw(self, name: str, outputs: list[moderngl.Texture], inputs: Inputs, clear: bool = True) -> None:
        draw_pixels(self.device, self._maps, name, outputs,
                    replace(inputs, defines={**inputs.defines, **self._defines}), clear)

    def _several(
        self, lights: Sequence[Light], image: moderngl.Texture, lit: list[moderngl.Texture],
        indirect: tuple[moderngl.Texture, moderngl.Texture] | None, around: EnvironmentLight | None,
    ) -> tuple[moderngl.Texture, list[moderngl.Texture], moderngl.Texture | None]:
        """Of several lights, channels apart, or of an environment: in passes."""
        device, common = self.device, self._common
        colour = device.texture(*image.size)
        masks = channel_masks(self.channels)
        lobes = [device.texture(*image.size) for _ in range(len(lights) * len(masks))]
        bounced: Mapping[str, moderngl.Texture] = {"u_bounced": indirect[0]} if indirect else {}
        glossy: Mapping[str, moderngl.Texture] = {"u_glossy": indirect[1]} if indirect else {}
        defines = {"BOUNCED": "1"} if indirect else {}
        with device.scope() as owned:
            irradiance, edges = device.texture(*image.size), device.texture(image.width, image.height, 1)
            with device.target([edges], clear=True):
                pass
            if around is not None:
                with device.target([irradiance], clear=True) as target:
                    device.draw("observe/copy.frag", target, Inputs(
                        {"u_map": around.irradiance}, {"u_corner": (0, 0)}), cells=self._maps.cells)
            with device.adding():
                for n, (light, shadow) in enumerate(zip(lights, lit, strict=True)):
                    self._draw("observe/irradiance.frag", [irradiance, edges], Inputs(
                        {"u_lit": shadow, "u_rim": self.rim}, {**common, **_lamp(light)}, _lamp_defines(light)),
                        clear=n == 0 and around is None)
            for n, lobe in enumerate(lobes):
                light, shadow = lights[n // len(masks)], lit[n // len(masks)]
                self._draw("observe/lobe.frag", [lobe], Inputs(
                    {"u_lit": shadow, "u_irradiance": irradiance, **bounced},
                    {**common, **_lamp(light), "u_channel": masks[n % len(masks)]}, _lamp_defines(light) | defines))
            self._draw("observe/colour.frag", [colour], Inputs(
                {"u_image": image, "u_irradiance": irradiance, "u_edges": edges, "u_rim": self.rim, **bounced,
                 **glossy}, common, defines))
            nodes = None
            if around is not None:
                nodes = around.nodes if not lights and indirect is None else share_of(
                    device, self._maps, around, irradiance, indirect[0] if indirect else None)
                owned.hand_over(nodes)
        return colour, lobes, nodes


def draw_pixels(
    device: Device, maps: GBufferMaps, name: str, outputs: list[moderngl.Texture], inputs: Inputs, clear: bool = True,
) -> None:
    """Draw a shader over a camera's pixels into new textures (or, not cleared, into what is there)."""
    textures = {"u_position": maps.position, "u_normal": maps.normal, **inputs.textures}
    with device.target(outputs, clear=clear) as target:
        device.draw(name, target, replace(inputs, textures=textures), cells=maps.cells)


def _lamp(light: Light) -> dict[str, object]:
    """Uniforms of one light."""
    return {**light_model.light_uniforms(light), "u_power": tuple(light.power)}


def _lamp_defines(light: Light) -> dict[str, str]:
    """What the programs for this light are made for: software rasterisers compute branches that uniforms decide."""
    sharp = light.kind != "AREA" and light.radius == 0.0
    point = light.kind != "AREA" and light.radius <= SOFT_ANGLE * 0.1
    ring = not point and light_model.shines_evenly(light)
    return {"LIGHT_KIND": str(light_model.KINDS.index(light.kind)), **({"LIGHT_SHARP": "1"} if sharp else {}),
            "LIGHT_POINTS": str(1 if point else RING_POINTS if ring else LATTICE_POINTS),
            **({} if point else {"LIGHT_WIDE": "1"}), **({"LIGHT_RING": "1"} if ring else {})}


def channel_masks(channels: int) -> list[tuple[float, float, float]]:
    """Which of R, G and B each channel sums."""
    return [(1.0, 1.0, 1.0)] if channels == 1 else [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
