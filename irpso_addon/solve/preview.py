"""The first look at a solve: coarse maps from a few reduced pictures, then finer ones, and how well they explain those.

It runs beside the real thing, in a worker that is already warm: shaders compiled, and alike for every scene, because
the number of views that they are made for is always VIEWS.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import moderngl
import numpy as np

from ..core.data import F32, Bool, Camera, Light, MeshArrays, RadianceImage, SceneData, View, ViewPicture
from ..core.errors import BadInput
from ..core.images import decoder_pool
from ..core.images.reference_image import read_reference
from ..core.job import Mailbox, Progress, Steps, retold
from ..core.live_maps import Live
from ..core.params import SolveSettings
from ..gpu.device import thread
from ..gpu.device.context import Device
from ..gpu.gbuffer.gbuffer import GBufferMaps, MeshBuffer
from ..gpu.gbuffer.texel_grid import TexelGrid, draw_texels
from ..gpu.maps.albedo import AlbedoSolver, Gloss
from ..gpu.maps.check_views import check_views, with_view_pictures
from ..gpu.maps.fill import fill
from ..gpu.observe.observation_atlas import CameraSource, ObservationAtlas, Tile
from ..gpu.observe.observations import Observations, ObserveOptions, observe
from ..gpu.solve import live_readback
from ..gpu.solve.solver import Solver
from .kept_images import reference_key

VIEWS = 12  # looked at, at most
FEWEST = 3  # with which to begin, when reading is slow
PATIENCE = 0.15  # seconds for reading more
PIXELS = 144 * 144  # of a reduced picture
SIZES = (128, 256, 512)  # texels
ITERATIONS = 2  # of base colour
SHADOW = 512  # texels of a shadow map
IDLE = 0.1  # seconds between two looks for maps to judge
Result = TypeVar("Result")
Images = dict[Hashable, RadianceImage]  # by `reference_key`


def preview(scene: SceneData, settings: SolveSettings, mailbox: Mailbox) -> Steps[None]:
    """Looks, coarse to fine; then the errors of whatever maps come into the ``mailbox``, until cancelled.

    Raises BadInput when no picture can be used.
    """
    images: Images = {}
    with ThreadPoolExecutor(4) as readers:
        order = spread(len(scene.views))
        reading = {readers.submit(read_reference, view, PIXELS): view for view in (scene.views[n] for n in order)}
        _first(reading, images)
        yield from _refined(_of(scene, order, images), settings, images, SIZES[:1])
        wait(reading)
        _take(reading, images)
    every = _of(scene, order, images)
    yield from _refined(every, settings, images, SIZES[1:], mailbox)


def warm_up() -> Steps[None]:
    """Compiles what every preview needs, on a scene of one square; and its images will not wait for decoders."""
    decoder_pool.warm_up()
    scene, images = _square()
    yield from _refined(scene, SolveSettings(size=16), images, (16,))


def spread(count: int) -> list[int]:
    """Places of at most VIEWS of so many views, far apart in the list, the farthest first."""
    chosen = range(count) if count <= VIEWS else [i * count // VIEWS for i in range(VIEWS)]
    return [chosen[i] for i in sorted(range(len(chosen)), key=lambda i: i * 7 % 12)]


def _first(reading: dict[Future[RadianceImage], View], images: Images) -> None:
    """Enough pictures to begin with."""
    wait(reading, timeout=PATIENCE)
    while len(images) < min(FEWEST, len(reading)) and not all(future.done() for future in reading):
        _take(reading, images)
        time.sleep(0.01)
    _take(reading, images)


def _take(reading: dict[Future[RadianceImage], View], images: Images) -> None:
    for future, view in reading.items():
        if future.done() and future.exception() is None:
            images[reference_key(view)] = future.result()


def _of(scene: SceneData, order: list[int], images: Images) -> SceneData:
    """The scene with those views of the ``order`` that were read."""
    views = tuple(view for view in (scene.views[n] for n in sorted(order)) if reference_key(view) in images)
    if not views:
        raise BadInput(f"{scene.name}: no picture can be read")
    return replace(scene, views=views)


# ---- solving


def _refined(
    scene: SceneData, settings: SolveSettings, images: Images, sizes: tuple[int, ...],
    mailbox: Mailbox | None = None,
) -> Steps[None]:
    """A solve at each size from the same observations; then judges what comes into the mailbox.

    Without one they are the first that are seen, and the last here.
    """
    device, first = thread.device(), mailbox is None
    with device.scope():
        mesh = MeshBuffer(device, scene.mesh)
        observations: Observations = yield from observe(
            device, scene, mesh, lambda view: images[reference_key(view)], ObserveOptions(shadow_size=SHADOW))
        if not observations.cameras:
            raise BadInput("; ".join(f"{name}: {why}" for name, why in observations.skipped))
        for size in sizes:
            if size < settings.size or first:  # as fine as the solve is the solve itself
                with device.scope():
                    texels = draw_texels(device, mesh, min(size, settings.size))
                    yield from _solve(device, texels, observations, settings, first)
        if mailbox is not None:
            yield from _judge(device, observations, draw_texels(device, mesh, 16).maps, mailbox)


def _solve(
    device: Device, texels: TexelGrid, observations: Observations, settings: SolveSettings, first: bool,
) -> Steps[None]:
    """One size.  ``first``: before anything else base colour as of a surface without gloss, which is there at once."""
    grid, coverage = texels.maps, texels.coverage
    if first:
        shape = coverage.shape
        gloss = Gloss(_constant(device, shape, 0.5, 0.5, 1.0), _constant(device, shape, 0.0, 0.0, 0.0))
        matte = AlbedoSolver(device, grid, observations, gloss)
        base = yield from _silent(matte.solve(iterations=0))
        yield _look_due(live_readback.base_color(device, base), coverage)
        yield _look_due(Live({}, pictures=_pictures(matte, base)), coverage)
    solver = Solver(device, _Source(device, grid, observations),
                    replace(settings, method="draft", model="one-lobe", loss="squares"))
    maps = yield from _with_coverage(solver.solve(), coverage)
    fit = maps.read(device)
    rough = fit.roughness
    known = _texture(device, rough, rough, np.ones_like(rough), fit.solved.astype(np.float32))
    lobes = fill(device, known)
    albedo = AlbedoSolver(device, grid, observations, Gloss(lobes))
    base = yield from _silent(albedo.solve(ITERATIONS))
    filled = fill(device, base)
    solved = fit.solved
    sure = live_readback.confidence(fit.sigma, fit.observations)
    error = live_readback.relative_error(fit.residual, fit.observations)
    yield _look_due(Live({
        "base_color": device.read(filled)[..., :3].copy(), "roughness": device.read(lobes)[..., 0].copy(),
        "confidence": np.where(solved, sure, np.float32(0)), "error": np.where(solved, error, np.float32(0)),
    }, pictures=_pictures(albedo, filled)), coverage)


def _judge(device: Device, observations: Observations, grid: GBufferMaps, mailbox: Mailbox) -> Steps[None]:
    """How well maps that are handed in explain the reduced pictures, until cancelled."""
    while True:
        maps = mailbox.take(IDLE)
        if maps is None:
            yield Progress(1.0, "preview")
            continue
        base_color, rough = maps["base_color"], maps["roughness"]
        known = [np.isfinite(values).astype(np.float32) for values in (base_color[..., 0], rough)]
        rough, base_color = np.nan_to_num(rough), np.nan_to_num(base_color)
        with device.scope():
            base = fill(device, _texture(device, *np.moveaxis(base_color, -1, 0), known[0]))
            lobes = fill(device, _texture(device, rough, rough, np.ones_like(rough), known[1]))
            live = Live({}, pictures=_pictures(AlbedoSolver(device, grid, observations, Gloss(lobes)), base))
        yield Progress(1.0, "preview", look=partial(_same, live), due=True)


def _pictures(albedo: AlbedoSolver, base: moderngl.Texture) -> tuple[ViewPicture, ...]:
    """The views beside what the maps predict."""
    pictures: list[ViewPicture] = []
    for _ in with_view_pictures(check_views(albedo, base, albedo.observations.cameras), pictures):
        pass
    return tuple(pictures)


def _with_coverage(steps: Steps[Result], coverage: Bool) -> Steps[Result]:
    """The same, with coverage in each look."""
    return retold(steps, lambda step: Progress(
        step.fraction, "preview", look=step.look and partial(_covered, step.look, coverage)))


def _same(live: Live) -> Live:
    return live


def _covered(seen: Callable[[], Live], coverage: Bool) -> Live:
    return replace(seen(), coverage=coverage)


def _silent(steps: Steps[Result]) -> Steps[Result]:
    """The same, with nothing to look at."""
    return retold(steps, lambda step: replace(step, look=None))


def _look_due(live: Live, coverage: Bool) -> Progress:
    """What must be seen."""
    return Progress(1.0, "preview", look=partial(_same, replace(live, coverage=coverage)), due=True)


def _constant(device: Device, shape: tuple[int, ...], *values: float) -> moderngl.Texture:
    """A texture of one value, known everywhere."""
    return device.texture(shape[1], shape[0], data=np.full((*shape, 4), (*values, 1.0), np.float32))


def _texture(device: Device, *channels: F32) -> moderngl.Texture:
    """Of four (h, w) channels."""
    return device.texture(channels[0].shape[1], channels[0].shape[0], 4, np.stack(channels, -1))


class _Source(CameraSource):
    """VIEWS layers, each a camera of its own, whether there are so many views or not."""

    def __init__(self, device: Device, grid: GBufferMaps, observations: Observations) -> None:
        super().__init__(device, grid, observations)
        self._used = len(self.layers.groups)
        self.tilts = None  # one program for all scenes
        if self.layers.channels == 1:
            self.layers = replace(self.layers, groups=tuple(range(VIEWS)))

    def gather(self, atlas: ObservationAtlas, tile: Tile, colour: bool) -> Iterator[None]:
        """And nothing in the layers that are left over."""
        yield from super().gather(atlas, tile, colour)
        each = self.layers.each
        for number in range(self._used * each, len(self.layers.groups) * each):
            atlas.target.clear(viewport=atlas.block(number))


# ---- something to warm up with


def _square() -> tuple[SceneData, Images]:
    """A white square of one metre seen and lit from above, VIEWS times."""
    corners = np.array([(-0.5, -0.5, 0.0), (0.5, -0.5, 0.0), (0.5, 0.5, 0.0), (-0.5, 0.5, 0.0)], np.float32)
    triangles = np.array([(0, 1, 2), (0, 2, 3)])
    up = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (2, 3, 1))
    mesh = MeshArrays("square", corners[triangles], up, corners[triangles][..., :2] + 0.5, np.zeros(2, np.int32), ("",))
    view = np.eye(4)
    view[2, 3] = -2.0
    projection = np.array([[3.0, 0, 0, 0], [0, 3.0, 0, 0], [0, 0, -1, -0.2], [0, 0, -1, 0]])
    camera = Camera("camera", view, projection, np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, -1.0]), False, 1.0)
    views = []
    for i in range(VIEWS):
        place = np.eye(4)
        place[:3, 3] = 0.1 * i, 0.0, 2.0
        light = Light(f"light {i}", "POINT", np.full(3, 100.0), place)
        views.append(View(Path(f"{i}.exr"), camera, (light,)))
    shades = [RadianceImage(np.full((32, 32, 3), 0.3 + 0.01 * (i % 3), np.float32), np.ones((32, 32), np.float32),
                            np.ones((32, 32), bool)) for i in range(VIEWS)]  # they differ: noise has shaders too
    scene = SceneData("warm", mesh, np.zeros((0, 3, 3), np.float32), tuple(views))
    return scene, {reference_key(view): shade for view, shade in zip(views, shades, strict=True)}
