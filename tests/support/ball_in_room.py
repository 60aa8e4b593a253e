"""A ball under suns and light from all around, as observed texels, with what its shaded side shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from irpso_addon.core.calibration.rig_sample import RigSample
from irpso_addon.core.calibration.shade import faces_away
from tests.support import tilted_sphere as balls

LAMPS, NOISE, AROUND = 12, 0.01, 0.02  # AROUND: radiance, where a sun's on white is 1


def ball(around: float, turned: float = 0.0, base: np.ndarray = balls.BASE) -> RigSample:
    """Its normals are off by a degree, and read noise lies on the shade too."""
    reflect = balls.principled(0.5, base)
    made = balls.sphere(reflect, lamps=LAMPS, noise=NOISE, slope=0.02, turned=turned)[0].rig
    rng = np.random.default_rng(4)
    shine = np.zeros((len(made.normal), 3))  # of the radiance from all around, what a place reflects: by brute force
    for way in balls.unit(rng.standard_normal((4000, 3))):
        cosine = made.normal @ way
        shine[cosine > 0] += (reflect(way, made.normal) * cosine[:, None] * 4 * np.pi / 4000)[cosine > 0]
    shine = shine[:, None]
    reflected = made.texels.reflected + around * shine / made.texels.irradiance
    dark = np.where(faces_away(made)[..., None], around * shine, np.nan)
    return replace(made, texels=replace(made.texels, reflected=reflected),
                   shade=dark + 0.002 * rng.standard_normal(dark.shape), light=np.pi)
