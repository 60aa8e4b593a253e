"""How much of the device's memory observed pictures take, and how large they may be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...core.data import F64, Environment, View
from ...core.reporting import estimates
from ...core.shading.emitters import mean_power
from ...core.shading.environment import texel_directions


def bytes_per_pixel(views: Sequence[View]) -> int:
    """GPU memory that all views take, for each pixel that one of them has."""
    lobes = sum(len(view.lights) for view in views) * channels_needed(views)
    lit = len({(view.camera.name, view.environment.key) for view in views if view.environment is not None})
    return estimates.bytes_per_pixel(len(views), lobes, len({view.camera.name for view in views}), lit)


def most_pixels(views: Sequence[View], memory: float) -> int:
    """Pixels of a picture up to which all views fit into ``memory`` GB together."""
    return int(memory * 1e9 / bytes_per_pixel(views))


def channels_needed(views: Sequence[View]) -> int:
    """1 while radiance / irradiance has the same specular part in R, G and B, else 3.

    It has with any one light, whatever its colour, and with several of one colour; but a channel
    with hardly any light holds mostly noise, so strong colours are treated apart as well.  Of an
    environment the mean of the channels' own parts is known.
    """
    for view in views:
        powers = [light.power for light in view.lights]
        if view.environment is not None:
            powers.append(mean_radiance(view.environment))
        colours = [power / max(float(power.sum()), 1e-20) for power in powers]
        if any(np.abs(c - colours[0]).max() > 0.01 or c.min() < 0.25 * c.max() for c in colours):
            return 3
    return 1


def mean_radiance(environment: Environment) -> F64:
    """(3,) over all directions."""
    _, solid = texel_directions(*environment.radiance.shape[:2])
    world = (environment.radiance * solid[..., None]).sum((0, 1), dtype=np.float64) / (4 * np.pi)
    return np.asarray(world + mean_power(environment.emitters))
