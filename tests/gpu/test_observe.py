"""Observations of the self-test's square: a view of one lamp goes another way through the shaders than one of two."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.compare.texels import observe_texels
from irpso_addon.core.data import Light, RadianceImage, SceneData, View
from irpso_addon.core.samples import selftest
from irpso_addon.gpu.device.context import Inputs
from irpso_addon.gpu.device.occupied_cells import CELL, OccupiedCells
from irpso_addon.gpu.gbuffer.gbuffer import MeshBuffer
from irpso_addon.gpu.observe.observations import LitMaps, ObserveOptions, observe
from irpso_addon.gpu.observe.visibility import LightVisibility
from tests.support import synthetic as syn
from tests.support.texels import finish


def observed(on_gl, scene: SceneData, read_image):
    """Per view (colour, lobes) of the only camera, as arrays."""

    def work(device):
        mesh = MeshBuffer(device, scene.mesh)
        steps = observe(device, scene, mesh, read_image)
        while True:
            try:
                next(steps)
            except StopIteration as end:
                found = end.value
                break
        result = [(device.read(view.colour), [device.read(lobe) for lobe in view.lobes])
                  for view in found.cameras[0].views]
        found.release()
        mesh.release()
        return result

    return on_gl(work)


def halves(light: Light, tint: tuple[float, float, float] = (0.5, 0.5, 0.5)) -> tuple[Light, Light]:
    """Two lamps in the place of one, which together are it."""
    share = np.array(tint)
    return (replace(light, name=f"{light.name} a", power=light.power * share),
            replace(light, name=f"{light.name} b", power=light.power * (1 - share)))


@pytest.fixture(scope="module")
def test():
    made = selftest.build()
    lamps = [replace(view.lights[0], radius=0.0 if i % 2 else 0.3) for i, view in enumerate(made.scene.views)]
    views = tuple(replace(view, lights=(lamp,)) for view, lamp in zip(made.scene.views, lamps, strict=True))
    return replace(made, scene=replace(made.scene, views=views[:6]))


def test_one_lamp_is_two_halves(on_gl, test):
    whole = observed(on_gl, test.scene, test.read_image)
    views = tuple(replace(view, lights=halves(view.lights[0])) for view in test.scene.views)
    parts = observed(on_gl, replace(test.scene, views=views), lambda view: test.read_image(view_of(test, view)))
    for (colour, (lobe,)), (colour_2, lobes_2) in zip(whole, parts, strict=True):
        assert colour[..., 3].max() > 0.5
        np.testing.assert_allclose(colour_2, colour, rtol=2e-5, atol=1e-6)
        for half in lobes_2:
            np.testing.assert_allclose(half[..., :3], lobe[..., :3], rtol=2e-5, atol=1e-6)
        np.testing.assert_allclose(lobes_2[0][..., 3] + lobes_2[1][..., 3], lobe[..., 3], rtol=2e-5, atol=1e-6)


def test_cameras_that_are_taken_over_show_the_same(on_gl, test):
    """Under other lamps, an earlier observation's cameras, its views freed, do for those drawn anew."""
    brighter = replace(test.scene, views=tuple(
        replace(view, ambient_radiance=(0.1, 0.2, 0.3),
                lights=(replace(view.lights[0], power=2 * view.lights[0].power),)) for view in test.scene.views))

    def read(view: View) -> RadianceImage:
        return test.read_image(view_of(test, view))

    def work(device):
        mesh = MeshBuffer(device, test.scene.mesh)
        first = finish(observe(device, test.scene, mesh, read))
        first.release_views()
        found = finish(observe(device, brighter, mesh, read, ObserveOptions(drawn=first.cameras)))
        assert found.cameras[0].maps is first.cameras[0].maps
        assert len(found.cameras[0].views) == len(test.scene.views)
        result = [(device.read(view.colour), device.read(view.lobes[0])) for view in found.cameras[0].views]
        found.release()
        mesh.release()
        return result

    for taken, (colour, (lobe,)) in zip(on_gl(work), observed(on_gl, brighter, read), strict=True):
        assert colour[..., 3].max() > 0
        np.testing.assert_array_equal(taken, (colour, lobe))


