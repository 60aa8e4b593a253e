"""Pictures that darken towards their edges: against the cosine of each pixel's own direction, in float64."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.data import RadianceImage, View
from irpso_addon.core.images.image_writer import write_image
from irpso_addon.core.images.reference_image import read_reference
from irpso_addon.core.images.response import file_scale
from irpso_addon.core.lens import Lens
from irpso_addon.core.projection import rays_of
from irpso_addon.core.tiled import uv_blocks
from irpso_addon.core.tiled.reference_cache import CachedReference, cache_reference
from irpso_addon.core.vignetting import brightened, corner_stops
from irpso_addon.solve import block_solve
from irpso_addon.solve.kept_images import KeptImages
from tests.support import synthetic as syn

LENS = Lens(6000, 4000, fx=4021.3, fy=4020.7, cx=3024.9, cy=1973.4, radial=(-0.105, 0.092, -0.031, 0.004),
            tangential=(6e-4, -3.5e-4), skew=1.6)
PLACE = (0.2, -1.0, 1.5), (0.1, 0.3, 0.0)
CAMERAS = {"matrix": syn.camera(*PLACE, degrees=60, aspect=1.5, shift=(0.2, -0.1)),
           "lens": syn.through(LENS, syn.camera(*PLACE))}
SIZE = 300, 200


def cosines(camera, size) -> np.ndarray:
    """(h, w) of every pixel's centre."""
    x, y = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    _, rays = rays_of(camera, np.stack([x.ravel(), y.ravel()], -1), size)
    return (rays @ camera.forward / np.linalg.norm(rays, axis=-1)).reshape(x.shape)


@pytest.mark.parametrize("name", CAMERAS)
def test_each_pixel_by_its_own_direction(name):
    camera, random = CAMERAS[name], np.random.default_rng(0)
    rgb = random.uniform(0.1, 2.0, (SIZE[1], SIZE[0], 3)).astype(np.float32)
    darker = (rgb * cosines(camera, SIZE)[..., None] ** 4).astype(np.float32)
    np.testing.assert_allclose(brightened(darker, camera, 4.0), rgb, rtol=2e-4)


def test_nothing_to_do():
    rgb = np.ones((20, 30, 3), np.float32)
    assert brightened(rgb, CAMERAS["matrix"], 0.0) is rgb
    assert brightened(rgb, replace(CAMERAS["matrix"], orthographic=True), 4.0) is rgb


@pytest.mark.parametrize("name", CAMERAS)
def test_a_part_of_a_picture_as_the_whole(name):
    """Blocks of a large map read parts."""
    camera, ones = CAMERAS[name], np.ones((SIZE[1], SIZE[0], 3), np.float32)
    crop = uv_blocks.Crop(40, 30, 120, 90, 1)
    part = brightened(ones[30:120, 40:160], uv_blocks.cropped(camera, *SIZE, crop), 4.0)
    np.testing.assert_allclose(part, brightened(ones, camera, 4.0)[30:120, 40:160], rtol=2e-4)


def test_a_files_vignetting_is_divided_out(tmp_path: Path):
    camera = CAMERAS["lens"]
    even = np.full((SIZE[1], SIZE[0], 3), 0.5)
    path = tmp_path / "dark.exr"
    write_image(path, (even * cosines(camera, SIZE)[..., None] ** 3.2).astype(np.float32), kind="exr", color=True)
    image = read_reference(View(path, camera, (), vignetting=3.2))
    np.testing.assert_allclose(image.rgb, even, rtol=1e-3)  # half floats


def test_a_block_reads_the_same(tmp_path: Path):
    """From the developed picture that the blocks of a large map share."""
    path, kept = tmp_path / "dark.exr", tmp_path / "0000.irp"
    write_image(path, np.random.default_rng(2).uniform(0.1, 1.0, (*SIZE[::-1], 3)).astype(np.float32), kind="exr",
                color=True)
    view = View(path, CAMERAS["lens"], (), vignetting=3.2)
    cache_reference(view, kept)
    block = block_solve._window(CachedReference(kept), uv_blocks.Crop(0, 0, *SIZE), 1.0, view)
    np.testing.assert_array_equal(block.rgb, read_reference(view).rgb)
    now = replace(view, vignetting=1.0, gain=1.1, tint=(1.2, 1.0, 0.9))  # found since
    scale = file_scale(view) / file_scale(now)
    block = block_solve._window(CachedReference(kept), uv_blocks.Crop(0, 0, *SIZE), scale, now)
    np.testing.assert_allclose(block.rgb, read_reference(now).rgb, rtol=1e-6)


def test_an_image_that_is_kept_follows_its_view():
    """However it was read first."""
    view = View(Path("a.exr"), CAMERAS["matrix"], (), gain=2.0, vignetting=1.0)
    rgb = np.random.default_rng(1).uniform(0.1, 1.0, (20, 30, 3)).astype(np.float32)
    full = np.ones(rgb.shape[:2], np.float32)
    read = KeptImages(lambda view: RadianceImage(
        brightened(rgb, view.camera, view.vignetting) / np.float32(view.gain), full, full > 0))
    for change in (view, replace(view, vignetting=3.0), replace(view, gain=4.0, vignetting=0.0), view):
        wanted = brightened(rgb, view.camera, change.vignetting) / np.float32(change.gain)
        np.testing.assert_allclose(read(change).rgb, wanted, rtol=1e-5)


def test_stops_in_the_corner():
    """A square picture whose half angle is 45 degrees: its corners are at a cosine of 1 / sqrt(3)."""
    camera = CAMERAS["matrix"]
    projection = camera.projection.copy()
    projection[0, 0] = projection[1, 1] = 1.0
    projection[0, 2] = projection[1, 2] = 0.0
    assert corner_stops([replace(camera, projection=projection)], 4.0) == pytest.approx(2 * np.log2(3))
