"""Narrow tiles, where a software renderer reads many layers: the same bytes as wide ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.observe.observation_atlas import NARROW, NARROW_BLOCKS, UNROLLED, ObservationAtlas
from irpso_addon.gpu.solve.solver import Solver
from tests.support.texels import finish, random_texels

SIZE = 144  # more than a narrow tile is wide
MANY = (0,) * 9 + (1,) * 8


@pytest.mark.one_python
def test_narrow_tiles_give_the_same_bytes(on_gl, monkeypatch):
    texels = random_texels(MANY, 1, lights=1, size=SIZE)

    def job(device: Device) -> tuple[int, list[bytes]]:
        solver = Solver(device, texels.source(device), SolveSettings(size=SIZE, loss="squares"))
        maps = finish(solver.solve())
        albedo = finish(solver.albedo(maps.roughness, 1))
        found = [device.read(texture) for texture in (maps.roughness, maps.detail, albedo)]
        assert all(np.ptp(array) > 0.01 for array in found)
        width = solver.atlas.tile[0]
        for thing in (maps.roughness, maps.detail, albedo, solver, solver.source):
            thing.release()
        return width, [array.tobytes() for array in found]

    def as_device(is_software: bool) -> Any:
        def run(device: Device) -> tuple[int, list[bytes]]:
            with monkeypatch.context() as patch:
                patch.setattr(device, "is_software", is_software)
                return job(device)

        return on_gl(run)

    narrow, wide = as_device(True), as_device(False)
    assert (narrow[0], wide[0]) == (NARROW, SIZE)
    assert narrow[1] == wide[1]


@pytest.mark.parametrize(("layers", "is_software", "width"), [
    (UNROLLED, True, SIZE), (UNROLLED + 1, True, NARROW), (UNROLLED + 1, False, SIZE),
    (NARROW_BLOCKS // 3, True, NARROW), (NARROW_BLOCKS // 3 + 1, True, SIZE)])  # a layer of one lamp has three blocks
def test_only_software_with_many_layers_has_narrow_tiles(on_gl, monkeypatch, layers, is_software, width):
    texels = random_texels((0,) * layers, 1, lights=1, size=SIZE)

    def job(device: Device) -> int:
        monkeypatch.setattr(device, "is_software", is_software)
        source = texels.source(device)
        atlas = ObservationAtlas(device, source)
        found = atlas.tile[0]
        atlas.release()
        source.release()
        return found

    assert on_gl(job) == width
