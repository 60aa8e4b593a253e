"""A flat sample under a flash on the camera, as observed texels: its mesh is a plane, its surface has bumps."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from irpso_addon.core.calibration.rig import Rig
from irpso_addon.core.calibration.rig_sample import RigSample
from irpso_addon.core.data import Camera, Light, View
from irpso_addon.core.evaluation.sampled_texels import SampledTexels
from irpso_addon.core.normals.tilt_sample import TiltSample
from irpso_addon.core.shading import brdf
from tests.support.tilted_sphere import bumps, unit

HEIGHT = 1.8  # of the camera, over half the side of the sample
# Nine places of the camera: over the middle, and about a half of the side away from it.
PLACES = np.array([(0, 0), (0.9, 0.1), (-0.8, 0.3), (0.1, 0.8), (0.2, -0.9), (0.5, 0.6), (-0.6, -0.5), (0.5, -0.5),
                   (-0.4, 0.7)])


def flat_relief(
    *, roughness: float = 0.35, slope: float = 0.0, noise: float = 0.02, texels: int = 800, views: int = 9,
    levels: tuple[float, float] = (0.1, 1.0), grain: float = 1.0, seed: int = 1,
) -> tuple[TiltSample, np.ndarray, np.ndarray]:
    """The observations, the true normals (T, 3) and levels (T,).

    ``slope``: of the bumps.  ``grain``: of an anisotropic lobe, roughness across over that along, which no model has.
    """
    rng = np.random.default_rng(seed)
    position = np.concatenate([rng.uniform(-1, 1, (texels, 2)), np.zeros((texels, 1))], 1)
    normal = np.broadcast_to([0.0, 0.0, 1.0], (texels, 3))
    true = unit(normal + bumps(0.3 * position, slope) * [1, 1, 0])
    base, level = rng.uniform(0.05, 0.5, (texels, 1)) * rng.uniform(0.5, 1, (texels, 3)), rng.uniform(*levels, texels)
    eye = np.concatenate([PLACES[:views], np.full((views, 1), HEIGHT)], 1)
    toward = unit(eye[None] - position[:, None])  # (T, V, 3), of camera and flash
    given, lit = toward[..., 2], np.clip((toward * true[:, None]).sum(-1), 0, 1)
    rough = roughness * np.where(np.abs(toward[..., 0]) > np.abs(toward[..., 1]), grain, 1 / grain)
    wide = [np.broadcast_to(v, (texels, views, 3)) for v in (base[:, None], true[:, None])]
    reflected = brdf.principled(wide[0], rough, toward, toward, wide[1], level=np.repeat(level[:, None], views, 1))
    reflected = reflected * (lit / given * (1 + noise * rng.standard_normal((texels, views))))[..., None]
    lobes = np.stack([1 - given**2, 0 * given, given, brdf.F_dielectric(1.0) / (2 * given * given)], -1)[:, :, None]
    light = np.pi * given * (HEIGHT / np.linalg.norm(eye[None] - position[:, None], axis=-1)) ** 2
    number = np.arange(views, dtype=np.int32)
    observed = SampledTexels(reflected, np.ones_like(given), given, lobes, np.repeat(light[..., None], 3, 2), number,
                             0 * number, number)
    shots = [View(Path(f"{n}.exr"), _camera(f"Camera {n}", place), (_flash(f"Flash {n}", place),))
             for n, place in enumerate(eye)]
    cluster = ((position[:, :2] + 1) * 5).astype(np.int32) @ np.array([1, 16], np.int32)
    rig = RigSample(observed, Rig.of(shots, np.zeros(3)), number, position, np.array(normal),
                    np.zeros(texels, np.int32), cluster.astype(np.int32))
    return TiltSample.of(rig), true, level


def _camera(name: str, place: np.ndarray) -> Camera:
    return Camera(name, np.eye(4), np.eye(4), place, np.array([0.0, 0.0, -1.0]), False, 1.0)


def _flash(name: str, place: np.ndarray) -> Light:
    matrix = np.eye(4)
    matrix[:3, 3] = place
    return Light(name, "POINT", np.full(3, 100.0), matrix)
