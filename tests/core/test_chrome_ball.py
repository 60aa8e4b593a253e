"""Chrome balls in pictures of tests/support/mirror_ball.py: outline, highlight, directions, and what is refused."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from irpso_addon.core.errors import BadInput
from irpso_addon.core.lens import Lens
from irpso_addon.core.shoot.ball_highlight import find_highlight, reflected_ray
from irpso_addon.core.shoot.chrome_ball import Ball, confirmed_ball, drawn_ball, find_ball
from tests.support.mirror_ball import Lamp, MirrorBall, picture

pytestmark = pytest.mark.one_python

LENS = Lens(640, 480, 800.0, 808.0, 315.0, 244.0, radial=(-0.12, 0.05, 0.0, 0.0), tangential=(0.001, -0.0015))
BALL = MirrorBall((-0.18, 0.05, 0.7), 0.06)  # 15 degrees off the axis, 68 pixels in radius
LARGE = MirrorBall((0.05, -0.02, 0.5), 0.08)  # 130 pixels
SMALL = MirrorBall((0.1, 0.1, 1.0), 0.04)  # 32 pixels
LAMPS = [Lamp(p, 0.06) for p in ((-0.8, -0.9, 0.1), (0.7, -0.6, -0.5), (0.1, -1.5, -0.2), (1.2, 0.1, 0.2))]


def angle(first, second) -> float:
    """Degrees."""
    first, second = np.asarray(first), np.asarray(second)
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(first, second)), first @ second)))


def cone_of(ball: MirrorBall) -> tuple[np.ndarray, float]:
    centre = np.array(ball.centre)
    distance = np.linalg.norm(centre)
    return centre / distance, float(np.arcsin(ball.radius / distance))


def true_ball(ball: MirrorBall) -> Ball:
    return Ball(*cone_of(ball), 0.0, 1.0)


@functools.cache
def pictures_of(ball: MirrorBall) -> tuple[np.ndarray, ...]:
    """One for each lamp, not clipped."""
    return tuple(picture(LENS, [ball], [lamp], clip=np.inf, seed=k) for k, lamp in enumerate(LAMPS))


@functools.cache
def before_backdrop(ball: MirrorBall, backdrop: tuple[float, float]) -> np.ndarray:
    return picture(LENS, [ball], LAMPS[:1], plain=backdrop)


@functools.cache
def empty_room() -> np.ndarray:
    return picture(LENS, [], [])


def rough(ball: MirrorBall, right: float, down: float, factor: float) -> tuple[float, float, float]:
    x, y, radius = true_ball(ball).circle(LENS)
    return x + right * radius, y + down * radius, radius * factor


def towards(lamp: Lamp, origin) -> np.ndarray:
    away = np.array(lamp.position) - origin
    return away / np.linalg.norm(away)


@pytest.mark.parametrize("ball", [BALL, LARGE])
@pytest.mark.parametrize("start", [(0, 0, 1), (0.2, -0.1, 0.85), (-0.15, 0.15, 1.2), None])
def test_outline(ball, start):
    image = np.clip(pictures_of(ball)[0], 0, 1)
    found = find_ball(image, LENS, None if start is None else rough(ball, *start))
    axis, half = cone_of(ball)
    pixel = 1 / 800
    assert angle(found.axis, axis) < np.degrees(0.1 * pixel)
    assert abs(found.half_angle - half) < 0.15 * pixel
    assert found.support > 0.75


@pytest.mark.parametrize(("ball", "backdrop", "pixels", "start"), [
    (BALL, (2.0, 3.0), 0.4, (0.1, 0, 1)), (LARGE, (2.0, 3.0), 0.4, (0.1, -0.08, 1.1)), (BALL, (2.0, 2.5), 0.2, None),
    (BALL, (1.0, 2.5), 0.3, (0.1, -0.08, 1.1)), (SMALL, (2.0, 2.5), 0.2, None), (LARGE, (0.6, 1.3), 1.2, None)])
def test_outline_before_a_plain_backdrop(ball, backdrop, pixels, start):
    """The rim mirrors the backdrop: its border is clearer than the outline, and up to 10 per cent further in."""
    near = None if start is None else rough(ball, *start)
    found = find_ball(before_backdrop(ball, backdrop), LENS, near)
    axis, half = cone_of(ball)
    assert angle(found.axis, axis) < np.degrees(pixels / 800)
    assert abs(found.half_angle - half) < pixels / 800


@pytest.mark.parametrize("ball", [BALL, LARGE])
def test_a_drawn_circle(ball):
    """Nearest to the outline, which perspective and the lens bend from a circle: within a pixel."""
    drawn = drawn_ball(LENS, true_ball(ball).circle(LENS))
    axis, half = cone_of(ball)
    assert angle(drawn.axis, axis) < np.degrees(1 / 800)
    assert abs(drawn.half_angle - half) < 0.5 / 800
    for circle in ((600.0, 200.0, 80.0), (300.0, 200.0, 3.0), (1e7, 0.0, 50.0)):
        with pytest.raises(BadInput, match=r"^a\.exr: "):
            drawn_ball(LENS, circle, "a.exr")


@pytest.mark.parametrize(("off", "agrees"), [(0.0, True), (0.015, True), (0.07, False)])
@pytest.mark.parametrize("ball", [BALL, LARGE])
def test_a_drawn_circle_is_final(ball, off, agrees):
    """Where the outline agrees within 3 % it is taken, to a fraction of a pixel; else the circle is, as drawn."""
    circle = rough(ball, off, 0, 1 + off)
    found, agreed = confirmed_ball(before_backdrop(ball, (2.0, 2.5)), LENS, circle, "a.exr")
    assert agreed is agrees
    expected = true_ball(ball).circle(LENS) if agrees else circle
    assert found.circle(LENS) == pytest.approx(expected, abs=0.3 if agrees else 1.2)


def test_a_drawn_circle_where_nothing_shows():
    """The empty room: the circle is taken, where an outline would be refused."""
    found, agreed = confirmed_ball(empty_room(), LENS, (200.0, 300.0, 40.0))
    assert not agreed and found.circle(LENS) == pytest.approx((200.0, 300.0, 40.0), abs=0.3)
    with pytest.raises(BadInput, match=r"^a\.exr: the picture cuts off"):
        confirmed_ball(empty_room(), LENS, (600.0, 200.0, 80.0), "a.exr")


@pytest.mark.parametrize("ball", [BALL, LARGE])
@pytest.mark.parametrize(("clip", "most"), [(1000.0, 0.2), (1.0, 0.4)])
def test_directions_and_rays(ball, clip, most):
    """Degrees.  A lamp that clips shows as whole pixels, however little of them it fills: three or four here."""
    pictures = [np.clip(image, 0, clip) for image in pictures_of(ball)]
    found = find_ball(np.mean(np.clip(pictures, 0, 1), 0), LENS, rough(ball, 0.1, 0.1, 1.1))
    errors = []
    for image, lamp in zip(pictures, LAMPS, strict=True):
        highlight = find_highlight(image, LENS, found)
        ray = reflected_ray(found, LENS, highlight, ball.radius)
        errors.append(angle(ray.direction, towards(lamp, ray.origin)))
        assert np.allclose(reflected_ray(found, LENS, highlight, 1.0).direction, ray.direction)
        assert abs(np.linalg.norm(ray.origin - np.array(ball.centre)) - ball.radius) < 0.01
    assert np.max(errors) <= most, errors


def test_streaks_do_not_pull_the_highlight():
    """A scratched ball: a streak to one side, brighter than half the clipped highlight and with as much light."""
    ball = true_ball(LARGE)
    image = np.clip(pictures_of(LARGE)[1], 0, 1)
    before = find_highlight(image, LENS, ball)
    x, y = before.astype(int)
    image[y - 20:y, x - 1:x + 1] = 0.6
    assert np.hypot(*(find_highlight(image, LENS, ball) - before)) < 0.6


def test_a_hot_pixel_is_no_highlight():
    ball = true_ball(LARGE)
    image = np.clip(pictures_of(LARGE)[1], 0, 1)
    before = find_highlight(image, LENS, ball)
    x, y, _ = ball.circle(LENS)
    image[int(y) - 30, int(x) - 10] = 1.0
    assert np.hypot(*(find_highlight(image, LENS, ball) - before)) < 0.1


def test_reflection_by_hand():
    """The ball on the axis, a pixel at which the normal is 30 degrees from it: the ray turns by twice the angle."""
    ball = Ball(np.array([0.0, 0.0, 1.0]), float(np.arcsin(0.1)), 0.0, 1.0)  # radius 1 m, 10 m away
    lens = Lens(400, 400, 1000.0, 1000.0, 200.0, 200.0)
    point = np.array([0.5, 0.0, 10 - np.cos(np.radians(30))])
    ray = reflected_ray(ball, lens, lens.project(point), 1.0)
    assert np.allclose(ray.origin, point)
    sight = np.degrees(np.arctan2(point[0], point[2]))
    # The normal is 150 degrees from the axis, so the mirrored direction is at 2 * 150 - (sight + 180).
    turned = np.radians(2 * 150 - (sight + 180))
    assert np.allclose(ray.direction, (np.sin(turned), 0, np.cos(turned)))


def test_several_lamps_are_refused():
    image = picture(LENS, [LARGE], LAMPS[:2])
    with pytest.raises(BadInput, match=r"^two\.exr: the ball shows similar highlights at \(\d+, \d+\) and"):
        find_highlight(image, LENS, true_ball(LARGE), "two.exr")


def test_no_lamp_is_refused():
    with pytest.raises(BadInput, match="no lamp's highlight"):
        find_highlight(picture(LENS, [LARGE], []), LENS, true_ball(LARGE))


def test_a_ball_that_is_cut_off_is_refused():
    ball = MirrorBall((0.18, 0.0, 0.5), 0.06)
    image = picture(LENS, [ball], LAMPS[:1])
    with pytest.raises(BadInput, match=r"^cut\.exr: the picture cuts off the chrome ball"):
        find_ball(image, LENS, rough(ball, 0, 0, 1), "cut.exr")


@pytest.mark.parametrize("near", [(100.0, 300.0, 40.0), (100.0, 300.0, 2.0), (np.nan, 1.0, 40.0), (9e9, 0.0, 50.0)])
def test_no_ball_near_the_circle(near):
    with pytest.raises(BadInput):
        find_ball(empty_room(), LENS, near)


def test_a_picture_without_a_ball():
    with pytest.raises(BadInput, match="no chrome ball was found"):
        find_ball(empty_room(), LENS)


@pytest.mark.parametrize("image", [np.zeros((480, 640, 3)), np.full((480, 640), np.nan), np.ones((10, 10, 3))])
def test_pictures_that_cannot_be(image):
    with pytest.raises(BadInput):
        find_ball(image, LENS)


def test_a_highlight_beside_the_ball():
    for place in ([0.0, 0.0], [np.nan, 5.0]):
        with pytest.raises(BadInput, match="not on the ball"):
            reflected_ray(true_ball(LARGE), LENS, np.array(place), 0.08)
    with pytest.raises(BadInput, match="radius"):
        reflected_ray(true_ball(LARGE), LENS, np.array(true_ball(LARGE).circle(LENS)[:2]), 0.0)