def test_shadows_that_are_taken_over_are_the_same(on_gl, test, monkeypatch):
    """None is drawn again; those of a lamp that has none yet are, and kept."""
    drawn: list[str] = []
    lit_maps = LightVisibility.lit_maps

    def counted(self, light, *given):
        drawn.append(light.name)
        return lit_maps(self, light, *given)

    monkeypatch.setattr(LightVisibility, "lit_maps", counted)

    def work(device):
        mesh, lit = MeshBuffer(device, test.scene.mesh), LitMaps()
        names = [view.lights[0].name for view in test.scene.views]
        some = replace(test.scene, views=test.scene.views[:-1])
        results = []
        for scene in (some, test.scene, test.scene):
            found = finish(observe(device, scene, mesh, test.read_image, ObserveOptions(lit=lit)))
            results.append([(device.read(view.colour), device.read(view.lobes[0])) for view in found.cameras[0].views])
            found.release()
        assert drawn == names and {key[0] for key in lit} == set(names)
        lit.release()
        mesh.release()
        assert not lit
        return results

    fresh = [(colour, lobe) for colour, (lobe,) in observed(on_gl, test.scene, test.read_image)]
    drawn.clear()
    for found in on_gl(work)[1:]:  # the first lacks a view, and with it goes by another level
        np.testing.assert_array_equal(found, fresh)


def test_coloured_lamps_share_each_channel(on_gl, test):
    """A red-weighted and a blue-weighted lamp: three lobes each, whose factors add up to the white lamp's."""
    whole = observed(on_gl, test.scene, test.read_image)
    views = tuple(replace(view, lights=halves(view.lights[0], (0.9, 0.5, 0.2))) for view in test.scene.views)
    parts = observed(on_gl, replace(test.scene, views=views), lambda view: test.read_image(view_of(test, view)))
    for (colour, (lobe,)), (colour_2, lobes_2) in zip(whole, parts, strict=True):
        assert len(lobes_2) == 6
        np.testing.assert_allclose(colour_2, colour, rtol=2e-5, atol=1e-6)
        for channel, share in enumerate((0.9, 0.5, 0.2)):
            np.testing.assert_allclose(lobes_2[channel][..., 3], lobe[..., 3] * share, rtol=1e-4, atol=1e-6)


def test_what_is_observed_is_what_was_drawn(on_gl, test):
    """f = radiance / irradiance of the pixel's own lamp, where the lamp is a point: the self-test's formula."""
    sharp = [i for i, view in enumerate(test.scene.views) if view.lights[0].radius == 0.0]
    for i, (colour, _) in enumerate(observed(on_gl, test.scene, test.read_image)):
        if i not in sharp:
            continue
        lamp, image = test.scene.views[i].lights[0], test.read_image(test.scene.views[i])
        good = colour[..., 3] > 0.5
        size = len(image.rgb)
        centres = selftest.EDGE * ((np.arange(size) + 0.5) / size * 2 - 1)
        x, y = np.meshgrid(centres, centres)
        away = lamp.matrix[:3, 3] - np.stack([x, y, np.zeros_like(x)], -1)
        square = (away**2).sum(-1)
        irradiance = lamp.power[0] * away[..., 2] / np.sqrt(square) / (4 * np.pi * square)
        # The footprint's mean irradiance is the centre's but for the curvature over a pixel.
        np.testing.assert_allclose(colour[good][:, :3], (image.rgb / irradiance[..., None])[good], rtol=2e-3)


@pytest.mark.parametrize(("share", "counts"), [(1e-3, False), (20.0, True)])
def test_the_terminator_of_a_lamp_counts_where_its_light_does(on_gl, test, share, counts):
    """A second lamp grazes the square: a thousandth of the first one's light leaves nothing in doubt."""
    def low(light: Light) -> Light:
        matrix = light.matrix.copy()
        matrix[:3, 3] = 60.0, 0.0, 1.0
        distance2 = (60.0 / np.linalg.norm(light.matrix[:3, 3])) ** 2
        return replace(light, name="Low", matrix=matrix, power=light.power * share * distance2)

    views = tuple(replace(view, lights=(*view.lights, low(view.lights[0]))) for view in test.scene.views)
    both = observed(on_gl, replace(test.scene, views=views), lambda view: test.read_image(view_of(test, view)))
    for (alone, _), (colour, _) in zip(observed(on_gl, test.scene, test.read_image), both, strict=True):
        good = alone[..., 3] > 0.5
        assert good.any()
        if counts:
            assert colour[good][:, 3].max() < 0.01
        else:
            np.testing.assert_allclose(colour[good][:, 3], alone[good][:, 3], rtol=0.01)


