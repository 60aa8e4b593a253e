"""Lenses in the projection: GLSL and what is drawn, against float64; and a solve through them.

The lens is like that of a 24 mm full-frame camera: 84 degrees across the picture's corners, two per cent of barrel
distortion.  `shown_at` is Brown's model written once more, after OpenCV's documentation.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core import lens_mesh
from irpso_addon.core.checks.mended_cameras import moved
from irpso_addon.core.data import Bounced, Camera, SceneData, View
from irpso_addon.core.lens import Lens
from irpso_addon.core.projection import pixel_widths, pixels_of
from irpso_addon.core.tiled.uv_blocks import Crop, cropped
from irpso_addon.core.triangle_bundles import BUNDLE, Bundles
from irpso_addon.gpu.gbuffer.drawn_outline import DrawnOutline
from irpso_addon.gpu.gbuffer.gbuffer import MeshBuffer, Occluders, draw_pixel_grid
from irpso_addon.gpu.gbuffer.projection import Projection
from irpso_addon.gpu.observe.indirect_light import Smoother
from irpso_addon.gpu.observe.observations import camera_uniforms
from tests.support import shoots
from tests.support import synthetic as syn

TOLERANCE = 0.05  # pixels
NOTHING = np.zeros((0, 3, 3), np.float32)
WIDE = Lens(6000, 4000, fx=4021.3, fy=4020.7, cx=3024.9, cy=1973.4, radial=(-0.105, 0.092, -0.031, 0.004),
            tangential=(6e-4, -3.5e-4), skew=1.6)
FISHEYE = Lens(6000, 4000, fx=2560.0, fy=2561.0, cx=3024.9, cy=1973.4, radial=(-0.02, 0.004, -0.001, 0.0),
               tangential=(2e-4, -1e-4), fisheye=True)
BARREL = Lens(6000, 4000, fx=3000.0, fy=3000.0, cx=3000.0, cy=2000.0, radial=(-0.3, 0.0, 0.0, 0.0))  # turns back inside
LENSES = {"24 mm": WIDE, "fisheye": FISHEYE, "barrel": BARREL}
SMALL = (450, 300)


def shown_at(lens: Lens, points: np.ndarray) -> np.ndarray:
    """Pixels from the upper left corner of points (N, 3) in camera axes."""
    X, Y, Z = np.asarray(points, np.float64).T
    x, y = X / Z, Y / Z
    if lens.fisheye:
        r = np.sqrt(X**2 + Y**2)
        theta = np.arctan2(r, Z)
        x, y = theta * X / np.maximum(r, 1e-300), theta * Y / np.maximum(r, 1e-300)
    (k1, k2, k3, k4), (p1, p2) = lens.radial, lens.tangential
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3 + k4 * r2**4
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    yd = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return np.stack([lens.cx + lens.fx * xd + lens.skew * yd, lens.cy + lens.fy * yd], -1)


def reprojected(camera: Camera, points: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Pixels from the lower left corner of world points."""
    local = (points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]) * (1, -1, -1)
    u, v = (shown_at(camera.lens, local) * size / (camera.lens.width, camera.lens.height)).T
    return np.stack([u, size[1] - v], -1)


def drawn(on_gl, triangles, camera, size=SMALL, occluders=NOTHING) -> np.ndarray:
    """(h, w, 4) world position and coverage."""
    up = np.broadcast_to((0.0, 0.0, 1.0), (len(triangles), 3, 3))

    def draw(device):
        with device.scope():
            mesh = MeshBuffer(device, syn.mesh_arrays(triangles, up))
            others = Occluders(device, np.asarray(occluders, np.float32))
            return device.read(draw_pixel_grid(device, mesh, others, camera, size, 0.0).position).copy()

    return on_gl(draw)


def off_centre(position: np.ndarray, camera: Camera) -> np.ndarray:
    """How far, in pixels, what pixels show lies from their centres."""
    y, x = np.nonzero(position[..., 3] > 0.5)
    found = reprojected(camera, position[y, x, :3].astype(np.float64), position.shape[1::-1])
    return np.hypot(*(found - np.stack([x, y], -1) - 0.5).T)


