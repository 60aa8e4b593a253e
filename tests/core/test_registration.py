"""Registration on pictures given by formulas: a ball of paint under several suns, so that every shift is exact."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.check_records import CERTAIN, GROWN, Misfit
from irpso_addon.core.checks.mended_cameras import corrected
from irpso_addon.core.checks.outline_cameras import optics_of
from irpso_addon.core.checks.outline_fit import BEND, GROWTH, INSET, ROLL, Optics, Outline, silhouette
from irpso_addon.core.checks.registration import OutlinedCamera, Registration, outline_misfits
from irpso_addon.core.checks.registration_fit import eroded, fit_views, gain_of_cameras
from irpso_addon.core.checks.view_check_data import CheckedView, PixelWindow
from irpso_addon.core.data import Camera, MeshArrays, SceneData, View
from irpso_addon.core.lens import Lens
from irpso_addon.core.projection import pixels_of
from tests.support.synthetic import plane_mesh

WIDTH, HEIGHT, RADIUS = 150, 120, 48.0
SUNS = np.array([(0.5, 0.3, 0.8), (-0.6, 0.2, 0.8), (0.1, -0.7, 0.7), (0.0, 0.6, 0.8), (0.7, -0.4, 0.6),
                 (-0.3, -0.2, 0.9)])


def ball(shift=(0.0, 0.0)):
    """(3, h, w) unit normal of a ball whose image lies ``shift`` pixels right and up; NaN beside it."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    n = np.stack([x - WIDTH / 2 - shift[0], y - HEIGHT / 2 - shift[1]]) / RADIUS
    beside = 1 - (n**2).sum(0)
    return np.concatenate([n, np.sqrt(np.where(beside > 0, beside, np.nan))[None]])


def paint(normal, seed):
    """(h, w) 0.2 to 0.8, waves a few pixels long, of a seed."""
    rng = np.random.default_rng(seed)
    waves = sum(np.sin(np.tensordot(rng.normal(size=3) * 9, normal, 1) + rng.uniform(0, 6)) for _ in range(4))
    return 0.5 + 0.3 * np.tanh(waves / 2)


def shaded(normal, sun):
    return np.maximum(np.tensordot(sun / np.linalg.norm(sun), normal, 1), 0)


@cache
def drawn_over(shift=(0.0, 0.0), shrunk=0.0):
    """(h, w) share of each pixel that the ball covers, by 8 x 8 points."""
    steps = (np.arange(8) + 0.5) / 8 - 0.5
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    inside = [np.hypot(x + i - WIDTH / 2 - shift[0], y + j - HEIGHT / 2 - shift[1]) < RADIUS - shrunk
              for i in steps for j in steps]
    return np.mean(inside, axis=0).astype(np.float32)


def camera(name="Cam"):
    return Camera(name, np.eye(4), np.eye(4), np.zeros(3), np.array([0, 0, -1.0]), False, WIDTH / HEIGHT)


def views(shifts, gains=None, alpha=True, noise=0.0, name="Cam", seed=5):
    """One camera's checked views.  Their prediction has partly another paint: what the maps say of it may be wrong."""
    still = ball()
    believed = 0.7 * paint(still, seed) + 0.3 * paint(still, 9)
    covered = np.isfinite(still[2])
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    window = PixelWindow((0, 0), (WIDTH, HEIGHT), covered, np.zeros((HEIGHT, WIDTH, 3), np.float32),
                    still.transpose(1, 2, 0).astype(np.float32),
                    np.stack([x / WIDTH, y / HEIGHT], -1).astype(np.float32), np.zeros((HEIGHT, WIDTH), np.float32),
                    np.nan_to_num(still[2]).astype(np.float32))
    rng = np.random.default_rng(1)
    three = lambda a: np.repeat(a[..., None], 3, 2).astype(np.float32)  # noqa: E731
    for n, shift in enumerate(shifts):
        there = ball(shift)
        light = np.where(covered, shaded(still, SUNS[n % len(SUNS)]), 0)
        seen = paint(there, seed) * shaded(there, SUNS[n % len(SUNS)]) * (gains[n] if gains is not None else 1)
        seen = seen * (1 + noise * rng.standard_normal(seen.shape))
        yield CheckedView(
            view=View(Path(f"{name}_{n}.exr"), camera(name), ()), window=window, observed=three(seen),
            predicted=three(np.where(covered, believed, 0)), specular=three(0 * light),
            quality=(light > 0.02).astype(np.float32), edge=light <= 0.02, unlit=covered & (light == 0),
            radiance=three(seen), irradiance=three(light), sin2h=light.astype(np.float32),
            coverage=drawn_over(shift) if alpha else np.ones((HEIGHT, WIDTH), np.float32), clipped=0.0)


