"""What a pixel observes of a lamp where the surface bends, or the lamp is wide, by more than the lobe."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.data import Light, RadianceImage, SceneData, View
from irpso_addon.core.shading import brdf, lights
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


@pytest.mark.one_python
@pytest.mark.parametrize("roughness", [0.05, 0.1])
def test_pixels_hold_all_of_a_highlight_that_is_smaller_than_they_are(roughness):
    """The highlights of points, summed over coarse pixels and over many that resolve them."""
    coarse, fine = (sum(_specular(*seen, roughness).sum() for seen in _seen_of_points(size)) / size**2
                    for size in (48, 512))
    assert coarse == pytest.approx(fine, rel=0.15)  # in no pixel's disc or in two; by two points: 0.04, 0.43


EVEN = "point", "sphere", "sun", "square", "disc"  # whose points all send alike
WIDE = {
    "point": syn.lamp(tuple(LAMP), radius=0.1),
    "sphere": syn.lamp(tuple(LAMP), radius=0.1, soft_falloff=False),
    "sun": syn.lamp(tuple(LAMP), kind="SUN", radius=0.05),
    "square": syn.lamp(tuple(LAMP), kind="AREA", size=(0.2, 0.2)),
    "disc": syn.lamp(tuple(LAMP), kind="AREA", shape="DISK", size=(0.2, 0.2)),
    "spread": syn.lamp(tuple(LAMP), kind="AREA", size=(0.2, 0.2), spread=2.0),
    "soft spot": syn.lamp(tuple(LAMP), kind="SPOT", radius=0.1, spot_angle=1.5, spot_blend=0.5),
}


def _moments(lamp: Light, P: np.ndarray, N: np.ndarray, V: np.ndarray) -> tuple[np.ndarray, ...]:
    """What a lobe should hold, by 1600 points of the lamp, of which each counts by what it would send straight on."""
    total, cosine, fresnel = np.zeros((3, len(P)))
    first, second = np.zeros((len(P), 3)), np.zeros((len(P), 3, 3))
    for i in range(1600):
        L, weight = lights.light_sample(lamp, P, np.full(len(P), i), 1600)
        L = L / np.linalg.norm(L, axis=-1, keepdims=True)
        cos_l = (L * N).sum(-1)
        weight = weight * (cos_l > 0)
        H = (L + V) / np.linalg.norm(L + V, axis=-1, keepdims=True)
        off = np.cross(N, H)
        total, cosine = total + weight, cosine + weight * cos_l
        fresnel = fresnel + weight * brdf.F_dielectric((V * H).sum(-1))
        first, second = first + weight[:, None] * off, second + (weight * off.T).T[:, None] * off[..., None]
    cosine, first, second = cosine / total, (first.T / total).T, (second.T / total).T
    middle2 = (first**2).sum(-1)
    half = 0.5 * (np.trace(second, axis1=1, axis2=2) - middle2)
    along = np.einsum("ni,nij,nj->n", first, second, first) - middle2**2
    radius2 = 4 * (along + half**2) / (middle2 + half)  # as disc_of in shaders/include/brdf.glsl
    return np.sqrt(middle2 + 2 * half - 0.5 * radius2), np.sqrt(radius2), cosine, fresnel / total


@pytest.mark.parametrize("name", WIDE)
def test_a_lobe_has_the_moments_of_all_that_a_wide_lamp_sends(name):
    """Sine of the middle half vector, radius of the half vectors' disc, mean cosine, Fresnel's reflectance.

    Lamps of which some points send less than others are sampled by 16 points that are not in balance.
    """
    _, lobe, cos_v, P, N, V = _seen(WIDE[name], 48, 0.01)
    middle, radius, cosine, fresnel = _moments(WIDE[name], P, N, V)
    inside = (cos_v > 0.3) & (cosine > 0.3)  # all of the lamp is above the horizon
    assert inside.sum() > 500
    assert 0.01 < np.median(radius[inside]) < 0.04
    seen = np.sqrt(lobe[:, 0]), np.sqrt(lobe[:, 1]), lobe[:, 2], lobe[:, 3] * 2 * lobe[:, 2] * cos_v / fresnel
    wanted = middle, radius, cosine, np.ones_like(cosine)
    for of, want, most in zip(seen, wanted, (5e-5, 2e-4, 5e-5, 1e-4), strict=True):
        np.testing.assert_allclose(of[inside], want[inside], atol=most if name in EVEN else 3e-3)


@pytest.mark.parametrize(("roughness", "typical", "most"), [
    (0.25, 1e-5, 0.05), (0.45, 5e-5, 0.003), (0.65, 6e-5, 3e-4)])
@pytest.mark.parametrize("shape", ["SQUARE", "DISK"])
def test_a_lobe_of_a_wide_lamp_above_the_horizon(shape, roughness, typical, most):
    """Of a lamp 0.4 of its distance wide: the relative error of reflectance, median and of all but a hundredth.

    The truth is a sum over 2500 points of the lamp, in float64, without the gain by multiple scattering.
    """
    lamp = syn.lamp(tuple(LAMP), kind="AREA", shape=shape, size=(0.6, 0.6), target=(0, 0, 0))
    irradiance, lobe, cos_v, P, N, V = _seen(lamp, 32, 0.01)
    seen, true, lowest = _specular(irradiance, lobe, cos_v, roughness) / irradiance, np.zeros(len(P)), np.ones(len(P))
    sent = np.zeros(len(P))
    for i in range(2500):
        L, weight = lights.light_sample(lamp, P, np.full(len(P), i), 2500)
        L = L / np.linalg.norm(L, axis=-1, keepdims=True)
        H = (L + V) / np.linalg.norm(L + V, axis=-1, keepdims=True)
        cos_l, sin2h = (L * N).sum(-1), 1 - (H * N).sum(-1) ** 2
        up = np.maximum(cos_l, 1e-3)
        each = brdf.lobe_ggx(roughness, sin2h, np.zeros(len(P)), up, cos_v) * brdf.F_dielectric((V * H).sum(-1))
        true, sent = true + weight * up * each, sent + weight * up
        lowest = np.minimum(lowest, cos_l)
    inside = (cos_v > 0.3) & (lowest > 0.25)
    assert inside.sum() > 100
    error = np.abs(seen - true / sent)[inside] / (0.3 / np.pi + (true / sent)[inside])
    assert np.median(error) < typical
    assert np.quantile(error, 0.99) < most