def floor(half: float) -> np.ndarray:
    return syn.quad([(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)])


def near_edge(mask: np.ndarray) -> np.ndarray:
    """Pixels at a change of the mask."""
    edge = np.zeros_like(mask)
    for change, (before, after) in ((mask[1:] != mask[:-1], (edge[:-1], edge[1:])),
                                    (mask[:, 1:] != mask[:, :-1], (edge[:, :-1], edge[:, 1:]))):
        before |= change
        after |= change
    return edge


# ---- GLSL


def plain(projection: Projection) -> dict[str, object]:
    """Its uniforms, matrices as tuples."""
    return {key: tuple(np.frombuffer(value, np.float32)) if isinstance(value, bytes) else value
            for key, value in projection.uniforms.items()}


@pytest.mark.parametrize("name", LENSES)
def test_the_shader_shows_places_where_the_lens_does(evaluate, name):
    """At corners, along the border and inside, at depths from 0.3 to 300 m, by a camera that stands askew."""
    lens = LENSES[name]
    camera = syn.through(lens, syn.camera((1.7, -2.9, 1.3), (0.2, 0.4, 0.1)))
    across, down = np.meshgrid(np.linspace(0, lens.width, 25), np.linspace(0, lens.height, 17))
    rays = lens.rays(np.stack([across, down], -1).reshape(-1, 2))
    rays = rays[np.isfinite(rays).all(-1)]
    assert len(rays) == (425 if name != "barrel" else len(rays)) > 200
    depth = 10 ** np.random.default_rng(3).uniform(-0.5, 2.5, (len(rays), 1))
    points = ((depth * rays * (1, -1, -1)) @ camera.world_to_camera[:3, :3] + camera.position).astype(np.float32)
    projection = Projection(lens.matrix @ np.diag([1.0, -1, -1, 1]), lens,
                            np.diag([1.0, -1, -1, 1]) @ camera.world_to_camera)
    got = evaluate("include/projection.glsl", "vec4 c = clip_of(a.xyz); o = vec4(c.xy / c.w, c.w, 0.0);", points,
                   plain(projection), projection.defines).astype(np.float64)
    pixels = (got[:, :2] * (0.5, -0.5) + 0.5) * (lens.width, lens.height)
    local = points.astype(np.float64) @ projection.axes[:3, :3].T + projection.axes[:3, 3]
    assert (got[:, 2] > 0).all()
    inside = lens.project(local)
    np.testing.assert_allclose(inside, shown_at(lens, local), atol=1e-8)
    assert np.hypot(*(pixels - inside).T).max() < TOLERANCE


def test_what_the_lens_does_not_reach_has_no_place(evaluate):
    uniforms = plain(Projection(np.eye(4), BARREL, np.eye(4)))
    points = np.array([(0, 0, 1), (1.0, 0, 1), (1.1, 0, 1), (0, -9, 1), (0.1, 0, -1)], np.float32)
    got = evaluate("include/projection.glsl", "o = clip_of(a.xyz);", points, uniforms, {"LENS": "1"})
    assert np.sqrt(1 / 0.9) == pytest.approx(BARREL.reach)  # 1.054
    assert (got[:, 3] > 0).tolist() == [True, True, False, False, False]


@pytest.mark.parametrize("name", LENSES)
def test_a_pixels_width_is_the_step_between_rays(name):
    """Of a surface across the axis (a fisheye's faces the camera): of the steps along and across the radius the larger,
    to 3 % (tangential terms, skew)."""
    lens = replace(LENSES[name], skew=0.0)
    camera = syn.through(lens, syn.camera((0, 0, 0), (0, 1, 0)))
    for share in (0.0, 0.3, 0.6):
        middle = np.array([lens.cx + share * 3000, lens.cy])
        steps = lens.rays(middle + np.array([(0, 0), (0.5, 0), (-0.5, 0), (0, 0.5), (0, -0.5)]))
        places = 2.0 * steps if lens.fisheye else 2.0 * steps / steps[:, 2:]
        want = max(np.linalg.norm(places[1] - places[2]), np.linalg.norm(places[3] - places[4]))
        world = (places[:1] * (1, -1, -1)) @ camera.world_to_camera[:3, :3]
        assert pixel_widths(camera, world, lens.height)[0] == pytest.approx(want, rel=0.03)


