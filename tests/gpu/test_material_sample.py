"""Squares of texels, packed: on the device as in memory."""

from __future__ import annotations

from collections.abc import Callable
from itertools import groupby
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.params import SolveSettings
from irpso_addon.core.samples import selftest
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.gbuffer.gbuffer import MeshBuffer, draw_texel_grid
from irpso_addon.gpu.observe.observation_atlas import CameraSource, ObservationAtlas
from irpso_addon.gpu.observe.observations import observe
from irpso_addon.gpu.solve.material_sample import SIDE, WIDTH, Squares, packed, spread_squares
from irpso_addon.gpu.solve.solver import Solver
from tests.support.texels import finish


@pytest.mark.parametrize("channels", [1, 4])
@pytest.mark.parametrize("count", [1, WIDTH // SIDE, 3 * WIDTH // SIDE - 5])
def test_a_texture_is_packed_as_an_array_is(on_gl: Any, count: int, channels: int) -> None:
    """The grid ends within squares, whose rest is 0."""
    rng = np.random.default_rng(count)
    grid = rng.random((99, 77, channels), np.float32)
    texels = np.ones(grid.shape[:2], bool)
    squares = spread_squares(texels, count, 1)
    squares = Squares((*squares.corners[1:], (72, 96)))  # the last of all

    def packed(device: Device) -> np.ndarray:
        with device.scope():
            return squares.pack_texture(device, device.texture(77, 99, channels, grid)).copy()

    expected = squares.pack(grid)
    assert expected[(count - 1) // (WIDTH // SIDE) * SIDE:].any()
    assert all(size & (size - 1) == 0 for size in expected.shape[:2])
    np.testing.assert_array_equal(on_gl(packed), expected)


@pytest.fixture
def drawn(on_gl: Any, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The shaders that draw, in their order."""
    names: list[str] = []

    def heard(original: Callable[..., Any]) -> Callable[..., Any]:
        def called(self: Device, name: str, *arguments: Any, **more: Any) -> Any:
            names.append(name)
            return original(self, name, *arguments, **more)

        return called

    for method in ("draw", "steps"):
        monkeypatch.setattr(Device, method, heard(getattr(Device, method)))
    return names


def _source(device: Device) -> CameraSource:
    """Texels of the self-test, as its cameras see them."""
    made = selftest.build()
    mesh = MeshBuffer(device, made.scene.mesh)
    return CameraSource(device, draw_texel_grid(device, mesh, 32),
                        finish(observe(device, made.scene, mesh, made.read_image)))


def test_an_atlas_that_holds_a_sample_is_not_filled_again(on_gl: Any, drawn: list[str]) -> None:
    """Unless other layers are left out, or another atlas was filled in between."""

    def job(device: Device) -> None:
        with device.scope():
            every = np.ones((32, 32), bool)
            sample = packed(device, _source(device), every, spread_squares(every, 16, 1))

            def filled(atlas: ObservationAtlas) -> np.ndarray:
                drawn.clear()
                for _ in sample.gather(atlas, (0, 0), False):
                    pass
                return device.read(atlas.texture).copy()

            atlas = ObservationAtlas(device, sample)
            whole = filled(atlas)
            assert np.array_equal(filled(atlas), whole) and not drawn
            sample.left_out = np.arange(len(sample.layers.groups)) % 3 == 0
            part = filled(atlas)
            assert drawn and not np.array_equal(part, whole)
            assert np.array_equal(filled(ObservationAtlas(device, sample)), part) and drawn
            assert np.array_equal(filled(atlas), part) and drawn
            sample.left_out = np.zeros_like(sample.left_out)
            assert np.array_equal(filled(atlas), whole)

    on_gl(job)


def test_base_colours_and_tables_share_what_a_tile_gathers(on_gl: Any, drawn: list[str]) -> None:
    """Each gathering matches the tile's texels to a camera's pixels."""

    def job(device: Device) -> None:
        with device.scope():
            source = _source(device)
            solver = Solver(device, source, SolveSettings(size=32))
            searched = finish(solver.searched())
            drawn.clear()
            finish(solver.among_neighbours(searched))
            tiles = "observe/match.frag", *(f"solve/{name}.kernel" for name in ("albedo", "table", "polish"))
            assert [name for name, _ in groupby(name for name in drawn if name in tiles)] == [
                "observe/match.frag", "solve/albedo.kernel", "solve/table.kernel",
                "observe/match.frag", "solve/polish.kernel"]

    on_gl(job)
