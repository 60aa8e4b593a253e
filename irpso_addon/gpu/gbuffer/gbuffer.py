"""The mesh on the GPU, drawn over the texel grid (G-buffer) and through the cameras (pixel maps)."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from ...core.data import F32, F64, Camera, MeshArrays
from ..device.context import Device
from ..device.draw_budget import Rectangle, rectangles
from ..device.occupied_cells import OccupiedCells

BUNDLE = 1024  # triangles that are drawn together
TRIANGLE = 64  # pixels that take as long as a triangle
FIRST_PIXELS = 131072.0  # of a draw of triangles before its speed is known
I64 = NDArray[np.int64]
_LAYOUT = "3f 3f 2f 2f 4f 3f 4f"
_NAMES = ("in_position", "in_normal", "in_uv", "in_grid", "in_facet", "in_object_normal", "in_tangent")


@dataclass(frozen=True)
class GBufferMaps:
    """G-buffer of a grid: texels (UV square) or a camera's pixels.  Released with ``release``."""

    position: moderngl.Texture  # RGBA32F: world xyz, coverage
    normal: moderngl.Texture  # RGBA32F: shading normal, material slot
    facet: moderngl.Texture  # RGBA32F: facet normal on the shading side, lift (metres)
    uv: moderngl.Texture | None = None  # RG32F, cameras only: place on the texel grid
    uv_slope: moderngl.Texture | None = None  # RGBA32F, cameras only: d(uv)/dx, d(uv)/dy
    cells: OccupiedCells | None = None  # the squares of it that show the mesh

    def release(self) -> None:
        """Free the textures."""
        for thing in (self.position, self.normal, self.facet, self.uv, self.uv_slope, self.cells):
            if thing is not None:
                thing.release()


def facets(mesh: MeshArrays) -> F32:
    """(T, 4): unit facet normal of each triangle and its lift in metres.

    The lift is how far the smooth surface that the corner normals describe stands above the flat
    facet (half the largest distance from a corner to another corner's tangent plane), after the
    shadow-terminator offset of Hanika (Ray Tracing Gems II, 2021, ch. 4).  Degenerate triangles
    get a zero normal.
    """
    p, n = mesh.positions.astype(np.float64), mesh.normals.astype(np.float64)
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 1e-20, normal / np.maximum(length, 1e-20), 0.0)
    lift = np.zeros(len(p))
    for i in range(3):
        for j in range(3):
            if i != j:
                lift = np.maximum(lift, 0.5 * np.abs(np.einsum("tk,tk->t", p[:, j] - p[:, i], n[:, i])))
    longest = np.max(np.linalg.norm(p - np.roll(p, 1, axis=1), axis=2), axis=1)
    lift = np.minimum(lift, 0.25 * longest)  # flat shading and hard edges: the planes say nothing
    return np.concatenate([normal, lift[:, None]], axis=1).astype(np.float32)


