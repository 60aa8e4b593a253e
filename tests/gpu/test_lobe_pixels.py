"""What a pixel observes of a lamp where the surface bends, or the lamp is wide, by more than the lobe."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.data import Light, RadianceImage, SceneData, View
from irpso_addon.core.shading import brdf
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.gbuffer.gbuffer import MeshBuffer
from irpso_addon.gpu.observe.observations import observe
from tests.support import synthetic as syn

LAMP, WIDTH = np.array([0.0, -2.0, 1.2]), 1.6
CAM = syn.camera((0, -4.0, 1.0), degrees=32)


def _seen(light: Light, size: int, pixel_filter: float) -> tuple[np.ndarray, ...]:
    """(irradiance, lobe (P, 4), cos_v, place, normal, direction to the camera) at good pixels of a sphere."""
    def white(_: View) -> RadianceImage:
        return RadianceImage(np.ones((size, size, 3), np.float32), np.ones((size, size), np.float32),
                             np.ones((size, size), bool))

    mesh = syn.mesh_arrays(*syn.sphere(64, 32))
    scene = SceneData("sphere", mesh, np.zeros((0, 3, 3), np.float32), (View(Path("a.exr"), CAM, (light,)),),
                      pixel_filter=pixel_filter)

    def job():
        device = thread.device()
        with device.scope():
            seen = yield from observe(device, scene, MeshBuffer(device, mesh), white)
            (camera,) = seen.cameras
            (view,) = camera.views
            return (device.read(view.colour), device.read(view.lobes[0]), device.read(camera.maps.position),
                    device.read(camera.maps.normal))

    colour, lobe, position, normal = (np.asarray(a, np.float64) for a in thread.run(job))
    N, V = normal[..., :3], CAM.position - position[..., :3]
    V /= np.linalg.norm(V, axis=-1, keepdims=True)
    cos_v = (N * V).sum(-1)
    good = (position[..., 3] > 0.5) & (colour[..., 3] > 0.5 * cos_v**2) & (colour[..., 0] > 0)
    return 1 / colour[good][:, 0], lobe[good], cos_v[good], position[good][:, :3], N[good], V[good]


def _specular(irradiance: np.ndarray, lobe: np.ndarray, cos_v: np.ndarray, roughness: float) -> np.ndarray:
    """Radiance, without the gain by multiple scattering."""
    sin2h, radius2, cos_l, factor = lobe.T
    return irradiance * brdf.lobe_ggx(roughness, sin2h, radius2, cos_l, cos_v) * 2 * cos_l * cos_v * factor


@pytest.mark.parametrize("roughness", [0.05, 0.1])
def test_a_smooth_surface_mirrors_a_wide_lamp(roughness):
    """Where the mirror direction meets the lamp well inside, its radiance by Fresnel's reflectance is seen."""
    lamp = syn.lamp(tuple(LAMP), kind="AREA", size=(WIDTH, WIDTH), target=(0, 0, 0))
    irradiance, lobe, cos_v, P, N, V = _seen(lamp, 64, 0.01)
    mirrored = 2 * cos_v[:, None] * N - V
    axes = lamp.matrix[:3, :3]
    along = ((LAMP - P) @ axes[:, 2]) / (mirrored @ axes[:, 2])
    across = (P + along[:, None] * mirrored - LAMP) @ axes[:, :2]
    inside = (along > 0) & (np.abs(across) < 0.3 * WIDTH).all(-1)
    assert inside.sum() > 20
    radiance = lamp.power.mean() / (np.pi * WIDTH**2)
    off = _specular(irradiance, lobe, cos_v, roughness)[inside] / (radiance * brdf.F_dielectric(cos_v[inside])) - 1
    assert np.abs(off).max() < 0.15  # it counts as a disc; by two points of the lobe most is missing


@functools.cache
def _seen_of_points(size: int) -> list[tuple[np.ndarray, ...]]:
    """(irradiance, lobe, cos_v) under each of 16 points."""
    lamps = [syn.lamp(2.3 * np.array([np.sin(t), -np.cos(t), 0.3 + 0.1 * t])) for t in np.linspace(-0.7, 0.7, 16)]
    return [_seen(lamp, size, 1.0)[:3] for lamp in lamps]


@pytest.mark.parametrize("roughness", [0.05, 0.1])
def test_pixels_hold_all_of_a_highlight_that_is_smaller_than_they_are(roughness):
    """The highlights of points, summed over coarse pixels and over many that resolve them."""
    coarse, fine = (sum(_specular(*seen, roughness).sum() for seen in _seen_of_points(size)) / size**2
                    for size in (48, 512))
    assert coarse == pytest.approx(fine, rel=0.15)  # in no pixel's disc or in two; by two points: 0.04, 0.43
