"""Indirect light in the observations, on the self-test's square: light that the pictures hold besides the lamps'."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.data import Bounced
from irpso_addon.core.observation_quality import DARK_SHARE
from irpso_addon.core.samples import selftest
from irpso_addon.core.tiled.uv_blocks import Crop, cropped
from irpso_addon.gpu.gbuffer.gbuffer import MeshBuffer, Occluders, draw_pixel_grid
from irpso_addon.gpu.observe import indirect_light as smoothing
from irpso_addon.gpu.observe.indirect_light import Smoother
from irpso_addon.gpu.observe.observations import ObserveOptions, camera_uniforms, observe
from tests.support.texels import finish

TINT = np.array([0.9, 0.5, 0.2], np.float32)  # of the indirect light


def observed(on_gl, scene, read_image, bounced):
    """Per view (colour, lobe factor), (h, w, 4) and (h, w)."""
    def work(device):
        mesh = MeshBuffer(device, scene.mesh)
        found = finish(observe(device, scene, mesh, read_image, ObserveOptions(bounced)))
        result = [(device.read(view.colour).copy(), device.read(view.lobes[0])[..., 3].copy())
                  for view in found.cameras[0].views]
        found.release()
        mesh.release()
        return result

    return on_gl(work)


@pytest.fixture(scope="module")
def square():
    test = selftest.build()
    return replace(test, scene=replace(test.scene, views=test.scene.views[:4]))


def flat(light: float, glossy: float, size: int = 16) -> Bounced:
    """The same everywhere."""
    return Bounced(np.full((size, size, 3), light, np.float32) * TINT, np.full((size, size, 3), glossy, np.float32))


def test_irradiance_is_the_sum_and_glossy_light_goes_off_the_picture(on_gl, square):
    """f = (L - glossy) / (E_lamp + E_indirect); the lamp's lobe counts by its share of the light, mean over RGB."""
    direct = observed(on_gl, square.scene, square.read_image, None)
    indirect = observed(on_gl, square.scene, square.read_image, dict.fromkeys(range(4), flat(3.0, 0.05)))
    for view, (plain, lobe), (colour, lobe_2) in zip(square.scene.views, direct, indirect, strict=True):
        good = (plain[..., 3] > 0.5) & (colour[..., 3] > 0)
        assert good.sum() > 1000
        radiance = square.read_image(view).rgb[good].astype(np.float64)
        lamp = radiance / plain[good][:, :3]
        want = np.maximum(radiance - 0.05, 0) / (lamp + 3.0 * TINT)
        np.testing.assert_allclose(colour[good][:, :3], want, rtol=2e-4, atol=1e-6)
        share = (lamp / (lamp + 3.0 * TINT)).mean(-1)
        np.testing.assert_allclose(lobe_2[good], lobe[good] * share, rtol=2e-4)
        assert (colour[good][:, 3] < plain[good][:, 3]).all()  # less is known than of lamps alone


def test_no_indirect_light_changes_nothing(on_gl, square):
    direct = observed(on_gl, square.scene, square.read_image, None)
    none = observed(on_gl, square.scene, square.read_image, dict.fromkeys(range(4), flat(0.0, 0.0)))
    for (plain, lobe), (colour, lobe_2) in zip(direct, none, strict=True):
        np.testing.assert_allclose(colour, plain, rtol=2e-5, atol=1e-6)
        np.testing.assert_allclose(lobe_2, lobe, rtol=2e-5, atol=1e-6)


def smoothed(on_gl, scene, picture: Bounced, size: tuple[int, int] = (64, 64)) -> np.ndarray:
    """(h, w, 4) irradiance at the square's pixels, and coverage."""
    def work(device):
        with device.scope():
            mesh, camera = MeshBuffer(device, scene.mesh), scene.views[0].camera
            nothing = Occluders(device, scene.occluders)
            maps = draw_pixel_grid(device, mesh, nothing, camera, size, 0.0)
            smoother = Smoother(device, mesh, nothing, camera, maps, lambda c, h: camera_uniforms(c, h, 0.0))
            result = device.read(smoother.smooth(picture)[0]).copy()
            result[..., 3] = device.read(maps.position)[..., 3]
            return result

    return on_gl(work)


