"""A solve of a small map in numpy: where there is no OpenGL, and the judge of the pipeline that has it.

One lobe at every texel, or none (model lambert).  float64 throughout; rays in place of shadow maps (rays.py), sums
over the lamps in place of discs (observe.py), each texel four points (texel_fit.py).
Shares with the pipeline the twins of BRDF and lamps, and core/{observation_quality,resampling}.py.  Not here: pixels'
footprints, disbelief of outliers, tilts of normals, other models, indirect light, parts, the views' checks.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Generator
from dataclasses import replace
from typing import TypeVar

import numpy as np

from ..data import F64, Bool, Maps, SceneData, Solution
from ..errors import BadInput
from ..job import Progress, mapped
from ..observation_quality import HALF_SURE
from ..params import DeviceSettings, SolveSettings
from ..resampling import linear
from .observe import ReadImage, memory, observe
from .rasterise import SurfacePoints, places, rasterise
from .rays import Index
from .texel_fit import Fit, fit_texels

SIDE = 2  # points of a texel, squared
DEFAULT_SIZE, MOST_SIZE = 64, 256  # texels: of what is asked for beyond the second, the first is solved
MOST_PIXELS = 1_000_000  # of a picture: beside texels this large, more would only alias
MIXED_HALF = 0.05  # standard error of roughness at which a texel is mixed half and half with what lies around
MODELS = {"auto": "one-lobe", "one-lobe": "one-lobe", "lambert": "lambert"}
MESH_NORMALS = "device numpy keeps the mesh's normals"
Result = TypeVar("Result")


def solve(
    scene: SceneData, settings: SolveSettings, read_image: ReadImage, most_memory: float = DeviceSettings().memory,
) -> Generator[Progress, None, Solution]:
    """From a scene's data to its maps, in numpy alone.  Raises BadInput for what it cannot do.

    most_memory: GB that observations may take; larger maps are solved smaller, with a warning.
    """
    settings, limits = _possible(scene, settings)
    seconds: dict[str, float] = {}
    started = time.perf_counter()
    lambert = MODELS[settings.model] == "lambert"
    owner, reduced = _owners(scene, settings.size, most_memory)
    coverage = owner >= 0
    points, at, neighbours = _points(scene, len(owner))
    seconds["gbuffer"] = time.perf_counter() - started
    yield Progress(0.02, "gbuffer")
    steps = observe(scene, points, neighbours, read_image)
    views, used, skipped, warnings = yield from _share(steps, 0.02, 0.5)
    if not views:
        raise BadInput("; ".join(f"{name}: {why}" for name, why in skipped))
    seconds["observe"] = time.perf_counter() - started - sum(seconds.values())
    fit, where = yield from _share(fit_texels(views, at, SIDE, lambert), 0.5, 0.98)
    seconds["solve"] = time.perf_counter() - started - sum(seconds.values())
    maps = _maps(fit, where, coverage, lambert)
    seconds["maps"] = time.perf_counter() - started - sum(seconds.values())
    good = maps.coverage & ~maps.filled
    slots = [scene.mesh.slot_names[s] for s in np.unique(scene.mesh.slots[owner[coverage]])]
    return Solution(
        maps=maps, model=dict.fromkeys(slots, MODELS[settings.model]), why=dict.fromkeys(slots, "device numpy"),
        texels={"covered": int(coverage.sum()), "observed": int(good.sum()), "solved": int(good.sum()),
                "filled": int((coverage & maps.filled).sum()), "kept": 0},
        seconds=seconds, residual=float(np.sqrt(np.mean(fit.error**2))) if len(fit.error) else 0.0,
        views_used=tuple(view.image.name for view in used), views_skipped=scene.skipped + tuple(skipped),
        warnings=(*scene.warnings, *warnings, *limits, *reduced), device=device(),
        normals_why=MESH_NORMALS if settings.normals == "auto" else "")


def _owners(scene: SceneData, size: int, most_memory: float) -> tuple[Index, list[str]]:
    """(n, n) triangle under each texel, -1: none; a warning where n has to be below ``size``.  Raises BadInput."""
    warnings: list[str] = []
    owner, _ = rasterise(scene.mesh.uvs, size)
    needed = memory(scene, int(np.count_nonzero(owner >= 0)) * SIDE**2)
    if needed > most_memory * 1e9:
        smaller = max(int(size * (most_memory * 1e9 / needed) ** 0.5), 1)
        warnings.append(f"device numpy: maps of {smaller} x {smaller} texels instead of {size} x {size}: larger ones "
                        f"do not fit in {most_memory:g} GB; choose a larger Memory, or fewer views")
        size, (owner, _) = smaller, rasterise(scene.mesh.uvs, smaller)
    if not (owner >= 0).any():
        raise BadInput(f"{scene.mesh.name}: no face covers a texel of the 0-1 UV square at {size} x {size}; "
                       "unwrap the mesh (UV > Smart UV Project)")
    return owner, warnings


def device() -> dict[str, str]:
    """As the GL device describes itself."""
    return {"renderer": f"numpy {np.__version__}", "vendor": platform.processor() or platform.machine(),
            "version": "float64, no OpenGL"}


def _share(
    steps: Generator[Progress, None, Result], low: float, high: float,
) -> Generator[Progress, None, Result]:
    """A stage of the whole."""
    return (yield from mapped(steps, lambda step: replace(step, fraction=low + (high - low) * step.fraction)))


def _possible(scene: SceneData, settings: SolveSettings) -> tuple[SolveSettings, list[str]]:
    """The settings as they can be followed, and what the user must know of it.  Raises BadInput."""
    limits = []
    if settings.model not in MODELS:
        raise BadInput(f"{scene.mesh.name}: model {settings.model} needs OpenGL; with device numpy choose one-lobe or "
                       "lambert")
    if scene.region is not None:
        raise BadInput(f"{scene.mesh.name}: solving a region needs OpenGL; with device numpy solve the whole object")
    if settings.size > MOST_SIZE:
        limits.append(f"device numpy: maps of {DEFAULT_SIZE} x {DEFAULT_SIZE} texels instead of {settings.size} x "
                    f"{settings.size}; choose at most {MOST_SIZE}")
        settings = replace(settings, size=DEFAULT_SIZE)
    if settings.udim == "all":
        limits.append("device numpy: only the 0-1 UV square is solved")
    if settings.indirect == "on":
        limits.append("device numpy: indirect light is not subtracted")
    if settings.method != SolveSettings().method:
        limits.append(f"device numpy: method {settings.method} needs OpenGL; the search was device numpy's own")
    if settings.loss == "robust":
        limits.append("device numpy: outliers have full weight")
    if settings.exposures == "solve":
        limits.append("device numpy: exposures are not solved; those of the views were used")
    return settings, limits


def _points(scene: SceneData, size: int) -> tuple[SurfacePoints, Bool, Index]:
    """The covered points of the texels, which of the finer grid those are, and the 8 neighbours of each among them."""
    owner, weights = rasterise(scene.mesh.uvs, size * SIDE)
    at = owner >= 0
    number = np.where(at, np.cumsum(at).reshape(at.shape) - 1, -1)
    around = np.pad(number, 1, constant_values=-1)
    n = size * SIDE
    near = np.stack([around[y:y + n, x:x + n][at] for y in range(3) for x in range(3) if (y, x) != (1, 1)], -1)
    return places(scene.mesh, owner[at], weights[at]), at, np.where(near < 0, number[at][:, None], near)


# ---- maps


def _maps(fit: Fit, where: Index, coverage: Bool, lambert: bool) -> Maps:
    """Whole maps: what is unsure or unseen is mixed with, or taken from, what lies around."""
    n = len(coverage)

    def spread(values: F64) -> F64:
        whole = np.zeros((n * n, *values.shape[1:]))
        whole[where] = values
        return whole.reshape(n, n, *values.shape[1:])

    good = spread(np.ones(len(where))) > 0
    good &= coverage
    def trust(half: float) -> F64:
        """One half where the standard error of roughness is ``half``."""
        return spread(1 / (1 + (fit.sigma / half) ** 2) * np.clip(fit.observations - 1, 0, 2) / 2) * good

    seen = good.astype(np.float64)
    weight = seen if lambert else np.maximum(trust(MIXED_HALF), 1e-4 * seen)
    rough = fill(spread(fit.roughness)[..., None], weight)[..., 0]
    return Maps(
        base_color=fill(spread(fit.base), seen).astype(np.float32), roughness=rough.astype(np.float32),
        confidence=trust(HALF_SURE).astype(np.float32), error=(spread(fit.error) * good).astype(np.float32),
        filled=~good, coverage=coverage, roughness_sigma=(spread(fit.sigma) * good).astype(np.float32),
        base_sigma=(spread(fit.base_sigma) * good).astype(np.float32))


def beside(values: F64, known: F64, parent: F64) -> F64:
    """(n, n, c) what the four texels around know, else those at the corners; where they know little, ``parent``."""
    h, w = known.shape
    weights, found = np.pad(known, 1, mode="edge"), parent
    weighted = np.pad(values * known[..., None], ((1, 1), (1, 1), (0, 0)), mode="edge")
    for corners in (True, False):  # what the sides know comes last: it counts
        places = [(y, x) for y in range(3) for x in range(3) if (y, x) != (1, 1) and (y != 1 and x != 1) == corners]
        share = np.sum([weights[y:y + h, x:x + w] for y, x in places], 0)[..., None]
        mean = np.sum([weighted[y:y + h, x:x + w] for y, x in places], 0) / np.maximum(share, 1e-12)
        found = np.where(share > 0, parent + np.minimum(share, 1) * (mean - parent), found)
    return np.asarray(found)


def fill(values: F64, known: F64, border: bool = True) -> F64:
    """(n, n, c) values where ``known`` (n, n) is 1; elsewhere, and by how much it is less, from around (push-pull).

    ``border``: the first texels beyond what is known continue it.
    """
    h, w = known.shape
    if max(h, w) == 1:
        return values
    even = np.pad(known, ((0, h % 2), (0, w % 2)))
    weighted = np.pad(values * known[..., None], ((0, h % 2), (0, w % 2), (0, 0)))
    share = even.reshape(-(-h // 2), 2, -(-w // 2), 2).sum((1, 3))
    sums = weighted.reshape(*share.shape[:1], 2, share.shape[1], 2, -1).sum((1, 3))
    coarse = fill(sums / np.maximum(share, 1e-12)[..., None], np.minimum(share, 1.0), border=False)
    y, x = ((np.arange(size) + 0.5) / 2 - 0.5 for size in (h, w))
    below = linear(linear(coarse, y, axis=0), x, axis=1)
    below = beside(values, known, below) if border else below
    return np.asarray(known[..., None] * values + (1 - known[..., None]) * below)