@pytest.mark.parametrize("low", [0.05, -0.2])
@pytest.mark.parametrize("shape", ["DISK", "SQUARE"])
def test_a_wide_lamp_that_the_horizon_cuts(on_gl, test, shape, low):
    """A panel of 2 m beside the square, of which about a half or less is above its plane: nothing hides what is.

    The truth is a sum over 200 x 200 points of the panel, in float64.
    """
    panel = syn.lamp((3.0, 0.0, low), (0, 0, low), kind="AREA", shape=shape, size=(2.0, 2.0), power=300.0)
    view = replace(test.scene.views[0], lights=(panel,))
    image = RadianceImage(np.ones((64, 64, 3), np.float32), np.ones((64, 64), np.float32), np.ones((64, 64), bool))
    (colour, _), = observed(on_gl, replace(test.scene, views=(view,)), lambda _: image)
    centres = selftest.EDGE * ((np.arange(64) + 0.5) / 64 * 2 - 1)
    inner = np.flatnonzero(abs(centres) < 0.9)[::6]
    x, y = np.meshgrid(centres[inner], centres[inner])
    a, b = ((np.indices((200, 200)).reshape(2, -1) + 0.5) / 100 - 1)
    on = a**2 + b**2 <= 1 if shape == "DISK" else np.ones_like(a, bool)
    points = panel.matrix[:3, 3] + a[on, None] * panel.matrix[:3, 0] + b[on, None] * panel.matrix[:3, 1]
    sent = np.zeros_like(x)
    for point in points[points[:, 2] > 0]:
        sent += point[2] * (point[0] - x) / ((point[0] - x)**2 + (point[1] - y)**2 + point[2]**2) ** 2
    irradiance = panel.power[0] / np.pi * sent / on.sum()
    error = abs(colour[np.ix_(inner, inner)][..., 1] * irradiance - 1)
    # Where the lowest points graze the square, it shadows itself a little; of a sunk panel few others are left.
    assert np.median(error) < 0.01 and error.max() < (0.04 if low > 0 else 0.06)
    if low > 0:
        assert (colour[np.ix_(inner, inner)][..., 3] > 0.5).mean() > 0.8


@pytest.mark.parametrize(("height", "shades"), [(3.0, False), (1.0, True)])
def test_what_cameras_do_not_see_casts_shadows_alone(on_gl, test, height, shades):
    """A wall between the camera, at 4 m, and the square; the lamps are at 2.5 m."""
    wall = np.array([(-9, -9, height), (9, -9, height), (0, 18, height)], np.float32)[None]
    views = tuple(view for view in test.scene.views if view.lights[0].radius == 0)
    scene = replace(test.scene, views=views)
    open_, hidden = (observed(on_gl, replace(scene, unseen=unseen), test.read_image)
                     for unseen in (scene.unseen, wall))
    for (colour, _), (behind, _) in zip(open_, hidden, strict=True):
        assert colour[..., 3].max() > 0.5
        if shades:
            assert not behind[..., 3].any()
        else:
            np.testing.assert_array_equal(behind, colour)


def view_of(test, view):
    """The self-test draws a view by its one lamp."""
    return next(own for own in test.scene.views if own.image == view.image)


