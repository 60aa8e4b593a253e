"""Epipolar distances of textured balls that are ray traced here, through cameras that are off by known pixels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.checks.drawn_view import DrawnView
from irpso_addon.core.checks.epipolar import Side, _corners, compared, epipolar_distances, neighbours, side_of
from irpso_addon.core.checks.mended_cameras import moved
from irpso_addon.core.data import Camera, RadianceImage, View
from irpso_addon.core.projection import rays_of
from tests.support import synthetic as syn

pytestmark = pytest.mark.one_python

SIZE = 320, 240
WAVES = np.random.default_rng(5).normal(size=(60, 3)) * np.linspace(4, 40, 60)[:, None]
PHASES = np.random.default_rng(6).uniform(0, 2 * np.pi, 60)


def camera(degrees: float, up: float = 0.4) -> Camera:
    turn = np.radians(degrees)
    found = syn.camera((4 * np.cos(turn), 4 * np.sin(turn), up), name=f"Cam {degrees:g}")
    projection = found.projection.copy()
    projection[0, 0] = projection[1, 1] * SIZE[1] / SIZE[0]
    return replace(found, projection=projection, aspect=SIZE[0] / SIZE[1])


def paint(places: np.ndarray) -> np.ndarray:
    """(N,) a texture in space."""
    return 0.4 + 0.06 * np.cos(places @ WAVES.T + PHASES).sum(1) / 2


def ball(seen_by: Camera, offsets: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """(h w, 3) where pixels' points, which lie ``offsets`` beside their lower left corners, see a ball; which do."""
    x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    origin, direction = rays_of(seen_by, np.stack([x, y], -1).reshape(-1, 2) + offsets, SIZE)
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    middle = (origin * direction).sum(1)
    inside = middle**2 - (origin**2).sum(1) + radius**2
    hit = inside > 0
    return origin + (-middle - np.sqrt(np.maximum(inside, 0)))[:, None] * direction, hit


def side(true: Camera, given: Camera | None = None, *, radius: float = 1.0, texture: float = 1.0,
         noise: float = 0.002) -> Side:
    """The picture is that of ``true``, the drawing that of ``given``, of a ball of ``radius``; its real radius is 1."""
    given = given or true
    grey = np.zeros(SIZE[0] * SIZE[1])
    for dx in (0.25, 0.75):
        for dy in (0.25, 0.75):
            places, hit = ball(true, np.array([dx, dy]), 1.0)
            grey += np.where(hit, 0.4 + texture * (paint(places) - 0.4), 0) / 4
    grey += noise * np.random.default_rng(1).normal(size=grey.shape)
    position, hit = ball(given, np.array([0.5, 0.5]), radius)
    shape = SIZE[1], SIZE[0]
    rgb = np.repeat(grey.reshape(*shape, 1), 3, 2).astype(np.float32)
    covered = hit.reshape(shape)
    image = RadianceImage(rgb, np.ones(shape, np.float32), np.ones(shape, bool))
    place = np.where(covered[..., None], position.reshape(*shape, 3), 0).astype(np.float32)
    view = View(Path(f"{given.name}.exr"), given, (syn.lamp((0, 0, 5)),))
    return side_of(DrawnView(view, image, place, place, covered, covered.astype(np.float32), ()))


@pytest.mark.parametrize("pixels", [0.0, 0.3, 2.0, 5.0])
def test_a_camera_that_is_turned(pixels):
    """To 0.05 pixels across the lines.  Cameras stand side by side, so that a turn sideways is not told."""
    one, other = camera(0), camera(12)
    at, distance = epipolar_distances(side(one), side(other, moved(other, (0.0, -pixels), SIZE)))
    assert len(at) > 100
    assert np.abs(np.median(np.abs(distance)) - pixels) < 0.05 or pixels == 0
    assert np.median(np.abs(distance)) < pixels + 0.1
    found = compared(side(one), side(other, moved(other, (-pixels, 0.0), SIZE)))
    assert found.measured and found.pixels < 0.15 + 0.12 * pixels  # the lines are not quite level