def test_smoothing_keeps_what_is_smooth_and_cuts_sparks(on_gl, square):
    """A ramp stays (but for the borders, where the window is one-sided); of one pixel of 10 000 times its light, which
    the mean would show 400 times brighter, little is left."""
    ramp = np.repeat(np.linspace(1, 2, 32, dtype=np.float32)[None, :, None], 32, 0).repeat(3, 2)
    result = smoothed(on_gl, square.scene, Bounced(ramp, ramp))
    at = (np.arange(64) + 0.5) / 2 - 0.5
    inner = slice(16, 48)
    np.testing.assert_allclose(result[inner, inner, 0], np.interp(at, np.arange(32), ramp[0, :, 0])[None, inner].repeat(
        32, 0), rtol=5e-3)
    spark = ramp.copy()
    spark[16, 16] *= 1e4
    lit = smoothed(on_gl, square.scene, Bounced(spark, ramp))
    assert lit[..., 0].max() < 40 * 1.5


def test_noise_is_averaged(on_gl, square):
    """Independent noise falls by the root of the window's effective number of pixels, 4 pi sigma^2."""
    noise = np.random.default_rng(1).gamma(4.0, 0.25, (64, 64, 1)).astype(np.float32).repeat(3, 2)  # 50 % of its mean
    result = smoothed(on_gl, square.scene, Bounced(noise, noise))
    inner = result[12:52, 12:52, 0]
    assert abs(inner.mean() - 1) < 0.02
    assert inner.std() < 1.3 * 0.5 / np.sqrt(4 * np.pi * smoothing.MEAN[1] ** 2)


def test_a_part_of_a_picture_has_the_light_of_that_part(on_gl, square):
    """A camera cropped to a part of its frame, as blocks of large maps have it, sees what the whole one sees there."""
    rng = np.random.default_rng(4)
    picture = Bounced(rng.uniform(0.5, 2.0, (16, 16, 3)).astype(np.float32), np.zeros((16, 16, 3), np.float32))
    crop = Crop(20, 8, 24, 40)
    whole = smoothed(on_gl, square.scene, picture)
    view = square.scene.views[0]
    part = replace(square.scene, views=(replace(view, camera=cropped(view.camera, 64, 64, crop)),))
    found = smoothed(on_gl, part, picture, size=(crop.width, crop.height))
    there = whole[crop.y:crop.y + crop.height, crop.x:crop.x + crop.width]
    assert (found[..., 3] == there[..., 3]).all() and found[..., 3].sum() > 500
    np.testing.assert_allclose(found[..., :3], there[..., :3], rtol=1e-4)


def test_weak_lamps_count_less_beside_light_from_all_around(on_gl, square):
    """By the square of how far such light's share exceeds half a per cent; under typical light nothing changes."""
    def seen(radiance: float):
        views = tuple(replace(view, ambient_radiance=(radiance,) * 3) for view in square.scene.views)

        def work(device):
            mesh = MeshBuffer(device, square.scene.mesh)
            found = finish(observe(device, replace(square.scene, views=views), mesh, square.read_image))
            result = [device.read(view.colour).copy() for view in found.cameras[0].views], found.level
            found.release()
            mesh.release()
            return result

        return on_gl(work)

    plain, level = seen(0.0)
    e = []
    for view, colour in zip(square.scene.views, plain, strict=True):
        good = colour[..., 3] > 0
        shown = square.read_image(view).rgb[good].mean(-1)
        e.append((good, shown / colour[good][:, :3].mean(-1)))
    ambient = 0.01 * float(np.median(np.concatenate([irradiance for _, irradiance in e])))  # W/m^2
    lit, _ = seen(ambient / np.pi)
    least = 1.0
    for (good, irradiance), before, after in zip(e, plain, lit, strict=True):
        dark = DARK_SHARE * level
        together = irradiance + ambient
        share, typical = (ambient / all_light / 0.005 for all_light in (together, 10 * level))
        wanted = np.minimum((1 + typical**2) / (1 + share**2), 1) / (1 + (ambient / together / 0.2) ** 2) * (
            together / (together + dark) * (irradiance + dark) / irradiance) ** 2
        got = after[good][:, 3] / before[good][:, 3]
        np.testing.assert_allclose(got, wanted, rtol=0.05)
        least = min(least, float(got.min()))
    assert least < 0.5
