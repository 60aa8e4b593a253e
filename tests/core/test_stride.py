"""How fine pictures are beside maps, against geometry by hand; and what is taken from solved texels by the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from irpso_addon.core.lens import Lens
from irpso_addon.core.maps.stride import ENOUGH, LEAST, MOST, SparseTexels, pixels_per_texel, stride_of
from tests.support import synthetic as syn

SQUARE = syn.mesh_arrays(syn.quad([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]),
                         uvs=syn.quad([(0, 0), (1, 0), (1, 1), (0, 1)]))
SIZE = 64  # texels of 1 / 32 m


def flat(size: int = SIZE) -> NDArray[np.float32]:
    """(size, size, 3) places of a plane's texels, a metre each."""
    y, x = np.mgrid[:size, :size].astype(np.float32)
    return np.stack([x, y, np.zeros_like(x)], -1)


# ---- pixels of a texel


@pytest.mark.parametrize("degrees", [0, 40, 70])
def test_a_tilted_plane_fills_fewer_pixels(degrees: float) -> None:
    """Orthographic: a pixel is 4 m / 100 wide, a texel 2 m / 64; the plane's area shrinks by the cosine."""
    tilt = np.radians(degrees)
    camera = syn.camera((0, -5 * np.sin(tilt), 5 * np.cos(tilt)), width=4.0)
    found = pixels_per_texel(SQUARE, [(camera, (100, 100))], SIZE)
    np.testing.assert_allclose(found, np.cos(tilt) * ((2 / SIZE) / (4 / 100)) ** 2, rtol=1e-6)


def test_a_camera_in_front_sees_less_of_what_is_farther() -> None:
    """Perspective, 2 m and 4 m away, 60 degrees: a picture is 2 tan(30) times as wide as the distance."""
    wide = 2 * np.tan(np.radians(30))
    for away in (2.0, 4.0):
        found = pixels_per_texel(SQUARE, [(syn.camera((0, 0, away), degrees=60), (300, 300))], SIZE)
        assert np.median(found) == pytest.approx(((2 / SIZE) / (away * wide / 300)) ** 2, rel=0.01)


def test_the_best_picture_counts() -> None:
    near, far, behind = (syn.camera((0, 0, z), width=4.0) for z in (2.0, 8.0, -2.0))
    fine = pixels_per_texel(SQUARE, [(near, (400, 400))], SIZE)
    both = pixels_per_texel(SQUARE, [(far, (100, 100)), (near, (400, 400))], SIZE)
    np.testing.assert_allclose(both, fine)
    assert len(pixels_per_texel(SQUARE, [(behind, (400, 400))], SIZE)) == 0  # sees the back
    beside = syn.camera((9, 0, 2), (9, 0, 0), width=4.0)
    assert len(pixels_per_texel(SQUARE, [(beside, (400, 400))], SIZE)) == 0


def test_a_mirrored_mesh_is_the_same() -> None:
    """Its corners go round the other way, its normals point as before."""
    mirrored = replace(SQUARE, positions=SQUARE.positions[:, ::-1], uvs=SQUARE.uvs[:, ::-1])
    camera = syn.camera((0, 0, 2), width=4.0)
    found, other = (pixels_per_texel(mesh, [(camera, (400, 400))], SIZE) for mesh in (SQUARE, mirrored))
    np.testing.assert_allclose(other.mean(), found.mean())


def test_triangles_that_are_not_solved_do_not_count() -> None:
    """Another square of the UV plane, in which texels are four times as wide, or whose triangles are left out."""
    aside = SQUARE.uvs / 4 + (1, 0)
    both = replace(SQUARE, uvs=np.concatenate([SQUARE.uvs, aside]).astype(np.float32), **{
        name: np.concatenate([getattr(SQUARE, name)] * 2) for name in ("positions", "normals")})
    camera = syn.camera((0, 0, 2), width=4.0)
    alone, beside = (pixels_per_texel(mesh, [(camera, (400, 400))], SIZE) for mesh in (SQUARE, both))
    np.testing.assert_allclose(beside, alone.mean(), rtol=1e-6)
    other = pixels_per_texel(both, [(camera, (400, 400))], SIZE, np.repeat([False, True], len(SQUARE.uvs)))
    np.testing.assert_allclose(other, 16 * alone.mean(), rtol=1e-6)


