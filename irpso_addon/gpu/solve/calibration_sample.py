"""Texels from all over an object with what its views observe: what lamps and exposures are judged by."""

from __future__ import annotations

from dataclasses import replace

import moderngl
import numpy as np

from ...core.calibration.rig import Rig
from ...core.calibration.rig_sample import RigSample, typical_light
from ...core.calibration.shade import faces_away
from ...core.data import F32, F64, I32, SOLID, Bool, View
from ...core.projection import pixels_of
from ..observe.observation_atlas import CameraSource
from .material_sample import CameraSample, read_sample, spread_squares

SIDE = 2  # texels: width of the squares; what texels are next to each other says how wide they are
TEXELS = 1000  # at most, half of those in the squares
CELLS = 12  # across the object's longest side: the texels of a cell err alike
MOST_TEXELS, OBSERVATIONS = 3000, 150_000  # of the larger sample that says by how much lamps are off


def calibration_sample(
    source: CameraSource, texels: Bool, seed: int, scale_known: bool, most: int = TEXELS,
) -> RigSample:
    """``texels``: (h, w) those to choose from.  ``scale_known``: as of the scene.  ``most``: of them."""
    return sampled(source, texels, seed, scale_known, most)[0]


def sampled(
    source: CameraSource, texels: Bool, seed: int, scale_known: bool, most: int = TEXELS,
    facet: moderngl.Texture | None = None,
) -> tuple[RigSample, tuple[F32, F32, F32]]:
    """As `calibration_sample`, and the (T, 4) position, normal and ``facet`` of its texels, as of GBufferMaps.

    Texels that nothing is observed of are left out, unless that is all.  They take time, and where they were most, they
    made what the others scatter by look like nothing.
    """
    device = source.device
    squares = spread_squares(texels, most // SIDE, seed, SIDE)
    with device.scope():
        sample = CameraSample(device, source, texels, squares)
        observed, places = read_sample(device, sample, most)
        surface = sample.places.reshape(-1, 4)[places], sample.normals.reshape(-1, 4)[places]
    flat = surface[1] if facet is None else squares.pack_texture(device, facet).reshape(-1, 4)[places]
    middle, seen = surface[0][:, :3].mean(0, dtype=np.float64), (observed.quality > 0).any(1)
    seen |= not seen.any()  # a sample of a few texels says nothing, and an empty one has no extent
    observed, surface, flat = observed.part(seen), (surface[0][seen], surface[1][seen]), flat[seen]
    position, normal = (each.astype(np.float64) for each in surface)
    views, of_layer = views_of(source)
    rig = RigSample(observed, Rig.of(views, middle), of_layer, position[:, :3], normal[:, :3],
                    normal[:, 3].round().astype(np.int32), cells_of(position[:, :3]), scale_known,
                    typical_light(observed))
    return replace(rig, shade=_shade(source, rig)), (*surface, flat)


def _shade(source: CameraSource, sample: RigSample) -> F64:
    """(T, V, C) radiance in the pixel that shows a texel which faces away from all lamps; else NaN."""
    result = np.full(sample.texels.reflected.shape, np.nan)
    away, channels = faces_away(sample), source.layers.channels
    layer = 0
    for camera in source.observations.cameras:
        x, y = camera.window[:2]
        at = pixels_of(camera.camera, sample.position, camera.maps.position.size) - (x, y)
        for channel in range(channels):
            for view in camera.views:
                picture = view.reference
                height, width = picture.shape[:2]
                with np.errstate(invalid="ignore"):
                    inside = away[:, layer] & (at >= 0).all(1) & (at[:, 0] < width) & (at[:, 1] < height)
                column, row = at[inside].astype(np.int64).T
                shown = picture[row, column].astype(np.float64)
                value = np.where(shown[:, 3:] > SOLID, shown[:, :3] * view.scale, np.nan)
                result[inside, layer] = value if channels == 1 else value[:, channel:channel + 1]
                layer += 1
    return result


def most_texels(layers: int) -> int:
    """Of a larger sample, so that a fit ends in seconds."""
    return int(np.clip(OBSERVATIONS // layers, TEXELS, MOST_TEXELS))


def views_of(source: CameraSource) -> tuple[list[View], I32]:
    """(the views, (V,) which of them each layer is)."""
    views: list[View] = []
    of_layer: list[int] = []
    for camera in source.observations.cameras:
        own = range(len(views), len(views) + len(camera.views))
        views += [view.view for view in camera.views]
        of_layer += [n for _ in range(source.layers.channels) for n in own]
    return views, np.array(of_layer, np.int32)


def cells_of(position: F64) -> I32:
    """(T,) the number of each place's cell."""
    low = position.min(0)
    at = ((position - low) * (CELLS / max(float(np.ptp(position, axis=0).max()), 1e-12))).astype(np.int32)
    return np.asarray(at @ np.array([1, CELLS + 1, (CELLS + 1)**2]), np.int32)
