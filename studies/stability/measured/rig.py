"""Sphere and cow under known lamps and cameras: texels with position and normal, and what a material shows there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from irpso_addon.core.data import F32, F64, Bool
from irpso_addon.core.shading import brdf

Reflectance = Callable[[F64, F64], F64]  # (L, V) in the normal's frame -> (..., 3)

NORMAL = np.array([0.0, 0.0, 1.0])
SPHERE_EDGE = np.radians(80)  # of the part that has texels, about +z
CONE = np.radians(65)  # half angle of the lamps'
DISTANCE = 4.0  # of the lamps, in radii
LEAST_COSINE = 0.1  # of light and view; what is more grazing is neither observed nor judged
CAMERAS = np.array([[0.6, 0.4, 5.0], [-2.4, -1.2, 4.2]])
HELD_OUT_CAMERA = np.array([1.4, -2.6, 4.0])
LAMPS = 12  # of each camera
HELD_OUT_LAMPS = 8
DEPTH_PIXELS, DEPTH_SAMPLES, DEPTH_SLACK = 160, 64, 0.04  # of the shadow maps; a triangle's points; radii


@dataclass(frozen=True)
class Surface:
    """Texels, (h, w, ...), of an object whose radius is about 1."""

    name: str
    position: F64
    normal: F64  # unit
    covered: Bool
    blockers: F64 | None = None  # (n, 3) points that cast shadows; None: convex


@dataclass(frozen=True)
class View:
    """One lamp and one camera, at every texel, (h, w)."""

    camera: int
    lamp: int
    L: F64  # (h, w, 3) unit, in the normal's frame (z)
    V: F64
    irradiance: F64
    seen: Bool  # lit and seen
    share: F64  # of the picture that a texel is: cos_v over squared distance


def sphere(size: int) -> Surface:
    """Equal areas on a disc (Lambert's projection)."""
    at = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(at, at)
    radius = np.hypot(x, y)
    polar = 2 * np.arcsin(np.minimum(radius, 1.0) * np.sin(SPHERE_EDGE / 2))
    flat = np.sin(polar) / np.maximum(radius, 1e-9)
    normal = np.stack([x * flat, y * flat, np.cos(polar)], -1)
    return Surface("sphere", normal, normal, radius < 1)


def cow(file: Path, size: int) -> Surface:
    """The mesh's texels by its UVs; +y is up and it looks down -z, so it is turned to show the cameras its side."""
    points, uvs, corners = _read_obj(file)
    points = points - (points.max(0) + points.min(0)) / 2
    points = points / np.linalg.norm(points, axis=1).max()
    turn = np.radians(60.0)
    points = points @ np.array([[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]])
    triangles = points[corners[..., 0]]
    face = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    smooth = np.zeros_like(points)
    for k in range(3):
        np.add.at(smooth, corners[:, k, 0], face)
    smooth = _unit(smooth)
    position, normal, covered = np.zeros((size, size, 3)), np.zeros((size, size, 3)), np.zeros((size, size), bool)
    normal[..., 2] = 1.0
    for corner in corners:
        at = uvs[corner[:, 1]] * size - 0.5
        x, y, share = _inside(at, size)
        position[y, x] = share @ points[corner[:, 0]]
        normal[y, x] = _unit(share @ smooth[corner[:, 0]])
        covered[y, x] = True
    rng = np.random.default_rng(0)
    share = rng.dirichlet(np.ones(3), (len(triangles), DEPTH_SAMPLES))
    return Surface("cow", position, normal, covered, (share @ triangles).reshape(-1, 3))


def views(surface: Surface, cameras: F64, lamps: F64) -> list[View]:
    """Every lamp at every camera, camera by camera."""
    frame = _frame(surface.normal)
    made = []
    shadows = [_visible(surface, lamp) for lamp in lamps]
    for number, camera in enumerate(cameras):
        away = camera - surface.position
        V = np.einsum("...ij,...j->...i", frame, _unit(away))
        share = np.maximum(V[..., 2], 0) / (away**2).sum(-1)
        visible = _visible(surface, camera)
        for n, (lamp, lit) in enumerate(zip(lamps, shadows, strict=True)):
            toward = lamp - surface.position
            L = np.einsum("...ij,...j->...i", frame, _unit(toward))
            irradiance = np.maximum(L[..., 2], 0) / (toward**2).sum(-1)
            good = (L[..., 2] > LEAST_COSINE) & (V[..., 2] > LEAST_COSINE)
            made.append(View(number, n, L, V, irradiance, surface.covered & visible & lit & good, share))
    return made


def lamps(count: int, turn: float = 0.0) -> F64:
    """Positions (count, 3) spread evenly over a cone about +z (golden-angle spiral, equal areas)."""
    i = np.arange(count) + 0.5
    z = 1 - (1 - np.cos(CONE)) * i / count
    ring, angle = np.sqrt(1 - z * z), i * np.pi * (3 - np.sqrt(5)) + turn
    return DISTANCE * np.stack([ring * np.cos(angle), ring * np.sin(angle), z], -1)


@dataclass(frozen=True)
class Geometry:
    """Of all views what observations need and no material changes."""

    views: list[View]
    quality: F32  # (h, w, K)
    cos_v: F32
    lobes: F32  # (h, w, K, 1, 4): sin2h, its spread (0), cos_l, F / (2 cos_l cos_v)
    groups: tuple[int, ...]
    irradiance: F32
    lamps: tuple[int, ...]


def geometry(of: list[View]) -> Geometry:
    """As gpu.atlas.ArraySource takes it; quality is the product's: cos_v and how bright beside the typical."""
    typical = np.median(np.concatenate([v.irradiance[v.seen] for v in of]))
    quality, cosines, lobes = [], [], []
    for view in of:
        at = brdf.angles(view.L, view.V, NORMAL)
        quality.append(np.where(view.seen, at.cos_v * np.minimum(view.irradiance / typical, 1.0), 0.0))
        cosines.append(at.cos_v)
        factor = brdf.F_dielectric(at.cos_vh) / (2 * at.cos_l * at.cos_v)
        lobes.append(np.stack([at.sin2h, np.zeros_like(at.sin2h), at.cos_l, factor], -1)[..., None, :])
    arrays = [np.stack(a, axis=2).astype(np.float32) for a in (quality, cosines, lobes)]
    irradiance = np.stack([v.irradiance for v in of], axis=2).astype(np.float32)
    return Geometry(of, arrays[0], arrays[1], arrays[2], tuple(v.camera for v in of), irradiance,
                    tuple(v.lamp for v in of))


def observe(of: list[View], material: Reflectance, noise: float = 0.0, seed: int = 0) -> F32:
    """(h, w, K, 3) radiance / irradiance, with relative noise of each channel by itself; 0 where not seen."""
    rng = np.random.default_rng(seed)
    shown = []
    for view in of:
        f = np.zeros((*view.seen.shape, 3))
        f[view.seen] = material(view.L[view.seen], view.V[view.seen])
        shown.append(f * (1 + noise * rng.standard_normal(f.shape)) if noise else f)
    return np.stack(shown, axis=2).astype(np.float32)


def _unit(v: F64) -> F64:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12))


