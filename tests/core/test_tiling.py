"""The lattice of blocks, the plan's map of several UV squares, and cameras cropped to a part of their picture."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from irpso_addon.core.errors import BadInput
from irpso_addon.core.tiled import uv_blocks
from irpso_addon.core.tiled.tiled_plan import cells_of
from irpso_addon.core.tiled.uv_blocks import Crop, UvBlock
from tests.support import synthetic as syn


@settings(deadline=None, max_examples=30)
@given(st.integers(16, 2100), st.sampled_from([64, 512]), st.sampled_from([(1001,), (1001, 1012, 1999)]))
def test_blocks_cover_each_texel_once(size, block, udims):
    found = uv_blocks.all_blocks(size, udims, block)
    area = sum(height * width for height, width in (window.shape for window in found))
    assert area == len(udims) * size**2
    assert len({window.key for window in found}) == len(found)
    assert all(window.side % uv_blocks.CELL == 0 and window.y % uv_blocks.CELL == 0 for window in found)


def test_a_texel_of_a_block_is_a_texel_of_the_map():
    window = UvBlock(1012, 1024, 512, 4096)
    column, row = 700, 1300  # of the map
    uv = np.array([1 + (column + 0.5) / 4096, 1 + (row + 0.5) / 4096])
    at = window.grid(uv.astype(np.float64)) * window.side
    np.testing.assert_allclose(at, [column - 512 + 32 + 0.5, row - 1024 + 32 + 0.5], atol=1e-3)


def test_udims_are_those_of_the_squares_that_hold_faces():
    middle = np.array([[0.5, 0.5], [1.5, 0.5], [3.2, 2.7], [-0.5, 0.5], [0.5, 10.5], [11.0, 0.5], [np.nan, 0.0]])
    triangle = np.array([[-0.1, -0.1], [0.2, -0.1], [-0.1, 0.2]])
    assert uv_blocks.udims_of((middle[:, None] + triangle).astype(np.float32)) == (1001, 1002, 1024, 1101)
    many = (np.arange(10)[:, None, None, None] * [1, 0] + np.arange(11)[None, :, None, None] * [0, 1] + 0.5 + triangle)
    with pytest.raises(BadInput, match="110 UDIM squares"):
        uv_blocks.udims_of(many.reshape(-1, 3, 2).astype(np.float32))


@pytest.mark.parametrize(("column", "row", "as_if"), [(10, 0, 1011), (-1, 1, 1010), (13, 2, 1034)])
def test_what_lies_beside_the_ten_columns_is_in_no_square(column, row, as_if):
    """Counted on, its number would be that of a square in another row."""
    triangle = np.array([[0.2, 0.2], [0.8, 0.2], [0.5, 0.9]])
    both = np.stack([triangle + np.array([column, row]), triangle + uv_blocks.corner(as_if)]).astype(np.float32)
    assert uv_blocks.udims_of(both) == (as_if,)
    grid = uv_blocks.layout(64, (as_if,)).grid(both)
    assert (grid[0] < 0).all() and (grid[1] > 0).all()


@pytest.mark.parametrize(("size", "udims", "large"), [
    (2048, (1001,), False), (2049, (1001,), True), (256, (1001, 1002), True), (256, (1002,), True)])
def test_what_is_large(size, udims, large):
    assert uv_blocks.is_large(size, udims) is large


def test_the_plan_holds_all_squares_side_by_side():
    udims = (1001, 1002, 1011)
    layout = uv_blocks.layout(4096, udims)
    assert (layout.columns, layout.square, layout.size) == (2, 512, 1024)
    triangle = np.array([[0.25, 0.25], [0.75, 0.25], [0.25, 0.75]])
    uvs = np.stack([triangle + uv_blocks.corner(udim) for udim in (*udims, 1012)]).astype(np.float32)
    grid = layout.grid(uvs)
    np.testing.assert_allclose(grid[:3], [triangle / 2, triangle / 2 + [0.5, 0], triangle / 2 + [0, 0.5]], atol=1e-6)
    assert (grid[3] < 0).all()  # no square of ours


def test_the_plan_is_sampled_where_the_cells_lie():
    layout = uv_blocks.layout(4096, (1001, 1002))
    row, column = np.mgrid[:layout.size, :layout.size] + 0.5
    values = np.stack([column, row], -1).astype(np.float32)
    window = UvBlock(1002, 1024, 2048, 4096)
    at = layout.sampled(values, window, window.side // uv_blocks.CELL)
    texel = np.arange(window.side // uv_blocks.CELL) * uv_blocks.CELL + 16 - 32
    np.testing.assert_allclose(at[0, :, 0], 512 + (2048 + texel) / 8, rtol=1e-6)
    np.testing.assert_allclose(at[:, 0, 1], (1024 + texel) / 8, rtol=1e-6)
    edge = layout.sampled(values, UvBlock(1001, 0, 3584, 4096), 18)
    assert edge[..., 0].max() <= 511.5  # never of the square beside it


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("crop", [Crop(10, 7, 33, 50), Crop(12, 8, 36, 48, 4)])
def test_a_cropped_camera_sees_the_same_pixels(orthographic, crop):
    camera = syn.camera((1.5, -2.0, 2.5), width=3.0 if orthographic else None, shift=(0.1, -0.2))
    width, height = 96, 80
    part = uv_blocks.cropped(camera, width, height, crop)
    points = np.random.default_rng(3).uniform(-0.5, 0.5, (50, 3))

    def pixels(cam, w, h):
        clip = np.c_[points, np.ones(50)] @ (cam.projection @ cam.world_to_camera).T
        return (clip[:, :2] / clip[:, 3:] * 0.5 + 0.5) * [w, h]

    whole = pixels(camera, width, height)
    mine = pixels(part, crop.width // crop.shrink, crop.height // crop.shrink)
    np.testing.assert_allclose(mine * crop.shrink + [crop.x, crop.y], whole, atol=1e-9)
    assert part.whole is camera
    np.testing.assert_allclose(np.array(part.part) * [width, height, width, height],
                               [crop.x, crop.y, crop.width, crop.height])


@settings(deadline=None)
@given(st.integers(0, 90), st.integers(0, 70), st.integers(1, 96), st.integers(1, 80), st.integers(1, 9))
def test_shrunk_crops_are_whole_cells_inside_the_picture(x, y, w, h, shrink):
    crop = Crop(x, y, min(w, 96 - x), min(h, 80 - y))
    cells = uv_blocks.shrunk(crop, shrink, 96, 80)
    assert cells.width % shrink == cells.height % shrink == cells.x % shrink == cells.y % shrink == 0
    assert cells.width > 0 and cells.height > 0 and cells.x + cells.width <= 96 and cells.y + cells.height <= 80
    for first, count, mine, mine_count, whole in ((crop.x, crop.width, cells.x, cells.width, 96),
                                                  (crop.y, crop.height, cells.y, cells.height, 80)):
        last_cell = whole // shrink * shrink  # what lies beyond has no whole cell
        assert mine <= first or first >= last_cell
        assert mine + mine_count >= min(first + count, last_cell)


def test_the_crop_holds_what_shows_the_block():
    camera = syn.camera((0.3, -2.0, 2.5))
    position = np.zeros((8, 8, 3), np.float32)
    position[..., 0], position[..., 1] = np.meshgrid(np.linspace(0.1, 0.3, 8), np.linspace(-0.2, 0.1, 8))
    normal = np.broadcast_to(np.float32([0, 0, 1]), position.shape)
    covered = np.ones((8, 8), bool)
    crop = uv_blocks.crop_of(camera, 400, 300, position, normal, covered)
    clip = np.concatenate([position, np.ones((8, 8, 1))], -1) @ (camera.projection @ camera.world_to_camera).T
    at = (clip[..., :2] / clip[..., 3:] * 0.5 + 0.5) * [400, 300]
    assert (at >= [crop.x + 8, crop.y + 8]).all()
    assert (at <= [crop.x + crop.width - 8, crop.y + crop.height - 8]).all()
    assert crop.pixels < 0.2 * 400 * 300
    away = uv_blocks.crop_of(camera, 400, 300, position, -normal, covered)
    assert away.pixels == 64  # a corner
    behind = replace(camera, world_to_camera=np.diag([1.0, 1.0, -1.0, 1.0]) @ camera.world_to_camera)
    assert uv_blocks.crop_of(behind, 400, 300, position, normal, covered).pixels == 64


def test_neighbouring_blocks_hear_the_same_of_their_border():
    """Coarse cells are whole levels of both pyramids, and lie alike in blocks beside each other."""
    layout, rng = uv_blocks.layout(4096, (1001,)), np.random.default_rng(2)
    values = rng.uniform(size=(layout.size, layout.size)).astype(np.float32)
    left, right = UvBlock(1001, 512, 512, 4096), UvBlock(1001, 512, 1024, 4096)
    count, width = cells_of(left), left.side
    while width > count:
        width = (width + 1) // 2
    assert width == count and left.side == count * uv_blocks.CELL
    shared = 2 * left.halo // uv_blocks.CELL
    np.testing.assert_array_equal(layout.sampled(values, left, count)[:, -shared:],
                                  layout.sampled(values, right, count)[:, :shared])
