"""Lamps by rays: made points and rays, standard errors against scatter, and two traced balls."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.errors import BadInput
from irpso_addon.core.lens import Lens
from irpso_addon.core.shoot.ball_highlight import Ray, find_highlight, reflected_ray
from irpso_addon.core.shoot.chrome_ball import find_ball
from irpso_addon.core.shoot.lamp_position import direction_scatter, lamp_position
from tests.support.mirror_ball import Lamp, MirrorBall, picture

pytestmark = pytest.mark.one_python


def rays_to(point, origins, degrees: float = 0.0, seed: int = 0) -> list[Ray]:
    """Each turned at random, by ``degrees`` in each of the two directions across it."""
    random = np.random.default_rng(seed)
    made = []
    for origin in np.asarray(origins, float):
        away = np.asarray(point, float) - origin
        away /= np.linalg.norm(away)
        noise = random.normal(0, np.radians(degrees), 3)
        turned = away + noise - (noise @ away) * away
        made.append(Ray(origin, turned / np.linalg.norm(turned)))
    return made


ORIGINS = [(0.3, 0.0, 1.0), (-0.3, 0.1, 1.1), (0.0, -0.2, 0.8)]


def test_exact_rays_meet():
    point = np.array([0.5, -1.2, 0.3])
    found = lamp_position(rays_to(point, ORIGINS))
    assert np.allclose(found.position, point, atol=1e-9)
    assert found.scatter_degrees < 1e-6
    assert found.scatter_millimetres < 1e-6
    assert 0 < found.standard_error < 0.02  # rays are never believed to be exact
    assert found.distance == pytest.approx(np.linalg.norm(point - np.mean(ORIGINS, 0)))


def test_two_skew_rays_by_hand():
    """Along x at y = 0 and along z 10 mm above it, both a metre from their crossing: half way between, 5 mm off."""
    found = lamp_position([Ray(np.array([-1.0, 0, 0]), np.array([1.0, 0, 0])),
                           Ray(np.array([0, 0.01, -1.0]), np.array([0, 0, 1.0]))])
    assert np.allclose(found.position, (0, 0.005, 0), atol=1e-6)
    assert found.scatter_millimetres == pytest.approx(5.0, abs=0.01)
    assert found.scatter_degrees == pytest.approx(np.degrees(0.005), abs=1e-3)


def test_standard_error_is_that_of_many_trials():
    """Largest principal deviation over 400 trials of six rays that are off by half a degree: within 15 %."""
    point = np.array([0.5, -1.2, 0.3])
    origins = [*ORIGINS, (0.5, 0.3, 1.0), (-0.4, 0.3, 0.9), (0.1, 0.4, 1.2)]
    found = [lamp_position(rays_to(point, origins, 0.5, seed)) for seed in range(400)]
    spread = np.sqrt(np.linalg.eigvalsh(np.cov(np.array([one.position for one in found]).T))[-1])
    assert np.sqrt(np.mean([one.standard_error ** 2 for one in found])) == pytest.approx(spread, rel=0.15)
    assert np.allclose(np.mean([one.position for one in found], 0), point, atol=0.006)  # a bias of second order


def test_near_parallel_rays_give_no_position():
    """Balls 10 cm apart, a lamp 40 m away: .14 degrees between the rays, less than they are good for."""
    point, origins = np.array([0.0, 0.0, 40.0]), [(-0.05, 0, 0), (0.05, 0, 0)]
    found = lamp_position(rays_to(point, origins), "Key")
    assert found.position is None
    assert found.standard_error == np.inf
    assert np.allclose(found.direction, (0, 0, 1), atol=1e-3)
    assert 5 < found.distance < 40  # the least
    line = found.summary("Key")
    assert line.startswith("Key: the rays are too nearly parallel") and "\n" not in line


def test_rays_that_contradict_each_other():
    """A ball's circle is wrong: its ray is turned outwards by 10 degrees and up by 8, from a lamp 1.5 m away."""
    origins = [np.array([-0.25, 0, 0.0]), np.array([0.25, 0, 0.0])]
    right, wrong = (np.array([0, 0, 1.5]) - origin for origin in origins)
    wrong = wrong / np.linalg.norm(wrong) + (np.sin(np.radians(10.0)), np.sin(np.radians(8.0)), 0)
    rays = [Ray(origin, ray / np.linalg.norm(ray)) for origin, ray in zip(origins, (right, wrong), strict=True)]
    found = lamp_position(rays, "Key")
    assert found.position is None and found.scatter_degrees > 4
    line = found.summary("Key")
    assert "contradict each other" in line and "circle and radius" in line and "\n" not in line


