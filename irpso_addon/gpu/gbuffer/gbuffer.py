"""The mesh on the GPU, drawn over the texel grid (G-buffer) and through the cameras (pixel maps)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import moderngl
import numpy as np

from ...core.data import F32, I32, Camera, MeshArrays
from ...core.lens_mesh import Bundles, divided
from ..device.context import Device
from ..device.draw_budget import Rectangle
from ..device.occupied_cells import OccupiedCells
from .projection import Projection, boxed, column_major, projection_of
from .triangles import Triangles

_LAYOUT = "3f 3f 2f 2f 4f 3f 4f"
_NAMES = ("in_position", "in_normal", "in_uv", "in_grid", "in_facet", "in_object_normal", "in_tangent")
GRID = slice(8, 10)  # of a vertex: in_grid


@dataclass(frozen=True)
class GBufferMaps:
    """G-buffer of a grid: texels (UV square) or a camera's pixels.  Released with ``release``."""

    position: moderngl.Texture  # RGBA32F: world xyz, coverage
    normal: moderngl.Texture  # RGBA32F: shading normal, material slot
    facet: moderngl.Texture  # RGBA32F: facet normal on the shading side, lift (metres)
    uv: moderngl.Texture | None = None  # RG32F, cameras only: place on the texel grid
    uv_slope: moderngl.Texture | None = None  # RGBA32F, cameras only: d(uv)/dx, d(uv)/dy
    cells: OccupiedCells | None = None  # the squares of it that show the mesh

    @property
    def objects(self) -> tuple[moderngl.Texture | moderngl.Buffer | None, ...]:
        """All that is on the device."""
        return (self.position, self.normal, self.facet, self.uv, self.uv_slope,
                None if self.cells is None else self.cells.corners)

    def release_position(self) -> None:
        """Free what another position is to replace."""
        self.position.release()
        if self.cells is not None:
            self.cells.release()

    def release(self) -> None:
        """Free the textures."""
        self.release_position()
        for texture in (self.normal, self.facet, self.uv, self.uv_slope):
            if texture is not None:
                texture.release()


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


def _rows(mesh: MeshArrays) -> tuple[F32, I32]:
    """What the vertex buffer holds (T, 3, 24), `_NAMES` in `_LAYOUT`, sorted by material slot; and the slots (T,)."""
    order = np.argsort(mesh.slots, kind="stable")
    zeros = np.zeros((len(order), 3, 4), np.float32)
    parts = [
        mesh.positions[order], mesh.normals[order], mesh.uvs[order],
        (mesh.uvs if mesh.grid is None else mesh.grid)[order],
        np.repeat(facets(mesh)[order][:, None], 3, axis=1),
        mesh.object_normals[order] if mesh.object_normals is not None else zeros[..., :3],
        mesh.tangents[order] if mesh.tangents is not None else zeros,
    ]
    return np.concatenate(parts, axis=2).astype(np.float32), mesh.slots[order]