def found(*cameras):
    registration = Registration()
    for one in cameras:
        for view in one:
            registration.add(view)
    return registration.estimate()


@pytest.mark.parametrize("alpha", [True, False])
@pytest.mark.parametrize("shift", [(0.25, 0.0), (0.4, -0.3), (-0.7, 0.7)])
def test_a_cameras_shift_is_found_whatever_the_paint(shift, alpha):
    """Within 5 % and 0.02 pixels in one round (measured: 0.005 with alpha, 0.03 without, at one pixel)."""
    got = found(views([shift] * 6, alpha=alpha))
    assert all(m.shifted and not m.alone for m in got)
    np.testing.assert_allclose([m.shift for m in got], [shift] * 6, rtol=0.05, atol=0.02)
    assert len({m.shift for m in got}) == 1


@pytest.mark.parametrize("alpha", [True, False])
def test_one_view_that_moved_is_named_by_itself(alpha):
    got = found(views([(0, 0)] * 3 + [(0.6, -0.8)] + [(0, 0)] * 2, alpha=alpha))
    assert [m.alone for m in got] == [False, False, False, True, False, False]
    assert got[3].image == Path("Cam_3.exr")
    assert got[3].pixels == pytest.approx(1.0, abs=0.1)
    assert not any(m.shifted for m in got if not m.alone)


@pytest.mark.parametrize("alpha", [True, False])
@pytest.mark.parametrize("noise", [0.0, 0.03])
def test_no_shift_and_no_drift_is_invented(alpha, noise):
    got = found(views([(0, 0)] * 6, alpha=alpha, noise=noise))
    assert not any(m.shifted or m.alone or m.drifted for m in got)
    assert max(m.pixels for m in got) < 0.02
    assert max(abs(m.gain - 1) for m in got) < 0.003


def test_a_camera_of_one_view_is_held_by_what_it_should_show():
    """Its prediction here has the true paint, as when other cameras show it."""
    one = next(views([(0.3, -0.2)], alpha=False))
    still = ball()
    true = np.where(np.isfinite(still[2]), paint(still, 5), 0)
    one = replace(one, predicted=np.repeat(true[..., None], 3, 2).astype(np.float32))
    np.testing.assert_allclose(found([one])[0].shift, (0.3, -0.2), atol=0.02)


def test_gains_are_found_within_and_between_cameras():
    """To 0.3 %; their geometric mean is 1."""
    first, second = np.exp([0.05, -0.03, 0.0, 0.02, -0.1, 0.06]), np.exp([-0.08, 0.04, 0.1, 0.0, -0.02, 0.01])
    got = found(views([(0, 0)] * 6, first, name="A"), views([(0.2, 0.1)] * 6, second, name="B"))
    truth = np.concatenate([first, second])
    np.testing.assert_allclose([m.gain for m in got], truth / np.exp(np.log(truth).mean()), atol=3e-3)
    assert np.log([m.gain for m in got]).mean() == pytest.approx(0, abs=1e-9)
    assert got[4].drifted
    assert not got[2].shifted


def test_light_that_is_elsewhere_makes_doubt_not_a_shift():
    """Suns 2 degrees off bend the shading by pixels; without alpha nothing gainsays it, but nothing is believed."""
    rng = np.random.default_rng(4)
    here = []
    for n, one in enumerate(views([(0, 0)] * 6, alpha=False)):
        wrong = SUNS[n] / np.linalg.norm(SUNS[n]) + rng.normal(size=3) * np.radians(2)
        light = np.where(one.window.covered, shaded(ball(), wrong), 0)
        here.append(replace(one, irradiance=np.repeat(light[..., None], 3, 2).astype(np.float32)))
    assert not any(m.shifted for m in found(here))


