"""The bottle solved from pictures under environments alone, beside its truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from irpso_addon.blender import files
from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.core.data import Solution
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device import thread
from irpso_addon.solve import pipeline
from studies.environment import shoot
from studies.intervals.assets import truth

SIZE = 128
CONFIDENT = 0.5
DONE = "done.txt"


@dataclass(frozen=True)
class Recovered:
    """Figures of the solved texels; confident ones are those of confidence above CONFIDENT."""

    rig: shoot.Rig
    model: str
    views: int
    albedo: float  # PSNR, dB
    mean: float  # error of roughness
    median: float
    confident: float  # error of roughness of the confident texels
    share: float  # of the texels that are confident
    seconds: dict[str, float]


def recover(rig: shoot.Rig, folder: Path, size: int = SIZE, model: str = "auto") -> tuple[Recovered, Solution]:
    """``folder`` keeps the pictures."""
    if not (folder / DONE).exists():
        shoot.make(folder, rig)
        (folder / DONE).write_text(rig.name, encoding="utf-8")
    files.open_blend(folder / "scene.blend")
    scene = read_scene(None, None, folder / "captures.json")
    solution: Solution = thread.run(lambda: pipeline.solve(scene, SolveSettings(size=size, model=model)))
    maps, (base, rough) = solution.maps, truth(shoot.BOTTLE, size)
    solved = maps.coverage & ~maps.filled
    off, error = (maps.base_color - base)[solved].astype(np.float64), np.abs(maps.roughness - rough)[solved]
    sure = maps.confidence[solved] > CONFIDENT
    return Recovered(
        rig, ", ".join(sorted(set(solution.model.values()))), len(scene.views),
        float(-10 * np.log10(np.mean(off**2))), float(error.mean()), float(np.median(error)),
        float(error[sure].mean()) if sure.any() else float("nan"), float(sure.mean()), solution.seconds), solution
