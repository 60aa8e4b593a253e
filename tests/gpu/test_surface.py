"""The G-buffers, over the UV square and through cameras, against float64 rasters and rays.

OpenGL snaps corners to 1/256 of a pixel (8 bits below it, the least that it grants): that is the tolerance of every
position, and pixels whose centre lies so near an edge may fall either way.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.data import Camera, MeshArrays, NormalMap, SceneData
from irpso_addon.core.errors import BadInput
from irpso_addon.core.triangle_bundles import Bundles
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.gbuffer.facets import facets
from irpso_addon.gpu.gbuffer.gbuffer import MeshBuffer, Occluders, draw_pixel_grid
from irpso_addon.gpu.gbuffer.projection import clip_matrix
from irpso_addon.solve import one_round
from tests.support import synthetic as syn

SNAP = 1.5 / 256  # pixels
SIZE = 57  # odd on purpose
NOTHING = np.zeros((0, 3, 3), np.float32)


def bake(mesh: MeshArrays, size: int = SIZE) -> one_round.GBuffer:
    scene = SceneData("test", mesh, NOTHING, ())
    return thread.run(lambda: one_round.bake_gbuffer(scene, size))


def raster(uvs: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric coordinates (size, size, 3) of texel centres in one triangle, and their distance inside its edges.

    The distance is in texels: positive inside, negative outside.
    """
    at = (np.arange(size) + 0.5) / size
    p = np.stack(np.meshgrid(at, at), -1)
    inward, height = np.empty((size, size, 3)), np.empty(3)
    for k in range(3):
        a, b, c = (uvs[(k + i) % 3].astype(np.float64) for i in range(3))
        normal = np.array([-(c - b)[1], (c - b)[0]]) / np.linalg.norm(c - b)
        height[k] = (a - b) @ normal
        inward[..., k] = (p - b) @ normal * np.sign(height[k])
    return inward / np.abs(height), inward.min(axis=-1) * size