def _frame(normal: F64) -> F64:
    """(..., 3, 3) rows x, y, z of a frame about each normal; the materials are isotropic, so x may point anywhere."""
    other = np.where(np.abs(normal[..., :1]) < 0.7, np.array([1.0, 0, 0]), np.array([0.0, 1, 0]))
    x = _unit(np.cross(other, normal))
    return np.stack([x, np.cross(normal, x), normal], axis=-2)


def _visible(surface: Surface, eye: F64) -> Bool:
    """What a lamp or camera reaches, by a depth map from there; a mask only, so that a rough one does."""
    if surface.blockers is None:
        return np.ones(surface.covered.shape, bool)
    z = eye / np.linalg.norm(eye)
    frame = _frame(z)

    def project(points: F64) -> tuple[np.ndarray, F64]:
        at = (eye - points) @ frame.T
        place = at[..., :2] / at[..., 2:] * np.linalg.norm(eye) / 1.5
        pixel = np.clip((place * 0.5 + 0.5) * DEPTH_PIXELS, 0, DEPTH_PIXELS - 1).astype(int)
        return pixel[..., 1] * DEPTH_PIXELS + pixel[..., 0], at[..., 2]

    nearest = np.full(DEPTH_PIXELS**2, np.inf)
    np.minimum.at(nearest, *project(surface.blockers))
    pixel, depth = project(surface.position)
    return np.asarray(depth < nearest[pixel] + DEPTH_SLACK)


def _read_obj(file: Path) -> tuple[F64, F64, np.ndarray]:
    """Points (n, 3), UVs (m, 2), corners (t, 3, 2) of points and UVs."""
    rows: dict[str, list[list[str]]] = {"v": [], "vt": [], "f": []}
    for line in file.read_text().splitlines():
        key, *words = line.split() or ["#"]
        rows.get(key, []).append(words)
    corners = np.array([[word.split("/")[:2] for word in row] for row in rows["f"]]).astype(int) - 1
    return np.array(rows["v"], float), np.array(rows["vt"], float)[:, :2], corners


def _inside(at: F64, size: int) -> tuple[np.ndarray, np.ndarray, F64]:
    """Texels (x, y) inside a triangle (3, 2) of the grid, and their barycentric coordinates (n, 3)."""
    low, high = np.ceil(at.min(0)).astype(int), np.floor(at.max(0)).astype(int)
    x, y = (a.ravel() for a in np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1)))
    edges = np.stack([at[1] - at[0], at[2] - at[0]])
    share = (np.stack([x, y], -1) - at[0]) @ np.linalg.inv(edges)
    share = np.concatenate([1 - share.sum(-1, keepdims=True), share], -1)
    keep = (share >= -1e-9).all(-1) & (x >= 0) & (y >= 0) & (x < size) & (y < size)
    return x[keep], y[keep], share[keep]
