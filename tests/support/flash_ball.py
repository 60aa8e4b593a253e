"""A ball that cameras all around it photograph under the flash beside each of them, as observed texels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from irpso_addon.core.calibration.rig import Rig
from irpso_addon.core.calibration.rig_sample import RigSample
from irpso_addon.core.data import Camera, Light, View
from irpso_addon.core.evaluation.sampled_texels import SampledTexels
from irpso_addon.core.shading import brdf
from irpso_addon.core.shading.lights import light_irradiance

RADIUS = 0.8  # metres, of the ball; cameras are 1.2 to 3.5 from its surface
BESIDE = np.array([0.0, 0.12, 0.0])  # where the flash is, metres in its camera's axes
BRONZE, PATINA = np.array([0.45, 0.27, 0.13]), np.array([0.12, 0.2, 0.15])
CELLS = 5  # across half the ball: texels of a cell err alike
LEAST_COSINE = 0.1  # to lamp and camera, of what is observed

# BRDF, 1/sr, (T, 3) from directions to light and camera and normals, (T, 3) each, and the texels' positions.
Reflect = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def unit(vectors: np.ndarray) -> np.ndarray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def metal(light: np.ndarray, view: np.ndarray, normal: np.ndarray, roughness: np.ndarray) -> np.ndarray:
    """GGX with height-correlated masking and Schlick's reflectance (Walter 2007; Heitz 2014; Schlick 1994), no more."""
    half = unit(light + view)
    n_l, n_v, n_h, v_h = (np.maximum((a * b).sum(-1), 1e-4) for a, b in (
        (normal, light), (normal, view), (normal, half), (view, half)))
    a2 = roughness**4
    facets = a2 / (np.pi * (n_h**2 * (a2 - 1) + 1) ** 2)
    masking = 1 / (n_l * np.sqrt(a2 + (1 - a2) * n_v**2) + n_v * np.sqrt(a2 + (1 - a2) * n_l**2)) / 2
    colour = BRONZE + (1 - BRONZE) * ((1 - v_h) ** 5)[:, None]
    return np.asarray((facets * masking)[:, None] * colour)