def test_a_mask_drawn_too_small_is_no_shift():
    covered = np.isfinite(ball()[2])
    inner = silhouette(covered.astype(np.float32), drawn_over(shrunk=1.0))
    assert inner is not None
    np.testing.assert_allclose(inner.shift, 0, atol=0.02)
    assert inner.bent(0.0).values[GROWTH] == pytest.approx(-1 / RADIUS, rel=0.1)
    assert silhouette(covered.astype(np.float32), np.ones(covered.shape, np.float32)) is None


def test_a_mask_of_something_else_says_nothing():
    half = drawn_over() * (np.arange(WIDTH) < WIDTH / 2)  # cut off through the middle: the right outline is gone
    found = silhouette(np.isfinite(ball()[2]).astype(np.float32), half.astype(np.float32))
    assert found is not None
    assert np.all(np.abs(found.shift) < 4 * np.sqrt(np.diag(found.shift_covariance)) + 0.05)


def test_a_focal_length_that_is_off() -> None:
    """The ball lies 30 pixels to the right of the middle and is 0.5 % too large: so is the corrected camera's image."""
    by, camera_ = 0.005, replace(camera(), projection=np.diag([2.0, 2.5, 1.0, 1.0]))
    misfit = Misfit(Path("a.exr"), "Cam", (WIDTH, HEIGHT), (0.2, 0.1), 0.01, 1.0, 0.01, False, by, 1e-4, (30.0, -10.0))
    scene = SceneData("s", plane_mesh(), np.zeros((0, 3, 3), np.float32), (View(Path("a.exr"), camera_, ()),))
    new = corrected(scene, [misfit], shifts=True, gains=False).views[0].camera
    place = np.array([0.3, 0.2, -1.0, 1.0])
    before, after = ((c.projection @ place)[:2] * (WIDTH / 2, HEIGHT / 2) for c in (camera_, new))
    np.testing.assert_allclose(after - before, (0.2, 0.1) + by * (before - (30.0, -10.0)), atol=1e-9)
    assert not replace(misfit, growth_error=0.001).grown


def blob(displacement: np.ndarray, optics: Optics, depth: float = 0.25) -> np.ndarray:
    """(h, w) share of each pixel that a leaf of three lobes covers, by 8 x 8 points.

    ``displacement``: as `Outline.values`, about (70, 66), where it has its middle.  ``depth``: of the lobes, 0: a disk.
    """
    steps = (np.arange(8) + 0.5) / 8
    across, up = np.meshgrid((np.arange(WIDTH)[:, None] + steps).ravel(), (np.arange(HEIGHT)[:, None] + steps).ravel())
    seen = np.stack([across, up])
    middle, axis = np.array([70.0, 66.0])[:, None, None], np.array(optics.axis)[:, None, None]

    def by(place: np.ndarray) -> np.ndarray:
        right, high = place - middle
        far, own = ((at - axis) / optics.focal for at in (place, middle))
        bend = optics.focal * (far * (far**2).sum(0) - own * (own**2).sum(0))
        x, y, growth, roll, k1 = displacement
        return np.stack([x + growth * right - roll * high, y + growth * high + roll * right]) + k1 * bend

    place = seen
    for _ in range(5):
        place = seen - by(place)
    right, high = place - middle
    inside = np.hypot(right, high) < 40 * (1 + depth * np.cos(3 * np.arctan2(high, right)))
    return inside.reshape(HEIGHT, 8, WIDTH, 8).mean((1, 3)).astype(np.float32)


@pytest.mark.parametrize("wrong", [
    (0.0, 0.0, 0.0, 0.0, 0.0), (0.4, -0.3, 0.0, 0.01, 0.0), (-0.2, 0.5, 0.006, -0.004, 0.0),
    (0.1, 0.1, 0.0, 0.0, -0.05), (0.3, -0.2, -0.004, 0.006, 0.04)])
def test_an_outline_says_how_its_camera_is_off(wrong: tuple[float, ...]) -> None:
    """Each number to 0.05 pixels at the outline: of the second order, and the middle that they are about is another."""
    optics = Optics((WIDTH / 2, HEIGHT / 2), 100.0)
    found = silhouette(blob(np.zeros(5), optics), blob(np.array(wrong), optics), optics)
    assert found is not None
    np.testing.assert_allclose(found.centre, (70, 66), atol=1.5)
    off = found.bent(float(found.values[BEND])).values[:5] - wrong
    moves = np.array([1.0, 1.0, 45.0, 45.0, 100.0 * 0.5**3])  # pixels at the outline, by a value of 1
    np.testing.assert_allclose(off * moves, 0, atol=0.05)
    straight = found.bent(0.0)
    np.testing.assert_allclose(straight.values[[BEND, INSET]], 0, atol=1e-12)
    if wrong[BEND] == 0:
        np.testing.assert_allclose((straight.values[:4] - wrong[:4]) * moves[:4], 0, atol=0.03)