class Triangles:
    """A run of triangles in a vertex buffer, drawn in pieces: bundles of them, and a dear bundle in bands of rows.

    In their order, so that what lies over what does not depend on how they are divided.
    """

    def __init__(self, positions: F32, first: int, count: int, grid: F32 | None = None) -> None:
        """``positions``: (T, 3, 3), world, of the whole buffer; ``grid``: (T, 3, 2) places on the texel grid."""
        self._ends = np.array([*range(first, first + count, BUNDLE), first + count], np.int64)
        self._boxes = _boxes(positions, self._ends)
        self._flat = None if grid is None else _boxes(grid, self._ends)

    def draw(
        self, device: Device, kind: Hashable, array: moderngl.VertexArray, target: moderngl.Framebuffer,
        clip: F64 | None,
    ) -> None:
        """Draw with what ``array`` and its program are; ``clip``: world to clip space, None: on the texel grid.

        ``kind``: what draws are alike in cost.
        """
        at = _projected(self._boxes, clip) if clip is not None else self._flat
        assert at is not None
        low, high = _pixels(at, target.size)
        area = (high - low).prod(axis=1)
        cost = np.where(area > 0, area + TRIANGLE * np.diff(self._ends), 0.0)
        device.ctx.viewport = 0, 0, *target.size
        target.use()
        i, shown = 0, np.append(area > 0, False)
        while i < len(cost):
            if not shown[i]:
                i += 1
                continue
            allowed = device.budget.most(kind, FIRST_PIXELS)
            end = i + int(np.argmin(shown[i:]))
            end = i + int(np.searchsorted(np.cumsum(cost[i:end]), allowed, side="right"))
            first, last = self._ends[i], self._ends[max(end, i + 1)]
            bands: Iterable[tuple[Rectangle | None, float]] = [(None, float(cost[i:end].sum()))]
            if end == i:  # even one is too much
                size = high[i] - low[i]
                bands = rectangles((*low[i].tolist(), *size.tolist()), lambda: device.budget.most(kind, FIRST_PIXELS),
                                   np.full(size[1], cost[i] / size[1], np.float32))
            for part, units in bands:
                if part is not None:
                    target.scissor = part
                    target.use()
                with device.budget.piece(kind, units):
                    array.render(moderngl.TRIANGLES, vertices=3 * int(last - first), first=3 * int(first))
            if end == i:
                target.scissor = None  # type: ignore[assignment]  # the stub does not know how to take it back
                target.use()
            i = max(end, i + 1)


def _boxes(points: F32, ends: I64) -> F64:
    """(B, 2^K, K) corners of the boxes around bundles of (T, 3, K) points."""
    if len(ends) < 2:
        return np.zeros((0, 2 ** points.shape[-1], points.shape[-1]))
    part = points[ends[0]:ends[-1]]
    box = np.stack([of.reduceat(part, ends[:-1] - ends[0]) for of in (np.minimum, np.maximum)])
    box = np.stack([box[0].min(axis=1), box[1].max(axis=1)]).astype(np.float64)  # (2, B, K)
    choice = np.array(np.meshgrid(*[[0, 1]] * points.shape[-1])).reshape(points.shape[-1], -1).T
    return np.stack([box[choice[:, k], :, k] for k in range(points.shape[-1])], axis=-1).swapaxes(0, 1)


def _projected(corners: F64, clip: F64) -> F64:
    """(B, 8, 2) places in the picture, 0 to 1; not finite where a box reaches behind the camera."""
    at = corners @ clip[:, :3].T + clip[:, 3]
    behind = at[..., 3].min(axis=1, initial=np.inf) <= 0.0
    at[behind] = np.nan
    return np.asarray(0.5 * at[..., :2] / at[..., 3:] + 0.5)


def _pixels(at: F64, size: tuple[int, int]) -> tuple[I64, I64]:
    """First and end, (B, 2) each, of the pixels that boxes span in a picture, with one to spare; all where unknown."""
    known = np.isfinite(at).all(axis=(1, 2))
    at = np.where(known[:, None, None], at, np.array([[0.0, 0.0], [1.0, 1.0]])[np.arange(at.shape[1]) % 2])
    low, high = (np.clip(end, -1.0, 2.0) * size for end in (at.min(axis=1), at.max(axis=1)))
    first = np.clip(np.floor(low).astype(np.int64) - 1, 0, size)
    return first, np.maximum(np.clip(np.ceil(high).astype(np.int64) + 1, 0, size), first)


