"""What `irpso compare` judges methods by: views held out of the solve, and the true maps where they are known."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..core.change_records import PredictionError
from ..core.data import F32, F64, I32, Bool, RadianceImage, SceneData, View
from ..core.errors import BadInput
from ..core.evaluation.metrics import map_errors, prediction_error
from ..core.evaluation.prediction import Pixels, PlaceView, Surface, predict, shown
from ..core.job import Progress
from ..core.resampling import at_size, on_grid
from ..gpu.device import thread
from ..gpu.maps.fill import fill
from .texels import Grid, observe_pixels, observe_texels

WARM_UP = 16  # texels: observed before the clock starts, so that no time holds compiling shaders
GOOD_VIEWS = 3  # that must show a texel well before it counts
GLOSS = 1.5  # a highlight came near where tan(theta_h) is less than so many true alphas
ReadImage = Callable[[View], RadianceImage]


@dataclass(frozen=True)
class Judge:
    """The texels that count, and what is known of them."""

    grid: Grid
    where: Bool  # (n, n) those texels
    held: list[tuple[Pixels, list[PlaceView]]]  # per camera: pixels that show them, in views that no solve has seen
    tan_h: F32  # (n, n) nearest highlight: least tan(theta_h) over the views solved from
    lambert: F32  # (n, n, 3) median over the views solved from of pi times radiance over irradiance, holes filled
    seconds: float  # that took
    truth: tuple[F64, F64] | None  # base colour (m, m, 3) and roughness (m, m), as fine as it is known

    def no_solver(self) -> Surface:
        """What division alone gives: `lambert` and a roughness of 0.5."""
        count = self.where.size
        return Surface(np.clip(self.lambert.reshape(-1, 3).astype(np.float64), 0, 1),
                       np.tile([0.5, 0.5, 1.0], (count, 1)), np.full(count, 0.5), np.zeros(count, bool))

    def true_maps(self) -> Surface | None:
        """The truth, where it is known: its error on the held-out views is what no method can be blamed for."""
        if self.truth is None:
            return None
        base, rough = self.truth
        r = rough.ravel()
        return Surface(base.reshape(-1, 3), np.stack([r, r, np.ones_like(r)], -1), np.full(r.shape, 0.5),
                       np.zeros(r.shape, bool))

    def errors(self, maps: Surface) -> dict[str, Any]:
        """``held_out``, ``held_out_error`` and ``truth`` of the report; None for what there is nothing to judge by."""
        share, error = self.held_out(maps) if self.held else (None, None)
        return {"held_out": share, "held_out_error": None if error is None else asdict(error),
                "truth": self._truth(maps) if self.truth else None}

    def held_out(self, maps: Surface) -> tuple[float, PredictionError | None]:
        """How far all predictions are off, twice.

        Sum of the absolute errors over the sum of what was seen, in radiance / irradiance.  And that of radiances, as
        a solve predicts it by leaving out lamps.
        """
        off = seen = 0.0
        radiance: list[tuple[F64, F64]] = []
        for pixels, views in self.held:
            at = shown(maps, pixels)
            for view in views:
                told = predict(at, view)
                off += float(np.sum(view.weight * np.abs(told - view.rgb)))
                seen += float(np.sum(view.weight * view.rgb))
                if view.irradiance is not None:
                    good = (view.weight > 0).all(-1) & np.isfinite(view.irradiance).all(-1)
                    light = view.irradiance[good].astype(np.float64)
                    radiance.append((view.rgb[good] * light, told[good] * light))
        error = prediction_error(*map(np.concatenate, zip(*radiance, strict=True))) if radiance else None
        return off / max(seen, 1e-20), error

    def _truth(self, maps: Surface) -> dict[str, float]:
        assert self.truth is not None
        size = len(self.where)
        base, rough = at_size(self.truth[0], size), at_size(self.truth[1], size)[..., 0]
        mine = maps.lobes[:, 0].reshape(rough.shape)
        errors = asdict(map_errors(maps.base.reshape(base.shape), mine, base, rough, self.where))
        informed = self.where & (self.tan_h < GLOSS * rough**2)
        if informed.any():
            errors["rough_mae_informed"] = float(np.abs(mine - rough)[informed].mean())
        return errors | {"informed_share": float(informed.sum() / self.where.sum())}


def make_judge(
    fit: SceneData, held: SceneData | None, truth: tuple[F64, F64] | None, read_image: ReadImage, size: int,
) -> Generator[Progress, None, Judge]:
    """Runs on the GL thread: gathers the views and chooses which texels count.  Raises BadInput where none does."""
    yield from observe_texels(fit, WARM_UP, read_image, _digest)
    started = time.perf_counter()
    grid, parts = yield from observe_texels(fit, size, read_image, _digest)
    shape = grid.covered.shape
    count, tan_h, lambert = np.zeros(shape, np.int32), np.zeros(shape, np.float32), np.zeros((*shape, 4), np.float32)
    for inside, *values in parts:
        count[inside], tan_h[inside], lambert[inside] = values
    filled = yield from _filled(lambert)
    seconds = time.perf_counter() - started
    where = count >= GOOD_VIEWS
    if not where.any():
        raise BadInput(f"{fit.mesh.name}: no texel is seen well in {GOOD_VIEWS} of the {len(fit.views)} views that "
                       "are solved from; add views, or hold out fewer")
    cameras = [] if held is None else (yield from observe_pixels(held, read_image))
    return Judge(grid, where, [_choose(*camera, where) for camera in cameras], tan_h, filled, seconds, truth)


def _digest(inside: Bool, views: list[PlaceView]) -> tuple[Bool, I32, F32, F32]:
    """The texels of a tile, how many views show each well, its nearest highlight, its median of pi f (and known)."""
    good = np.stack([view.weight.min(-1) > 0 for view in views])  # (K, T)
    sin2h = np.stack([view.nearest() for view in views])
    tan_h = np.sqrt(np.where(good, sin2h / np.maximum(1 - sin2h, 1e-6), 1e6)).min(0)
    f = np.ma.array(np.stack([view.rgb for view in views]), mask=np.repeat(~good[..., None], 3, -1))
    median = np.pi * np.ma.median(f, axis=0).filled(0.0)
    known = np.concatenate([median, good.any(0)[:, None]], -1)
    return inside, good.sum(0).astype(np.int32), tan_h.astype(np.float32), known.astype(np.float32)


def _filled(values: F32) -> Generator[Progress, None, F32]:
    """Runs on the GL thread: (n, n, 3) of (n, n, 4), holes (where the fourth is 0) filled."""
    device = thread.device()
    yield Progress(0.0, "maps")
    with device.scope():
        source = device.texture(values.shape[1], values.shape[0], data=values)
        return device.read(fill(device, source))[..., :3].copy()


def _choose(pixels: Pixels, views: list[PlaceView], where: Bool) -> tuple[Pixels, list[PlaceView]]:
    """The pixels that show texels that count."""
    size = len(where)
    x, y = np.clip((pixels.uv * size).astype(int), 0, size - 1).T
    part = where[y, x] & on_grid(pixels.uv)
    return Pixels(pixels.uv[part], pixels.slope[part], pixels.footprint), [
        PlaceView(view.rgb[part], view.weight[part], view.cos_v[part], view.lobes[part],
                  None if view.irradiance is None else view.irradiance[part],
                  None if view.nodes is None else view.nodes[part]) for view in views]
