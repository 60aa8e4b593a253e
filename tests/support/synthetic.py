"""A bumpy plane under cameras and lamps, and its exact images: float64, no OpenGL, no Blender.

The plane is flat in space, so rays meet it in closed form, but its corner normals roll: within a picture a texel is
seen and lit under many angles.  Its normal at a hit is interpolated over the very triangles that the mesh holds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from irpso_addon.core.data import Camera, Light, MeshArrays, RadianceImage, SceneData, View
from irpso_addon.core.lens import Lens
from irpso_addon.core.shading import brdf, lights
from irpso_addon.core.vectors import dot, length

CELLS = 24
MARGIN = 0.05  # of the UV square, left free around the island
BUMP = 0.22  # slope of the normals


# ---- meshes, cameras, lamps


def mesh_arrays(
    positions: np.ndarray, normals: np.ndarray | None = None, uvs: np.ndarray | None = None,
    slots: np.ndarray | None = None, slot_names: tuple[str, ...] = ("Paint",), name: str = "Subject", **more: object,
) -> MeshArrays:
    """Triangles (T, 3, 3) as the pipeline takes them; flat normals and no UVs unless given."""
    positions = np.asarray(positions, np.float32)
    if normals is None:
        flat = np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0])
        flat /= np.linalg.norm(flat, axis=1, keepdims=True)
        normals = np.repeat(flat[:, None], 3, axis=1)
    if uvs is None:
        uvs = np.zeros((*positions.shape[:2], 2))
    if slots is None:
        slots = np.zeros(len(positions), np.int32)
    return MeshArrays(name, positions, np.asarray(normals, np.float32), np.asarray(uvs, np.float32),
                      np.asarray(slots, np.int32), slot_names, **more)


def quad(corners: Sequence[Sequence[float]]) -> np.ndarray:
    """Two triangles (2, 3, 3) from four corners, anticlockwise."""
    c = np.asarray(corners, np.float64)
    return c[[[0, 1, 2], [0, 2, 3]]]


def box(low: Sequence[float], high: Sequence[float]) -> np.ndarray:
    """The twelve triangles of an upright box."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    c = [(x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z0), (x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1)]
    sides = [(3, 2, 1, 0), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    return np.concatenate([quad([c[i] for i in side]) for side in sides])


def sphere(segments: int, rings: int, radius: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Positions and exact normals (T, 3, 3) of a sphere about the origin."""
    theta = np.linspace(0, np.pi, rings + 1)[:, None]
    phi = np.linspace(0, 2 * np.pi, segments + 1)[None]
    n = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi], -1)
    a, b, c, d = n[:-1, :-1], n[1:, :-1], n[1:, 1:], n[:-1, 1:]
    triangles = np.concatenate([np.stack([a, b, c], 2).reshape(-1, 3, 3), np.stack([a, c, d], 2).reshape(-1, 3, 3)])
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    triangles = triangles[area > 1e-9]
    return radius * triangles, triangles


def trough(facets: int, radius: float, half_length: float) -> tuple[np.ndarray, np.ndarray]:
    """(positions, normals) of the lower half of a cylinder about Y, seen from within, with the cylinder's normals."""
    angle = np.pi * np.arange(facets + 1) / facets
    rim = np.stack([-np.cos(angle), 0 * angle, -np.sin(angle)], -1)
    ends = np.array([0, half_length, 0])
    a, b, c, d = (radius * rim[:-1] - ends, radius * rim[1:] - ends, radius * rim[1:] + ends, radius * rim[:-1] + ends)
    positions = np.stack([np.stack(corners, 1) for corners in ((a, b, c), (a, c, d))], 1).reshape(-1, 3, 3)
    normals = -np.stack([np.stack([rim[i], rim[j], rim[k]], 1) for i, j, k in (
        (slice(None, -1), slice(1, None), slice(1, None)), (slice(None, -1), slice(1, None), slice(None, -1)))], 1)
    return positions, normals.reshape(-1, 3, 3)


def camera(
    position: Sequence[float], target: Sequence[float] = (0, 0, 0), *, degrees: float = 30.0,
    width: float | None = None, aspect: float = 1.0, shift: tuple[float, float] = (0.0, 0.0), name: str = "camera",
) -> Camera:
    """A camera that looks at ``target``; orthographic where ``width`` (metres) is given.  ``shift``: in half images."""
    place = np.asarray(position, np.float64)
    forward = np.asarray(target, np.float64) - place
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0, 0, 1) if abs(forward[2]) < 0.99 else (0, 1, 0))
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(right, forward), -forward])
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3], world_to_camera[:3, 3] = rotation, -rotation @ place
    projection = np.zeros((4, 4))
    if width is None:
        projection[0, 0] = 1 / np.tan(np.radians(degrees) / 2)
        projection[0, 2], projection[1, 2], projection[3, 2] = shift[0], shift[1], -1
    else:
        projection[0, 0] = 2 / width
        projection[0, 3], projection[1, 3], projection[3, 3] = -shift[0], -shift[1], 1
    projection[1, 1] = projection[0, 0] * aspect
    projection[2] = 0, 0, -1.0002, -0.20002  # 0.1 m to 1 km, as Blender's own; replaced when drawn
    return Camera(name, world_to_camera, projection, place, forward, width is not None, aspect)