class MeshBuffer:
    """The triangles of a mesh in one vertex buffer, sorted by material slot."""

    def __init__(self, device: Device, mesh: MeshArrays) -> None:
        self.device, self.mesh = device, mesh
        rows, slots = _rows(mesh)
        self.buffer = device.buffer(rows)
        self._arrange(rows[..., :3], rows[..., GRID], slots)
        self.normal_maps: dict[int, moderngl.Texture] = {}
        for slot, image in mesh.normal_maps.items():
            h, w = image.pixels.shape[:2]
            texture = device.texture(w, h, 3, image.pixels)
            texture.filter = (moderngl.LINEAR, moderngl.LINEAR)  # Cycles samples bilinear, without mip-maps
            texture.repeat_x = texture.repeat_y = True
            self.normal_maps[slot] = texture
        self.offsets: F32 | None = None  # (m, m, 3) over the texel grid: what refined normals add to the mesh's own
        self.tilt: moderngl.Texture | None = None  # the same

    def refine(self, offsets: F32) -> None:
        """From here on the shading normals have these offsets: (m, m, 3) world, added to unit normals."""
        assert self.tilt is None
        self.offsets = offsets
        self.tilt = self.device.texture(offsets.shape[1], offsets.shape[0], 3, offsets)
        self.tilt.filter = (moderngl.LINEAR, moderngl.LINEAR)

    def _arrange(self, places: F32, grid: F32 | None, slots: I32) -> None:
        """``places``: (T, 3, 3) what a projection's matrix maps; ``grid``: on the texel grid, if drawn there."""
        ranges = [(int(s), int(np.searchsorted(slots, s)), int(np.count_nonzero(slots == s))) for s in np.unique(slots)]
        self.slots = [(slot, Triangles(places, first, count, grid)) for slot, first, count in ranges]
        self.triangles = Triangles(places, 0, len(slots), grid)
        self._arrays: dict[int, moderngl.VertexArray] = {}

    @contextmanager
    def through(self, camera: Camera, size: tuple[int, int]) -> Iterator[MeshBuffer]:
        """What is to be drawn for the camera's pictures of ``size``: with a lens, triangles that it does not bend."""
        if camera.lens is None:
            yield self
            return
        rows, slots = self._sorted
        division = divided(rows[..., :3], camera, size, self._bundles)
        with self.device.scope():
            drawn = copy(self)
            if not division.whole:
                parts = division.divided(rows)
                parts[..., :3] = division.positions
                drawn.buffer = self.device.buffer(parts) if len(parts) else self.buffer
            drawn._arrange(boxed(camera, division.positions), None, slots[division.parent])
            try:
                yield drawn
            finally:
                drawn._release_arrays()

    @cached_property
    def _sorted(self) -> tuple[F32, I32]:
        """As `_rows`; asked for by each camera that has a lens."""
        return _rows(self.mesh)

    @cached_property
    def _bundles(self) -> Bundles:
        return Bundles.of(self._sorted[0][..., :3])

    def draw(self, target: moderngl.Framebuffer, projection: Projection | None, footprint: float = 0.0) -> None:
        """Draw into the target: through a projection, or over the UV square when None.

        ``footprint``: width in pixels over which a normal map is averaged.
        """
        device = self.device
        through = projection or Projection(np.eye(4))
        program = device.programs.get("gbuffer/gbuffer.vert", "gbuffer/gbuffer.frag", through.defines)
        normal_matrix = np.eye(3) if self.mesh.normal_matrix is None else self.mesh.normal_matrix
        device.programs.set(program, {
            **through.uniforms, "u_in_uv": projection is None, "u_normal_matrix": column_major(normal_matrix),
            "u_footprint": footprint,
        })
        for slot, triangles in self.slots:
            device.bind(program, {"u_normal_map": self.normal_maps.get(slot), "u_tilt": self.tilt})
            used = self.mesh.normal_maps.get(slot)
            device.programs.set(program, {
                "u_has_normal_map": used is not None, "u_slot": float(slot), "u_has_tilt": self.tilt is not None,
                "u_normal_strength": used.strength if used else 0.0,
                "u_unit_normal": used is not None and used.unit_normal,
            })
            triangles.draw(device, ("gbuffer/gbuffer.frag", projection is None, target.size), self._array(program),
                           target, None if projection is None else projection.clip)

    def draw_positions(
        self, target: moderngl.Framebuffer, fragment: str, projection: Projection, uniforms: dict[str, Any],
        region: Rectangle | None = None,
    ) -> None:
        """Draw positions alone with ``gbuffer/depth.vert`` and a fragment shader, on all of a target or a region."""
        program = self.device.programs.get("gbuffer/depth.vert", fragment, projection.defines)
        self.device.programs.set(program, {**uniforms, **projection.uniforms})
        kind = fragment, region[2:] if region else target.size
        self.triangles.draw(self.device, kind, self._array(program), target, projection.clip, region)

    def draw_count(self, target: moderngl.Framebuffer) -> None:
        """Add 1 to every texel under each triangle's UVs."""
        program = self.device.programs.get("gbuffer/gbuffer.vert", "gbuffer/count.frag")
        self.device.programs.set(program, {"u_in_uv": True})
        with self.device.adding():
            self.triangles.draw(self.device, ("gbuffer/count.frag", target.size), self._array(program), target, None)

    def _array(self, program: moderngl.Program) -> moderngl.VertexArray:
        array = self._arrays.get(program.glo)
        if array is None or isinstance(array.mglo, moderngl.InvalidObject):  # freed with the scope of an earlier draw
            layout = [(f"{size}" if name in program else f"{size[0]}x4") for size, name in
                      zip(_LAYOUT.split(), _NAMES, strict=True)]
            used = [name for name in _NAMES if name in program]
            array = self.device.vertex_array(program, [(self.buffer, " ".join(layout), *used)])
            self._arrays[program.glo] = array
        return array

    def _release_arrays(self) -> None:
        for array in self._arrays.values():
            array.release()

    def release(self) -> None:
        """Free buffer and textures."""
        self._release_arrays()
        for texture in (*self.normal_maps.values(), *([] if self.tilt is None else [self.tilt])):
            texture.release()
        self.buffer.release()


