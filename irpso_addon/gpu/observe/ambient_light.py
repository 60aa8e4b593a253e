"""Light from all around that shines beside a view's lamps, as indirect light of known radiance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import moderngl
import numpy as np

from ...core.data import F32, Environment, View
from ...core.shading.environment import directions
from ..device.context import Device, Inputs
from ..gbuffer.gbuffer import MeshBuffer, Occluders
from .environment_light import LitByEnvironment
from .view_drawing import SeenThrough, draw_pixels
from .visibility import LightVisibility

HEIGHT, WIDTH = 8, 16  # pixels of the environment: directions by which what surfaces hide of it is found
Pair = tuple[moderngl.Texture, moderngl.Texture]  # irradiance, and what highlights of it add, RGB


def uniform_environment() -> Environment:
    """Of radiance 1 from everywhere."""
    return Environment("ambient light", np.ones((HEIGHT, WIDTH, 3), np.float32), np.eye(3))


def is_ambient(views: Sequence[View]) -> bool:
    """Whether some view has such light."""
    return any(any(view.ambient_radiance) for view in views)


class AmbientShadows:
    """What a mesh, and whatever casts shadows on it, hides of such light: drawn once for all that ask."""

    def __init__(self, device: Device, mesh: MeshBuffer, casters: F32) -> None:
        """``casters``: triangles, as of SceneData."""
        self._device, self._mesh, self._casters = device, mesh, casters
        self.lit: LitByEnvironment | None = None  # None: not drawn yet

    def draw(self) -> Iterator[float]:
        """All of them, unless that is done; they belong to the scope.  Yields the share that is done."""
        if self.lit is None:
            visibility = LightVisibility(self._device, self._mesh, Occluders(self._device, self._casters), 1)
            lit = LitByEnvironment(self._device, visibility, directions(uniform_environment()))
            yield from lit.draw_shadows()
            self.lit = lit

    def drawn(self) -> LitByEnvironment:
        """The same at once."""
        for _ in self.draw():
            pass
        assert self.lit is not None
        return self.lit


def with_ambient(
    device: Device, camera: SeenThrough, openness: moderngl.Texture, table: moderngl.Texture,
    radiance: tuple[float, float, float], indirect: Pair | None,
) -> Pair:
    """Its light at a camera's pixels, with other indirect light there.

    ``openness``: irradiance at radiance 1; ``table``: core.shading.tables.principled_table().
    """
    size = openness.size
    both = device.texture(*size), device.texture(*size)
    other = {"u_bounced": indirect[0], "u_glossy": indirect[1]} if indirect is not None else {}
    draw_pixels(device, camera.maps, "observe/ambient.frag", list(both), Inputs(
        {"u_open": openness, "u_principled_table": table, **other}, {**camera.uniforms, "u_radiance": radiance},
        {**camera.defines, **({"BOUNCED": "1"} if other else {})}))
    return both
