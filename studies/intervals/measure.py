"""What a solve says of an asset and how sure it is, beside the truth."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from irpso_addon.blender import files
from irpso_addon.blender.jobs.indirect import IndirectRenderer
from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.core.data import F32, Maps, SceneData, Solution
from irpso_addon.core.evaluation.metrics import FAIL
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device import thread
from irpso_addon.solve import pipeline
from studies.intervals import capture
from studies.intervals.assets import TEXELS, Asset, truth

Z90 = 1.645  # standard errors to each side of 90 % of a normal distribution
CONFIDENT = 0.5
MADE_BY = "made_by.txt"


@dataclass(frozen=True)
class Figures:
    """Of the solved texels; shares are 0..1."""

    texels: int
    mean_error: float  # of roughness
    median_error: float
    base_error: float  # mean, of base colour's mean of channels
    held: float  # share whose true roughness lies in the 90 % interval
    base_held: float
    confident: float  # share with confidence above CONFIDENT
    wrong: float  # share of these that are off by more than FAIL
    all_wrong: float  # share of all solved texels that are


def judge(maps: Maps, base: F32, roughness: F32) -> Figures:
    """``base`` (n, n, 3) and ``roughness`` (n, n): the truth.  Texels without a standard error do not count."""
    solved = maps.coverage & ~maps.filled & (maps.roughness_sigma > 0)
    error, sigma = np.abs(maps.roughness - roughness)[solved], maps.roughness_sigma[solved]
    base_error, base_sigma = np.abs((maps.base_color - base).mean(-1))[solved], maps.base_sigma[solved]
    sure = maps.confidence[solved] > CONFIDENT
    return Figures(
        texels=int(solved.sum()), mean_error=_mean(error), median_error=float(np.median(error)) if len(error) else 0.0,
        base_error=_mean(base_error), held=_mean(error <= Z90 * sigma), base_held=_mean(base_error <= Z90 * base_sigma),
        confident=_mean(sure), wrong=_mean(error[sure] > FAIL), all_wrong=_mean(error > FAIL))


def _mean(values: np.ndarray) -> float:
    return float(np.mean(values, dtype=np.float64)) if values.size else 0.0


def scene_of(asset: Asset, folder: Path, lamps: int = capture.LAMPS, room: bool = False) -> SceneData:
    """The scene, which is open then; ``folder`` keeps its pictures, rendered where the code that made them changed."""
    parts = [f"{asset.name} {asset.pixels} {asset.samples} {lamps}{' room' * room}".encode(), truth(asset)[0].tobytes(),
             *(part.vertices.tobytes() for part in asset.sheets),
             *((Path(__file__).parent / name).read_bytes() for name in ("assets.py", "capture.py"))]
    key = hashlib.sha256(b"".join(parts)).hexdigest()
    if not (folder / MADE_BY).exists() or (folder / MADE_BY).read_text(encoding="utf-8") != key:
        capture.make(asset, folder, lamps, room)
        (folder / MADE_BY).write_text(key, encoding="utf-8")
    files.open_blend(folder / "scene.blend")
    return read_scene(None, None, folder / "captures.json")


def solve(asset: Asset, folder: Path, lamps: int = capture.LAMPS, size: int = TEXELS) -> Solution:
    """With `auto`; ``folder`` keeps the pictures."""
    scene = scene_of(asset, folder, lamps)
    bounce = IndirectRenderer.of_open_file(folder / "scene.blend") if asset.bounces else None
    solution: Solution = thread.run(
        lambda: pipeline.solve(scene, SolveSettings(size=size, model="auto"), bounce=bounce))
    return solution


def measure(asset: Asset, folder: Path) -> tuple[Solution, Figures]:
    """The solve of an asset, and its figures."""
    solution = solve(asset, folder)
    return solution, judge(solution.maps, *truth(asset))