def test_lenses_count() -> None:
    """A barrel squeezes what lies off the axis."""
    camera = syn.camera((0, 0, 2), degrees=60)
    focal = 150 / np.tan(np.radians(30))
    straight = Lens(300, 300, focal, focal, 150, 150)
    plain, same, barrel = (pixels_per_texel(SQUARE, [(given, (300, 300))], SIZE) for given in (
        camera, syn.through(straight, camera), syn.through(replace(straight, radial=(-0.2, 0.0, 0.0, 0.0)), camera)))
    np.testing.assert_allclose(same, plain, rtol=1e-6)
    assert barrel.mean() < 0.9 * same.mean()


def test_meshes_without_area() -> None:
    point = syn.mesh_arrays(np.zeros((2, 3, 3)), normals=np.zeros((2, 3, 3)), uvs=np.zeros((2, 3, 2)))
    assert len(pixels_per_texel(point, [(syn.camera((0, 0, 2)), (100, 100))], SIZE)) == 0
    folded = syn.mesh_arrays(SQUARE.positions, uvs=SQUARE.uvs * [1, 0])
    assert len(pixels_per_texel(folded, [(syn.camera((0, 0, 2)), (100, 100))], SIZE)) == 0
    assert len(pixels_per_texel(SQUARE, [], SIZE)) == 0


@pytest.mark.parametrize(("pixels", "size", "stride"), [
    (ENOUGH / 4, 1024, 2), (ENOUGH / 4 + 1e-9, 1024, 1), (ENOUGH / 16, 1024, 4), (ENOUGH / 16, 1000, 2),
    (ENOUGH / 16, 2 * LEAST - 1, 1), (1e-6, 8192, MOST), (4.0, 8192, 1)])
def test_stride(pixels: float, size: int, stride: int) -> None:
    assert stride_of(np.full(5, pixels), size) == stride


def test_what_nobody_sees_needs_no_stride() -> None:
    assert stride_of(np.zeros(0), 4096) == 1


# ---- from solved texels to all

strides = st.sampled_from([2, 4, 8])
coverages = st.integers(0, 2**32 - 1).map(lambda seed: np.random.default_rng(seed).random((40, 40)) < 0.7)


@given(strides, st.sampled_from([40, 37]))
@settings(deadline=None)
def test_a_slope_stays_a_slope(stride: int, size: int) -> None:
    """Bilinear between solved texels; beyond the last ones their own values."""
    texels = SparseTexels.of(flat(size), np.zeros((size, size), np.int32), stride)
    y, x = np.mgrid[:size, :size].astype(np.float32)
    slope = 0.01 * x - 0.02 * y
    found = texels.spread(texels.picked(slope))
    last = (size - 1) // stride * stride
    np.testing.assert_allclose(found[:last + 1, :last + 1], slope[:last + 1, :last + 1], atol=1e-5)
    np.testing.assert_allclose(found[last:, last:], slope[last, last], atol=1e-5)