# ---- drawn


@pytest.mark.parametrize("name", LENSES)
@pytest.mark.parametrize("half", [3.0, 50.0])
def test_a_coarse_plane_lies_where_the_lens_shows_it(on_gl, name, half):
    """Two triangles that fill the picture, and reach under and behind the camera: none is missing, none folded."""
    camera = syn.through(LENSES[name], syn.camera((0.2, -1.0, 1.5), (0.1, 0.9, 0)))
    got = drawn(on_gl, floor(half), camera)
    origin, direction = syn.pixel_rays(camera, *SMALL)
    inside = np.abs(syn.meet_plane(origin, direction)[..., :2]).max(-1) < half
    shown = got[..., 3] > 0.5
    assert shown.mean() > 0.3
    assert off_centre(got, camera).max() < TOLERANCE
    rim = near_edge(inside)
    assert not (shown & ~inside & ~rim).any()
    missing = inside & ~shown & ~rim
    if name == "barrel":  # its reach ends in the picture's corners
        off_axis = np.arccos(np.clip(direction @ camera.forward, -1, 1))
        missing &= off_axis < np.arctan(camera.lens.reach) - 2 * lens_mesh.LEAST_BORDER
    assert not missing.any()


@pytest.mark.parametrize("corner", [(0, 0), (5760, 0), (0, 3840), (5760, 3840)])
def test_the_corners_of_a_whole_picture(on_gl, corner):
    """Of 24 million pixels."""
    camera = syn.through(WIDE, syn.camera((0.2, -1.0, 1.5), (0.1, 0.3, 0)))
    part = cropped(camera, 6000, 4000, Crop(*corner, 240, 160))
    got = drawn(on_gl, floor(30.0), part, (240, 160))
    assert (got[..., 3] > 0.5).all()
    assert off_centre(got, part).max() < TOLERANCE
    assert not lens_mesh.divided(floor(30.0).astype(np.float32), part, (240, 160)).whole


def test_a_portrait_picture_too(on_gl):
    lens = replace(WIDE, width=4000, height=6000, cx=1973.4, cy=3024.9)
    camera = syn.through(lens, syn.camera((0.2, -1.0, 1.5), (0.1, 0.3, 0)))
    got = drawn(on_gl, floor(9.0), camera, (400, 600))
    assert (got[..., 3] > 0.5).all()
    assert off_centre(got, camera).max() < TOLERANCE


def test_a_fisheye_looks_sideways(on_gl):
    """A room around a camera that shows 115 degrees off its axis; no wall is missing, however near."""
    lens = Lens(450, 300, fx=135.0, fy=135.0, cx=227.5, cy=148.0, radial=(-0.005, 0.0, 0.0, 0.0), fisheye=True)
    camera = syn.through(lens, syn.camera((0.2, -1.0, 1.5), (0.1, 0.3, 1.2)))
    got = drawn(on_gl, syn.box((-4, -5, -1), (5, 4, 3)), camera)
    assert (got[..., 3] > 0.5).all()
    local = (got[..., :3] - camera.position) @ camera.forward
    assert (local < 0).sum() > 1000  # behind the camera's plane
    assert off_centre(got, camera).max() < TOLERANCE