@pytest.mark.parametrize("radius", [0.99, 1.01])
def test_the_mesh_does_not_matter(radius):
    """A ball that is drawn 1 % too small or too large shifts points along their lines alone."""
    one, other = camera(0), camera(12)
    found = compared(side(one, radius=radius), side(other, radius=radius))
    assert found.measured and found.points > 100 and found.pixels < 0.15


def test_pictures_that_do_not_tell():
    """No texture but noise; the picture of something else; a repeated one is told apart no more."""
    one, other = camera(0), camera(12)
    assert not compared(side(one, texture=0.0), side(other, texture=0.0)).measured
    stranger = side(camera(170), other)
    assert not compared(side(one), stranger).measured
    fine = side(one)
    stripes = replace(fine, grey=(np.indices(fine.grey.shape).sum(0) % 6 / 6).astype(np.float32))
    assert not compared(stripes, replace(stripes, view=side(other).view, position=side(other).position)).measured


def test_a_picture_of_one_pixel_has_no_corners():
    whole = side(camera(0))
    tiny = replace(whole, grey=whole.grey[:1, :1], usable=whole.usable[:1, :1])
    rows, columns = _corners(tiny)
    assert len(rows) == len(columns) == 0


def test_a_turn_about_the_axis_is_no_scatter():
    """Points to the left lie above their lines and points to the right below: two degrees are told."""
    one, other = camera(0), camera(12)
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(0.035), -np.sin(0.035)], [np.sin(0.035), np.cos(0.035)]]
    found = compared(side(one), side(other, replace(other, world_to_camera=turn @ other.world_to_camera)))
    assert found.measured and found.pixels > 1


PLACES = np.random.default_rng(3).normal(size=(300, 3))
PLACES /= np.linalg.norm(PLACES, axis=1, keepdims=True)


def test_neighbours():
    def view(degrees: float, light: str = "A") -> View:
        return View(Path(f"{degrees:g}{light}.exr"), camera(degrees), (replace(syn.lamp((0, 0, 5)), name=light),))

    views = [view(0), view(0, "B"), view(1), view(10, "B"), view(14), view(90), view(140)]
    pairs = neighbours(views, views[:1], PLACES, on_camera=False)
    assert [(a.image.stem, b.image.stem) for a, b in pairs] == [("0A", "14A")]  # the same lamp, and not beside itself
    pairs = neighbours(views, views[:1], PLACES, on_camera=True)
    assert [b.image.stem for _, b in pairs] == ["10B"]
    assert neighbours(views, views[5:], PLACES, on_camera=True) == []
    two = [views[0], views[4]]
    assert len(neighbours(two, two, PLACES, on_camera=False)) == 1  # 0-14 and 14-0 are one
    ring = [view(4 * n) for n in range(90)]
    assert len(neighbours(ring, ring[::8], PLACES, on_camera=False)) == 5


def test_neighbours_show_the_same_parts_about_as_large():
    """Close-ups of a tall object: one of its other end and a picture of the whole are not the nearest."""
    tall = PLACES * (1, 1, 8)

    def view(name: str, degrees: float, height: float, narrow: float = 1.0) -> View:
        seen_by = camera(degrees, 0.0)
        world, projection = seen_by.world_to_camera.copy(), seen_by.projection.copy()
        world[:3, 3] -= world[:3, :3] @ (0, 0, height)
        projection[:2, :2] *= narrow
        place = seen_by.position + np.array([0, 0, height])
        return View(Path(f"{name}.exr"), replace(seen_by, world_to_camera=world, projection=projection, position=place),
                    (syn.lamp((0, 0, 5)),))

    feet, head, whole = view("feet", 0, -6, 3.0), view("head", 4, 6, 3.0), view("whole", 5, -5, 0.7)
    beside = view("beside", 20, -6, 3.0)
    (pair,) = neighbours([feet, head, whole, beside], [feet], tall, on_camera=True)
    assert [each.image.stem for each in pair] == ["feet", "beside"]
    (pair,) = neighbours([feet, head, whole], [feet], tall, on_camera=True)
    assert [each.image.stem for each in pair] == ["feet", "whole"]  # better than none
    assert neighbours([feet, head], [feet], tall, on_camera=True) == []
