"""The mesh on the GPU, drawn over the texel grid (G-buffer) and through the cameras (pixel maps)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, TypeVar

import moderngl
import numpy as np

from ...core.data import F32, I32, Camera, MeshArrays
from ...core.lens_mesh import divided
from ...core.triangle_bundles import Bundles
from ..device.context import Device
from ..device.draw_budget import Rectangle
from ..device.occupied_cells import OccupiedCells
from .facets import facets
from .projection import Projection, boxed, column_major, projection_of
from .triangles import I64, Triangles

POSITION = "3f", ("in_position",)  # a buffer's layout and the names in it: a draw of depths alone reads no more
SURFACE = "3f 2f 2f 4f", ("in_normal", "in_uv", "in_grid", "in_facet")
NORMAL_MAPPED = "3f 2f 2f 4f 3f 4f", (*SURFACE[1], "in_object_normal", "in_tangent")  # with a normal map
Values = TypeVar("Values", F32, I32)
GRID, LIFT = slice(5, 7), 10  # of a vertex's row of SURFACE: in_grid, in_facet.w


@dataclass(frozen=True)
class GBufferMaps:
    """G-buffer of a grid: texels (UV square) or a camera's pixels.  Released with ``release``."""

    position: moderngl.Texture  # RGBA32F: world xyz, coverage: 0 or 1, of pixels at seams less: see seams.py
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


