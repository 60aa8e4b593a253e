"""The power of a flash of which nothing is known, so that base colours fill the range from black to white."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import bpy
import numpy as np

from ...core.data import F32, F64, SOLID, Camera, Light, RadianceImage, View
from ...core.errors import BadInput
from ...core.images import decoder_pool
from ...core.images.read_ahead import ReadAhead
from ...core.images.reference_image import read_reference, with_one_white_balance
from ...core.images.response import straightened
from ...core.job import Progress, Steps, run_to_end
from ...core.projection import rays_of
from ...core.shading.lights import light_irradiance
from ..scene.scene_objects import read_camera, read_light
from .mesh_rays import MeshRays
from .shoot_objects import SPACES
from .shoot_pictures import ShootPictures

VIEWS = 8  # that are looked at
PIXELS = 64 * 64  # of each
WHITE = 0.8  # base colour of the brightest ...
QUANTILE = 0.98  # ... but for so few
STEEP = 0.3, 0.9  # cosines of the light's angle: beyond lie edges and, where the flash is near the lens, highlights


Item = TypeVar("Item")
Shown = Mapping[Path, RadianceImage]  # by the file's full path


def flash_pictures(pictures: ShootPictures, colors: str) -> Steps[Shown]:
    """What `flash_power` looks at, before there are views: large files take a second each.  Raises BadInput."""
    views = []
    for camera in _spread(pictures.cameras):
        file, mask = pictures.files.files[camera.name], pictures.files.masks.get(camera.name)
        like = Camera(camera.name, np.eye(4), np.eye(4), np.zeros(3), np.array([0.0, 0, -1]), False,
                      camera.lens.width / camera.lens.height)
        views.append(View(file.resolve(), like, (), pictures.exposures[camera.name], mask, SPACES[colors] or None))
    return (yield from _read(with_one_white_balance(views)))


def flash_power(
    context: bpy.types.Context, mesh: bpy.types.Object, views: Sequence[bpy.types.PropertyGroup], power: float,
    shown: Shown | None = None,
) -> float:
    """Watts, given that the views' lights have ``power`` now.  Raises BadInput where no view shows the mesh lit.

    ``shown``: as of `flash_pictures`, of these views; None: they are read now.
    """
    depsgraph, rays = context.evaluated_depsgraph_get(), MeshRays(context, mesh)
    chosen = with_one_white_balance([_view(context, entry, depsgraph) for entry in _spread(views)])
    images = shown
    if images is None:
        plain = [replace(view, response=1.0, shoulder=1.0) for view in chosen]
        images = run_to_end(_read(plain), lambda _: None)
    albedo = np.concatenate([_albedo(view, images[view.image], rays) for view in chosen])
    found = float(power * np.quantile(albedo, QUANTILE) / WHITE) if len(albedo) else 0.0
    if not 0 < found < np.inf:
        raise BadInput(f"mesh '{mesh.name}': it is black in every picture; check pictures, cameras and "
                       "mesh, or give the flash's power")
    return found


def _spread(items: Sequence[Item]) -> list[Item]:
    """At most VIEWS of them."""
    return [items[i] for i in np.unique(np.linspace(0, len(items) - 1, VIEWS).astype(int))]


def _read(views: Sequence[View]) -> Steps[Shown]:
    found: dict[Path, RadianceImage] = {}
    with ReadAhead(partial(read_reference, max_pixels=PIXELS), views, decoder_pool.MOST) as pictures:
        for n, view in enumerate(views):
            found[view.image] = yield from pictures.next(Progress(1.0, "light", f"{n} of {len(views)}"))
    return found


def _view(context: bpy.types.Context, entry: bpy.types.PropertyGroup, depsgraph: bpy.types.Depsgraph) -> View:
    camera = read_camera(entry.camera, context.scene, depsgraph)
    lights = tuple(read_light(item.light, depsgraph, lambda _: None) for item in entry.lights)
    mask = Path(bpy.path.abspath(entry.mask)) if entry.mask else None
    return View(Path(bpy.path.abspath(entry.image)), camera, lights, entry.exposure, mask, entry.colorspace or None,
                response=entry.response, shoulder=entry.shoulder)


def _albedo(view: View, image: RadianceImage, rays: MeshRays) -> F64:
    """Of the pixels of a view, under its lights' present power; ``image`` was read as if the file had no curve."""
    height, width = image.valid.shape
    rows, columns = np.nonzero(image.valid & (image.coverage > SOLID))
    return surface_albedo(view.camera, view.lights, np.stack([columns, rows], -1) + 0.5, (width, height),
                          straightened(image.rgb[rows, columns], view), rays)


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
