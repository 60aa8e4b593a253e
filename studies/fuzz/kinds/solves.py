"""Whole solves of small maps from scenes made odd, with pictures that are fine: maps of numbers, or a reason."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from random import Random

import bpy
import numpy as np

from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.core.job import Progress
from irpso_addon.core.maps.export import layers
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device import thread
from irpso_addon.solve import pipeline

from .. import pictures
from ..case import Box
from . import scenes

prepare = scenes.prepare


def make(shared: list[Path], rng: Random, box: Box) -> Callable[[], None]:
    """A scene as those of `scenes`, and its pictures."""
    scenes.make(shared, rng, box)
    noise = np.random.default_rng(rng.randrange(2**32))
    for name in ("a", "b"):
        pixels = noise.uniform(0, rng.choice((1e-9, 1.0, 1e9)), (24, 36, 3)).astype(np.float32)
        if rng.random() < 0.2:
            pixels[:] = rng.choice((0.0, 1.0, 6e4))
        pictures.write(box.given / f"{name}.exr", pixels, "float", {})
    pictures.write(box.given / "mask.png", np.ones((24, 36, 1), np.float32), "uint8", {})
    box.memory = 3_000_000_000  # of a software renderer
    settings = SolveSettings(size=16, indirect="off", model=rng.choice(("auto", "lambert", "one-lobe", "two-lobe")),
                             method=rng.choice(("refined", "draft")))
    return partial(run, settings, box)


def run(settings: SolveSettings, box: Box) -> None:
    """Reads and solves."""
    box.note("")
    data = read_scene(None, "Subject" if "Subject" in bpy.data.objects else None, None)
    files = [getattr(view, name) for view in bpy.context.scene.irpso.views for name in ("image", "mask")]
    box.names = (*box.names, "a.exr", "b.exr", "mask.png", *(file for file in files if file))
    solution = thread.run(lambda: pipeline.solve(data, settings), on_progress=lambda p: _note_stage(box, p))
    for name, array in layers(solution.maps).items():
        assert np.isfinite(array).all(), name
    assert np.isfinite(solution.residual)
    roughness, base = solution.maps.roughness, solution.maps.base_color
    assert 0 <= roughness.min() and roughness.max() <= 1 and base.min() >= 0


def _note_stage(box: Box, progress: Progress) -> None:
    """It is alive: shaders take their time to be compiled."""
    box.note(progress.stage)