class MeshBuffer:
    """The triangles of a mesh in two vertex buffers, sorted by material slot."""

    def __init__(self, device: Device, mesh: MeshArrays) -> None:
        self.device, self.mesh = device, mesh
        self._order: I64 | None = None  # None: they are sorted
        if (np.diff(mesh.slots) < 0).any():
            self._order = np.argsort(mesh.slots, kind="stable")
        self.bundles = Bundles.of(self._sorted(mesh.positions))
        self.positions = device.buffer(self.bundles.triangles)
        self._layout = NORMAL_MAPPED if mesh.normal_maps else SURFACE
        surface = self._surface()
        self.lift = float(surface[:, 0, LIFT].max())  # the shadow look-up lifts points off the facets by at most that
        self._buffer: moderngl.Buffer | None = device.buffer(surface)
        self._rows: Callable[[], F32] = lambda: self._kept  # of that buffer, where it is None
        self._arrange(self.bundles.triangles, surface[..., GRID], self._sorted(mesh.slots))
        self.normal_maps: dict[int, moderngl.Texture] = {}
        for slot, image in mesh.normal_maps.items():
            h, w = image.pixels.shape[:2]
            texture = device.texture(w, h, 3, image.pixels)
            texture.filter = (moderngl.LINEAR, moderngl.LINEAR)  # Cycles samples bilinear, without mip-maps
            texture.repeat_x = texture.repeat_y = True
            self.normal_maps[slot] = texture
        self.offsets: F32 | None = None  # (m, m, 3) over the texel grid: what refined normals add to the mesh's own
        self.tilt: moderngl.Texture | None = None  # the same
        self.closed: bool | None = None  # as of LightVisibility, once that has looked

    def refine(self, offsets: F32) -> None:
        """From here on the shading normals have these offsets: (m, m, 3) world, added to unit normals."""
        if self.tilt is not None:
            self.tilt.release()
        self.offsets = offsets
        self.tilt = self.device.texture(offsets.shape[1], offsets.shape[0], 3, offsets)
        self.tilt.filter = (moderngl.LINEAR, moderngl.LINEAR)

    def _sorted(self, values: Values) -> Values:
        """Values (T, ...) of the triangles in the order of the buffers."""
        return values if self._order is None else values[self._order]

    def _surface(self) -> F32:
        """(T, 3, c) what the second buffer holds, in its layout."""
        mesh, count = self.mesh, len(self.mesh.positions)
        parts = [mesh.normals, mesh.uvs, mesh.uvs if mesh.grid is None else mesh.grid,
                 np.broadcast_to(facets(mesh)[:, None], (count, 3, 4))]
        if mesh.normal_maps:
            assert mesh.object_normals is not None
            assert mesh.tangents is not None
            parts += [mesh.object_normals, mesh.tangents]
        rows = np.empty((count, 3, sum(part.shape[2] for part in parts)), np.float32)
        at = 0
        for part in parts:
            rows[..., at:at + part.shape[2]] = self._sorted(part)
            at += part.shape[2]
        return rows

    @cached_property
    def _kept(self) -> F32:
        """As `_surface`; asked for by cameras whose lens divides triangles."""
        return self._surface()

    def _arrange(self, places: F32, grid: F32 | None, slots: I32) -> None:
        """``places``: (T, 3, 3) what a projection's matrix maps; ``grid``: on the texel grid, if drawn there."""
        ends = [0, *(np.flatnonzero(np.diff(slots)) + 1).tolist(), len(slots)]
        self.slots = [(int(slots[first]), Triangles(places, first, last - first, grid))
                      for first, last in pairwise(ends) if first < last]
        self.triangles = self.slots[0][1] if len(self.slots) == 1 else Triangles(places, 0, len(slots), grid)
        self._arrays: dict[int, moderngl.VertexArray] = {}

    @contextmanager
    def through(self, camera: Camera, size: tuple[int, int]) -> Iterator[MeshBuffer]:
        """What is to be drawn for the camera's pictures of ``size``: with a lens, triangles that it does not bend."""
        if camera.lens is None:
            yield self
            return
        division = divided(self.bundles.triangles, camera, size, self.bundles)
        with self.device.scope():
            drawn = copy(self)
            if not division.whole:
                drawn.positions = self.device.buffer(division.positions) if len(division.positions) else self.positions
                drawn._buffer = None
                drawn._rows = lambda: division.divided(self._kept)
            drawn._arrange(boxed(camera, division.positions), None, self._sorted(self.mesh.slots)[division.parent])
            try:
                yield drawn
            finally:
                drawn._release_arrays()

    def draw(self, target: moderngl.Framebuffer, projection: Projection | None, footprint: float = 0.0) -> None:
        """Draw into the target: through a projection, or over the UV square when None.

        ``footprint``: width in pixels over which a normal map is averaged.
        """
        device = self.device
        through = projection or Projection(np.eye(4))
        program = device.programs.get("gbuffer/gbuffer.vert", "gbuffer/gbuffer.frag", through.defines | self._defines)
        device.programs.set(program, {
            **through.uniforms, "u_in_uv": projection is None, "u_footprint": footprint,
            "u_has_tilt": self.tilt is not None,
        })
        for slot, triangles in self.slots:
            device.programs.set(program, {"u_slot": float(slot)})
            device.bind(program, {"u_tilt": self.tilt, **self._normal_map(program, slot)})
            triangles.draw(device, ("gbuffer/gbuffer.frag", projection is None, target.size), self._array(program),
                           target, None if projection is None else projection.clip)

    @property
    def _defines(self) -> dict[str, str]:
        return {"NORMAL_MAP": "1"} if self.normal_maps else {}

    def _normal_map(self, program: moderngl.Program, slot: int) -> dict[str, moderngl.Texture | None]:
        """The sampler of a slot, where some slot has a normal map; its uniforms are set."""
        if not self.normal_maps:
            return {}
        used = self.mesh.normal_maps.get(slot)
        normal_matrix = np.eye(3) if self.mesh.normal_matrix is None else self.mesh.normal_matrix
        self.device.programs.set(program, {
            "u_normal_matrix": column_major(normal_matrix), "u_has_normal_map": used is not None,
            "u_normal_strength": used.strength if used else 0.0, "u_unit_normal": used is not None and used.unit_normal,
        })
        return {"u_normal_map": self.normal_maps.get(slot)}

    def draw_positions(
        self, target: moderngl.Framebuffer, fragment: str, projection: Projection, uniforms: dict[str, Any],
        region: Rectangle | None = None,
    ) -> None:
        """Draw positions alone with ``gbuffer/depth.vert`` and a fragment shader, on all of a target or a region."""
        program = self.device.programs.get("gbuffer/depth.vert", fragment, projection.defines)
        self.device.programs.set(program, {**uniforms, **projection.uniforms})
        kind = fragment, region[2:] if region else target.size
        self.triangles.draw(self.device, kind, self._array(program), target, projection.clip, region)

    def draw_told(
        self, target: moderngl.Framebuffer, projection: Projection, centres: GBufferMaps, away: tuple[float, float],
    ) -> None:
        """Draw 1 where what is so many pixels ``away`` from a pixel's centre is what the centre tells, else 0."""
        program = self.device.programs.get("gbuffer/gbuffer.vert", "gbuffer/told.frag", projection.defines)
        self.device.programs.set(program, {**projection.uniforms, "u_in_uv": False, "u_away": away})
        self.device.bind(program, {"u_uv": centres.uv, "u_uv_slope": centres.uv_slope})
        self.triangles.draw(self.device, ("gbuffer/told.frag", target.size), self._array(program), target,
                            projection.clip)

    def draw_count(self, target: moderngl.Framebuffer) -> None:
        """Add 1 to every texel under each triangle's UVs."""
        program = self.device.programs.get("gbuffer/gbuffer.vert", "gbuffer/count.frag")
        self.device.programs.set(program, {"u_in_uv": True})
        with self.device.adding():
            self.triangles.draw(self.device, ("gbuffer/count.frag", target.size), self._array(program), target, None)

    def _array(self, program: moderngl.Program) -> moderngl.VertexArray:
        array = self._arrays.get(program.glo)
        if array is None or isinstance(array.mglo, moderngl.InvalidObject):  # freed with the scope of an earlier draw
            content = [_read_by(program, self.positions, *POSITION)]
            if any(name in program for name in self._layout[1]):
                if self._buffer is None:
                    self._buffer = self.device.buffer(self._rows())
                content.append(_read_by(program, self._buffer, *self._layout))
            array = self.device.vertex_array(program, content)
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
        self.positions.release()
        if self._buffer is not None:
            self._buffer.release()


