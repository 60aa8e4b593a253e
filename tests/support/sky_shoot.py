"""Exact pictures of the bumpy plane under environments and lamps, without any renderer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from irpso_addon.core.data import Environment, RadianceImage, SceneData, View
from irpso_addon.core.shading import environment
from tests.support import synthetic as syn

PIXELS = 40


def picture(sky: Environment | None, view: View, truth: syn.Truth, pixels: int = PIXELS) -> RadianceImage:
    """The plane under its lamps and a sum over all pixels of the environment that stand above the plane."""
    origin, direction = syn.pixel_rays(view.camera, pixels, pixels)
    points = syn.meet_plane(origin, direction)
    seen = np.isfinite(points[..., 0]) & (np.abs(points[..., :2]) <= 1).all(-1)
    rgb = np.zeros((pixels, pixels, 3))
    if sky is not None:
        rgb[seen] = _under_sky(sky, points[seen], -direction[seen], truth)
    rgb[seen] += syn.radiance(truth, points[seen], -direction[seen], view.lights)
    return RadianceImage(rgb.astype(np.float32), seen.astype(np.float32), np.ones(seen.shape, bool))


def _under_sky(sky: Environment, points: np.ndarray, toward_camera: np.ndarray, truth: syn.Truth) -> np.ndarray:
    """(P, 3) radiance."""
    toward, solid = environment.texel_directions(*sky.radiance.shape[:2])
    L = (toward @ sky.rotation).reshape(-1, 3)
    power = (sky.radiance * solid[..., None]).reshape(-1, 3).astype(np.float64)
    L, power = L[L[:, 2] > 0], power[L[:, 2] > 0]
    uv, normal = syn.plane_uv(points), syn.plane_normal(points)
    base, rough = truth.base(uv[:, 0], uv[:, 1]), truth.roughness(uv[:, 0], uv[:, 1])
    values = []
    for n, (N, V) in enumerate(zip(normal, toward_camera, strict=True)):
        f = truth.reflect(base[n], rough[n], L, V, N)
        values.append((f * np.maximum(L @ N, 0)[:, None] * power).sum(0))
    return np.array(values)


def shoot(views: Sequence[View], truth: syn.Truth = syn.PATCHES, pixels: int = PIXELS) -> syn.Shoot:
    """The views' pictures, and a scene that is right."""
    images = {view.image.name: picture(view.environment, view, truth, pixels) for view in views}
    scene = SceneData("plane", syn.plane_mesh(), np.zeros((0, 3, 3), np.float32), tuple(views), pixel_filter=0.01)
    return syn.Shoot(scene, images, truth)
