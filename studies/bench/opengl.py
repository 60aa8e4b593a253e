"""The product's methods and the GLSL rivals on a problem: through irpso_addon.gpu, without a scene.

Solvers and observations are made before the clock starts, and every program has run once: what a run takes is the
search of all texels and their base colour, from the observations on the GPU to the maps on the GPU.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import moderngl
import numpy as np

from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading.tables import principled_table
from irpso_addon.gpu.device.context import Device, Inputs
from irpso_addon.gpu.observe.observation_atlas import ArraySource, ObservedTexels
from irpso_addon.gpu.solve.solver import METHODS, TWO_LOBES, Solver
from tests.support.texel_problem import Estimate, Problem

SHADERS = Path(__file__).with_name("shaders")


class Bench:
    """One problem on the GPU."""

    def __init__(self, device: Device, problem: Problem) -> None:
        self.device, self.problem = device, problem
        self.lobes = 2 if problem.spec.model == "two-lobe" else 1
        self.source = ArraySource(device, ObservedTexels(
            problem.rgb, problem.quality, problem.cos_v, problem.lobes, problem.groups), principled_table())
        settings = SolveSettings(size=max(problem.spec.size, 16), seed=problem.spec.seed)
        self.solver = Solver(device, self.source, settings, self.source.size)
        for _ in self.source.gather(self.solver.atlas, (0, 0), True):
            pass
        if self.solver.atlas.tile != self.source.size:
            raise ValueError(f"{problem.spec.size} texels are more than one tile of observations holds")

    def knobs(self, method: str) -> dict[str, int]:
        """What the search kernel does as one of the product's methods."""
        return dict((METHODS if self.lobes == 1 else TWO_LOBES)[method])

    def solve(self, knobs: Mapping[str, int]) -> tuple[float, Estimate, dict[str, np.ndarray]]:
        """The product's whole solve: search, neighbours, polish, base colour.  (seconds, estimate, more maps)."""
        self.solver.knobs = {self.lobes: knobs}
        start = self._now()
        maps = result(self.solver.solve_two() if self.lobes == 2 else self.solver.solve())
        found = maps.roughness if maps.pairs is None else maps.pairs
        albedo = result(self.solver.albedo(found, self.lobes))
        seconds = self._now() - start
        more = {"roughness_sigma": self.device.read(maps.roughness)[..., 1],
                "base_sigma": self.device.read(maps.detail)[..., 3]}
        estimate = self._estimate(found, albedo)
        for texture in (maps.roughness, maps.detail, albedo, *([maps.pairs] if maps.pairs else [])):
            texture.release()
        return seconds, estimate, more

    def rival(self, name: str, uniforms: Mapping[str, Any]) -> tuple[float, Estimate]:
        """A kernel of studies/bench/shaders, which writes what it finds of each texel; and the base colour from it."""
        found = self.device.texture(*self.source.size)
        start = self._now()
        self.run(name, [found], uniforms)
        albedo = result(self.solver.albedo(found, self.lobes))
        seconds = self._now() - start
        estimate = self._estimate(found, albedo)
        found.release()
        albedo.release()
        return seconds, estimate

    def run(self, name: str, outputs: list[moderngl.Texture], uniforms: Mapping[str, Any],
            defines: Mapping[str, str] | None = None) -> None:
        """Run a kernel of this benchmark over all texels in one go."""
        target = self.device.framebuffer(outputs)
        self.device.kernel(
            str(SHADERS / name) if (SHADERS / name).exists() else name, target, Inputs(textures={
                "u_texel_position": self.source.position, "u_observations": self.solver.atlas.texture,
                "u_principled_table": self.source.principled_table,
            }, uniforms={**self.solver.atlas.uniforms, "u_group_slack": 0.0, "u_tile": (0, 0), **uniforms},
            defines={**self.source.layers.defines(), "LOBES": str(self.lobes), **(defines or {})}),
            region=(0, 0, *self.source.size))
        target.release()

    def _estimate(self, found: moderngl.Texture, albedo: moderngl.Texture) -> Estimate:
        values = self.device.read(found).astype(np.float64)
        base = self.device.read(albedo)[..., :3].astype(np.float64)
        if self.lobes == 1:
            return Estimate(base, values[..., 0])
        return Estimate(base, values[..., 0], values[..., 1], values[..., 2])

    def _now(self) -> float:
        self.device.ctx.finish()
        return time.perf_counter()

    def release(self) -> None:
        """Free the textures."""
        self.solver.release()
        self.source.release()


def result(steps: Any) -> Any:
    """What a generator returns."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value