@pytest.mark.parametrize("name", ["24 mm", "fisheye"])
def test_what_is_in_front_hides_what_is_behind(on_gl, name):
    """A box and a wall behind the camera, in coarse triangles, against rays; and the same surface twice."""
    camera = syn.through(LENSES[name], syn.camera((0.2, -1.0, 1.5), (0.1, 0.9, 0)))
    low, high = (-0.5, 0.2, 0.2), (0.6, 0.8, 0.5)
    wall = syn.quad([(-9, -1.2, -3), (9, -1.2, -3), (9, -1.2, 9), (-9, -1.2, 9)])
    plain = drawn(on_gl, floor(30.0), camera)
    got = drawn(on_gl, floor(30.0), camera, occluders=np.concatenate([syn.box(low, high), wall]))
    origin, direction = syn.pixel_rays(camera, *SMALL)
    hidden = syn.box_blocks(origin, 1000 * direction, low, high)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (-1.2 - origin[..., 1]) / direction[..., 1]
    behind = (t > 0) & (t < -origin[..., 2] / np.where(direction[..., 2] < 0, direction[..., 2], -1e-9))
    hidden |= behind & (np.abs((origin + t[..., None] * direction)[..., 0]) < 9) & (direction[..., 2] < 0)
    floor_seen = plain[..., 3] > 0.5
    wrong = floor_seen & ((got[..., 3] > 0.5) == hidden)
    assert (floor_seen & hidden).sum() > 5000
    edge = near_edge(hidden)
    assert not (wrong & ~edge).any()
    assert wrong.sum() < 0.05 * edge.sum()
    kept = floor_seen & (got[..., 3] > 0.5)
    np.testing.assert_array_equal(got[kept], plain[kept])


def test_triangles_of_all_sizes_leave_no_cracks(on_gl):
    """A square cut at random into slivers and large pieces that share their edges.

    What slivers thinner than OpenGL's snap show may lie anywhere on them: a pixel in a thousand.
    """
    rng = np.random.default_rng(4)
    triangles = list(floor(12.0))
    for _ in range(400):
        t = triangles.pop(int(rng.integers(len(triangles))) if rng.random() < 0.8 else 0)
        weights = rng.dirichlet((0.4, 0.4, 0.4))
        point = (weights @ t).astype(np.float32)
        triangles += [np.stack([t[0], t[1], point]), np.stack([t[1], t[2], point]), np.stack([t[2], t[0], point])]
    camera = syn.through(WIDE, syn.camera((0.2, -1.0, 1.5), (0.1, 0.3, 0)))
    got = drawn(on_gl, np.array(triangles), camera)
    assert (got[..., 3] > 0.5).all()
    assert np.quantile(off_centre(got, camera), 0.999) < TOLERANCE


def test_a_fine_mesh_is_drawn_as_it_is(on_gl):
    mesh = syn.plane_mesh()
    camera = syn.through(WIDE, syn.camera((0.2, -1.0, 6.5), (0.1, 0.3, 0)))
    assert lens_mesh.divided(mesh.positions, camera, SMALL).whole
    assert off_centre(drawn(on_gl, mesh.positions, camera), camera).max() < TOLERANCE