@pytest.fixture(scope="module")
def islands() -> MeshArrays:
    """Three triangles of different winding in the UV square, anywhere in space, with normals that differ by corner."""
    rng = np.random.default_rng(2)
    uvs = [[(0.05, 0.07), (0.62, 0.11), (0.21, 0.55)], [(0.95, 0.93), (0.91, 0.31), (0.55, 0.88)],
           [(0.05, 0.95), (0.4, 0.93), (0.12, 0.66)]]
    normals = rng.normal(size=(3, 1, 3)) + 0.4 * rng.normal(size=(3, 3, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return syn.mesh_arrays(rng.uniform(-2, 2, (3, 3, 3)) + np.array([5, -3, 8]), normals, uvs)


def test_texels_are_the_triangles_they_lie_in(islands):
    """Position to the snap, normal to the turn that the snap makes of it, coverage except within it of an edge."""
    got = bake(islands)
    inside = np.zeros((SIZE, SIZE), bool)
    for k in range(3):
        weights, depth = raster(islands.uvs[k], SIZE)
        mine, sure = depth > 0, depth > SNAP
        assert 60 < sure.sum() < mine.sum() + 5
        assert got.coverage[sure].all()
        inside |= depth > -SNAP
        corners = islands.positions[k].astype(np.float64)
        expected = weights[sure] @ corners
        texel = max(np.linalg.norm(np.linalg.solve((islands.uvs[k, 1:] - islands.uvs[k, 0]).astype(float),
                                                   corners[1:] - corners[0]), axis=1)) / SIZE
        assert np.linalg.norm(got.position[sure] - expected, axis=-1).max() < 2 * SNAP * texel
        normal = weights[sure] @ islands.normals[k].astype(np.float64)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        angle = np.degrees(2 * np.arcsin(np.linalg.norm(got.normal[sure] - normal, axis=-1) / 2))
        assert angle.max() < 0.05
    assert not got.coverage[~inside].any()
    assert not got.overlap.any()
    assert not got.position[~got.coverage].any()


def test_row_zero_is_v_zero():
    """A single triangle low in the UV square covers low rows."""
    uvs = [[(0.0, 0.0), (1.0, 0.0), (0.5, 0.2)]]
    got = bake(syn.mesh_arrays([[(0, 0, 0), (1, 0, 0), (0.5, 0.2, 0)]], uvs=uvs))
    rows = np.flatnonzero(got.coverage.any(axis=1))
    assert rows.min() == 0
    assert rows.max() < 0.2 * SIZE


def test_quads_leave_no_gap_and_no_overlap_on_their_diagonal():
    got = bake(syn.plane_mesh(), 64)
    at = np.stack(np.meshgrid(*2 * [(np.arange(64) + 0.5) / 64]), -1)
    inside = ((at > syn.MARGIN) & (at < 1 - syn.MARGIN)).all(-1)
    np.testing.assert_array_equal(got.coverage, inside)
    assert not got.overlap.any()
    world = (at - syn.MARGIN) / (1 - 2 * syn.MARGIN) * 2 - 1
    np.testing.assert_allclose(got.position[inside][:, :2], world[inside], atol=2 / 64 * SNAP * 1.2)
    exact = syn.plane_normal(np.concatenate([world, 0 * world[..., :1]], -1))[inside]
    assert np.linalg.norm(got.normal[inside] - exact, axis=-1).max() < 2e-4


def test_overlap_is_where_two_triangles_claim_a_texel():
    one = np.array([(0.1, 0.1), (0.7, 0.1), (0.1, 0.7)])
    other = np.array([(0.6, 0.6), (0.1, 0.6), (0.6, 0.1)])
    mesh = syn.mesh_arrays([[(0, 0, 0), (1, 0, 0), (0, 1, 0)]] * 2, uvs=[one, other])
    got = bake(mesh)
    depth = np.minimum(raster(one, SIZE)[1], raster(other, SIZE)[1])
    assert (depth > SNAP).sum() > 50
    assert got.overlap[depth > SNAP].all()
    assert not got.overlap[depth < -SNAP].any()


def test_a_mesh_outside_the_uv_square_is_named():
    uvs = [[(2.0, 0.0), (3.0, 0.0), (2.0, 1.0)]]
    with pytest.raises(BadInput, match="Subject: no face covers a texel"):
        bake(syn.mesh_arrays([[(0, 0, 0), (1, 0, 0), (0, 1, 0)]], uvs=uvs))


def test_the_lift_is_the_sagitta_on_humps_and_zero_on_flat_faces_and_in_hollows():
    """Half the height of a corner over another corner's tangent plane: for a sphere edge of length e, e^2 / (4 r)."""
    flat = facets(syn.mesh_arrays(syn.box((0, 0, 0), (1, 2, 3))))
    np.testing.assert_allclose(flat[:, 3], 0, atol=1e-6)
    positions, normals = syn.sphere(48, 24, radius=2.0)
    got = facets(syn.mesh_arrays(positions, normals))
    edge = np.linalg.norm(positions - np.roll(positions, 1, axis=1), axis=-1).max(axis=1)
    np.testing.assert_allclose(got[:, 3], edge**2 / (4 * 2.0), rtol=1e-3)
    np.testing.assert_allclose(facets(syn.mesh_arrays(positions, -normals))[:, 3], 0, atol=1e-6)  # seen from within
    outward = (got[:, :3] * positions.mean(axis=1)).sum(-1)
    assert (np.abs(outward) > 0.98 * np.linalg.norm(positions.mean(axis=1), axis=1)).all()


# ---- through cameras

CAMERAS = {
    "perspective": syn.camera((1.1, -2.0, 3.2), (0.1, 0.1, 0), degrees=34, aspect=1.5),
    "shifted": syn.camera((1.1, -2.0, 3.2), (0.4, 0.1, 0), degrees=34, aspect=1.5, shift=(0.3, -0.2)),
    "wide": syn.camera((0.2, -0.3, 0.9), degrees=95, aspect=1.5),
    "orthographic": syn.camera((1.1, -2.0, 3.2), (0.1, 0.1, 0), width=2.6, aspect=1.5),
    "orthographic, shifted": syn.camera((-1.0, 0.3, 2.0), (0.3, 0.1, 0), width=2.2, aspect=1.5, shift=(-0.2, 0.1)),
}
WIDTH, HEIGHT = 96, 64


def pixel_grid(on_gl, mesh: MeshArrays, camera: Camera, occluders: np.ndarray = NOTHING, footprint: float = 0.0,
               size: tuple[int, int] = (WIDTH, HEIGHT)) -> dict[str, np.ndarray]:
    """A camera's maps as arrays by name."""

    def draw(device):
        buffer, others = MeshBuffer(device, mesh), Occluders(device, np.asarray(occluders, np.float32))
        maps = draw_pixel_grid(device, buffer, others, camera, size, footprint)
        found = {name: device.read(getattr(maps, name)).copy() for name in ("position", "normal", "uv", "uv_slope")}
        maps.release()
        buffer.release()
        return found

    return on_gl(draw)


@pytest.mark.parametrize("name", CAMERAS)
def test_pixels_are_where_their_rays_meet_the_plane(on_gl, name):
    camera = CAMERAS[name]
    got = pixel_grid(on_gl, syn.plane_mesh(), camera)
    origin, direction = syn.pixel_rays(camera, WIDTH, HEIGHT)
    points = syn.meet_plane(origin, direction)
    within = np.abs(points[..., :2]).max(-1)
    shown = got["position"][..., 3] > 0.5
    slant = 1 / np.abs(direction[..., 2])
    depth = (points - camera.position) @ camera.forward
    pixel = 2 / (camera.projection[0, 0] * WIDTH) * (1 if camera.orthographic else depth) * slant
    assert shown[within < 1 - SNAP * pixel].all()
    assert not shown[~(within < 1 + SNAP * pixel)].any()
    sure = shown & (within < 1)
    assert sure.sum() > 1000
    assert (np.linalg.norm(got["position"][..., :3] - points, axis=-1)[sure] < 2 * SNAP * pixel[sure]).all()
    assert np.linalg.norm(got["normal"][..., :3] - syn.plane_normal(points), axis=-1)[sure].max() < 2e-3
    np.testing.assert_allclose(got["uv"][sure], syn.plane_uv(points)[sure], atol=2 * SNAP * pixel[sure].max())
    assert not got["position"][~shown].any()


@pytest.mark.parametrize("name", ["perspective", "orthographic"])
def test_uv_slopes_are_the_step_to_the_next_pixel(on_gl, name):
    """Against the analytic uv at the neighbours' rays.  A driver takes them per 2 x 2 pixels: compare there."""
    camera = CAMERAS[name]
    got = pixel_grid(on_gl, syn.plane_mesh(), camera)
    uv = syn.plane_uv(syn.meet_plane(*syn.pixel_rays(camera, WIDTH, HEIGHT)))
    whole = (got["position"][..., 3] > 0.5)
    inside = whole & np.roll(whole, (1, 1), (0, 1)) & np.roll(whole, (-1, -1), (0, 1))
    inside[[0, -1]] = inside[:, [0, -1]] = False
    step = np.concatenate([(np.roll(uv, -1, 1) - np.roll(uv, 1, 1)) / 2, (np.roll(uv, -1, 0) - np.roll(uv, 1, 0)) / 2],
                          axis=-1)
    assert inside.sum() > 1000
    np.testing.assert_allclose(got["uv_slope"][inside], step[inside], rtol=0.03, atol=3e-4)


@pytest.mark.parametrize("name", ["perspective", "orthographic"])
def test_pixels_are_where_their_rays_meet_a_sphere(on_gl, name):
    """Within the sagitta of the facets (0.0006 of the radius) and the angle that a chord makes of it."""
    positions, normals = syn.sphere(128, 64, radius=0.8)
    camera = CAMERAS[name]
    got = pixel_grid(on_gl, syn.mesh_arrays(positions, normals), camera)
    origin, direction = syn.pixel_rays(camera, WIDTH, HEIGHT)
    b = (origin * direction).sum(-1)
    root = b * b - (origin * origin).sum(-1) + 0.8**2
    hit = root > 0
    points = origin + (-b - np.sqrt(np.where(hit, root, 0)))[..., None] * direction
    facing = -(points * direction).sum(-1) / 0.8
    sure = hit & (facing > 0.3)
    assert sure.sum() > 400
    assert (got["position"][..., 3][sure] > 0.5).all()
    assert np.linalg.norm(got["position"][..., :3] - points, axis=-1)[sure].max() < 0.004
    assert np.linalg.norm(got["normal"][..., :3] - points / 0.8, axis=-1)[sure].max() < 0.005
    missed = ~hit & (root < -0.02)
    assert not got["position"][..., 3][missed].any()


@pytest.mark.parametrize("name", ["perspective", "orthographic"])
def test_another_object_in_front_hides_and_one_behind_does_not(on_gl, name):
    camera = CAMERAS[name]
    low, high = (-0.4, -0.3, 0.3), (0.2, 0.5, 0.5)
    under = syn.quad([(-3, -3, -0.05), (3, -3, -0.05), (3, 3, -0.05), (-3, 3, -0.05)])
    plain = pixel_grid(on_gl, syn.plane_mesh(), camera)["position"]
    got = pixel_grid(on_gl, syn.plane_mesh(), camera, np.concatenate([syn.box(low, high), under]))["position"]
    origin, direction = syn.pixel_rays(camera, WIDTH, HEIGHT)
    hidden = syn.box_blocks(origin, 100 * direction, low, high)
    on_plane = plain[..., 3] > 0.5
    wrong = on_plane & ((got[..., 3] > 0.5) == hidden)
    assert (on_plane & hidden).sum() > 200
    assert (wrong & ~near_edge(hidden)).sum() == 0
    assert wrong.sum() <= 3  # pixels whose centre lies on the box's outline
    kept = on_plane & (got[..., 3] > 0.5)
    np.testing.assert_array_equal(got[kept], plain[kept])


def near_edge(mask: np.ndarray, reach: int = 1) -> np.ndarray:
    """Pixels within ``reach`` of a change of the mask."""
    padded = np.pad(mask, reach, mode="edge")
    shifts = [padded[y:y + mask.shape[0], x:x + mask.shape[1]]
              for y in range(2 * reach + 1) for x in range(2 * reach + 1)]
    return np.any(shifts, axis=0) & ~np.all(shifts, axis=0)


@pytest.mark.parametrize("name", ["perspective", "orthographic"])
def test_what_lies_behind_the_camera_hides_nothing(on_gl, name):
    """A wall at the camera's back, as in a room."""
    camera = CAMERAS[name]
    back = camera.position - 1.5 * camera.forward
    side = np.cross(camera.forward, (0, 0, 1))
    up = np.cross(side, camera.forward)
    wall = syn.quad([back - 9 * side - 9 * up, back + 9 * side - 9 * up, back + 9 * side + 9 * up,
                     back - 9 * side + 9 * up])
    plain = pixel_grid(on_gl, syn.plane_mesh(), camera)["position"]
    got = pixel_grid(on_gl, syn.plane_mesh(), camera, wall)["position"]
    assert (plain[..., 3] > 0.5).sum() > 1000
    np.testing.assert_array_equal(got[..., 3], plain[..., 3])


@pytest.mark.parametrize("name", ["perspective", "orthographic"])
def test_a_mesh_wholly_behind_the_camera_is_not_seen(on_gl, name):
    camera = CAMERAS[name]
    turned = syn.camera(camera.position, 2 * camera.position, degrees=34, aspect=1.5,
                        width=2.6 if camera.orthographic else None)
    assert not pixel_grid(on_gl, syn.plane_mesh(), turned)["position"].any()


def test_depth_tells_surfaces_apart_that_nearly_touch(on_gl):
    """A millimetre at four metres, with something else a kilometre away and something beside the camera."""
    camera = CAMERAS["perspective"]
    lid = syn.quad([(-1, -1, 1e-3), (1, -1, 1e-3), (1, 1, 1e-3), (-1, 1, 1e-3)])
    far = syn.quad([(-500, 500, -300), (500, 500, -300), (500, 900, -300), (-500, 900, -300)])
    got = pixel_grid(on_gl, syn.plane_mesh(), camera, np.concatenate([lid, far]))["position"][..., 3] > 0.5
    # Only the rim that a slanted look lets show under the lid may remain.
    assert got.sum() < 60
    below = pixel_grid(on_gl, syn.plane_mesh(), camera, np.concatenate([lid * (1, 1, -1), far]))["position"][..., 3]
    assert (below > 0.5).sum() > 1000


def test_clip_matrix_keeps_the_image_plane_and_puts_depths_in_range():
    camera = CAMERAS["shifted"]
    mesh = syn.plane_mesh()
    clip = clip_matrix(camera, [Bundles.of(mesh.positions), Bundles.of(NOTHING)])
    points = np.concatenate([mesh.positions.reshape(-1, 3), np.ones((len(mesh.positions) * 3, 1))], axis=1)
    got, own = points @ clip.T, points @ (camera.projection @ camera.world_to_camera).T
    np.testing.assert_allclose(got[:, [0, 1, 3]], own[:, [0, 1, 3]], rtol=1e-12, atol=1e-12)
    assert (np.abs(got[:, 2] / got[:, 3]) < 1).all()


# ---- normal maps


def mapped_plane(pixels: np.ndarray, strength: float = 1.0) -> MeshArrays:
    """A flat square of 2 m, uv = (x + 1) / 2, tangent along x, under a normal map and an uneven scale."""
    positions = syn.quad([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
    up, tangent = np.zeros((2, 3, 3), np.float32), np.zeros((2, 3, 4), np.float32)
    up[..., 2], tangent[..., 0], tangent[..., 3] = 1, 1, 1
    mesh = syn.mesh_arrays(positions, up, (positions[..., :2] + 1) / 2)
    return replace(mesh, object_normals=up, tangents=tangent, normal_matrix=np.diag([1.0, 0.5, 2.0]).astype(np.float32),
                   normal_maps={0: NormalMap(pixels.astype(np.float32), strength)})


def waves(size: int) -> np.ndarray:
    """A smooth tangent-space map, repeating: 3 waves across, 2 up."""
    at = (np.arange(size) + 0.5) / size
    u, v = np.meshgrid(at, at)
    n = np.stack([0.5 * np.sin(6 * np.pi * u), 0.4 * np.cos(4 * np.pi * v), np.ones_like(u)], -1)
    return n / np.linalg.norm(n, axis=-1, keepdims=True) * 0.5 + 0.5


def look_up(pixels: np.ndarray, uv: np.ndarray, strength: float) -> np.ndarray:
    """The mapped normal at uv (..., 2) in float64: bilinear, repeating, through diag(1, .5, 2)."""
    size = pixels.shape[0]
    at = uv * size - 0.5
    i, f = np.floor(at).astype(int), at - np.floor(at)
    c = np.zeros((*uv.shape[:-1], 3))
    for dx in (0, 1):
        for dy in (0, 1):
            w = np.abs(1 - dx - f[..., 0]) * np.abs(1 - dy - f[..., 1])
            c += w[..., None] * pixels[(i[..., 1] + dy) % size, (i[..., 0] + dx) % size]
    c = 2 * c - 1
    c = np.stack([c[..., 0] * strength, c[..., 1] * strength, 1 + (c[..., 2] - 1) * min(max(strength, 0), 1)], -1)
    n = c * (1, 0.5, 2)
    return n / np.linalg.norm(n, axis=-1, keepdims=True)


@pytest.mark.parametrize("strength", [1.0, 0.4, 1.7])
def test_texels_take_the_normal_map_at_their_centre(strength):
    """A sampler's filter has 8 bits below a texel: 1/256 of the step between two texels of the map."""
    pixels = waves(32)
    got = bake(mapped_plane(pixels, strength), 48)
    uv = np.stack(np.meshgrid(*2 * [(np.arange(48) + 0.5) / 48]), -1)
    assert got.coverage.all()
    assert np.linalg.norm(got.normal - look_up(pixels, uv, strength), axis=-1).max() < 0.006


def test_pixels_take_the_mean_of_the_normal_map_over_their_footprint(on_gl):
    """Against a dense mean (32 x 32) of a map whose waves are a few pixels long; the centre alone is far off."""
    pixels = np.tile(waves(24), (6, 6, 1))
    camera = syn.camera((0, 0, 5), width=2.0)
    size = 40
    got = pixel_grid(on_gl, mapped_plane(pixels), camera, footprint=1.0, size=(size, size))["normal"][..., :3]
    fine = size * 32
    at = (np.arange(fine) + 0.5) / fine
    dense = look_up(pixels, np.stack(np.meshgrid(at, at), -1), 1.0).reshape(size, 32, size, 32, 3).mean(axis=(1, 3))
    dense /= np.linalg.norm(dense, axis=-1, keepdims=True)
    centre = pixel_grid(on_gl, mapped_plane(pixels), camera, footprint=0.0, size=(size, size))["normal"][..., :3]
    error = np.linalg.norm(got - dense, axis=-1)
    assert np.linalg.norm(centre - dense, axis=-1).max() > 0.06
    assert error.max() < 0.006
    middle = (np.arange(size) + 0.5) / size
    exact = look_up(pixels, np.stack(np.meshgrid(middle, middle), -1), 1.0)
    assert np.linalg.norm(centre - exact, axis=-1).max() < 0.015


def test_each_slot_has_its_own_map(on_gl):
    """Two halves of a plane, one with a map, one without: the slot's number and the normals differ."""
    positions = np.concatenate([syn.quad([(-1, -1, 0), (0, -1, 0), (0, 1, 0), (-1, 1, 0)]),
                                syn.quad([(0, -1, 0), (1, -1, 0), (1, 1, 0), (0, 1, 0)])])
    base = mapped_plane(np.full((4, 4, 3), (0.8, 0.5, 0.9)))
    up, tangent = np.concatenate([base.object_normals] * 2), np.concatenate([base.tangents] * 2)
    mesh = replace(syn.mesh_arrays(positions, up, (positions[..., :2] + 1) / 2, np.array([1, 1, 0, 0]), ("A", "B")),
                   object_normals=up, tangents=tangent, normal_matrix=np.eye(3, dtype=np.float32),
                   normal_maps={1: NormalMap(np.full((4, 4, 3), (0.8, 0.5, 0.9), np.float32), 1.0)})
    got = pixel_grid(on_gl, mesh, syn.camera((0, 0, 5), width=2.0), size=(8, 8))["normal"]
    tilted = np.array([0.6, 0.0, 0.8]) / np.linalg.norm([0.6, 0.0, 0.8])
    np.testing.assert_allclose(got[:, :4], np.broadcast_to([*tilted, 1], (8, 4, 4)), atol=1e-5)
    np.testing.assert_allclose(got[:, 4:], np.broadcast_to([0, 0, 1, 0], (8, 4, 4)), atol=1e-5)