@pytest.mark.parametrize("pixels", [24, 96])
def test_no_pixel_is_taken_for_the_back_of_what_it_shows(on_gl, pixels):
    """Near the outline of a ball the far side is less than a few slanted pixels behind the near one."""
    positions, normals = syn.sphere(96, 48)
    around = np.arctan2(normals[..., 1], normals[..., 0]) / (2 * np.pi)
    middle = np.arctan2(*np.moveaxis(normals.mean(1)[:, 1::-1], -1, 0)) / (2 * np.pi)
    around += np.round(middle[:, None] - around) + 0.5  # a triangle's corners on one side of the seam
    uvs = np.stack([around, np.arccos(np.clip(normals[..., 2], -1, 1)) / np.pi], -1)
    camera = syn.camera((0, -5, 0), width=2.2)
    view = View(Path("a.exr"), camera, (syn.lamp((0.5, -5, 1)),))
    white = RadianceImage(np.ones((pixels, pixels, 3), np.float32), np.ones((pixels, pixels), np.float32),
                          np.ones((pixels, pixels), bool))
    scene = SceneData("ball", syn.mesh_arrays(positions, normals, uvs), np.zeros((0, 3, 3), np.float32), (view,))

    def work(_):
        _, (found,) = finish(observe_texels(
            scene, 64, lambda _: white, lambda where, views: (*np.nonzero(where), views[0].weight.max(-1) > 0)))
        return found

    rows, columns, seen = on_gl(work)
    turn, down = 2 * np.pi * ((columns + 0.5) / 64 - 0.5), np.pi * (rows + 0.5) / 64
    facing = -np.sin(down) * np.sin(turn)  # cosine between normal and the camera's direction
    assert seen[facing > 0.9].all()
    assert not seen[facing < -0.02].any()


@pytest.mark.parametrize("size", [(8, 8), (37, 21), (64, 40)])
def test_cells_are_the_squares_that_hold_something(on_gl, size):
    """Drawn into zeros, they cover every covered pixel and nothing outside the squares around them."""
    width, height = size
    covered = np.zeros((height, width), bool)
    covered[height // 2, width // 3], covered[-1, -1], covered[0, 0] = True, True, True
    want = np.zeros_like(covered)
    for y, x in np.argwhere(covered):
        want[y // CELL * CELL:(y // CELL + 1) * CELL, x // CELL * CELL:(x // CELL + 1) * CELL] = True

    def work(device):
        ones = device.texture(width, height, 4, np.ones((height, width, 4), np.float32))
        texture = device.texture(width, height)
        target = device.framebuffer([texture])
        texture.write(np.repeat(covered[..., None], 4, axis=2).astype(np.float32).tobytes())
        cells = OccupiedCells(device, texture)
        target.clear()
        with device.adding():  # what is drawn twice would show
            device.draw("maps/fill_up.frag", target, Inputs(textures={"u_map": ones, "u_parent": ones}),
                        cells=cells)
        result = device.read(texture)[..., 0].copy()
        for thing in (cells, target, texture, ones):
            thing.release()
        return result

    assert (on_gl(work) == want).all()


def test_cells_of_nothing_draw_nothing(on_gl):
    def work(device):
        texture = device.texture(16, 16, 4, np.full((16, 16, 4), 7, np.float32))
        target = device.framebuffer([texture])
        nothing = device.texture(16, 16, 4, np.zeros((16, 16, 4), np.float32))
        cells = OccupiedCells(device, nothing)
        device.draw("maps/fill_up.frag", target, Inputs(textures={"u_map": texture, "u_parent": texture}),
                    cells=cells)
        result = device.read(texture).copy()
        for thing in (cells, target, texture, nothing):
            thing.release()
        return result

    assert (on_gl(work) == 7).all()


@pytest.mark.parametrize("lamps", [1, 2])
def test_negative_radiance_is_observed_as_it_is(on_gl, test, lamps):
    """Noise about the black level: where a pixel shows -0.03 of what it did, so does its observation."""
    views = tuple(replace(view, lights=halves(view.lights[0])) if lamps == 2 else view for view in test.scene.views)
    scene = replace(test.scene, views=views)

    def dark(view):
        image = test.read_image(view_of(test, view))
        rgb = image.rgb.copy()
        rgb[::2] *= np.float32(-0.03)
        return replace(image, rgb=rgb)

    whole = observed(on_gl, scene, lambda view: test.read_image(view_of(test, view)))
    for (colour, _), (below, _) in zip(whole, observed(on_gl, scene, dark), strict=True):
        lit = (colour[::2, :, 3] > 0) & (colour[::2, :, :3] > -100).all(-1)
        assert lit.sum() > 100
        np.testing.assert_allclose(below[::2, :, :3][lit], -0.03 * colour[::2, :, :3][lit], rtol=1e-5, atol=2e-5)
        np.testing.assert_array_equal(below[1::2, :, :3], colour[1::2, :, :3])