@pytest.mark.parametrize("name", LENSES)
@pytest.mark.parametrize("height", [0.3, 1.5, 6.5])
def test_bundles_that_are_left_as_they_are_change_nothing_that_is_seen(name, height):
    """Of a floor that is fine on one side and coarse on the other: the pieces are those without bundles."""
    x, y = np.meshgrid(np.r_[np.linspace(-3, 0.5, 60), 2.0, 5.0], np.linspace(-3, 3, 60))
    at = np.stack([x, y, 0 * x], -1)
    quads = np.stack([at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]], 2).reshape(-1, 4, 3)
    triangles = quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3).astype(np.float32)
    camera = syn.through(LENSES[name], syn.camera((0.2, -1.0, height), (0.1, 0.3, 0)))
    count = -(-len(triangles) // BUNDLE)
    unknown = Bundles(triangles, np.full((count, 3), -1e30), np.full((count, 3), 1e30))
    each = lens_mesh.divided(triangles, camera, SMALL, unknown)
    got = lens_mesh.divided(triangles, camera, SMALL)
    assert got.whole == each.whole
    assert (np.diff(got.parent) >= 0).all()
    wanted = {piece.tobytes() for piece in each.positions}
    more = [piece for piece in got.positions if piece.tobytes() not in wanted]
    assert len(got.positions) - len(more) == len(wanted)
    if more:  # what lies beside the picture is not looked for in bundles
        pixels = reprojected(camera, np.array(more).reshape(-1, 3), SMALL).reshape(-1, 3, 2)
        assert len(more) > 10
        assert ((pixels.max(axis=1) < 0) | (pixels.min(axis=1) > np.array(SMALL))).any(axis=1).all()


def test_values_at_corners_go_with_the_pieces():
    """UVs are linear in the place, and a piece's corners lie on the triangle that it is part of."""
    triangles = floor(5.0).astype(np.float32)
    camera = syn.through(WIDE, syn.camera((0.2, -1.0, 1.5), (0.1, 0.3, 0)))
    division = lens_mesh.divided(triangles, camera, SMALL)
    assert not division.whole
    assert len(division.parent) > 1000
    assert (np.diff(division.parent) >= 0).all()
    np.testing.assert_allclose(division.divided(triangles), division.positions, atol=1e-5)
    normal = np.cross(*(division.positions[:, k] - division.positions[:, 0] for k in (1, 2)))
    assert (normal[:, 2] > 0).all()  # turned as they were


def test_pieces_are_bounded(monkeypatch):
    monkeypatch.setattr(lens_mesh, "MOST", 3000)
    camera = syn.through(replace(WIDE, radial=(-0.3, 0.4, 0.0, 0.0)), syn.camera((0.2, -1.0, 1.5), (0.1, 0.3, 0)))
    layers = np.concatenate([floor(40.0) + np.array([0, 0, 0.01 * k]) for k in range(20)]).astype(np.float32)
    assert len(lens_mesh.divided(layers, camera, (6000, 4000)).parent) < 4 * 3000


def test_nothing_to_draw(on_gl):
    """Behind the camera, at its eye, and not finite."""
    camera = syn.through(WIDE, syn.camera((0, 0, 2.0), (0, 0, 9)))
    assert not drawn(on_gl, floor(3.0), camera)[..., 3].any()
    eye = np.array([[camera.position] * 3, [camera.position, (0, 0, 1), (1, 0, 1)], [(np.nan, 0, 5)] * 3])
    assert not len(lens_mesh.divided(eye.astype(np.float32), camera, SMALL).parent)


# ---- parts, registration, outlines, indirect light


@pytest.mark.parametrize("name", ["24 mm", "fisheye"])
def test_a_part_of_a_picture_shows_what_the_whole_does_there(on_gl, name):
    camera = syn.through(LENSES[name], syn.camera((0.2, -1.0, 1.5), (0.1, 0.3, 0)))
    crop = Crop(255, 20, 120, 100)
    whole = drawn(on_gl, floor(9.0), camera)[20:120, 255:375]
    part = drawn(on_gl, floor(9.0), cropped(camera, *SMALL, crop), (120, 100))
    assert (part[..., 3] > 0.5).all()
    step = np.linalg.norm(np.diff(whole[..., :3], axis=1), axis=-1)[:, :1]
    assert (np.linalg.norm(part - whole, axis=-1)[:, 1:] < 2 * TOLERANCE * 3 * step.max()).all()
    offset = np.array([crop.x, crop.y])
    points = whole[..., :3].reshape(-1, 3).astype(np.float64)
    np.testing.assert_allclose(pixels_of(cropped(camera, *SMALL, crop), points, (120, 100)) + offset,
                               pixels_of(camera, points, SMALL), atol=1e-8)


def test_registration_moves_the_principal_point():
    camera = syn.through(WIDE, syn.camera((0.2, -1.0, 1.5), (0.1, 0.3, 0)))
    points = np.random.default_rng(1).uniform(-0.6, 0.6, (50, 3)) * (1, 1, 0)
    shift = 0.7, -0.4
    beside = moved(camera, shift, SMALL)
    np.testing.assert_allclose(pixels_of(beside, points, SMALL), pixels_of(camera, points, SMALL) + np.array(shift),
                               atol=1e-9)
    straight = replace(camera, lens=None)  # the matrix goes along
    np.testing.assert_allclose(beside.projection[:2], moved(straight, shift, SMALL).projection[:2], atol=1e-12)


def test_the_outline_is_the_lenss(on_gl):
    """Shares of pixels that a square covers, against float64 rays on a grid of 8 x 8 in each."""
    camera, size, half = syn.through(WIDE, syn.camera((0.2, -1.0, 1.5), (0.1, 0.3, 0))), (120, 80), 0.7

    def draw(device):
        with device.scope():
            outline = DrawnOutline(device, MeshBuffer(device, syn.mesh_arrays(floor(half))), NOTHING, 1.0)
            return outline.shares(camera, size, (0, 0, *size))

    points = syn.meet_plane(*syn.pixel_rays(camera, 8 * size[0], 8 * size[1]))
    want = (np.abs(points[..., :2]).max(-1) < half).reshape(size[1], 8, size[0], 8).mean((1, 3))
    got = on_gl(draw)
    assert ((want > 0) & (want < 1)).sum() > 100
    assert np.abs(got - want).max() <= 0.3  # steps of a quarter
    assert abs((got - want)[(want > 0) & (want < 1)].mean()) < 0.01


def test_indirect_light_is_looked_up_through_the_pinhole_that_rendered_it(on_gl):
    """Light that grows with the world's x, in a picture of the camera without its lens."""
    lens = replace(WIDE, radial=(0.12, 0.0, 0.0, 0.0))  # shows less than the pinhole
    camera, small, size = syn.through(lens, syn.camera((0.2, -1.0, 1.5), (0.1, 0.3, 0))), (48, 32), (150, 100)
    x = syn.meet_plane(*syn.pixel_rays(replace(camera, lens=None), *small))[..., :1]
    light = np.repeat(2 + x, 3, -1).astype(np.float32)

    def draw(device):
        with device.scope():
            mesh, nothing = MeshBuffer(device, syn.mesh_arrays(floor(9.0))), Occluders(device, NOTHING)
            maps = draw_pixel_grid(device, mesh, nothing, camera, size, 0.0)
            smoother = Smoother(device, mesh, nothing, camera, maps, lambda c, h: camera_uniforms(c, h, 0.0))
            return device.read(smoother.smooth(Bounced(light, light))[0]).copy(), device.read(maps.position).copy()

    got, position = on_gl(draw)
    inner = slice(20, 80), slice(30, 120)
    np.testing.assert_allclose(got[inner][..., 0], 2 + position[inner][..., 0], atol=0.03)


# ---- a solve


def pictures(bent: bool) -> syn.Shoot:
    """Three cameras near the plane, one of them portrait, with six lamps each; noise of 2 %."""
    sizes, cams = ((120, 80), (80, 120), (120, 80)), []
    for cam, (w, h) in zip(syn.cameras(3), sizes, strict=True):
        lens = Lens(w, h, fx=88.0, fy=87.9, cx=0.507 * w, cy=0.49 * h)
        if bent:
            lens = replace(lens, radial=(-0.12, 0.09, -0.03, 0.004), tangential=(6e-4, -3.5e-4), skew=0.1)
        near = syn.through(lens, syn.camera(0.55 * cam.position, name=cam.name))
        cams.append(near if bent else replace(near, lens=None))
    rng, views, images = np.random.default_rng(5), [], {}
    for cam, (w, h) in zip(cams, sizes, strict=True):
        for lamp in syn.lamps(6):
            view = View(syn.Path(f"view_{len(views):02d}.exr"), cam, (lamp,))
            picture = syn.image_of(syn.PATCHES, view, w, h, 3)
            noisy = picture.rgb * (1 + 0.02 * rng.standard_normal((h, w, 1)))
            images[view.image.name] = replace(picture, rgb=noisy.astype(np.float32))
            views.append(view)
    return syn.Shoot(SceneData("synthetic", syn.plane_mesh(), NOTHING, tuple(views)), images, syn.PATCHES)


@pytest.mark.one_python
def test_a_solve_through_lenses_is_as_good_as_one_without():
    """Within 5 % of the roughness' error and .3 dB of the base colour's."""
    found = {bent: shoots.run(pictures(bent)) for bent in (False, True)}
    off = {bent: shoots.errors(solution, syn.PATCHES) for bent, solution in found.items()}
    assert off[True].share > 0.95
    assert found[True].model == {"Paint": "one-lobe"}
    assert not found[True].warnings
    for typical in (np.median, np.mean):
        assert typical(off[True].rough) < 1.05 * typical(off[False].rough)
    decibels = [-10 * np.log10((off[bent].base ** 2).mean()) for bent in (False, True)]
    assert decibels[1] > decibels[0] - 0.3
    assert max(np.hypot(*m.shift) for m in found[True].checks.registration) < 0.05