class MeshBuffer:
    """The triangles of a mesh in one vertex buffer, sorted by material slot."""

    def __init__(self, device: Device, mesh: MeshArrays) -> None:
        self.device, self.mesh = device, mesh
        order = np.argsort(mesh.slots, kind="stable")
        slots = mesh.slots[order]
        zeros = np.zeros((len(order), 3, 4), np.float32)
        parts = [
            mesh.positions[order], mesh.normals[order], mesh.uvs[order],
            (mesh.uvs if mesh.grid is None else mesh.grid)[order],
            np.repeat(facets(mesh)[order][:, None], 3, axis=1),
            mesh.object_normals[order] if mesh.object_normals is not None else zeros[..., :3],
            mesh.tangents[order] if mesh.tangents is not None else zeros,
        ]
        self.buffer = device.buffer(np.concatenate(parts, axis=2).astype(np.float32))
        ranges = [(int(s), int(np.searchsorted(slots, s)), int(np.count_nonzero(slots == s))) for s in np.unique(slots)]
        self.slots = [(slot, Triangles(parts[0], first, count, parts[3])) for slot, first, count in ranges]
        self.triangles = Triangles(parts[0], 0, len(order), parts[3])
        self.normal_maps: dict[int, moderngl.Texture] = {}
        for slot, image in mesh.normal_maps.items():
            h, w = image.pixels.shape[:2]
            texture = device.texture(w, h, 3, image.pixels)
            texture.filter = (moderngl.LINEAR, moderngl.LINEAR)  # Cycles samples bilinear, without mip-maps
            texture.repeat_x = texture.repeat_y = True
            self.normal_maps[slot] = texture
        self._arrays: dict[int, moderngl.VertexArray] = {}

    def draw(self, target: moderngl.Framebuffer, clip: F64 | None, footprint: float = 0.0) -> None:
        """Draw into the target: through ``clip`` (world to clip space), or over the UV square when None.

        ``footprint``: width in pixels over which a normal map is averaged.
        """
        device = self.device
        program = device.programs.get("gbuffer/gbuffer.vert", "gbuffer/gbuffer.frag")
        matrix = np.eye(4) if clip is None else clip
        normal_matrix = np.eye(3) if self.mesh.normal_matrix is None else self.mesh.normal_matrix
        device.programs.set(program, {
            "u_in_uv": clip is None, "u_clip": column_major(matrix), "u_normal_matrix": column_major(normal_matrix),
            "u_footprint": footprint,
        })
        for slot, triangles in self.slots:
            device.bind(program, {"u_normal_map": self.normal_maps.get(slot)})
            used = self.mesh.normal_maps.get(slot)
            device.programs.set(program, {
                "u_has_normal_map": used is not None, "u_slot": float(slot),
                "u_normal_strength": used.strength if used else 0.0,
                "u_unit_normal": used is not None and used.unit_normal,
            })
            triangles.draw(device, ("gbuffer/gbuffer.frag", clip is None, target.size), self._array(program), target,
                           clip)

    def draw_positions(
        self, target: moderngl.Framebuffer, fragment: str, clip: F64, uniforms: dict[str, Any],
    ) -> None:
        """Draw positions alone with ``gbuffer/depth.vert`` and a fragment shader."""
        program = self.device.programs.get("gbuffer/depth.vert", fragment)
        self.device.programs.set(program, {**uniforms, "u_clip": column_major(clip)})
        self.triangles.draw(self.device, (fragment, target.size), self._array(program), target, clip)

    def draw_count(self, target: moderngl.Framebuffer) -> None:
        """Add 1 to every texel under each triangle's UVs."""
        program = self.device.programs.get("gbuffer/gbuffer.vert", "gbuffer/count.frag")
        self.device.programs.set(program, {"u_in_uv": True})
        with self.device.adding():
            self.triangles.draw(self.device, ("gbuffer/count.frag", target.size), self._array(program), target, None)

    def _array(self, program: moderngl.Program) -> moderngl.VertexArray:
        if program.glo not in self._arrays:
            layout = [(f"{size}" if name in program else f"{size[0]}x4") for size, name in
                      zip(_LAYOUT.split(), _NAMES, strict=True)]
            used = [name for name in _NAMES if name in program]
            self._arrays[program.glo] = self.device.ctx.vertex_array(program, [(self.buffer, " ".join(layout), *used)])
        return self._arrays[program.glo]

    def release(self) -> None:
        """Free buffer and textures."""
        for array in self._arrays.values():
            array.release()
        for texture in self.normal_maps.values():
            texture.release()
        self.buffer.release()


