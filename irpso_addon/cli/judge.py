"""What `irpso compare` judges methods by: views held out of the solve, and the true maps where they are known."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from ..core.data import F32, F64, I32, Bool, RadianceImage, SceneData, View
from ..core.errors import BadInput
from ..core.metrics import map_errors
from ..core.predict import Surface, TexelView, predict
from ..gpu import thread
from .texels import Grid, observe_texels

WARM_UP = 16  # texels: observed before the clock starts, so that no time holds compiling shaders
GOOD_VIEWS = 3  # that must show a texel well before it counts
GLOSS = 1.5  # a highlight came near where tan(theta_h) is less than so many true alphas
ReadImage = Callable[[View], RadianceImage]


@dataclass(frozen=True)
class Judge:
    """The T texels that count, and what is known of them."""

    grid: Grid
    where: Bool  # (n, n) the T texels
    held: list[TexelView]  # views that no solve has seen
    tan_h: F32  # (T,) nearest highlight: least tan(theta_h) over the views solved from
    lambert: F32  # (T, 3) median over the views solved from of pi times radiance over irradiance
    seconds: float  # that took
    truth: tuple[F64, F64] | None  # base colour (n, n, 3) and roughness (n, n)

    def no_solver(self) -> Surface:
        """What division alone gives: `lambert` and a roughness of 0.5."""
        count = len(self.lambert)
        return Surface(np.clip(self.lambert.astype(np.float64), 0, 1), np.tile([0.5, 0.5, 1.0], (count, 1)),
                       np.full(count, 0.5), np.zeros(count, bool))

    def errors(self, at: Surface) -> dict[str, Any]:
        """``held_out`` and ``truth`` of the report; None for what there is nothing to judge by."""
        return {"held_out": self._held_out(at) if self.held else None, "truth": self._truth(at) if self.truth else None}

    def _held_out(self, at: Surface) -> float:
        """Sum of the absolute errors of all predictions over the sum of what was seen, in radiance / irradiance."""
        off = seen = 0.0
        for view in self.held:
            off += float(np.sum(view.weight * np.abs(predict(at, view) - view.rgb)))
            seen += float(np.sum(view.weight * view.rgb))
        return off / max(seen, 1e-20)

    def _truth(self, at: Surface) -> dict[str, float]:
        assert self.truth is not None
        base, rough = self.truth[0][self.where], self.truth[1][self.where]
        found = asdict(map_errors(at.base, at.lobes[:, 0], base, rough, np.ones(len(rough), bool)))
        informed = self.tan_h < GLOSS * rough**2
        if informed.any():
            found["rough_mae_informed"] = float(np.abs(at.lobes[:, 0] - rough)[informed].mean())
        return found | {"informed_share": float(informed.mean())}


def make_judge(
    fit: SceneData, held: SceneData | None, truth: tuple[F64, F64] | None, read_image: ReadImage, size: int,
) -> Judge:
    """Gather the views at the texels and choose which of these count.  Raises BadInput where none does."""
    thread.run(lambda: observe_texels(fit, WARM_UP, read_image, _digest))
    started = time.perf_counter()
    grid, parts = thread.run(lambda: observe_texels(fit, size, read_image, _digest))
    seconds = time.perf_counter() - started
    shape = grid.covered.shape
    count, tan_h, lambert = np.zeros(shape, np.int32), np.zeros(shape, np.float32), np.zeros((*shape, 3), np.float32)
    for inside, *values in parts:
        count[inside], tan_h[inside], lambert[inside] = values
    where = count >= GOOD_VIEWS
    if not where.any():
        raise BadInput(f"{fit.mesh.name}: no texel is seen well by {GOOD_VIEWS} of the {len(fit.views)} views solved "
                       "from; add views, or hold fewer out")
    views: list[TexelView] = []
    if held is not None:
        _, chosen = thread.run(lambda: observe_texels(held, size, read_image, partial(_choose, where)))
        views = _join(chosen, where)
    return Judge(grid, where, views, tan_h[where], lambert[where], seconds, truth)


def _digest(inside: Bool, views: list[TexelView]) -> tuple[Bool, I32, F32, F32]:
    """The texels of a tile, how many views show each well, its nearest highlight, its median of pi f."""
    good = np.stack([view.weight.min(-1) > 0 for view in views])  # (K, T)
    sin2h = np.stack([view.lobes[:, :, :, 0].min((1, 2)) for view in views])
    tan_h = np.sqrt(np.where(good, sin2h / np.maximum(1 - sin2h, 1e-6), 1e6)).min(0)
    f = np.ma.array(np.stack([view.rgb for view in views]), mask=np.repeat(~good[..., None], 3, -1))
    median = np.pi * np.ma.median(f, axis=0).filled(0.5 / np.pi)
    return inside, good.sum(0).astype(np.int32), tan_h.astype(np.float32), median.astype(np.float32)


def _choose(where: Bool, inside: Bool, views: list[TexelView]) -> tuple[Bool, list[TexelView]]:
    """The texels of a tile that count, (n, n), and the views there."""
    part = where[inside]
    return inside & where, [TexelView(*(getattr(view, name)[part] for name in TexelView.__dataclass_fields__))
                            for view in views]


def _join(parts: list[tuple[Bool, list[TexelView]]], where: Bool) -> list[TexelView]:
    """The views over all texels that count, in the order of ``where``."""
    place = np.zeros(where.shape, np.int64)
    place[where] = np.arange(np.count_nonzero(where))
    order = np.argsort(np.concatenate([place[inside] for inside, _ in parts]))
    return [TexelView(*(np.concatenate([getattr(view, name) for view in tiles])[order]
                        for name in TexelView.__dataclass_fields__))
            for tiles in zip(*(views for _, views in parts), strict=True)]
