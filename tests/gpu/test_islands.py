"""Two UV islands of other paint that meet in every picture: base colour at their edges is each island's own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.gpu.device.programs import SEAM
from irpso_addon.gpu.gbuffer.gbuffer import MeshBuffer, Occluders, draw_pixel_grid
from irpso_addon.gpu.gbuffer.seams import CORNER, mark_seams
from tests.support import synthetic as syn
from tests.support.shoots import rig, run

SIZE = 48
PAINT = np.array([[0.15, 0.4, 0.7], [0.7, 0.5, 0.1]])
TWO = replace(syn.PATCHES, base=lambda u, v: PAINT[(np.asarray(u) > 0.5).astype(int)],
              roughness=lambda u, v: np.full_like(np.asarray(u), 0.4))
ISLANDS = ((0.06, 0.44), (0.55, 0.93))  # u of the plane's left and right half: their edges cut texels


def torn_mesh() -> syn.MeshArrays:
    """The plane, its halves apart in UV space."""
    mesh = syn.plane_mesh()
    x = mesh.positions[..., 0]
    left = x.mean(axis=1, keepdims=True) < 0
    u = np.where(left, np.interp(x, (-1, 0), ISLANDS[0]), np.interp(x, (0, 1), ISLANDS[1]))
    return replace(mesh, uvs=np.stack([u, mesh.uvs[..., 1]], -1).astype(np.float32))


@pytest.mark.parametrize("pixels", [40, pytest.param(72, marks=pytest.mark.one_python)])
def test_paint_beyond_a_seam_stays_there(pixels):
    """Pictures average 6 x 6 rays in a pixel.  A texel that a pixel of both islands shows differs from the mean of
    the two paints by 0.3 in a channel.
    """
    solution = run(syn.shoot(TWO, rig(3, 4), (pixels, pixels), mesh=torn_mesh(), samples=6), size=SIZE)
    maps, u = solution.maps, (np.arange(SIZE) + 0.5) / SIZE
    off = np.abs(maps.base_color - np.where(u[:, None] < 0.5, *PAINT)).max(-1)
    beside = ~maps.filled & ((np.abs(u - ISLANDS[0][1]) < 1 / SIZE) & (u < ISLANDS[0][1])
                             | (np.abs(u - ISLANDS[1][0]) < 1 / SIZE) & (u > ISLANDS[1][0]))
    assert beside.any(axis=0).sum() == 2  # columns of texels
    assert beside.sum() > 80
    assert np.sqrt(np.mean(off[beside] ** 2)) < 0.04  # 0.11 and 0.08 where seams are not seen
    assert np.median(off[beside]) < 0.01


@pytest.mark.one_python
@pytest.mark.parametrize("footprint", [0.01, 1.0, 1.5])
def test_pixels_at_a_seam_are_marked(on_gl, footprint):
    """Where a corner of the footprint lies beyond the seam, by rays; beside the plane nothing mixes in."""
    camera, (width, height) = syn.cameras(1)[0], (40, 32)
    mesh = torn_mesh()

    def work(device):
        with device.scope():
            buffer, none = MeshBuffer(device, mesh), Occluders(device, np.zeros((0, 3, 3), np.float32))
            maps = draw_pixel_grid(device, buffer, none, camera, (width, height), footprint)
            mark_seams(device, buffer, none, camera, maps, footprint)
            return device.read(maps.position)[..., 3].copy()

    coverage = on_gl(work)
    fine = 100
    points = syn.meet_plane(*syn.pixel_rays(camera, fine * width, fine * height))
    side = np.where((np.abs(points[..., :2]) <= 1).all(-1), np.sign(points[..., 0]), 0)
    reach = round(CORNER * footprint * fine)
    y, x = np.meshgrid(fine * np.arange(1, height - 1) + fine // 2, fine * np.arange(1, width - 1) + fine // 2,
                       indexing="ij")
    ends = -reach, reach
    corners = sum((side[y + dy, x + dx] * side[y, x] < 0).astype(int) for dy in ends for dx in ends)
    inner, seen = coverage[1:-1, 1:-1], side[y, x] != 0
    assert (inner > 0.5)[seen].all()
    assert footprint < 0.1 or ((corners > 0) & seen).any()
    want = 1 - SEAM * corners if footprint > 0.1 else np.ones_like(inner)
    assert np.mean(np.abs(inner - want)[seen] < 0.01) > 0.995  # rays are a hundredth of a pixel apart
