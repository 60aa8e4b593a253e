"""What light reaches which pixel, against rays cast in float64 and penumbrae in closed form.

The finest shadow map's texel is some 2 mm here and a pixel some 25 mm: only pixels on an edge may differ.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.data import Camera, Light, MeshArrays
from irpso_addon.gpu.gbuffer.gbuffer import MeshBuffer, Occluders, draw_pixel_grid
from irpso_addon.gpu.observe.shadow_sheet import COLUMNS, draw_sheet
from irpso_addon.gpu.observe.visibility import LightVisibility, parallel_frustum, shadow_points
from tests.support import synthetic as syn

PIXELS = 96
NOTHING = np.zeros((0, 3, 3))
FLOOR = syn.quad([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
LOW, HIGH = (-0.35, -0.25, 0.0), (0.15, 0.2, 0.4)
SLANTED = syn.camera((0.9, -1.9, 3.6), degrees=36)


def lit_maps(on_gl, mesh: MeshArrays, light: Light, cameras: list[Camera], occluders: np.ndarray = NOTHING,
             pixels: int = PIXELS, subject: float = np.inf) -> list[np.ndarray]:
    """(h, w, 4) for each camera: world position, and the light's share that arrives; NaN where nothing is seen.

    ``subject``: the object's diameter in pixels, that shadow maps are as fine for; inf: as fine as they get.
    """

    def draw(device):
        with device.scope():
            buffer, others = MeshBuffer(device, mesh), Occluders(device, np.asarray(occluders, np.float32))
            grids = [draw_pixel_grid(device, buffer, others, camera, (pixels, pixels), 0.0) for camera in cameras]
            visibility = LightVisibility(device, buffer, others)
            *_, found = visibility.lit_maps(light, grids, subject)
            result = []
            for grid, texture in zip(grids, found, strict=True):
                kind = {"f2": np.float16, "f4": np.float32}[texture.dtype]
                lit = np.frombuffer(texture.read(alignment=1), kind).reshape(pixels, pixels).astype(float)
                position = device.read(grid.position).astype(float)
                shown = position[..., 3] > 0.5
                position[..., 3] = lit
                result.append(np.where(shown[..., None], position, np.nan))
            return result

    return on_gl(draw)


def near_edge(mask: np.ndarray, reach: int = 1) -> np.ndarray:
    """Pixels within ``reach`` of a change of the mask."""
    h, w = mask.shape
    padded = np.pad(mask, reach, mode="edge")
    shifts = [padded[y:y + h, x:x + w] for y in range(2 * reach + 1) for x in range(2 * reach + 1)]
    return np.any(shifts, axis=0) & ~np.all(shifts, axis=0)


LAMPS = {
    "point": syn.lamp((1.6, 0.9, 2.0)),
    "point, far away": syn.lamp((210.0, 130.0, 270.0)),
    "point, inside the bounding sphere": syn.lamp((0.45, -0.55, 0.7)),
    "point, on the sphere": syn.lamp((0.9, 0.2, 1.15)),
    "spot": syn.lamp((-1.2, -0.9, 2.2), kind="SPOT", spot_angle=2.0),
    "small area lamp": syn.lamp((0.2, -1.9, 2.0), kind="AREA", size=(0.01, 0.01)),
    "sun": syn.lamp((0.9, 0.5, 1.1), kind="SUN"),
    "low sun": syn.lamp((-1.0, 0.3, 0.35), kind="SUN"),
}


@pytest.mark.parametrize("subject", [np.inf, PIXELS], ids=["finest", "as the picture"])
@pytest.mark.parametrize("own", [True, False], ids=["own shadow", "of another object"])
@pytest.mark.parametrize("name", LAMPS)
def test_a_box_shadows_the_floor(on_gl, name, own, subject):
    """The box stands on the floor, as part of the mesh or as another object."""
    light, block = LAMPS[name], syn.box(LOW, HIGH)
    mesh = syn.mesh_arrays(np.concatenate([FLOOR, block]) if own else FLOOR)
    got = lit_maps(on_gl, mesh, light, [SLANTED], NOTHING if own else block, subject=subject)[0]
    floor = np.isfinite(got[..., 3]) & (np.abs(got[..., 2]) < 1e-4)
    toward = light.matrix[:3, 2] * 100 if light.kind == "SUN" else light.matrix[:3, 3] - got[..., :3]
    blocked = syn.box_blocks(np.nan_to_num(got[..., :3]) + np.array([0, 0, 1e-6]), np.nan_to_num(toward), LOW, HIGH)
    wrong = floor & (np.abs(got[..., 3] - ~blocked) > 0.02)
    assert (floor & blocked).sum() > 150
    assert (floor & ~blocked).sum() > 1500
    # The foot of the box hides the floor: there a pixel's neighbour is no floor.
    assert not (wrong & ~near_edge(blocked) & ~near_edge(floor)).any()
    assert wrong.sum() < 0.25 * near_edge(blocked & floor).sum()
    assert got[..., 3][floor].min() >= 0
    assert got[..., 3][floor].max() <= 1.001


def test_the_lit_sides_of_the_box_are_lit_and_the_others_dark(on_gl):
    """No speckle on faces that the light strikes at up to 80 degrees."""
    light = syn.lamp((1.4, -0.8, 2.6))
    got = lit_maps(on_gl, syn.mesh_arrays(np.concatenate([FLOOR, syn.box(LOW, HIGH)])), light, [SLANTED])[0]
    on_top = np.isfinite(got[..., 3]) & (np.abs(got[..., 2] - HIGH[2]) < 1e-4)
    on_side = np.isfinite(got[..., 3]) & (np.abs(got[..., 1] - LOW[1]) < 1e-4) & (got[..., 2] > 0.02)
    assert on_top.sum() > 100
    assert on_side.sum() > 50
    assert (got[..., 3][on_top & ~near_edge(on_top)] == 1).all()
    assert (got[..., 3][on_side & ~near_edge(on_side)] == 1).all()
    other = lit_maps(on_gl, syn.mesh_arrays(np.concatenate([FLOOR, syn.box(LOW, HIGH)])), syn.lamp((-1.0, 2.5, 1.5)),
                     [SLANTED])[0]
    assert (other[..., 3][on_side & ~near_edge(on_side)] == 0).all()


@pytest.mark.parametrize("height", [0.3, 0.5, 0.9])
def test_the_six_maps_of_a_lamp_inside_meet_without_seam(on_gl, height):
    """Every pixel of an empty floor belongs to one map exactly, those on the diagonals too."""
    for camera in (syn.camera((0, 0, 4), width=2.2), SLANTED):
        got = lit_maps(on_gl, syn.mesh_arrays(FLOOR), syn.lamp((0, 0, height)), [camera])[0]
        shown = np.isfinite(got[..., 3])
        assert shown.sum() > 2000
        np.testing.assert_array_equal(got[..., 3][shown], 1)


@pytest.mark.parametrize("name", ["point", "point, inside the bounding sphere", "sun"])
@pytest.mark.parametrize("segments", [16, 48])
def test_smooth_spheres_do_not_shadow_themselves(on_gl, name, segments):
    """Low-poly ones too: far beyond where a facet turns from the light, the smooth surface is lit, as in Cycles."""
    positions, normals = syn.sphere(segments, segments // 2, radius=0.9)
    light = LAMPS[name]
    if "inside" in name:  # between the sphere and its bounding sphere there is no room: lift it above the pole
        light = syn.lamp((0.2, -0.3, 1.0))
    mesh = syn.mesh_arrays(positions, normals)
    got = lit_maps(on_gl, mesh, light, [SLANTED])[0]
    shown = np.isfinite(got[..., 3])
    n = got[..., :3] / np.linalg.norm(got[..., :3], axis=-1, keepdims=True)
    toward = light.matrix[:3, 2] if light.kind == "SUN" else light.matrix[:3, 3] - got[..., :3]
    cosine = (n * toward).sum(-1) / np.linalg.norm(toward, axis=-1)
    faces = shown & (cosine > np.cos(np.radians(86)))
    assert faces.sum() > 100
    assert (got[..., 3][faces] > 0.99).mean() > 0.999


@pytest.mark.parametrize(
    "light", [syn.lamp((1.0, 0.2, 0.7), kind="SUN"), syn.lamp((2.4, 0.4, 1.5))], ids=["sun", "lamp"])
def test_the_rim_of_a_trough_of_few_facets_shadows_it(on_gl, light):
    """What is lifted off the facets of a hollow would see light past the rim that its surface does not see."""
    got = lit_maps(on_gl, syn.mesh_arrays(*syn.trough(5, 0.8, 0.9)), light, [syn.camera((0, -1.2, 2.6), degrees=26)])[0]
    shown = np.isfinite(got[..., 3]) & (np.abs(got[..., 1]) < 0.4) & (got[..., 2] < -1e-3)
    place = np.nan_to_num(got[..., :3])
    toward = light.matrix[:3, 2] * 100 if light.kind == "SUN" else light.matrix[:3, 3] - place
    facing = -(place * np.array([1, 0, 1]) * toward).sum(-1) / np.linalg.norm(toward, axis=-1)
    shown &= facing > 0.8 * 0.35  # the facets do, too
    past = (place - toward * (place[..., 2] / np.broadcast_to(toward, place.shape)[..., 2])[..., None])[..., 0] > 0.8
    wrong = shown & (np.abs(got[..., 3] - ~past) > 0.5)
    assert (shown & past).sum() > 500 and (shown & ~past).sum() > 500
    assert not (wrong & ~near_edge(past)).any()  # 128 of the sun's where points are lifted as on a hump


def test_what_stands_near_the_lamp_or_behind_it(on_gl):
    """A small plate close under the lamp shadows all the floor, one above it nothing; so for the sun from far away."""
    mesh = syn.mesh_arrays(FLOOR)
    lamp = syn.lamp((0.1, 0.2, 3.0))
    under = syn.box((-0.5, -0.4, 2.6), (0.7, 0.8, 2.7))
    above = syn.box((-0.5, -0.4, 3.2), (0.7, 0.8, 3.3))
    camera = syn.camera((0, -2.5, 2.0), degrees=40)
    dark = lit_maps(on_gl, mesh, lamp, [camera], under)[0][..., 3]
    light = lit_maps(on_gl, mesh, lamp, [camera], above)[0][..., 3]
    shown = np.isfinite(dark)
    assert shown.sum() > 1000
    assert not dark[shown].any()
    assert (light[shown] == 1).all()
    sun = syn.lamp((0, 0, 1), kind="SUN")
    plate = syn.box((-2, -2, 80), (0, 2, 81))
    half = lit_maps(on_gl, mesh, sun, [syn.camera((0, 0, 4), width=2.2)], plate)[0]
    shown = np.isfinite(half[..., 3]) & (np.abs(half[..., 0]) > 0.03)
    np.testing.assert_array_equal(half[..., 3][shown], half[..., 0][shown] > 0)


def test_a_lamp_without_shadow_lights_all(on_gl):
    mesh = syn.mesh_arrays(np.concatenate([FLOOR, syn.box(LOW, HIGH)]))
    got = lit_maps(on_gl, mesh, replace(LAMPS["point"], cast_shadow=False), [SLANTED])[0][..., 3]
    assert (got[np.isfinite(got)] == 1).all()


def test_several_cameras_share_a_shadow_map(on_gl):
    mesh = syn.mesh_arrays(np.concatenate([FLOOR, syn.box(LOW, HIGH)]))
    other = syn.camera((-1.5, 1.0, 3.0), degrees=40)
    both = lit_maps(on_gl, mesh, LAMPS["point"], [SLANTED, other])
    for got, camera in zip(both, (SLANTED, other), strict=True):
        np.testing.assert_array_equal(got, lit_maps(on_gl, mesh, LAMPS["point"], [camera])[0])


@pytest.mark.parametrize(("degrees", "pixels", "count"), [
    (0.0, 512, 1), (0.1, 512, 1), (0.265, 512, 4), (0.265, 3000, 8), (3.0, 512, 16), (3.0, np.inf, 16)])
def test_a_sun_takes_as_many_points_as_its_penumbra_shows(degrees: float, pixels: float, count: int) -> None:
    sun = syn.lamp((0, 0, 1), kind="SUN", radius=float(np.radians(degrees)))
    points = np.array(shadow_points(sun, np.zeros(3), pixels)[0])
    assert len(points) == count
    assert np.degrees(np.arccos(points[:, 2] / np.linalg.norm(points[:, :3], axis=1))).max() <= degrees + 1e-9


# ---- penumbrae: a half plane x < 0 at height 1 over the floor

SCREEN = syn.quad([(-3, -3, 1), (0, -3, 1), (0, 3, 1), (-3, 3, 1)])


def disc_share(t: np.ndarray) -> np.ndarray:
    """Share of a unit disc that lies on the side x > -t of a line."""
    t = np.clip(t, -1, 1)
    return np.asarray(0.5 + (t * np.sqrt(1 - t * t) + np.arcsin(t)) / np.pi)


def square_share(t: np.ndarray) -> np.ndarray:
    return np.clip(0.5 + 0.5 * t, 0, 1)


SOFT = {
    # name: lamp above x = 0, half width of the penumbra on the floor, share by x / half width
    "square lamp": (syn.lamp((0, 0, 3), kind="AREA", size=(0.6, 0.6)), 0.15, square_share),
    "disk lamp": (syn.lamp((0, 0, 3), kind="AREA", shape="DISK", size=(0.6, 0.6)), 0.15, disc_share),
    "point with radius": (syn.lamp((0, 0, 3), radius=0.3), 0.15, disc_share),
    "wide sun": (syn.lamp((0, 0, 1), kind="SUN", radius=np.radians(12)), np.tan(np.radians(12)), disc_share),
}


@pytest.mark.parametrize("subject", [np.inf, PIXELS], ids=["finest", "as the picture"])
@pytest.mark.parametrize("name", SOFT)
def test_penumbra_is_the_visible_share_of_the_emitter(on_gl, name, subject):
    """Sixteen points on the emitter, or eight: shares are a sixteenth off, two if the lattice lies along the edge."""
    light, half, share = SOFT[name]
    mesh = syn.mesh_arrays(FLOOR)
    camera = syn.camera((0, -2.2, 0.9), (0, 0, 0), degrees=30)  # below the screen's edge, where the floor shows
    got = lit_maps(on_gl, mesh, light, [camera], SCREEN, subject=subject)[0]
    near = np.isfinite(got[..., 3]) & (np.abs(got[..., 1]) < 0.5)
    expected = share(got[..., 0] / half)
    soft = near & (np.abs(got[..., 0]) < half)
    assert soft.sum() > 300
    error = got[..., 3] - expected
    assert np.abs(error[near]).max() < 0.16
    assert np.abs(error[soft]).mean() < 0.05
    assert abs(error[soft].mean()) < 0.03
    assert (got[..., 3][near & (got[..., 0] > 1.25 * half)] > 0.999).all()
    assert (got[..., 3][near & (got[..., 0] < -1.25 * half)] < 0.001).all()


BOX = syn.box(LOW, HIGH)
SIDES = np.array([(0.3, 0.5, 0.8), (-0.2, 0.4, -0.9), (0.9, -0.1, -0.2), (0.0, 0.0, -1.0), (-0.6, -0.7, 0.3)])


def hit_depth(triangles: np.ndarray, origins: np.ndarray, forward: np.ndarray) -> np.ndarray:
    """(N,) metres along (3,) a direction to the first of (T, 3, 3) triangles, whichever way it faces; inf: none."""
    nearest = np.full(len(origins), np.inf)
    for a, b, c in triangles.astype(np.float64):  # Moeller and Trumbore 1997
        across = np.cross(forward, c - a)
        determinant = across @ (b - a)
        if abs(determinant) < 1e-9:
            continue
        u = (origins - a) @ across / determinant
        along = np.cross(origins - a, b - a)
        v, t = along @ forward / determinant, along @ (c - a) / determinant
        nearest = np.where((u >= 0) & (v >= 0) & (u + v <= 1), np.minimum(nearest, t), nearest)
    return nearest


@pytest.mark.parametrize(("triangles", "closed"), [
    (BOX, True), (np.concatenate([BOX, syn.box((0.0, 0.1, 0.2), (0.5, 0.5, 0.6))]), True), (BOX[:, ::-1], False),
    (BOX[np.abs(BOX[..., 2]).max(1) > 1e-6], False), (np.concatenate([BOX, FLOOR]), False),
], ids=["a box", "two that meet", "inside out", "without its bottom", "on a floor"])
def test_maps_of_a_world_have_what_is_nearest(on_gl, triangles, closed):
    """Whether or not backs of triangles can be left out of them."""
    mesh, side = syn.mesh_arrays(triangles), 64

    def draw(device):
        with device.scope():
            visibility = LightVisibility(device, MeshBuffer(device, mesh), Occluders(device, NOTHING), 1)
            maps = [parallel_frustum(toward, visibility.center, visibility.radius, visibility.bounds, side)
                    for toward in SIDES]
            sheet = draw_sheet(device, visibility, maps, side, visibility.is_closed).read(alignment=1)
            return visibility.is_closed, visibility.center, maps, np.frombuffer(sheet, np.float16)

    found, center, maps, sheet = on_gl(draw)
    assert found == closed
    sheet = sheet.reshape(COLUMNS * side, COLUMNS * side).astype(float)
    for n, frustum in enumerate(maps):
        got = sheet[:side, n * side:(n + 1) * side]
        plane = np.array(frustum.plane)
        at = 2 * (np.arange(side) + 0.5) / side - 1
        x, y = np.meshgrid(at, at)
        rows = frustum.clip[:2, :3]  # orthogonal: a row over its square is a place's share
        from_center = np.stack([x, y], -1).reshape(-1, 2) - (rows @ center + frustum.clip[:2, 3])
        origins = center + from_center @ (rows / (rows**2).sum(1, keepdims=True)) - 10 * plane[:3]
        wanted = hit_depth(triangles, origins, plane[:3]).reshape(side, side) + (
            origins @ plane[:3] + plane[3]).reshape(side, side)
        inner = ~near_edge(np.isfinite(wanted))
        assert (np.isfinite(wanted) & inner).sum() > 100
        same = np.where(np.isfinite(wanted), np.abs(got - wanted) < frustum.texel, got > 1e3)
        assert same[inner].mean() > 0.99  # edges between faces, and roundings of half floats
