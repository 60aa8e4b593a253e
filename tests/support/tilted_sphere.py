"""A sphere under suns, as observed texels: the believed normals are the sphere's, the true ones may be others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from irpso_addon.core.calibration.rig import Rig
from irpso_addon.core.calibration.rig_sample import RigSample
from irpso_addon.core.data import Camera, Light, View
from irpso_addon.core.evaluation.sampled_texels import SampledTexels
from irpso_addon.core.normals.tilt_sample import TiltSample
from irpso_addon.core.shading import brdf

TOWARD = np.array([0.0, 0.0, 1.0])  # the camera
BASE = np.array([0.3, 0.2, 0.12])
CELLS = 6  # across the sphere's half width: texels of a cell err alike

# BRDF, 1/sr, (T, 3) from the direction to the light and normals (T, 3).
Reflect = Callable[[np.ndarray, np.ndarray], np.ndarray]


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def degrees_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip((unit(a) * unit(b)).sum(-1), -1, 1)))


def principled(roughness: float, base: np.ndarray = BASE) -> Reflect:
    def reflect(toward_light: np.ndarray, normal: np.ndarray) -> np.ndarray:
        wide = [np.broadcast_to(v, normal.shape) for v in (base, toward_light, TOWARD)]
        return np.asarray(brdf.principled(wide[0], np.full(len(normal), roughness), wide[1], wide[2], normal))
    return reflect


def rough_diffuse(toward_light: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Burley 2012, "Physically Based Shading at Disney", section 5.3, at roughness 0.9: no Lambert."""
    cos_l, cos_v = (np.clip((normal * v).sum(-1), 0, 1) for v in (toward_light, TOWARD))
    across = float((toward_light * unit(toward_light + TOWARD)).sum())
    grazing = 0.5 + 2 * 0.9 * across**2 - 1
    value = (1 + grazing * (1 - cos_l) ** 5) * (1 + grazing * (1 - cos_v) ** 5)
    return BASE / np.pi * value[:, None]


def dielectric_diffuse(toward_light: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Light that a smooth surface of index 1.5 lets in and out (Wolff 1994, "Diffuse-reflectance model").

    Fresnel's equations in full.  White light at right angles sees BASE.
    """
    return BASE / np.pi * (_let_in((normal * toward_light).sum(-1)) * _let_in(normal @ TOWARD) / 0.96**2)[:, None]


def _let_in(cosine: np.ndarray) -> np.ndarray:
    inside = np.sqrt(1 - (1 - np.clip(cosine, 0, 1) ** 2) / 1.5**2)
    across, along = (cosine - 1.5 * inside) / (cosine + 1.5 * inside), (inside - 1.5 * cosine) / (inside + 1.5 * cosine)
    return np.asarray(1 - (across**2 + along**2) / 2)


def bumps(position: np.ndarray, slope: float) -> np.ndarray:
    """What is added to the sphere's normals: waves of about a tenth of its width."""
    x, y, z = position.T
    return slope * np.stack([np.sin(30 * y + 3 * z), np.cos(30 * x), np.sin(30 * (y - x))], -1)


def sphere(
    reflect: Reflect, *, lamps: int = 24, texels: int = 600, noise: float = 0.0, slope: float = 0.0, seed: int = 1,
    turned: float = 0.0, beside: float = 0.0,
) -> tuple[TiltSample, np.ndarray]:
    """The observations, and the true normals (T, 3).

    ``noise``: relative; ``slope``: of the bumps; ``turned``: radians by which each sun is believed elsewhere.
    ``beside``: about how far from each texel of the first half one of the second is, radians; 0: anywhere.
    """
    rng = np.random.default_rng(seed)
    normal, lit = directions(rng, texels, lamps)
    if beside:
        half = normal[:texels // 2]
        normal = np.concatenate([half, unit(half + beside * rng.standard_normal(half.shape))])
    true = unit(normal + bumps(normal, slope))
    radiance = np.stack([reflect(way, true) * np.maximum(true @ way, 0)[:, None] for way in lit], 1)
    radiance *= 1 + noise * rng.standard_normal((texels, lamps, 1))
    toward = unit(lit + np.tan(turned) * unit(np.cross(lit, rng.standard_normal((lamps, 3)))))
    camera = Camera("Camera", np.eye(4), np.eye(4), 5 * TOWARD, -TOWARD, True, 1.0)
    views = [View(Path(f"{n}.exr"), camera, (sun(f"Sun {n}", way),)) for n, way in enumerate(toward)]
    cos_v = np.repeat((normal @ TOWARD)[:, None], lamps, 1)
    given = np.clip(normal @ toward.T, 1e-3, 1)  # (T, V)
    half = unit(toward + TOWARD)
    fresnel = brdf.F_dielectric((half * TOWARD).sum(-1))
    sin2h = 1 - (normal @ half.T) ** 2
    lobes = np.stack([sin2h, 0 * sin2h, given, fresnel / (2 * given * cos_v)], -1)[:, :, None]
    number = np.arange(lamps, dtype=np.int32)
    quality = np.where(normal @ toward.T > 0.08, cos_v**2, 0.0)
    observed = SampledTexels(radiance / given[..., None], quality, cos_v, lobes,
                             np.repeat(np.pi * given[..., None], 3, 2), 0 * number, 0 * number, number)
    cluster = ((normal + 1) * CELLS).astype(np.int32) @ np.array([1, 13, 169], np.int32)
    rig = RigSample(observed, Rig.of(views, normal.mean(0)), number, normal, normal,
                    np.zeros(texels, np.int32), cluster.astype(np.int32))
    return TiltSample.of(rig), true


def seen_twice(one: RigSample, log_power: np.ndarray, log_gain: np.ndarray) -> RigSample:
    """The sample as another camera in the same place sees it too.

    ``log_power``: (V,) by which the suns are off; ``log_gain``: (2 V,) the same of exposures.
    """
    texels, count = one.texels, len(one.view)
    radiance = np.exp(np.tile(log_power, 2) + log_gain)[:, None]
    twice = {name: np.concatenate([getattr(texels, name)] * 2, 1)
             for name in ("reflected", "quality", "cos_v", "lobes", "irradiance")}
    number = np.arange(2 * count, dtype=np.int32)
    observed = SampledTexels(**{**twice, "reflected": twice["reflected"] * radiance}, camera=number // count,
                             channel=0 * number, lamps=number % count)
    others = [replace(view, image=Path(f"other {view.image}"), camera=replace(view.camera, name="Other"))
              for view in one.rig.views]
    return RigSample(observed, Rig.of([*one.rig.views, *others], one.normal.mean(0)), number, one.position, one.normal,
                     one.slot, one.cluster)


def directions(rng: np.random.Generator, texels: int, lamps: int) -> tuple[np.ndarray, np.ndarray]:
    """Normals that face the camera (T, 3), and the ways to suns (V, 3)."""
    every = unit(rng.standard_normal((8 * texels, 3)))
    toward = unit(rng.standard_normal((16 * lamps, 3)))
    return every[every[:, 2] > 0.25][:texels], toward[toward[:, 2] > 0.4][:lamps]


def sun(name: str, toward: np.ndarray) -> Light:
    """Of radiance 1 on white; ``toward``: it."""
    matrix = np.eye(4)
    matrix[:3, 0] = unit(np.cross([0.1, 0.2, 1.0], toward))
    matrix[:3, 1], matrix[:3, 2] = np.cross(toward, matrix[:3, 0]), toward
    return Light(name, "SUN", np.full(3, np.pi), matrix)