def through(lens: Lens, cam: Camera) -> Camera:
    """The camera with this lens."""
    return replace(cam, lens=lens, projection=lens.matrix, aspect=lens.width / lens.height)


def lamp(
    position: Sequence[float], target: Sequence[float] = (0, 0, 0), *, kind: str = "POINT", name: str = "lamp",
    power: float | Sequence[float] = 100.0, **settings: object,
) -> Light:
    """A lamp that shines at ``target``."""
    place = np.asarray(position, np.float64)
    back = place - np.asarray(target, np.float64)
    back /= np.linalg.norm(back)
    right = np.cross((0, 0, 1) if abs(back[2]) < 0.99 else (0, 1, 0), back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = np.stack([right, np.cross(back, right), back], 1), place
    return Light(name, kind, np.broadcast_to(np.asarray(power, np.float64), 3).copy(), matrix, **settings)


# ---- rays


def pixel_rays(cam: Camera, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Origins and unit directions (h, w, 3) through the pixels' centres; row 0 is the bottom."""
    if cam.lens is not None:
        u, v = np.meshgrid((np.arange(width) + 0.5) / width, 1 - (np.arange(height) + 0.5) / height)
        local = cam.lens.rays(np.stack([u * cam.lens.width, v * cam.lens.height], -1)) * (1, -1, -1)
        direction = local @ cam.world_to_camera[:3, :3]
        return np.broadcast_to(cam.position, direction.shape).copy(), direction
    ndc_x = (np.arange(width) + 0.5) / width * 2 - 1
    ndc_y = (np.arange(height) + 0.5) / height * 2 - 1
    x, y = np.meshgrid(ndc_x, ndc_y)
    p = cam.projection
    rotation = cam.world_to_camera[:3, :3].T
    flat = np.zeros_like(x)
    if cam.orthographic:
        start = np.stack([(x - p[0, 3]) / p[0, 0], (y - p[1, 3]) / p[1, 1], flat], -1)
        return cam.position + start @ rotation.T, np.broadcast_to(cam.forward, start.shape).copy()
    direction = np.stack([(x + p[0, 2]) / p[0, 0], (y + p[1, 2]) / p[1, 1], flat - 1], -1) @ rotation.T
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return np.broadcast_to(cam.position, direction.shape).copy(), direction


def meet_plane(origin: np.ndarray, direction: np.ndarray, z: float = 0.0) -> np.ndarray:
    """Where rays meet the level z; NaN where they don't."""
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (z - origin[..., 2]) / direction[..., 2]
        return np.where((t > 0)[..., None], origin + t[..., None] * direction, np.nan)


def box_blocks(origin: np.ndarray, toward: np.ndarray, low: Sequence[float], high: Sequence[float]) -> np.ndarray:
    """Does the segment from origin to origin + toward pass through the box (slabs)?"""
    with np.errstate(divide="ignore", invalid="ignore"):
        a = (np.asarray(low) - origin) / toward
        b = (np.asarray(high) - origin) / toward
    enter = np.nanmax(np.minimum(a, b), axis=-1)
    leave = np.nanmin(np.maximum(a, b), axis=-1)
    return (enter < leave) & (leave > 1e-9) & (enter < 1)


# ---- the bumpy plane


def bumpy_normal(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Normals whose slopes roll with x and y; not yet unit."""
    return np.stack([BUMP * np.sin(5.1 * x + 1.7 * y), BUMP * np.cos(4.3 * y - 2.1 * x), np.ones_like(x)], -1)


def _corner_normals() -> np.ndarray:
    """(CELLS + 1, CELLS + 1, 3) unit, as float32 holds them; [i, j] at x index i, y index j."""
    at = np.linspace(-1, 1, CELLS + 1)
    n = bumpy_normal(*np.meshgrid(at, at, indexing="ij"))
    return (n / np.linalg.norm(n, axis=-1, keepdims=True)).astype(np.float32)


def plane_mesh(slots: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
               slot_names: tuple[str, ...] = ("Paint",)) -> MeshArrays:
    """The plane: 2 m wide about the origin; ``slots``: material of a cell by its centre's (u, v)."""
    at = np.linspace(-1, 1, CELLS + 1)
    points = np.stack([*np.meshgrid(at, at, indexing="ij"), np.zeros((CELLS + 1, CELLS + 1))], -1)

    def triangles(grid: np.ndarray) -> np.ndarray:
        a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
        return np.stack([np.stack([a, b, c], 2), np.stack([a, c, d], 2)], 2).reshape(-1, 3, grid.shape[-1])

    positions = triangles(points)
    uvs = plane_uv(positions)
    centre = uvs.mean(axis=1)
    numbers = slots(centre[:, 0], centre[:, 1]).astype(np.int32) if slots else None
    return mesh_arrays(positions, triangles(_corner_normals()), uvs, numbers, slot_names)


def plane_uv(points: np.ndarray) -> np.ndarray:
    """UVs of points of the plane."""
    return np.asarray(MARGIN + (1 - 2 * MARGIN) * (points[..., :2] + 1) / 2)


def plane_normal(points: np.ndarray) -> np.ndarray:
    """The shading normal that the mesh has at points of the plane: corner normals interpolated over the triangle."""
    corner = _corner_normals().astype(np.float64)
    at = np.clip((points[..., :2] + 1) / 2 * CELLS, 0, CELLS - 1e-9)
    i, j = np.floor(at).astype(int)[..., 0], np.floor(at).astype(int)[..., 1]
    f = at - np.floor(at)
    fx, fy = f[..., :1], f[..., 1:]
    a, b, c, d = corner[i, j], corner[i + 1, j], corner[i + 1, j + 1], corner[i, j + 1]
    n = np.where(fy <= fx, a + fx * (b - a) + fy * (c - b), a + fx * (c - d) + fy * (d - a))
    return np.asarray(n / np.linalg.norm(n, axis=-1, keepdims=True))


@dataclass(frozen=True)
class Truth:
    """What the plane is made of: functions of (u, v)."""

    base: Callable[[np.ndarray, np.ndarray], np.ndarray]
    roughness: Callable[[np.ndarray, np.ndarray], np.ndarray]
    lobe: Callable[[np.ndarray, np.ndarray], np.ndarray] = field(default=lambda u, v: np.ones_like(u))
    # The BRDF, 1/sr, from base, roughness, L, V, N; where ``lobe`` is 0 it is base / pi.
    reflect: Callable[..., np.ndarray] = field(default=brdf.principled)


def quarters(values: Sequence[object]) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """A function of (u, v) that is constant on each quarter of the UV square."""
    table = np.asarray(values, np.float64)

    def look_up(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.asarray(table[(np.asarray(u) > 0.5).astype(int) + 2 * (np.asarray(v) > 0.5).astype(int)])

    return look_up


PATCHES = Truth(
    base=quarters([(0.6, 0.3, 0.1), (0.2, 0.5, 0.7), (0.8, 0.8, 0.8), (0.1, 0.12, 0.15)]),
    roughness=quarters([0.3, 0.45, 0.6, 0.4]),
)


LEVELS = 0.15, 0.8


def _by_brightness(base: np.ndarray, *others: np.ndarray) -> np.ndarray:
    return brdf.principled(base, *others, level=np.where(base.mean(-1) > 0.4, *LEVELS[::-1]))


VARIED = Truth(  # one roughness; the light parts have the larger of two Specular IOR Levels
    base=quarters([(0.6, 0.5, 0.4), (0.2, 0.3, 0.2), (0.7, 0.7, 0.7), (0.1, 0.12, 0.15)]),
    roughness=lambda u, v: np.full_like(np.asarray(u, np.float64), 0.4), reflect=_by_brightness)


def levels_of_varied(size: int) -> np.ndarray:
    """(size, size) Specular IOR Level of VARIED at texels."""
    at = (np.arange(size) + 0.5) / size
    return np.asarray(np.where(VARIED.base(*np.meshgrid(at, at)).mean(-1) > 0.4, *LEVELS[::-1]))


Box = tuple[Sequence[float], Sequence[float]]  # lowest and highest corner


def radiance(truth: Truth, points: np.ndarray, toward_viewer: np.ndarray, lamps: Sequence[Light],
             blocks: Sequence[Box] = (), emitter_points: int = 64) -> np.ndarray:
    """Radiance (..., 3) of points of the plane; a lamp with a size is a sum over points on it."""
    uv, normal = plane_uv(points), plane_normal(points)
    base, rough, lobe = (f(uv[..., 0], uv[..., 1]) for f in (truth.base, truth.roughness, truth.lobe))
    total = np.zeros(points.shape)
    for light in lamps:
        count = 1 if light.kind != "AREA" and light.radius == 0 else emitter_points
        for i in range(count):
            offset, weight = lights.light_sample(light, points, np.full(points.shape[:-1], i), count)
            L = offset / length(offset)[..., None]
            cosine = np.maximum(dot(L, normal), 0)
            for low, high in blocks:
                weight = weight * ~box_blocks(points, L * 100 if light.kind == "SUN" else offset, low, high)
            whole = truth.reflect(base, rough, L, toward_viewer, normal)
            f = np.where(lobe[..., None] > 0, whole, base / np.pi)
            total += (weight * cosine)[..., None] * light.power * f
    return total


def image_of(
    truth: Truth, view: View, width: int, height: int, samples: int = 1, blocks: Sequence[Box] = ()
) -> RadianceImage:
    """The exact picture: each pixel is the radiance at its centre, or the mean of samples x samples in its square."""
    origin, direction = pixel_rays(view.camera, samples * width, samples * height)
    points = meet_plane(origin, direction)
    seen = np.isfinite(points[..., 0]) & (np.abs(points[..., :2]) <= 1).all(-1)
    points = np.where(seen[..., None], points, 0.0)
    for low, high in blocks:
        seen &= ~box_blocks(origin, points - origin, low, high)
    rgb = np.where(seen[..., None], radiance(truth, points, -direction, view.lights, blocks), 0.0)
    share = np.add.reduceat(np.add.reduceat(seen, range(0, samples * height, samples), 0),
                            range(0, samples * width, samples), 1) if samples > 1 else seen.astype(int)
    mean = np.add.reduceat(np.add.reduceat(rgb, range(0, samples * height, samples), 0),
                           range(0, samples * width, samples), 1) if samples > 1 else rgb
    mean = mean / np.maximum(share, 1)[..., None]  # not premultiplied
    return RadianceImage(mean.astype(np.float32), (share / samples**2).astype(np.float32), np.ones(share.shape, bool))


@dataclass(frozen=True)
class Shoot:
    """A scene with its pictures, ready for pipeline.solve(scene, settings, read_image)."""

    scene: SceneData
    images: dict[str, RadianceImage]
    truth: Truth

    def read_image(self, view: View) -> RadianceImage:
        """In place of core.image.read_reference."""
        return self.images[view.image.name]


def cameras(count: int, **settings: object) -> list[Camera]:
    """Cameras in a ring above the plane, 25 to 35 degrees off its axis."""
    made = []
    for i in range(count):
        turn, tilt = 2.2 * i + 0.3, np.radians(25 + 10 * (i % 2))
        place = 4.4 * np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
        made.append(camera(place, name=f"Camera {i}", **settings))
    return made


def lamps(count: int, **settings: object) -> list[Light]:
    """Lamps above the plane on a spiral, 10 to 55 degrees off its axis."""
    made = []
    for i in range(count):
        turn, tilt = 2.39996 * i, np.radians(10 + 45 * (i + 0.5) / count)
        place = 3.1 * np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
        made.append(lamp(place, name=f"Light {i}", **settings))
    return made


def shoot(truth: Truth, rig: Sequence[tuple[Camera, Sequence[Light]]], pixels: tuple[int, int] = (72, 72), *,
          mesh: MeshArrays | None = None, noise: float = 0.0, samples: int = 1,
          blocks: Sequence[Box] = ()) -> Shoot:
    """Pictures of the plane, one per (camera, lamps).

    ``noise``: relative standard deviation, independent.  ``samples``: squared, of a pixel; 1 is its centre alone.
    ``blocks``: boxes in the way.
    """
    views, images = [], {}
    rng = np.random.default_rng(5)
    for n, (cam, lit_by) in enumerate(rig):
        view = View(Path(f"view_{n:02d}.exr"), cam, tuple(lit_by))
        picture = image_of(truth, view, *pixels, samples, blocks)
        if noise:
            rgb = picture.rgb * (1 + noise * rng.standard_normal(picture.rgb.shape[:2])[..., None])
            picture = RadianceImage(rgb.astype(np.float32), picture.coverage, picture.valid)
        views.append(view)
        images[view.image.name] = picture
    occluders = np.concatenate([np.zeros((0, 3, 3)), *(box(*block) for block in blocks)]).astype(np.float32)
    scene = SceneData("synthetic", mesh or plane_mesh(), occluders, tuple(views),
                      pixel_filter=1.0 if samples > 1 else 0.01)
    return Shoot(scene, images, truth)


def moved(original: Shoot, scale: float, turn: np.ndarray, offset: Sequence[float]) -> Shoot:
    """The same scene elsewhere, turned and of another size; power grows with area, so that the pictures stay."""
    shift = np.asarray(offset, np.float64)

    def place(points: np.ndarray) -> np.ndarray:
        return np.asarray(scale * (points @ turn.T) + shift)

    views = []
    for view in original.scene.views:
        cam = view.camera
        rotation = cam.world_to_camera[:3, :3] @ turn.T
        world_to_camera = np.eye(4)
        world_to_camera[:3, :3] = rotation
        world_to_camera[:3, 3] = -rotation @ place(cam.position)
        cam = replace(cam, world_to_camera=world_to_camera, position=place(cam.position), forward=turn @ cam.forward)
        moved_lamps = []
        for light in view.lights:
            matrix = np.eye(4)
            matrix[:3, :3], matrix[:3, 3] = turn @ light.matrix[:3, :3], place(light.matrix[:3, 3])
            moved_lamps.append(replace(light, matrix=matrix, power=light.power * scale**2))
        views.append(replace(view, camera=cam, lights=tuple(moved_lamps)))
    mesh = original.scene.mesh
    mesh = replace(mesh, positions=place(mesh.positions.astype(np.float64)).astype(np.float32),
                   normals=(mesh.normals.astype(np.float64) @ turn.T).astype(np.float32))
    return replace(original, scene=replace(original.scene, mesh=mesh, views=tuple(views)))
