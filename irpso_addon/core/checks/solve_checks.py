"""Can the maps be trusted?  Figures from the views and the maps, and the lines that warn of what they show.

Pure functions of arrays: the pipeline asks them about pictures, studies/stability about problems without a scene.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ..check_records import Checks, MaterialCheck, Residual, ViewCheck
from ..data import F32, F64, I32, Bool, View
from ..shading.brdf import ROUGHNESS_MIN
from .light_checks import Places
from .registration import Registration
from .residuals import BLOCK, SMALL, BlockErrors, residual, sample, sample_view, shared_error
from .view_check_data import CheckedView

WRONG = 0.15  # an error of roughness that a user would see
CELLS = 256  # squared: the grid over the UV square on which highlights are counted
NO_HIGHLIGHT = 2.0  # tan(theta_h) / alpha from which on a lobe tells little: a fifth of the texels fail at 1 % noise
NEEDED = {"lambert": 1.0, "one-lobe": 3.0, "one-lobe-specular": 6.0, "two-lobe": 12.0}  # good observations a texel
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


def measure(views: Iterable[CheckedView], texels: TexelFit) -> Checks:
    """Consumes one view at a time; those of a camera follow one another."""
    places, registration, window = Places(), Registration(), None
    found: list[tuple[View, float, Residual]] = []
    lobes: list[BlockErrors] = []
    others: list[BlockErrors] = []
    areas: list[F32] = []  # texels that a pixel shows, at the cameras' blocks
    nearest = np.full(CELLS * CELLS, np.inf, np.float32)
    for view in views:
        registration.add(view)
        if view.window is not window:
            window = view.window
            at = sample(window)
            places.camera(window, at)
            uv = window.uv.reshape(-1, 2)[at]
            x, y = np.moveaxis(np.clip(uv * CELLS, 0, CELLS - 1).astype(np.int64), -1, 0)
            cells = y * CELLS + x
            right, up = uv[:, 1] - uv[:, 0], uv[:, BLOCK] - uv[:, 0]
            areas.append(np.abs(right[:, 0] * up[:, 1] - right[:, 1] * up[:, 0]) * texels.solved.size)
        seen = sample_view(view, at)
        figures, shiny, other = residual(seen)
        places.add(view.view, seen, figures.gain)
        sines = np.minimum(view.sin2h.ravel()[at[seen.good]], np.float32(1 - 1e-6))
        np.minimum.at(nearest, cells[seen.good], np.sqrt(sines / (1 - sines)))
        found.append((view.view, view.clipped, figures))
        lobes.append(shiny)
        others.append(other)
    overall, each = places.slopes()
    residuals = [figures for *_, figures in found]
    dark = np.array([(r.unlit, r.unlit_pixels) for r in residuals if r.unlit is not None])
    noise = _median([r.noise for r in residuals])
    least, solved = _alphas(nearest.reshape(CELLS, CELLS), texels)
    return Checks(
        name=texels.name,
        views=tuple(ViewCheck(view.image.name, view.camera.name, tuple(light.name for light in view.lights), clipped,
                              figures, slope) for (view, clipped, figures), slope in zip(found, each, strict=True)),
        lights=tuple(places.lights([r.gain for r in residuals])), noise=noise,
        materials=tuple(_materials(texels, noise)),
        structure=_median([r.structure for r in residuals]), slope=overall,
        highlight=max(shared_error(_together(lobes)) ** 2 - shared_error(_together(others)) ** 2, 0.0) ** 0.5,
        unlit_share=float(np.average(dark[:, 0], weights=dark[:, 1])) if len(dark) else float("nan"),
        clipped=float(np.mean([clipped for _, clipped, _ in found])) if found else 0.0,
        no_highlight=float(np.mean(least[solved] > NO_HIGHLIGHT)) if solved.any() else 0.0,
        nearest=float(np.median(least[solved])) if solved.any() else float("inf"),
        doubtful=doubtful(texels.sigma[texels.solved]) if texels.sure else float("nan"), sure=texels.sure,
        pixels_per_texel=1 / max(float(np.median(np.concatenate([*areas, np.zeros(0)]))), 1e-9) if found else 0.0,
        registration=registration.estimate())


def worse(after: Checks, before: Checks) -> bool:
    """Whether what was put right between the two made the maps explain less; beyond what coarser maps do."""
    return after.structure > 2 * before.structure + 0.001


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


def _together(parts: list[BlockErrors]) -> BlockErrors:
    """Those of all views."""
    none = np.zeros(0, np.float32)
    return BlockErrors(np.concatenate([none, *(x.means for x in parts)]),
                       np.concatenate([none, *(x.within for x in parts)]),
                  SMALL**2)


def _alphas(nearest: F32, texels: TexelFit) -> tuple[F64, Bool]:
    """(CELLS, CELLS) least tan(theta_h) / alpha, and which cells were seen and solved (those without gloss are not)."""
    n = texels.solved.shape[0]
    at = np.minimum(((np.arange(CELLS) + 0.5) * n / CELLS).astype(int), n - 1)
    pick = np.ix_(at, at)
    dull = [slot for slot, name in enumerate(texels.slot_names) if texels.models.get(name) == "lambert"]
    matt = np.isin(texels.slots, dull)
    seen = np.isfinite(nearest) & texels.solved[pick] & ~matt[pick]
    alpha = np.maximum(texels.roughness[pick].astype(np.float64), ROUGHNESS_MIN) ** 2
    return np.where(seen, nearest, 0) / alpha, seen


def _materials(texels: TexelFit, noise: float) -> list[MaterialCheck]:
    found = []
    needed = NEEDED_IN_NOISE if noise > TWO_LOBE_NOISE else NEEDED
    for slot, name in enumerate(texels.slot_names):
        seen = texels.observed[texels.solved & (texels.slots == slot)]
        model = texels.models.get(name, "one-lobe")
        enough = needed["one-lobe" if texels.chosen and model == "lambert" else model]  # to tell that there is no lobe
        if len(seen):
            found.append(MaterialCheck(name, model, float(np.median(seen)), enough, float(np.mean(seen < enough))))
    return found