class Occluders:
    """Triangles of the other objects in the scene, positions only."""

    def __init__(self, device: Device, triangles: F32) -> None:
        self.device, self.triangles = device, triangles
        self.buffer = device.buffer(triangles.astype(np.float32)) if len(triangles) else None
        self._triangles = Triangles(triangles, 0, len(triangles))

    @cached_property
    def _bundles(self) -> Bundles:
        return Bundles.of(self.triangles)

    @contextmanager
    def through(self, camera: Camera, size: tuple[int, int]) -> Iterator[Occluders]:
        """As `MeshBuffer.through`."""
        if camera.lens is None or self.buffer is None:
            yield self
            return
        division = divided(self.triangles, camera, size, self._bundles)
        with self.device.scope():
            drawn = copy(self)
            if not division.whole:
                drawn.buffer = self.device.buffer(division.positions) if len(division.positions) else None
            drawn._triangles = Triangles(boxed(camera, division.positions), 0, len(division.positions))
            yield drawn

    def draw(
        self, target: moderngl.Framebuffer, fragment: str, projection: Projection, uniforms: dict[str, Any],
        region: Rectangle | None = None,
    ) -> None:
        """Draw with ``gbuffer/depth.vert`` and a fragment shader, on all of a target or a region."""
        if self.buffer is None:
            return
        program = self.device.programs.get("gbuffer/depth.vert", fragment, projection.defines)
        self.device.programs.set(program, {**uniforms, **projection.uniforms})
        with self.device.scope():
            array = self.device.vertex_array(program, [(self.buffer, "3f", "in_position")])
            kind = fragment, region[2:] if region else target.size
            self._triangles.draw(self.device, kind, array, target, projection.clip, region)


def draw_texel_grid(device: Device, mesh: MeshBuffer, size: int) -> GBufferMaps:
    """The G-buffer of the UV square, ``size`` texels on a side; uncovered texels are all zero."""
    textures = [device.texture(size, size) for _ in range(3)]
    with device.target(textures, clear=True) as target:
        mesh.draw(target, None)
    position, normal, facet = textures
    return GBufferMaps(position, normal, facet, cells=OccupiedCells(device, position))


def overlap_counts(device: Device, mesh: MeshBuffer, size: int) -> F32:
    """(size, size): how many triangles cover each texel's centre."""
    with device.scope():
        texture = device.texture(size, size, 1)
        with device.target([texture], clear=True) as target:
            mesh.draw_count(target)
        return device.read(texture)[..., 0]


def draw_pixel_grid(
    device: Device, mesh: MeshBuffer, occluders: Occluders, camera: Camera, size: tuple[int, int], footprint: float,
) -> GBufferMaps:
    """What a camera's pixel centres see of the mesh; other objects in front leave zeros.

    ``size``: width and height of its picture.  ``footprint``: width in pixels over which a normal map is averaged.
    """
    projection = projection_of(camera, [mesh.mesh.positions, occluders.triangles])
    textures = [device.texture(*size, channels) for channels in (4, 4, 4, 2, 4)]
    with device.scope(), device.target(textures, device.depth_map(*size)) as target, device.keeping_nearest():
        target.clear(depth=1.0)
        with mesh.through(camera, size) as drawn:
            drawn.draw(target, projection, footprint)
        with occluders.through(camera, size) as others:
            others.draw(target, "gbuffer/occluder.frag", projection, {"u_depth_plane": (0.0, 0.0, 0.0, 0.0)})
    position, normal, facet, uv, slope = textures
    return GBufferMaps(position, normal, facet, uv, slope, OccupiedCells(device, position))

