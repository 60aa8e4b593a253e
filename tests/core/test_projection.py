"""Places to pixels and back in float64, through matrices and lenses, whole pictures and parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.lens import Lens
from irpso_addon.core.projection import pixels_of, rays_of
from irpso_addon.core.tiled.uv_blocks import Crop, crop_of, cropped
from tests.support import synthetic as syn

SIZE = (300, 200)
LENS = Lens(6000, 4000, fx=4021.3, fy=4020.7, cx=3024.9, cy=1973.4, radial=(-0.105, 0.092, -0.031, 0.004),
            tangential=(6e-4, -3.5e-4), skew=1.6)
STRAIGHT = replace(LENS, radial=(0.0,) * 4, tangential=(0.0, 0.0))
PLACE = ((0.2, -1.0, 1.5), (0.1, 0.3, 0.0))
CAMERAS = {
    "matrix": syn.camera(*PLACE, degrees=60, aspect=1.5, shift=(0.2, -0.1)),
    "orthographic": syn.camera(*PLACE, width=2.0, aspect=1.5, shift=(0.2, -0.1)),
    "lens": syn.through(LENS, syn.camera(*PLACE)),
    "fisheye": syn.through(replace(LENS, fisheye=True, fx=1500.0, fy=1500.0), syn.camera(*PLACE)),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_a_pixels_ray_goes_through_the_places_that_it_shows(name):
    camera = CAMERAS[name]
    pixels = np.random.default_rng(2).uniform(0, 1, (200, 2)) * SIZE
    origin, direction = rays_of(camera, pixels, SIZE)
    for distance in (0.5, 20.0):
        np.testing.assert_allclose(pixels_of(camera, origin + distance * direction, SIZE), pixels, atol=1e-7)


def test_rows_count_from_the_lower_edge():
    for camera in CAMERAS.values():
        up = camera.world_to_camera[1, :3]
        points = camera.position + 2 * camera.forward + np.array([[0.0], [0.2]]) * up
        low, high = pixels_of(camera, points, SIZE)
        assert high[1] > low[1] + 5
        assert abs(high[0] - low[0]) < 0.1


def test_a_lens_that_bends_nothing_is_its_matrix():
    camera = syn.through(STRAIGHT, syn.camera(*PLACE))
    points = np.random.default_rng(2).uniform(-1, 1, (100, 3))
    np.testing.assert_allclose(pixels_of(camera, points, SIZE), pixels_of(replace(camera, lens=None), points, SIZE),
                               atol=1e-9)


@pytest.mark.parametrize("name", ["matrix", "lens"])
def test_what_lies_behind_is_nowhere(name):
    camera = CAMERAS[name]
    points = camera.position + np.array([[1.0], [-1.0]]) * camera.forward
    np.testing.assert_array_equal(np.isfinite(pixels_of(camera, points, SIZE)).all(axis=1), [True, False])


@pytest.mark.parametrize("name", ["lens", "fisheye"])
def test_a_block_is_cropped_where_the_lens_shows_it(name):
    camera = CAMERAS[name]
    corner = syn.meet_plane(*rays_of(camera, np.array([[290.0, 10.0]]), SIZE))[0]
    position = corner + np.random.default_rng(1).uniform(-0.03, 0.03, (8, 8, 3)) * (1, 1, 0)
    normal = np.broadcast_to([0.0, 0.0, 1.0], position.shape)
    crop = crop_of(camera, *SIZE, position.astype(np.float32), normal.astype(np.float32), np.ones((8, 8), bool))
    assert crop.width < 80
    assert (crop.x + crop.width, crop.y) == (SIZE[0], 0)
    part = cropped(camera, *SIZE, crop)
    assert part.aspect == crop.width / crop.height
    points = position.reshape(-1, 3)
    whole = pixels_of(camera, points, SIZE)
    np.testing.assert_allclose(pixels_of(part, points, (crop.width, crop.height)), whole - np.array([crop.x, crop.y]),
                               atol=1e-9)
    shrunk = pixels_of(cropped(camera, *SIZE, Crop(200, 100, 100, 100, 2)), points, (50, 50))  # each 2 x 2 are one
    np.testing.assert_allclose(2 * shrunk + (200, 100), whole, atol=1e-9)
