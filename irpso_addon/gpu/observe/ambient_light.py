"""Light from all around that shines beside a view's lamps, as indirect light of known radiance."""

from __future__ import annotations

from collections.abc import Sequence

import moderngl
import numpy as np

from ...core.data import Environment, View
from ..device.context import Device, Inputs
from .view_drawing import SeenThrough, draw_pixels

HEIGHT, WIDTH = 8, 16  # pixels of the environment: directions by which what surfaces hide of it is found
Pair = tuple[moderngl.Texture, moderngl.Texture]  # irradiance, and what highlights of it add, RGB


def uniform_environment() -> Environment:
    """Of radiance 1 from everywhere."""
    return Environment("ambient light", np.ones((HEIGHT, WIDTH, 3), np.float32), np.eye(3))


def is_ambient(views: Sequence[View]) -> bool:
    """Whether some view has such light."""
    return any(any(view.ambient_radiance) for view in views)


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
