"""The power of a flash of which nothing is known, so that base colours fill the range from black to white."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import bpy
import numpy as np

from ...core.data import F32, F64, SOLID, Camera, Light, RadianceImage, View
from ...core.errors import BadInput
from ...core.images import decoder_pool
from ...core.images.reference_image import read_reference, with_one_white_balance
from ...core.projection import rays_of
from ...core.shading.lights import light_irradiance
from ..scene.scene_objects import read_camera, read_light
from .mesh_rays import MeshRays

VIEWS = 8  # that are looked at
PIXELS = 64 * 64  # of each
WHITE = 0.8  # base colour of the brightest ...
QUANTILE = 0.98  # ... but for so few
STEEP = 0.3, 0.9  # cosines of the light's angle: beyond lie edges and, where the flash is near the lens, highlights


def flash_power(
    context: bpy.types.Context, mesh: bpy.types.Object, views: Sequence[bpy.types.PropertyGroup], power: float,
) -> float:
    """Watts, given that the views' lights have ``power`` now.  Raises BadInput where no view shows the mesh lit."""
    chosen = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, VIEWS).astype(int))]
    depsgraph, rays = context.evaluated_depsgraph_get(), MeshRays(context, mesh)
    shown = with_one_white_balance([_view(context, entry, depsgraph) for entry in chosen])
    with ThreadPoolExecutor(decoder_pool.MOST, "irpso-flash") as threads:  # large RAW files take a second each
        images = list(threads.map(lambda view: read_reference(view, PIXELS), shown))
    albedo = np.concatenate([_albedo(view, image, rays) for view, image in zip(shown, images, strict=True)])
    found = float(power * np.quantile(albedo, QUANTILE) / WHITE) if len(albedo) else 0.0
    if not 0 < found < np.inf:
        raise BadInput(f"mesh '{mesh.name}': it is black in every picture; check pictures, cameras and "
                       "mesh, or give the flash's power")
    return found


def _view(context: bpy.types.Context, entry: bpy.types.PropertyGroup, depsgraph: bpy.types.Depsgraph) -> View:
    camera = read_camera(entry.camera, context.scene, depsgraph)
    lights = tuple(read_light(item.light, depsgraph, lambda _: None) for item in entry.lights)
    mask = Path(bpy.path.abspath(entry.mask)) if entry.mask else None
    return View(Path(bpy.path.abspath(entry.image)), camera, lights, entry.exposure, mask, entry.colorspace or None)


def _albedo(view: View, image: RadianceImage, rays: MeshRays) -> F64:
    """Of the pixels of a view, under its lights' present power."""
    height, width = image.valid.shape
    rows, columns = np.nonzero(image.valid & (image.coverage > SOLID))
    return surface_albedo(view.camera, view.lights, np.stack([columns, rows], -1) + 0.5, (width, height),
                          image.rgb[rows, columns], rays)


def surface_albedo(
    camera: Camera, lights: Sequence[Light], pixels: F64, size: tuple[int, int], radiance: F32, rays: MeshRays,
) -> F64:
    """(N,) of the brightest channel where ``pixels`` (n, 2), from the **lower** left, show the mesh.

    Nothing shades it, and it is matt.  ``radiance`` (n, 3); ``size``: the picture's width and height.
    """
    origins, directions = rays_of(camera, pixels, size)
    found = []
    for origin, direction, value in zip(origins, directions, radiance, strict=True):
        hit = rays.hit(origin, direction) if np.isfinite(direction).all() else None
        if hit is not None:
            found.append((*hit[0], *hit[1], *value))
    if not found:
        return np.zeros(0)
    values = np.array(found, np.float64)
    position, normal, radiances = values[:, :3], values[:, 3:6], values[:, 6:]
    irradiance = sum(light_irradiance(light, position, normal)[:, None] * light.power for light in lights)
    towards = lights[0].matrix[:3, 3] - position
    cosine = (towards * normal).sum(-1) / np.linalg.norm(towards, axis=-1)
    used = (cosine > STEEP[0]) & (cosine < STEEP[1]) & (np.asarray(irradiance).min(-1) > 0)
    if not used.any():
        used = np.asarray(irradiance).min(-1) > 0
    values = np.pi * radiances[used] / np.asarray(irradiance)[used]
    return np.asarray(values.max(-1))
