"""The refined normals of all texels: tile by tile what the observations say, then smoothed on the grid."""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Generator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import moderngl
import numpy as np

from ...core.calibration.rig import Rig
from ...core.calibration.rig_sample import RigSample
from ...core.calibration.texel_materials import lobes_of
from ...core.data import F32, F64, I32, Bool
from ...core.evaluation.joint_material import OneMaterial
from ...core.evaluation.sampled_texels import one_lobe
from ...core.job import Progress, Steps, share_of
from ...core.normals.judge import NormalsJudged
from ...core.normals.tangent_map import padded
from ...core.normals.texel_tilts import TexelTilts
from ...core.normals.tilt_fit import Beside, fit_tilts
from ...core.normals.tilt_sample import TiltedWorlds, TiltSample
from ..observe.observation_atlas import CameraSource, Layers, ObservationAtlas, tiles
from .calibration_sample import views_of
from .material_sample import LayerLight, observed_texels
from .world_light import TiltedLight

SAMPLE = 1500  # texels that say whether normals are refined
SAMPLE_UNDER_WORLDS = 500  # the same where light from all around is drawn for each
MOST = 250_000  # texels that are fitted: pictures seldom tell more apart
PADDING = 4  # texels around islands: what is interpolated there
MOST_UNDER_WORLDS = 750_000  # observations of texels that are fitted, where light from all around is drawn for each
AT_ONCE = 80_000  # observations of light, of texels that are fitted together: as many as fit into a core's cache
ROUNDS, OWN, AGAIN = 2, 3, 2  # of the fit with the material's roughness, with each texel's own, and from tilts found
LEAST = 200  # texels that are fitted together: they say what is noise
THREADS = min(os.cpu_count() or 1, 8)  # that fit texels, beside that which reads them