def _read_by(
    program: moderngl.Program, buffer: moderngl.Buffer, layout: str, names: tuple[str, ...],
) -> tuple[moderngl.Buffer | str, ...]:
    """What of a buffer a program reads, for a vertex array."""
    sizes = [size if name in program else f"{size[0]}x4" for size, name in zip(layout.split(), names, strict=True)]
    return buffer, " ".join(sizes), *[name for name in names if name in program]


class Occluders:
    """Triangles of the other objects in the scene, positions only."""

    def __init__(self, device: Device, triangles: F32) -> None:
        self.device, self.triangles = device, triangles
        self.buffer = device.buffer(triangles.astype(np.float32)) if len(triangles) else None
        self.bundles = Bundles.of(triangles)
        self._triangles = Triangles(triangles, 0, len(triangles))

    @contextmanager
    def through(self, camera: Camera, size: tuple[int, int]) -> Iterator[Occluders]:
        """As `MeshBuffer.through`."""
        if camera.lens is None or self.buffer is None:
            yield self
            return
        division = divided(self.triangles, camera, size, self.bundles)
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
    projection = projection_of(camera, [mesh.bundles, occluders.bundles])
    textures = [device.texture(*size, channels) for channels in (4, 4, 4, 2, 4)]
    with device.scope(), device.target(textures, device.depth_map(*size)) as target, device.keeping_nearest():
        target.clear(depth=1.0)
        with mesh.through(camera, size) as drawn:
            drawn.draw(target, projection, footprint)
        with occluders.through(camera, size) as others:
            others.draw(target, "gbuffer/occluder.frag", projection, {"u_depth_plane": (0.0, 0.0, 0.0, 0.0)})
    position, normal, facet, uv, slope = textures
    return GBufferMaps(position, normal, facet, uv, slope, OccupiedCells(device, position))