def test_a_mask_drawn_too_small_bends_no_lens() -> None:
    """By a pixel all around, which growth and bend together would explain."""
    optics = Optics((WIDTH / 2, HEIGHT / 2), 100.0)
    whole = blob(np.zeros(5), optics)
    inside = eroded(whole > 0.5, 1).astype(np.float32)
    found = silhouette(whole, inside, optics)
    assert found is not None
    assert 1 < abs(found.values[INSET]) < 2**0.5  # by the square of eight neighbours
    assert abs(found.values[BEND]) < CERTAIN * found.covariance[BEND, BEND] ** 0.5
    settled = found.bent(0.0)
    np.testing.assert_allclose(settled.shift, 0, atol=0.1)
    assert abs(settled.values[GROWTH]) < GROWN * settled.covariance[GROWTH, GROWTH] ** 0.5
    assert abs(settled.values[ROLL]) < CERTAIN * settled.covariance[ROLL, ROLL] ** 0.5


@pytest.mark.parametrize("lens", [True, False])
@pytest.mark.parametrize("depth", [0.0, 0.05, 0.1, 0.25])
def test_a_mask_of_whole_pixels_changes_no_focal_length(depth: float, lens: bool) -> None:
    """It lies half a pixel within the outline, which looks much as a growth does; a growth of 1 % is still one."""
    optics = Optics((WIDTH / 2, HEIGHT / 2), 100.0)
    whole = blob(np.zeros(5), optics, depth)
    larger = blob(np.array([0, 0, 0.01, 0, 0]), optics, depth)
    for mask, growth in ((whole > 0.999, 0.0), (larger, 0.01)):
        found = silhouette(whole, mask.astype(np.float32), optics if lens else None)
        assert found is not None
        settled = found.bent(0.0)
        error = settled.covariance[GROWTH, GROWTH] ** 0.5
        assert (abs(settled.values[GROWTH]) > GROWN * error) == (growth > 0)
        if growth:
            assert settled.values[GROWTH] == pytest.approx(growth, rel=0.05)


@pytest.mark.parametrize("depth", [0.0, 0.1, 0.25])
def test_alpha_of_parts_of_pixels_shows_a_small_growth(depth: float) -> None:
    """It has no inset, so that a focal length that is 0.3 % off is beyond doubt."""
    optics = Optics((WIDTH / 2, HEIGHT / 2), 100.0)
    alpha = blob(np.array([0, 0, 0.003, 0, 0]), optics, depth)
    noise = 0.05 * np.random.default_rng(1).standard_normal(alpha.shape)
    alpha = np.where((alpha > 0) & (alpha < 1), np.clip(alpha + noise, 0, 1), alpha).astype(np.float32)
    found = silhouette(blob(np.zeros(5), optics, depth), alpha, optics)
    assert found is not None
    settled = found.bent(0.0)
    assert settled.values[GROWTH] == pytest.approx(0.003, rel=0.1)
    assert settled.values[GROWTH] > GROWN * settled.covariance[GROWTH, GROWTH] ** 0.5


def test_a_lens_that_was_measured_is_left_as_it_is() -> None:
    """k1 alone may be what a round before has found."""
    window = next(views([(0, 0)])).window
    place = window.corner, window.image
    lens = Lens(WIDTH, HEIGHT, 100.0, 100.0, 80.0, 50.0, radial=(-0.1, 0.0, 0.0, 0.0))
    assert optics_of(replace(camera(), lens=lens), *place) == Optics((80.0, HEIGHT - 50.0), 100.0)
    for measured in (replace(lens, radial=(-0.1, 0.01, 0.0, 0.0)), replace(lens, tangential=(1e-4, 0.0)),
                     replace(lens, fisheye=True)):
        assert optics_of(replace(camera(), lens=measured), *place) is None