def refined_normals(
    source: CameraSource, texels: Bool, judged: NormalsJudged, scale_known: bool, facet: moderngl.Texture,
    worlds: TiltedLight | None = None, most: int = MOST, near: F32 | None = None,
) -> Generator[Progress, None, F32]:
    """(m, m, 3) over the UV square: what is to be added to the unit shading normals of the ``texels``, (h, w).

    m is less than h where there are more texels than ``most``: then every second or third row and column says the
    tilts.
    ``facet``: as of GBufferMaps.  ``worlds``: where some view has an environment.  ``near``: what was found of fewer
    texels, or under a mesh that was a little off.
    """
    device, layers = source.device, source.layers
    most = most if worlds is None else min(most, MOST_UNDER_WORLDS // len(layers.groups))
    step = max(math.ceil(math.sqrt(np.count_nonzero(texels) / most)), 1)
    kept = np.zeros_like(texels)
    some = slice(step // 2, None, step)
    kept[some, some] = True
    kept &= texels
    position = device.read(source.grid.position)[..., :3]
    normal = device.read(source.grid.normal)
    found = TexelTilts(position, normal[..., :3], kept)
    views, of_layer = views_of(source)
    rig = Rig.of(views, position[texels].mean(0).astype(np.float64))

    def observed(at: tuple[I32, I32], blocks: F32, kept: Bool) -> RigSample:
        own, some = of_layer[kept], replace(layers, groups=tuple(int(n) for n in np.array(layers.groups)[kept]))
        light = _light(blocks, layers.lights, own)
        return RigSample(observed_texels(blocks, some, light), rig, own, position[at].astype(np.float64),
                         _unit(normal[at][:, :3].astype(np.float64)), normal[at][:, 3].round().astype(np.int32),
                         np.zeros(len(blocks), np.int32), scale_known)

    flat = device.read(facet) if worlds is not None else None

    def around(at: tuple[I32, I32], blocks: F32) -> Steps[TiltedWorlds | None]:
        if worlds is None or flat is None:
            return None
        surface = np.concatenate([position[at], np.ones((len(blocks), 1), np.float32)], 1), normal[at], flat[at]
        return (yield from worlds(surface, seen_by(blocks[:, :, 0, 1], layers)))

    def fitted(at: tuple[I32, I32], blocks: F32, light: TiltedWorlds | None) -> tuple[F64, F64]:
        kept = _shown(blocks, layers) if light is None else np.ones(len(of_layer), bool)
        sample = TiltSample.of(observed(at, blocks[:, kept], kept), light)
        return _fitted(sample, judged, None if near is None else sample.in_plane(_at(near, at, len(texels))))

    fits: deque[tuple[tuple[I32, I32], Future[tuple[F64, F64]]]] = deque()
    pool = ThreadPoolExecutor(THREADS, "irpso-normals")
    try:
        for done, at, blocks in _read(source, kept):
            if at is not None and blocks is not None:
                light = yield from share_of(around(at, blocks), 0.9 * done, 0.9 * done)
                fits.append((at, pool.submit(fitted, at, blocks, light)))
            if len(fits) > THREADS:
                _take(found, fits)
            yield Progress(0.9 * done, "normals", "shading normals")
        while fits:
            _take(found, fits)
            yield Progress(0.9, "normals", "shading normals")
    finally:
        pool.shutdown(cancel_futures=True)
    part = found.of((some, some)) if step > 1 else found
    return padded(part.offsets(judged.deviation, judged.beside is Beside.LEVEL, judged.large), part.texels, PADDING)


def _take(found: TexelTilts, fits: deque[tuple[tuple[I32, I32], Future[tuple[F64, F64]]]]) -> None:
    """The fit that was begun first."""
    at, fit = fits.popleft()
    found.add(at, *fit.result())


def _read(
    source: CameraSource, texels: Bool,
) -> Generator[tuple[float, tuple[I32, I32] | None, F32 | None], None, None]:
    """Share that is done, and rows, columns and the blocks (T, layers, blocks, 4) of some texels; or a pause.

    Of those that some view observes, sorted by the views that do, so that the texels of a fit lack the same ones.
    """
    device, layers = source.device, source.layers
    each = max(AT_ONCE // (len(layers.groups) * max(layers.lights, 1)), LEAST)
    with device.scope():
        atlas = ObservationAtlas(device, source)
        w, h = atlas.tile
        places = tiles(atlas, texels)
        for n, (x, y) in enumerate(places):
            for _ in source.gather(atlas, (x, y), layers.channels == 1):
                yield n / len(places), None, None
            blocks = device.read(atlas.texture).reshape(layers.blocks, h, w, 4)
            seen = (blocks[::layers.each, ..., 1] > 0)[:, :texels.shape[0] - y, :texels.shape[1] - x]
            row, column = (index.astype(np.int32) for index in np.nonzero(texels[y:y + h, x:x + w] & seen.any(0)))
            order = np.lexsort(np.packbits(seen[:, row, column], axis=0)[::-1])
            row, column = row[order], column[order]
            for first in range(0, len(row), each):
                down, along = row[first:first + each], column[first:first + each]
                own = np.moveaxis(blocks[:, down, along], 0, 1)
                yield n / len(places), (down + y, along + x), own.reshape(
                    len(down), len(layers.groups), layers.each, 4)


def _shown(blocks: F32, layers: Layers) -> Bool:
    """(V,) layers that some of the texels are observed in, and all of a camera of which that is one alone.

    A camera with one view has no base colour of its own.
    """
    shown: Bool = (blocks[:, :, 0, 1] > 0).any(0)
    _, group = np.unique(layers.groups, return_inverse=True)
    return np.asarray(shown | (np.bincount(group, shown) == 1)[group])


def _at(values: F32, at: tuple[I32, I32], size: int) -> F64:
    """Of a square grid of other texels, where rows and columns of one of ``size`` lie."""
    row, column = (index * len(values) // size for index in at)
    return values[row, column].astype(np.float64)


def _fitted(sample: TiltSample, judged: NormalsJudged, tilt: F64 | None) -> tuple[F64, F64]:
    """(information, pull) of some texels, each with its own roughness under its own tilt.

    ``tilt``: (T, 2) about what it is; None: nothing is known of it.  Levels beside it take all rounds in any case.
    """
    known = [judged.materials.get(int(slot), OneMaterial(0.5)) for slot in sample.rig.slot]
    rough, level = (np.array([getattr(one, name) for one in known]) for name in ("roughness", "level"))
    first = one_lobe(rough, level)
    fit = partial(fit_tilts, sample, scatter=judged.scatter, beside=judged.beside)
    if judged.beside is Beside.LEVEL:  # the roughness is the material's
        fit = partial(fit, deviation=judged.deviation)
    lobes, rounds = first, AGAIN
    if tilt is None or judged.beside is Beside.LEVEL:
        found = fit(first, rounds=ROUNDS)
        tilt, lobes, rounds = found.under(judged.deviation)[0], found.lobes, OWN
    if judged.beside is not Beside.LEVEL:
        lobes = lobes_of(sample.rig, sample.tilted(tilt)[0], judged.materials)
    found = fit(lobes, start=tilt, rounds=rounds)
    return found.information, found.pull


def seen_by(quality: F32 | F64, layers: Layers) -> Bool:
    """(T, cameras) by which cameras texels are seen, of (T, V) qualities."""
    camera = np.array(layers.groups) // layers.channels
    return np.stack([(quality[:, camera == n] > 0).any(1) for n in range(camera.max() + 1)], -1)


def _light(blocks: F32, lights: int, of_layer: np.ndarray) -> LayerLight:
    """What weighs observations against each other where the lamps' own light is not needed; worlds weigh alike."""
    cosine = blocks[:, :, 2:2 + lights, 2].max(-1, initial=1e-3) if lights else np.ones(blocks.shape[:2])
    return LayerLight(np.asarray(cosine, np.float64)[..., None], of_layer)


def _unit(normal: F64) -> F64:
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12))