def test_least_distance_holds():
    """The true distance is hardly ever below the least one: at two standard errors, one time in forty."""
    point, origins = np.array([0.0, 0.0, 12.0]), [(-0.05, 0, 0), (0.05, 0, 0), (0.0, 0.07, 0), (0.02, -0.03, 0)]
    below = []
    for seed in range(300):
        try:
            found = lamp_position(rays_to(point, origins, 0.2, seed))
        except BadInput:
            continue
        below.append(found.distance > 12.0 and found.position is None)
    assert len(below) > 285
    assert np.mean(below) < 0.05


def test_one_ball_twice_gives_a_direction():
    ray = Ray(np.array([0.1, 0, 1.0]), np.array([0.0, -0.6, 0.8]))
    found = lamp_position([ray, ray])
    assert found.position is None
    assert found.distance < 1e-6  # nothing is known of it
    assert np.allclose(found.direction, ray.direction)


@pytest.mark.parametrize(
    "directions",
    [((-1, 0, 1), (1, 0, 1)), ((-1, 0, 0), (1, 0, 0)), ((1, 0, 0), (-1, 0, 0)), ((-1, 0, 20), (1, 0, 20))])
def test_rays_that_part(directions):
    units = [np.array(one) / np.linalg.norm(one) for one in directions]
    rays = [Ray(np.array(origin), unit) for origin, unit in zip([(-0.3, 0, 0.0), (0.3, 0, 0.0)], units, strict=True)]
    with pytest.raises(BadInput, match=r"^Key: the rays of the balls point apart"):
        lamp_position(rays, "Key")


def test_one_ray():
    with pytest.raises(BadInput, match="one ray gives a direction only"):
        lamp_position(rays_to((0, 0, 1), [(0, 0, 0)]))


def test_direction_scatter():
    at = [np.array([np.sin(a), 0, np.cos(a)]) for a in np.radians([0.0, 1.0, 3.0])]
    assert direction_scatter(at) == pytest.approx((1 + 2 + 3) / 3)
    assert direction_scatter(at[:1]) == 0


def test_two_traced_balls():
    """A lamp 1.3 m away by two balls 40 cm apart: within 1.5 % of its distance, and three standard errors."""
    lens = Lens(800, 400, 1000.0, 1000.0, 402.0, 197.0, radial=(-0.1, 0.03, 0.0, 0.0))
    balls = [MirrorBall((-0.2, 0.02, 0.8), 0.06), MirrorBall((0.2, 0.0, 0.85), 0.06)]
    for seed, place in enumerate([(-0.4, -0.9, -0.1), (0.6, -0.7, 0.0)]):
        image = picture(lens, balls, [Lamp(place, 0.06)], clip=np.inf, seed=seed)
        rays = []
        for ball in balls:
            near = (*lens.project(np.array(ball.centre)), 1000 * ball.radius / ball.centre[2])
            found = find_ball(np.clip(image, 0, 1), lens, near)
            rays.append(reflected_ray(found, lens, find_highlight(image, lens, found), ball.radius))
        lamp = lamp_position(rays)
        off = np.linalg.norm(lamp.position - place)
        assert off < 0.015 * lamp.distance
        assert off < 3 * lamp.standard_error
        assert lamp.scatter_degrees < 0.2