def bronze(light: np.ndarray, view: np.ndarray, normal: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Roughness 0.3 to 0.5, with matt patches of patina."""
    wave = np.sin(5 * position[:, 0] / RADIUS) * np.cos(4 * position[:, 1] / RADIUS + 1)
    patches = np.sin(6 * position[:, 2] / RADIUS) * np.cos(5 * position[:, 0] / RADIUS) > 0.35
    return np.where(patches[:, None], PATINA / np.pi, metal(light, view, normal, 0.4 + 0.1 * wave))


def paint(light: np.ndarray, view: np.ndarray, normal: np.ndarray, position: np.ndarray) -> np.ndarray:
    """A dark, glossy dielectric."""
    base = np.broadcast_to(0.05 + 0.03 * np.sin(5 * position / RADIUS), normal.shape)
    return np.asarray(brdf.principled(base, np.full(len(normal), 0.4), light, view, normal))


def flash_ball(
    reflect: Reflect, *, views: int = 36, texels: int = 600, off: tuple[float, float, float] = (0.0, 0.0, 0.0),
    log_gain: np.ndarray | None = None, power: float = 1.0, floor: float = 0.001, seed: int = 1,
) -> RigSample:
    """The observations.

    ``off``: metres by which the scene has the flash beside its place, in the camera's axes.  ``log_gain``: (V,) by
    which exposures are off.  ``power``: to which the files hold radiance, white being theirs.  ``floor``: of white,
    what light that bounces and noise make of a picture.
    """
    rng = np.random.default_rng(seed)
    normal = unit(rng.standard_normal((texels, 3)))
    position = RADIUS * normal
    cameras = [_camera(n, rng) for n in range(views)]
    pictures, seen, given = [], [], []
    for camera in cameras:
        true, told = (_flash(camera, BESIDE + by) for by in (np.zeros(3), np.array(off)))
        toward, view = unit(true.matrix[:3, 3] - position), unit(camera.position - position)
        light = light_irradiance(true, position, normal)
        believed = unit(told.matrix[:3, 3] - position)
        pictures.append(reflect(toward, view, normal, position) * light[:, None])
        seen.append([(normal * believed).sum(-1), (normal * view).sum(-1), (normal * unit(believed + view)).sum(-1),
                     (view * unit(believed + view)).sum(-1)])
        given.append((told, light_irradiance(told, position, normal)))
    radiance = np.stack(pictures, 1)
    cos_l, cos_v, cos_h, across = np.array(seen).transpose(1, 2, 0)  # (T, V) each
    good = (cos_l > LEAST_COSINE) & (cos_v > LEAST_COSINE)
    white = np.percentile(radiance[good], 99.5)
    radiance = radiance * (1 + 0.01 * rng.standard_normal(radiance.shape))
    radiance += floor * white * np.abs(rng.standard_normal(radiance.shape))
    gain = np.zeros(views) if log_gain is None else log_gain
    radiance = white * (radiance / white) ** power * np.exp(gain)[:, None]
    irradiance = np.stack([light for _, light in given], 1)
    clear, steep = np.maximum(cos_v, 1e-3), np.maximum(cos_l, 1e-3)
    lobes = np.stack([1 - cos_h**2, 0 * cos_h, steep, brdf.F_dielectric(across) / (2 * steep * clear)], -1)[:, :, None]
    number = np.arange(views, dtype=np.int32)
    observed = SampledTexels(radiance / np.maximum(irradiance, 1e-9)[..., None], np.where(good, cos_v**2, 0.0), clear,
                             lobes, np.repeat(irradiance[..., None], 3, 2), number, 0 * number, number)
    rig = Rig.of([View(Path(f"{n}.exr"), camera, (lamp,)) for n, (camera, (lamp, _)) in enumerate(
        zip(cameras, given, strict=True))], np.zeros(3))
    cluster = ((normal + 1) * CELLS).astype(np.int32) @ np.array([1, 13, 169], np.int32)
    return RigSample(observed, rig, number, position, normal, np.zeros(texels, np.int32), cluster.astype(np.int32))


def bumpy(reflect: Reflect, degrees: float, seed: int = 3) -> Reflect:
    """The same where normals of cells of neighbours lean by about so much, which the mesh lacks."""
    rng, leans = np.random.default_rng(seed), dict[int, np.ndarray]()

    def bumped(light: np.ndarray, view: np.ndarray, normal: np.ndarray, position: np.ndarray) -> np.ndarray:
        cells = ((unit(position) + 1) * CELLS).astype(int) @ np.array([1, 13, 169])
        lean = np.array([leans.setdefault(int(cell), rng.standard_normal(3)) for cell in cells])
        lean *= np.radians(degrees) / np.sqrt(2)
        return reflect(light, view, unit(normal + lean - (lean * normal).sum(-1, keepdims=True) * normal), position)

    return bumped


def as_jpeg(sample: RigSample) -> RigSample:
    """Of files that may have a tone curve."""
    views = tuple(replace(view, image=view.image.with_suffix(".jpg")) for view in sample.rig.views)
    return replace(sample, rig=replace(sample.rig, views=views))


def _camera(number: int, rng: np.random.Generator) -> Camera:
    """Somewhere around the ball, and looking at it."""
    back = unit(rng.standard_normal(3))
    place = back * rng.uniform(2.0, 4.3)
    right = unit(np.cross([0.1, 0.2, 1.0], back))
    turn = np.stack([right, np.cross(back, right), back])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, -turn @ place
    return Camera(f"Camera {number}", matrix, np.eye(4), place, -back, False, 1.0)


def _flash(camera: Camera, beside: np.ndarray) -> Light:
    matrix = np.linalg.inv(camera.world_to_camera)
    matrix[:3, 3] = (matrix @ [*beside, 1.0])[:3]
    return Light(f"Flash {camera.name}", "POINT", np.full(3, 1.0), matrix)