@given(strides, coverages, coverages)
@settings(deadline=None, max_examples=50)
def test_solved_texels_keep_their_values(stride: int, covered: NDArray[np.bool_], seen: NDArray[np.bool_]) -> None:
    """And all others have values between those of solved ones; who has none around has none."""
    slots = np.where(covered, 0, -1).astype(np.int32)
    texels = SparseTexels.of(flat(40), slots, stride)
    solved = texels.picked(covered & seen)
    values = np.random.default_rng(1).random(solved.shape).astype(np.float32)
    around = texels.among(solved)
    found = around.spread(values)
    assert not (around.known & ~covered).any()
    own = np.zeros_like(covered)
    own[texels.rows, texels.columns] = solved
    own &= (np.arange(40) % stride == 0) & (np.arange(40)[:, None] % stride == 0)  # the lattice's own places
    assert around.known[own].all()
    row, column = np.nonzero(own)
    np.testing.assert_allclose(found[own], values[row // stride, column // stride], rtol=1e-6)
    if solved.any():
        assert values[solved].min() - 1e-6 <= found[around.known].min()
        assert found[around.known].max() <= values[solved].max() + 1e-6
    assert (found[~around.known] == 0).all()


def test_every_covered_texel_finds_a_solved_one() -> None:
    """Islands as narrow as a texel too."""
    slots = np.full((40, 40), -1, np.int32)
    slots[:, 5] = slots[17, :] = slots[30:33, 30:33] = 0
    texels = SparseTexels.of(flat(40), slots, 4)
    np.testing.assert_array_equal(texels.known, slots == 0)


@pytest.mark.parametrize("apart", ["material", "place"])
def test_pieces_do_not_mix(apart: str) -> None:
    """Left and right of column 21 are two materials, or two islands that lie elsewhere on the object."""
    position, slots = flat(40), np.zeros((40, 40), np.int32)
    right = np.arange(40) >= 21
    if apart == "material":
        slots[:, right] = 1
    else:
        position[:, right] += [500, 0, 0]
    texels = SparseTexels.of(position, slots, 4)
    found = texels.spread(texels.picked(np.broadcast_to(right, (40, 40))).astype(np.float32))
    np.testing.assert_array_equal(found, np.broadcast_to(right, (40, 40)))


def test_stretched_texels_are_one_piece() -> None:
    """A texel three times as long as wide, on a cylinder."""
    y, x = np.mgrid[:40, :40].astype(np.float32)
    bent = np.stack([50 * np.sin(x / 50), 3 * y, 50 * np.cos(x / 50)], -1)
    texels = SparseTexels.of(bent, np.zeros((40, 40), np.int32), 4)
    np.testing.assert_allclose(texels.spread(texels.picked(x))[:37, :37], x[:37, :37], atol=1e-4)


def test_colour_tells_where_one_side_ends() -> None:
    """Roughness and colour change between two solved texels: the mean of both sides is found nowhere."""
    texels = SparseTexels.of(flat(40), np.zeros((40, 40), np.int32), 4)
    for edge in (21, 22, 23):
        right = np.broadcast_to(np.arange(40) >= edge, (40, 40))
        rough = np.where(right, 0.5, 0.2).astype(np.float32)
        base = np.where(right[..., None], [0.5, 0.2, 0.1], [0.1, 0.3, 0.5]).astype(np.float32)
        plain, guided = texels.spread(texels.picked(rough)), texels.guided(base).spread(texels.picked(rough))
        assert np.abs(plain - rough).max() > 0.07
        assert np.abs(guided - rough).max() < 0.005
        even = texels.guided(np.full_like(base, 0.3)).spread(texels.picked(rough))
        np.testing.assert_allclose(even, plain, atol=1e-6)
        black = texels.guided(np.zeros_like(base)).spread(texels.picked(rough))
        np.testing.assert_allclose(black, plain, atol=1e-6)


def test_channels_and_numbers_that_are_missing() -> None:
    """Three channels at once; a number that is NaN where no texel takes it from stays there."""
    texels = SparseTexels.of(flat(8), np.zeros((8, 8), np.int32), 2)
    solved = np.ones((4, 4), bool)
    solved[:, 3] = False
    values = np.random.default_rng(2).random((4, 4, 3)).astype(np.float32)
    values[:, 3] = np.nan
    around = texels.among(solved)
    found = around.spread(values)
    assert np.isfinite(found[around.known]).all() and found.shape == (8, 8, 3)
    for channel in range(3):
        np.testing.assert_array_equal(found[..., channel], around.spread(values[..., channel]))