def test_a_camera_that_is_turned_and_bent() -> None:
    """The corrected camera shows places near the object where the picture has them: displaced as the outline is."""
    roll, bend, focal = 0.004, -0.06, 150.0
    camera_ = replace(camera(), projection=np.array(
        [[2 * focal / WIDTH, 0, 0, 0], [0, 2 * focal / HEIGHT, 0, 0], [0, 0, -1, -0.2], [0, 0, -1.0, 0]]))
    misfit = Misfit(Path("a.exr"), "Cam", (WIDTH, HEIGHT), (0.2, 0.1), 0.01, 1.0, 0.01, False, 0.0, 1e-4, (20.0, -10.0),
                    roll, 1e-5, bend, 1e-3)
    assert misfit.rolled and misfit.warped and not misfit.grown
    scene = SceneData("s", plane_mesh(), np.zeros((0, 3, 3), np.float32), (View(Path("a.exr"), camera_, ()),))
    new = corrected(scene, [misfit], shifts=True, gains=False).views[0].camera
    pixels = np.array([[20.0, -10.0], [50.0, 5.0], [-30.0, 20.0]])
    points = np.concatenate([pixels / focal, -np.ones((3, 1))], 1)
    before, after = (pixels_of(c, points, (WIDTH, HEIGHT)) - np.array([WIDTH, HEIGHT]) / 2 for c in (camera_, new))
    np.testing.assert_allclose(before, pixels, atol=1e-9)
    centre = pixels[0]
    by = lambda at: focal * (at / focal) * ((at / focal) ** 2).sum(-1, keepdims=True)  # noqa: E731
    right, high = (pixels - centre).T
    wanted = np.array([0.2, 0.1]) + roll * np.stack([-high, right], -1) + bend * (by(pixels) - by(centre[None]))
    np.testing.assert_allclose(after - before, wanted, atol=0.01)  # of second order
    assert not replace(misfit, roll_error=0.001).rolled


