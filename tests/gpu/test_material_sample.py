"""Squares of texels, packed: on the device as in memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import groupby
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.data import RadianceImage
from irpso_addon.core.evaluation.sampled_texels import SampledTexels
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.samples import selftest
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.gbuffer.gbuffer import MeshBuffer, draw_texel_grid
from irpso_addon.gpu.observe.observation_atlas import CameraSource, ObservationAtlas
from irpso_addon.gpu.observe.observations import ObserveOptions, observe
from irpso_addon.gpu.solve.calibration_sample import calibration_sample
from irpso_addon.gpu.solve.material_sample import SIDE, WIDTH, Squares, packed, read_sample, spread_squares
from irpso_addon.gpu.solve.model_prediction import Decision, ModelPrediction
from irpso_addon.gpu.solve.prediction_trials import Fitted
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


Change = Callable[[RadianceImage], RadianceImage]


def _source(device: Device, change: Change = lambda image: image, coloured: bool = False) -> CameraSource:
    """Texels of the self-test, as its cameras see them; ``change``: of the pictures.

    ``coloured``: a red and a blue lamp in the place of each, so that channels are kept apart.
    """
    made = selftest.build()
    scene = made.scene
    views = {view.image: view for view in scene.views}
    if coloured:
        scene = replace(scene, views=tuple(replace(view, lights=tuple(
            replace(view.lights[0], name=f"{view.lights[0].name} {n}", power=view.lights[0].power * share)
            for n, share in enumerate(np.array([[0.9, 0.5, 0.2], [0.1, 0.5, 0.8]])))) for view in scene.views))
    mesh = MeshBuffer(device, scene.mesh)
    return CameraSource(device, draw_texel_grid(device, mesh, 32), finish(
        observe(device, scene, mesh, lambda view: change(made.read_image(views[view.image])))))


def _clipped(white: float) -> Change:
    def change(image: RadianceImage) -> RadianceImage:
        rgb = np.minimum(image.rgb, np.float32(white))
        return replace(image, rgb=rgb, valid=image.valid & (image.rgb < white).all(-1))

    return change


@pytest.mark.parametrize("coloured", [False, True])
def test_a_sample_knows_what_clipped_pixels_show_at_least(on_gl: Any, coloured: bool) -> None:
    """Where they would be good observations, and as far; nothing else changes."""

    def job(device: Device) -> tuple[SampledTexels, ...]:
        with device.scope():
            every = np.ones((32, 32), bool)
            squares = spread_squares(every, 16, 1)
            true, clipped = (_source(device, change, coloured) for change in (lambda image: image, _clipped(white)))
            assert true.layers.channels == (3 if coloured else 1)
            kept, known = (packed(device, each, every, squares) for each in (true, clipped))
            return (read_sample(device, kept, 500, bounds=True)[0], read_sample(device, known, 500, bounds=True)[0],
                    read_sample(device, known, 500)[0])

    white = float(np.quantile([selftest.build().read_image(view).rgb.max(-1) for view in selftest.build().scene.views],
                              0.8))
    true, bounded, left_out = on_gl(job)
    assert true.clipped is None and left_out.clipped is None and bounded.clipped is not None
    over = bounded.clipped > 0
    assert 0.1 < over.mean() < 0.4
    np.testing.assert_array_equal(over, (true.quality > 0) & (bounded.quality == 0))
    np.testing.assert_allclose(bounded.clipped[over], true.quality[over], rtol=0.06)  # less for little light
    radiance = true.reflected * true.irradiance
    least = np.minimum(radiance, white) / true.irradiance
    np.testing.assert_allclose(bounded.reflected[over], least[over], rtol=0.015)  # pixels lie beside their texels
    assert (bounded.reflected <= true.reflected).all()
    if not coloured:
        above = [(true.quality > 0) & (radiance > (1 + off) * white).any(-1) for off in (-0.015, 0.015)]
        assert (over <= above[0]).all() and (over >= above[1]).all()
    for name in ("quality", "cos_v", "lobes", "irradiance"):
        np.testing.assert_array_equal(getattr(bounded, name), getattr(left_out, name))
    np.testing.assert_array_equal(left_out.reflected, np.where(over[..., None], 0, bounded.reflected))
    good = bounded.quality > 0
    np.testing.assert_array_equal(bounded.reflected[good], true.reflected[good])


def left(image: RadianceImage) -> RadianceImage:
    """The same picture, its right half masked."""
    shown = np.arange(image.rgb.shape[1]) < image.rgb.shape[1] // 2
    return replace(image, valid=image.valid & shown)


def test_texels_that_nothing_shows_say_nothing_of_lamps(on_gl: Any) -> None:
    """Pictures whose right half is masked: the sample is that of whole pictures, as far as these show it."""

    def job(device: Device) -> tuple[np.ndarray, ...]:
        with device.scope():
            every = np.ones((32, 32), bool)
            return tuple(calibration_sample(_source(device, change), every, 1, True).position
                         for change in (lambda image: image, left))

    whole, half = on_gl(job)
    assert 0.4 * len(whole) < len(half) < 0.6 * len(whole)
    pixel = 2.2 / 64  # metres
    assert half[:, 0].max() < pixel and whole[whole[:, 0] < -pixel].shape == half[half[:, 0] < -pixel].shape


def test_a_sample_of_which_nothing_shows_is_whole(on_gl: Any) -> None:
    """As where pictures show a small spot of a large map, which the sample misses: it is not empty."""

    def job(device: Device) -> np.ndarray:
        with device.scope():
            right = np.zeros((32, 32), bool)
            right[:, 20:] = True
            sample = calibration_sample(_source(device, left), right, 1, True)
            assert not (sample.texels.quality > 0).any()
            return sample.position

    assert len(on_gl(job)) > 100


@pytest.mark.one_python
def test_prediction_counts_highlights_that_are_clipped(on_gl: Any) -> None:
    """Lambert lacks them; the one lobe that the square has does not."""

    def black(image: RadianceImage) -> RadianceImage:
        image = _clipped(white)(image)
        return replace(image, rgb=np.where(image.valid[..., None], image.rgb, np.float32(0)))

    def job(device: Device) -> list[Decision]:
        found = []
        for change in (_clipped(white), black):
            with device.scope():
                prediction = ModelPrediction(device, _source(device, change), SolveSettings(size=32))
                found.append(finish(prediction.decide(np.ones((32, 32), bool), Fitted("one-lobe"))))
        return found

    shown = selftest.build()
    white = float(np.quantile([shown.read_image(view).rgb.max(-1) for view in shown.scene.views], 0.9))
    known, unknown = (decision.prediction for decision in on_gl(job))
    assert known is not None and unknown is not None
    assert known.tried["lambert"].relative_rms > 1.1 * unknown.tried["lambert"].relative_rms
    assert known.tried["one value"].relative_rms < 0.01 and unknown.tried["one value"].relative_rms < 0.01


def test_edges_and_what_masks_keep_out_bound_nothing(on_gl: Any) -> None:
    """A pixel of the square's outline, and one that a mask covers in part, may be bright by what lies beside."""
    parted = np.ones((selftest.PIXELS, selftest.PIXELS), np.float32)
    parted[20:24], parted[30:34], parted[40:44] = 0.0, 0.4, 0.9

    def change(image: RadianceImage) -> RadianceImage:
        return replace(image, rgb=np.full_like(image.rgb, 3.0), valid=image.coverage < 0, coverage=parted)

    def job(device: Device) -> np.ndarray:
        with device.scope():
            made = selftest.build()
            mesh = MeshBuffer(device, made.scene.mesh)
            seen = finish(observe(device, replace(made.scene, views=made.scene.views[:1]), mesh,
                                  lambda view: change(made.read_image(view)), ObserveOptions(level=1.0)))
            return device.read(seen.cameras[0].views[0].colour).copy()

    colour = on_gl(job)
    assert not colour[..., 3].any()
    bound = (colour[..., :3] > 0).all(-1)
    shown = np.flatnonzero(abs(selftest.EDGE * ((np.arange(selftest.PIXELS) + 0.5) / selftest.PIXELS * 2 - 1)) < 1)
    inner = np.zeros_like(bound)
    inner[shown[1]:shown[-1], shown[1]:shown[-1]] = True
    np.testing.assert_array_equal(bound, inner & (parted == 1))


def test_the_search_of_each_texel_leaves_clipped_pixels_out(on_gl: Any) -> None:
    """To the last bit what it finds where a clipped pixel holds nothing."""

    def black(image: RadianceImage) -> RadianceImage:
        image = _clipped(white)(image)
        return replace(image, rgb=np.where(image.valid[..., None], image.rgb, np.float32(0)))

    def job(device: Device) -> list[tuple[np.ndarray, np.ndarray]]:
        found = []
        for change in (_clipped(white), black):
            with device.scope():
                source = _source(device, change)
                atlas = ObservationAtlas(device, source)
                for _ in source.gather(atlas, (0, 0), True):
                    pass
                blocks = device.read(atlas.texture).reshape(source.layers.blocks, -1)
                solver = Solver(device, source, SolveSettings(size=32))
                maps = finish(solver.among_neighbours(finish(solver.searched())))
                found.append((blocks[::source.layers.each].copy(), device.read(maps.roughness).copy()))
        return found

    white = 0.1
    for clipped, out in zip(*on_gl(job), strict=True):
        assert out.any()
        np.testing.assert_array_equal(clipped, out)


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
