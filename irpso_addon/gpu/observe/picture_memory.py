"""How much of the device's memory observed pictures take, and how large they may be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...core.data import F64, Environment, SceneData, View
from ...core.images.image_file import open_image
from ...core.maps.stride import ENOUGH, pixels_per_texel, stride_of
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


def coarser_line(scene: SceneData, size: int, memory: float) -> tuple[str, ...]:
    """What to say where ``memory`` GB leave so little of the pictures that fewer texels of a map are searched.

    Raises BadInput for a picture that cannot be opened.
    """
    views, most = scene.views, most_pixels(scene.views, memory)
    files = [open_image(view.image, view.full_raw) for view in views]
    shares = [min(1.0, (most / (file.width * file.height)) ** 0.5) for file in files]
    if min(shares, default=1.0) == 1:
        return ()
    whole, reduced = (pixels_per_texel(scene.mesh, [
        (view.camera, (max(1, int(share * file.width)), max(1, int(share * file.height))))
        for view, file, share in zip(views, files, kept, strict=True)], size) for kept in ([1.0] * len(files), shares))
    finest, found = stride_of(whole, size), stride_of(reduced, size)
    if found <= finest:
        return ()
    n = int(np.argmin(shares))
    enough = ENOUGH / (2 * finest) ** 2 / float(whole.mean()) * files[n].width * files[n].height
    needed = np.ceil(bytes_per_pixel(views) * enough / 1e8 + 0.1) / 10
    return (f"all views: too many pixels for {memory:g} GB ('{views[n].image.name}' is reduced from {files[n].width} x "
            f"{files[n].height} to {int(shares[n] * files[n].width)} x {int(shares[n] * files[n].height)}), so IRPSO "
            f"searched one of {found**2 // finest**2} texels that the pictures show apart; increase Memory to "
            f"{needed:g} GB",)


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
    _, of_row = texel_directions(len(environment.radiance), 1)
    world = (environment.radiance.mean(1, dtype=np.float64) * of_row).sum(0) / (4 * np.pi)
    return np.asarray(world + mean_power(environment.emitters))
