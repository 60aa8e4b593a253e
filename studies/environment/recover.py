"""Objects solved from pictures under environments alone, or lamps alone, beside their truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from irpso_addon.blender import files
from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.core.data import Environment, Solution
from irpso_addon.core.evaluation.metrics import FAIL
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading.environment import about_z
from irpso_addon.gpu.device import thread
from irpso_addon.solve import pipeline
from studies.environment import shoot
from studies.environment.relight import relit
from studies.intervals.assets import truth

SIZE = 128
CONFIDENT = 0.5
DONE = "done.txt"
Change = Callable[[Environment], Environment]  # of what a scene has as its world


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
    far: float  # share of those whose roughness is off by more than FAIL
    seconds: dict[str, float]
    relit: float  # PSNR under a new lamp from a new camera, dB


def recover(
    rig: shoot.Rig, folder: Path, size: int = SIZE, model: str = "auto", lamps: str = "auto",
    change: Change | None = None,
) -> tuple[Recovered, Solution]:
    """``folder`` keeps the pictures of one rig; ``change``: makes worlds wrong."""
    if not (folder / DONE).exists() or (folder / DONE).read_text(encoding="utf-8") != repr(rig):
        (folder / DONE).unlink(missing_ok=True)
        shoot.make(folder, rig)
        (folder / DONE).write_text(repr(rig), encoding="utf-8")
    files.open_blend(folder / "scene.blend")
    scene = read_scene(None, None, folder / "captures.json")
    if change is not None:
        scene = replace(scene, views=tuple(
            view if view.environment is None else replace(view, environment=change(view.environment))
            for view in scene.views))
    settings = SolveSettings(size=size, model=model, lamps=lamps)
    solution: Solution = thread.run(lambda: pipeline.solve(scene, settings))
    maps, (base, rough) = solution.maps, truth(rig.asset, size)
    solved = maps.coverage & ~maps.filled
    off, error = (maps.base_color - base)[solved].astype(np.float64), np.abs(maps.roughness - rough)[solved]
    sure = maps.confidence[solved] > CONFIDENT
    return Recovered(
        rig, ", ".join(sorted(set(solution.model.values()))), len(scene.views),
        float(-10 * np.log10(np.mean(off**2))), float(error.mean()), float(np.median(error)),
        float(error[sure].mean()) if sure.any() else float("nan"), float(sure.mean()),
        float((error[sure] > FAIL).mean()) if sure.any() else float("nan"), solution.seconds,
        relit(folder / "scene.blend", rig.asset, maps)), solution


def turned(degrees: float) -> Change | None:
    """A world about Z elsewhere than it shone from; its record does not show it."""
    about = about_z(np.radians(degrees))
    return (lambda world: replace(world, rotation=world.rotation @ about)) if degrees else None