class Occluders:
    """Triangles of the other objects in the scene, positions only."""

    def __init__(self, device: Device, triangles: F32) -> None:
        self.device, self.triangles = device, triangles
        self.buffer = device.buffer(triangles.astype(np.float32)) if len(triangles) else None
        self._triangles = Triangles(triangles, 0, len(triangles))

    def draw(self, target: moderngl.Framebuffer, fragment: str, clip: F64, uniforms: dict[str, Any]) -> None:
        """Draw with ``gbuffer/depth.vert`` and a fragment shader."""
        if self.buffer is None:
            return
        program = self.device.programs.get("gbuffer/depth.vert", fragment)
        self.device.programs.set(program, {**uniforms, "u_clip": column_major(clip)})
        array = self.device.ctx.vertex_array(program, [(self.buffer, "3f", "in_position")])
        self._triangles.draw(self.device, (fragment, target.size), array, target, clip)
        array.release()

    def release(self) -> None:
        """Free the buffer."""
        if self.buffer is not None:
            self.buffer.release()


def column_major(matrix: F32 | F64) -> bytes:
    """A matrix as a GL uniform's bytes."""
    return np.ascontiguousarray(np.asarray(matrix).T, dtype=np.float32).tobytes()


def draw_texel_grid(device: Device, mesh: MeshBuffer, size: int) -> GBufferMaps:
    """The G-buffer of the UV square, ``size`` texels on a side; uncovered texels are all zero."""
    textures = [device.texture(size, size) for _ in range(3)]
    target = device.framebuffer(textures)
    target.clear()
    mesh.draw(target, None)
    target.release()
    position, normal, facet = textures
    return GBufferMaps(position, normal, facet, cells=OccupiedCells(device, position))


def overlap_counts(device: Device, mesh: MeshBuffer, size: int) -> F32:
    """(size, size): how many triangles cover each texel's centre."""
    texture = device.texture(size, size, 1)
    target = device.framebuffer([texture])
    target.clear()
    mesh.draw_count(target)
    counts = device.read(texture)[..., 0]
    target.release()
    texture.release()
    return counts


def draw_pixel_grid(
    device: Device, mesh: MeshBuffer, occluders: Occluders, camera: Camera, width: int, height: int, footprint: float
) -> GBufferMaps:
    """What a camera's pixel centres see of the mesh; other objects in front leave zeros.

    ``footprint``: width in pixels over which a normal map is averaged.
    """
    clip = clip_matrix(camera, [mesh.mesh.positions, occluders.triangles])
    textures = [device.texture(width, height), device.texture(width, height), device.texture(width, height),
                device.texture(width, height, 2), device.texture(width, height)]
    with device.making(f"a depth map of {width} x {height}"):
        depth = device.ctx.depth_texture((width, height))
    target = device.framebuffer(textures, depth)
    target.clear(depth=1.0)
    with device.keeping_nearest():
        mesh.draw(target, clip, footprint)
        occluders.draw(target, "gbuffer/occluder.frag", clip, {"u_depth_plane": (0.0, 0.0, 0.0, 0.0)})
    target.release()
    depth.release()
    position, normal, facet, uv, slope = textures
    return GBufferMaps(position, normal, facet, uv, slope, OccupiedCells(device, position))


def clip_matrix(camera: Camera, triangles: list[F32]) -> F64:
    """World to clip space, near and far fitted around what is in front of the camera.

    The camera's own clip range would waste depth precision (0.1 m to 1 km by default).
    """
    depths = [-(t.reshape(-1, 3) @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3])
              for t in triangles if len(t)]
    depth = np.concatenate(depths).astype(np.float64)
    far = max(float(depth.max()) * 1.01, 1e-3)
    if camera.orthographic:
        near, far = max(float(depth.min()) - 0.01 * far - 1e-3, 0.0), far + 1e-3  # what lies behind is not seen
        row = [0.0, 0.0, -2.0 / (far - near), -(far + near) / (far - near)]
    else:
        near = max(float(depth.min()) * 0.99, 1e-3 * far)
        row = [0.0, 0.0, -(far + near) / (far - near), -2.0 * far * near / (far - near)]
    projection = camera.projection.copy()
    projection[2] = row
    return np.asarray(projection @ camera.world_to_camera, dtype=np.float64)
