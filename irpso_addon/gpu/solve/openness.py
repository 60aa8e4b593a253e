"""How much of the light from all around reaches a sample of texels, by what the object and its surroundings hide."""

from __future__ import annotations

import numpy as np

from ...core.calibration.rig_sample import RigSample
from ...core.data import F32, F64
from ..device.context import Device
from ..observe.ambient_light import AmbientShadows
from ..observe.observation_atlas import CameraSource
from .world_light import SampleTexels, sample_grids


def openness(
    device: Device, source: CameraSource, shadows: AmbientShadows, sample: RigSample, surface: tuple[F32, F32, F32],
) -> F64:
    """(T,) irradiance over that of a place from which nothing is hidden; 1 where no camera sees the texel.

    ``surface``: (T, 4) each, as of GBufferMaps.
    """
    usable, camera = sample.texels.quality > 0, sample.texels.camera
    seen = np.where(usable.any(1), camera[usable.argmax(1)], -1)  # by whichever camera: each one's pixels face it
    result, lit = np.ones(len(seen)), shadows.drawn()
    with device.scope():
        for n in np.unique(seen[seen >= 0]):
            own = seen == n
            of = source.observations.cameras[n]
            texels = SampleTexels(
                sample_grids(device, surface, own), {**of.uniforms, "u_footprint": 0.0}, of.defines)
            *_, made = lit.irradiance(texels)
            assert made is not None
            result[own] = device.read(made).reshape(-1, 4)[:own.sum(), 1] / np.pi
    return result