def test_the_pixels_factors_are_eliminated_exactly():
    """Beside one least-squares problem with every pixel's factor in it, all weights 1."""
    rng = np.random.default_rng(0)
    count, pixels = 4, 900
    predicted = rng.uniform(0.5, 1.0, (count, pixels))
    slopes = rng.normal(size=(2, count, pixels)) * 0.05
    shift, gain = rng.normal(size=(2, count)) * 0.3, rng.normal(size=count) * 0.02
    gain -= gain.mean()
    own = rng.normal(size=pixels) * 0.01
    observed = predicted * (1 + own + gain[:, None]) - (shift[:, :, None] * slopes).sum(0)
    flat = np.stack([np.ones(pixels), np.zeros(pixels), np.zeros(pixels)])
    fit = fit_views(np.stack([predicted, *slopes, observed]), flat, (np.arange(pixels) // 30).astype(np.int32))
    np.testing.assert_allclose(fit.shift, shift.T, atol=1e-4)
    logs = np.log1p(gain)
    np.testing.assert_allclose(fit.log_gain, logs - logs.mean(), atol=1e-5)
    np.testing.assert_allclose(fit.factor - fit.factor.mean(), own - own.mean(), atol=1e-5)


def test_a_view_that_few_tiles_show_states_its_gain_less_surely():
    """Tiles err by 2 % each; of four views the first has three tiles of 40."""
    rng, off = np.random.default_rng(2), []
    tiles = (np.arange(2000) // 50).astype(np.int32)
    factor = np.stack([np.ones(2000), np.zeros(2000), np.zeros(2000)])
    for _ in range(200):
        seen = np.stack([np.ones((4, 2000)), *(0.05 * rng.normal(size=(2, 4, 2000))), np.ones((4, 2000))])
        seen[3] *= 1 + 0.02 * rng.standard_normal((4, 40))[:, tiles] + 0.001 * rng.standard_normal((4, 2000))
        seen[:, 0, tiles >= 3] = np.nan
        fit = fit_views(seen, factor, tiles)
        off.append((fit.log_gain / fit.gain_error)[0])
    assert np.sqrt(np.mean(np.square(off))) < 2.0  # 2.6 as if 40 tiles told it
    assert np.mean(np.abs(off) > 4) < 0.06  # 0.115


def test_cameras_that_share_no_place_keep_their_gains():
    uv = np.random.default_rng(0).uniform(0, 0.4, (4000, 2)).astype(np.float32)
    apart = gain_of_cameras([(uv, np.full(4000, 1.2)), (uv + np.float32(0.5), np.full(4000, 0.9))])
    np.testing.assert_allclose(apart, 0)
    shared = gain_of_cameras([(uv, np.full(4000, 1.2)), (uv, np.full(4000, 0.9))])
    np.testing.assert_allclose(shared, [np.log(1.2 / 0.9) / 2, -np.log(1.2 / 0.9) / 2], atol=1e-6)


def scene(count=3):
    empty = np.zeros((0, 3, 3), np.float32)
    mesh = MeshArrays("Ball", empty, empty, empty[..., :2], np.zeros(0, np.int32), ("Paint",))
    return SceneData("scene", mesh, empty, tuple(View(Path(f"{n}.exr"), camera(), ()) for n in range(count)))


def misfit(n, shift=(0.0, 0.0), gain=1.0, alone=False):
    return Misfit(Path(f"{n}.exr"), "Cam", (WIDTH, HEIGHT), shift, 0.01, gain, 0.001, alone)


def test_nothing_to_mend_leaves_the_scene_itself():
    given = scene()
    small = [misfit(n, (0.015, 0.0), 1.002) for n in range(3)]
    large = [misfit(n, (1.0, 0.0), 1.1) for n in range(3)]
    assert corrected(given, small, shifts=True, gains=True) is given
    assert corrected(given, large, shifts=False, gains=False) is given
    assert corrected(given, [], shifts=True, gains=True) is given


def test_shared_shifts_stay_shared_and_a_lone_one_gets_its_own_camera():
    given = scene()
    mended = corrected(given, [misfit(0, (1, 0)), misfit(1, (3, 0), alone=True), misfit(2, (1, 0), gain=1.1)],
                       shifts=True, gains=True)
    first, second, third = mended.views
    assert first.camera is third.camera
    assert first.camera.name == "Cam"
    assert second.camera.name == "Cam (1.exr)"
    assert first.camera.projection[0, 3] == pytest.approx(2 / WIDTH)  # the identity's row 3 is (0, 0, 0, 1)
    assert second.camera.projection[0, 3] == pytest.approx(6 / WIDTH)
    assert (first.gain, third.gain) == (1.0, pytest.approx(1.1))


def test_what_is_only_likely_is_put_right_beside_what_is_sure():
    given = scene()
    lone = [misfit(1, (0.03, 0), alone=True), misfit(2, (0.5, 0), alone=True)]
    mended = corrected(given, [misfit(0, (0.015, 0)), *lone], shifts=True, gains=True)
    assert mended.views[0].camera is given.views[0].camera
    assert mended.views[1].camera.projection[0, 3] == pytest.approx(0.06 / WIDTH)


def test_views_that_tell_nothing_are_not_moved() -> None:
    """Two of four views without a pixel (all clipped): no crash, and an error that nobody believes."""
    rng = np.random.default_rng(1)
    seen = rng.random((4, 4, 2000)) + 0.5
    seen[3] = seen[0] * (1 + 0.01 * rng.standard_normal((4, 2000)))
    seen[:, 2:] = np.nan
    factor = np.stack([np.ones(2000), np.zeros(2000), np.zeros(2000)])
    fit = fit_views(seen, factor, (np.arange(2000) // 50).astype(np.int32))
    assert np.isfinite(fit.shift).all() and (np.abs(fit.shift[2:]) < 1e-6).all()
    assert (np.sqrt(fit.covariance[2:, 0, 0]) > 1).all() and (fit.gain_error[2:] > 1).all()
    assert (fit.gain_error[:2] < 0.1).all()


@pytest.mark.parametrize("outlined", [1, 3, 5, 9])
def test_views_without_an_outline_go_by_those_of_their_camera_that_have_one(outlined):
    seen_by = camera()
    views = tuple(View(Path(f"{n}.exr"), seen_by, ()) for n in range(10))
    values = np.array([1.5, 0.5, 0, 0, 0, 0])
    outline = Outline(values, np.eye(6), 1e-4 * np.eye(6), np.array([75.0, 60.0]), None, whole=False)
    outlines = [outline] * outlined + [None] * (10 - outlined)
    found = outline_misfits([OutlinedCamera(views, (0, 0), (WIDTH, HEIGHT), outlines)])
    assert not any(misfit.alone for misfit in found)
    np.testing.assert_allclose([misfit.shift for misfit in found], [(1.5, 0.5)] * 10, atol=0.02)
