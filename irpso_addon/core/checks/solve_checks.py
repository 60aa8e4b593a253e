"""Can the maps be trusted?  Figures from the views and the maps, and the lines that warn of what they show.

Pure functions of arrays: the pipeline asks them about pictures, studies/stability about problems without a scene.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ..check_records import Checks, MaterialCheck, Residual, ViewCheck
from ..data import F32, F64, I32, Bool, View
from ..observation_quality import HALF_SURE
from ..resampling import nearest
from ..shading.brdf import ROUGHNESS_MIN
from .light_checks import Places
from .registration import Registration
from .residuals import BLOCK, LEAST, SMALL, BlockErrors, residual, sample, sample_view, shared_error
from .view_check_data import CheckedView, PixelWindow

WRONG = 0.15  # an error of roughness that a user would see
CELLS = 256  # squared: the grid over the UV square on which highlights are counted
CONTRADICTORY = 0.2  # relative residual from which on views contradict each other, if others' are far less
NO_HIGHLIGHT = 2.0  # tan(theta_h) / alpha from which on a lobe tells little: a fifth of the texels fail at 1 % noise
NEEDED = {"lambert": 1.0, "one-lobe": 3.0, "one-lobe-specular": 6.0, "one-lobe-metallic": 6.0,
          "two-lobe": 12.0}  # good observations a texel
NEEDED_IN_NOISE = NEEDED | {"two-lobe": 24.0}  # from TWO_LOBE_NOISE on
TWO_LOBE_NOISE = 0.002


@dataclass(frozen=True)
class TexelFit:
    """What the solve says of each texel, (n, n) unless told."""

    name: str  # of the object
    models: Mapping[str, str]  # material -> model
    slots: I32  # material of each texel, -1: none
    slot_names: tuple[str, ...]
    solved: Bool
    observed: F32  # good observations
    roughness: F32  # of the sharper lobe
    sigma: F32  # its standard error
    sure: bool = True  # False: the method knows no standard errors
    chosen: bool = False  # whether the models were chosen by the data, and not asked for
    misfit: bool = False  # whether some material is not clearly what its model says
    one_value: tuple[str, ...] = ()  # materials of one roughness, but for coats and rough diffuses, which no Model has
    contradicted: float = 0.0  # share of solved texels whose views contradict each other, see gpu/maps/finish_maps.py


def measure(views: Iterable[CheckedView], texels: TexelFit) -> Checks:
    """Consumes one view at a time; those of a camera follow one another."""
    measured = Measured(texels.solved.size)
    for view in views:
        measured.add(view)
    return measured.checks(texels)


class Measured:
    """What the views show, summed up one view after another; those of a camera follow one another."""

    def __init__(self, texels: int) -> None:
        """``texels``: of a map."""
        self.texels = texels
        self.places, self.registration = Places(), Registration()
        self.views: list[tuple[View, float, Residual]] = []  # and the share of its pixels that is clipped
        self.lobes: list[BlockErrors] = []
        self.others: list[BlockErrors] = []
        self.areas: list[F32] = []  # texels that a pixel shows, at the cameras' blocks
        self.tangents = np.full(CELLS * CELLS, np.inf, np.float32)  # least tan(theta_h) in each cell
        self.window: PixelWindow | None = None  # of the last view; what follows belongs to it
        self.pixels = self.cells = np.zeros(0, np.int64)

    def add(self, view: CheckedView) -> None:
        """Take in a view."""
        self.registration.add(view)
        if view.window is not self.window:
            self._enter(view.window)
        seen = sample_view(view, self.pixels)
        figures, shiny, other = residual(seen)
        self.places.add(view.view, seen, figures.gain)
        sines = np.minimum(view.sin2h.ravel()[self.pixels[seen.good]], np.float32(1 - 1e-6))
        np.minimum.at(self.tangents, self.cells[seen.good], np.sqrt(sines / (1 - sines)))
        self.views.append((view.view, view.clipped, figures))
        self.lobes.append(shiny)
        self.others.append(other)

    def _enter(self, window: PixelWindow) -> None:
        """Begin with the views of a camera."""
        self.window, self.pixels = window, sample(window)
        self.places.camera(window, self.pixels)
        uv = window.uv.reshape(-1, 2)[self.pixels]
        x, y = np.moveaxis(np.clip(uv * CELLS, 0, CELLS - 1).astype(np.int64), -1, 0)
        self.cells = y * CELLS + x
        right, up = uv[:, 1] - uv[:, 0], uv[:, BLOCK] - uv[:, 0]
        self.areas.append(np.abs(right[:, 0] * up[:, 1] - right[:, 1] * up[:, 0]) * self.texels)

    def checks(self, texels: TexelFit) -> Checks:
        """The figures of all views and of the texels."""
        overall, slopes = self.places.slopes()
        residuals = [figures for *_, figures in self.views]
        noise = _median([r.noise for r in residuals])
        least, solved = _alphas(self.tangents.reshape(CELLS, CELLS), texels)
        return Checks(
            name=texels.name,
            views=tuple(
                ViewCheck(view.image.name, view.camera.name, view.light_names, clipped,
                          figures, slope) for (view, clipped, figures), slope in zip(self.views, slopes, strict=True)),
            lights=tuple(self.places.lights([r.gain for r in residuals])), noise=noise,
            materials=tuple(_materials(texels, noise)),
            structure=_median([r.structure for r in residuals]), slope=overall,
            highlight=max(shared_error(_together(self.lobes)) ** 2 - shared_error(_together(self.others)) ** 2,
                          0.0) ** 0.5,
            unlit_share=_unlit_share(residuals),
            clipped=float(np.mean([clipped for _, clipped, _ in self.views])) if self.views else 0.0,
            no_highlight=float(np.mean(least[solved] > NO_HIGHLIGHT)) if solved.any() else 0.0,
            nearest=float(np.median(least[solved])) if solved.any() else float("inf"),
            doubtful=doubtful(texels.sigma[texels.solved]) if texels.sure else float("nan"), sure=texels.sure,
            pixels_per_texel=self._pixels_per_texel(), registration=self.registration.estimate(), misfit=texels.misfit,
            contradicted=texels.contradicted, around=any(view.environment is not None for view, *_ in self.views),
            known=float(np.mean(texels.sigma[texels.solved] < HALF_SURE)) if solved.any() and texels.sure else 1.0)

    def _pixels_per_texel(self) -> float:
        if not self.views:
            return 0.0
        areas = np.concatenate(self.areas)
        return 1 / max(float(np.median(areas)), 1e-9) if len(areas) else float("nan")


def left_over(checks: Checks) -> float:
    """Logarithm of the relative errors of brightness that views leave over, the mean of them; of noise and gain too.

    Between two solves of one size it says whether what was put right explains the views better.
    """
    errors = [np.hypot(r.spread, np.log(r.gain)) for r in (view.residual for view in checks.views) if r.pixels >= LEAST]
    return float(np.mean(np.log(np.maximum(errors, 1e-9)))) if errors else np.inf


def doubtful(sigma: F32) -> float:
    """The share of texels to expect off by more than WRONG, given their standard errors."""
    from math import erfc

    if not len(sigma):
        return 0.0
    edges = np.linspace(0, 1, 201)
    counts, _ = np.histogram(np.clip(sigma, 0, 1), edges)
    chances = [erfc(WRONG / (s * 2**0.5)) for s in (edges[1:] + edges[:-1]) / 2]
    return float(counts @ np.array(chances) / len(sigma))


def _median(values: list[float]) -> float:
    return float(np.median(values)) if values else 0.0


def _unlit_share(residuals: list[Residual]) -> float:
    """Radiance where no light arrives, as a share of the lit median; NaN: nothing tells."""
    dark = np.array([(r.unlit, r.unlit_pixels) for r in residuals if r.unlit is not None])
    return float(np.average(dark[:, 0], weights=dark[:, 1])) if len(dark) else float("nan")


def _together(parts: list[BlockErrors]) -> BlockErrors:
    """Those of all views."""
    none = np.zeros(0, np.float32)
    return BlockErrors(np.concatenate([none, *(x.means for x in parts)]),
                       np.concatenate([none, *(x.within for x in parts)]),
                  SMALL**2)


def _alphas(tangents: F32, texels: TexelFit) -> tuple[F64, Bool]:
    """(CELLS, CELLS) least tan(theta_h) / alpha, and which cells were seen and solved (those without gloss are not).

    The lobe is as narrow as the standard error of roughness allows: without a highlight it may seem wide by chance.
    """
    dull = [slot for slot, name in enumerate(texels.slot_names) if texels.models.get(name) == "lambert"]
    matt = np.isin(texels.slots, dull)
    seen = np.isfinite(tangents) & nearest(texels.solved, CELLS) & ~nearest(matt, CELLS)
    least = texels.roughness - texels.sigma if texels.sure else texels.roughness
    alpha = np.maximum(nearest(least, CELLS).astype(np.float64), ROUGHNESS_MIN) ** 2
    return np.where(seen, tangents, 0) / alpha, seen


def _materials(texels: TexelFit, noise: float) -> list[MaterialCheck]:
    checks = []
    needed = NEEDED_IN_NOISE if noise > TWO_LOBE_NOISE else NEEDED
    for slot, name in enumerate(texels.slot_names):
        seen = texels.observed[texels.solved & (texels.slots == slot)]
        model = texels.models.get(name, "one-lobe")
        enough = needed["one-lobe" if texels.chosen and model == "lambert" else model]  # to tell that there is no lobe
        if len(seen):
            checks.append(MaterialCheck(name, model, float(np.median(seen)), enough, float(np.mean(seen < enough)),
                                        name in texels.one_value))
    return checks
