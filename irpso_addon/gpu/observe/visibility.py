"""Which pixels a light reaches: shadow maps drawn from the light, looked up per camera pixel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import ceil, inf

import moderngl
import numpy as np

from ...core.data import F64, Light
from ...core.shading import lights as light_model
from ..device.context import Device, Inputs
from ..gbuffer.gbuffer import GBufferMaps, MeshBuffer, Occluders
from ..gbuffer.projection import Projection, column_major

SHADOW_SIZE = 2048  # texels on a side, at most; 0.1 % of lit texels change against 4096
LEAST_SIZE = 512  # at least
PIXEL_TEXELS = 4.0  # texels of a shadow map for a pixel of the pictures; ...
SOFT_PIXEL_TEXELS = 2.0  # ... with several maps, whose errors average
SIZE_STEP = 256  # sizes are multiples of it: lights that differ little share a map
# Sample points on an emitter that casts a visible penumbra: one for each pixel of its width.
SOFT_POINTS = (4, 8, 16)
SOFT_ANGLE = 0.004  # radians; a smaller emitter has penumbrae thinner than a pixel: one point is enough
FAR_TEXEL = 1e30
SHADOW = "gbuffer/shadow.frag"
CLOSED_SIDE, CLOSED_TEXELS = 256, 16  # of maps by which a mesh is found closed, and those that may show a back


@dataclass(frozen=True)
class Frustum:
    """One shadow map's projection."""

    clip: F64  # (4, 4) world to clip
    plane: tuple[float, float, float, float]  # linear depth along the view axis
    texel: float  # width of a texel, metres, or metres per metre of depth where perspective
    parallel: bool
    face: int = -1  # of the six around a point inside the subject's sphere: +X +Y +Z -X -Y -Z
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of a perspective map


def shadow_points(light: Light, center: F64, pixels: float) -> tuple[list[F64], F64]:
    """Homogeneous points (4,) on the emitter that stand for it, (x, y, z, 1) or (direction to it, 0), and their shares.

    ``pixels``: diameter of the subject's sphere.  What casts a shadow is mostly no farther away than a quarter of that.
    """
    position = light.matrix[:3, 3]
    distance = max(float(np.linalg.norm(position - center)), 1e-6)
    if light.kind == "SUN":
        extent = light.radius
    elif light.kind == "AREA":
        scale = np.linalg.norm(light.matrix[:3, :2], axis=0)
        extent = 0.5 * max(light.size[0] * scale[0], light.size[1] * scale[1]) / distance
    else:
        extent = light.radius / distance
    count = 1
    if extent > SOFT_ANGLE:
        count = next((n for n in SOFT_POINTS if n >= 0.5 * extent * pixels), SOFT_POINTS[-1])
    vectors, weights = light_model.light_sample(light, center[None], np.arange(count), count)
    shares = weights.ravel() if weights.any() else np.ones(count)  # the middle may lie behind an AREA lamp
    shares = shares / shares.sum()
    if light.kind == "SUN":
        return [np.append(v, 0.0) for v in vectors.reshape(-1, 3)], shares
    return [np.append(center + v, 1.0) for v in vectors.reshape(-1, 3)], shares


def frusta(point: F64, center: F64, radius: float, bounds: F64, size: int = SHADOW_SIZE) -> list[Frustum]:
    """The map (or six maps, when the point lies inside the sphere) that cover the subject's sphere.

    ``bounds``: (N, 3) corners of everything that casts shadows, for the near and far planes.  ``size``: texels of a map
    on a side.
    """
    if point[3] == 0.0:
        return [parallel_frustum(point[:3], center, radius, bounds, size)]
    position = point[:3]
    axis = center - position
    distance = float(np.linalg.norm(axis))
    if distance > radius * 1.2:
        half = radius / np.sqrt(distance**2 - radius**2)  # tangent of the sphere's angular radius
        return [_perspective(position, axis / distance, 1.01 * half, size)]
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    return [replace(_perspective(position, a, 1.001, size), face=i) for i, a in enumerate(axes)]


def _frame(forward: F64) -> F64:
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(right, forward), forward])


def _perspective(position: F64, forward: F64, half: float, size: int) -> Frustum:
    frame = _frame(forward)
    view = np.concatenate([frame, -(frame @ position)[:, None]], axis=1)
    # z = 0 in clip space: MIN blending sorts, not the depth test; w = depth keeps what is behind out
    clip = np.stack([view[0] / half, view[1] / half, np.zeros(4), view[2]])
    return Frustum(clip, _quad(view[2]), 2.0 * half / size, False,
                   origin=(float(position[0]), float(position[1]), float(position[2])))


def parallel_frustum(toward: F64, center: F64, radius: float, bounds: F64, size: int) -> Frustum:
    """The map of light from one direction."""
    forward = -toward / np.linalg.norm(toward)
    frame = _frame(forward)
    view = np.concatenate([frame, -(frame @ center)[:, None]], axis=1)
    view[2, 3] -= float((bounds @ view[2, :3] + view[2, 3]).min()) - radius  # depths start above zero
    width = 1.01 * radius
    clip = np.stack([view[0] / width, view[1] / width, np.zeros(4), np.array([0.0, 0.0, 0.0, 1.0])])
    return Frustum(clip, _quad(view[2]), 2.0 * width / size, True)


def _quad(row: F64) -> tuple[float, float, float, float]:
    return (float(row[0]), float(row[1]), float(row[2]), float(row[3]))


class LightVisibility:
    """Makes lit maps; holds one shadow map, which belongs to the scope."""

    def __init__(self, device: Device, mesh: MeshBuffer, occluders: Occluders, size: int = SHADOW_SIZE) -> None:
        """``size``: texels of the shadow map on a side, at most."""
        self.device, self.mesh, self.occluders, self.size = device, mesh, occluders, size
        bundles = mesh.bundles
        low, high = bundles.low.min(axis=0), bundles.high.max(axis=0)
        self.center = (low + high) / 2
        self.radius = bundles.farthest(self.center) * 1.001 + mesh.lift + 1e-6
        if len(occluders.triangles):
            others = occluders.bundles
            low, high = np.minimum(low, others.low.min(axis=0)), np.maximum(high, others.high.max(axis=0))
        self.bounds = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
        self._map = device.texture(size, size, 1)
        self._target = device.framebuffer([self._map])

    @property
    def is_closed(self) -> bool:
        """Whether no back of the mesh's triangles shows from any of 26 sides: from outside, its fronts hide them all.

        Costs about as much as 26 maps where that is so, once for a mesh.
        """
        if self.mesh.closed is None:
            self.mesh.closed = self._looks_closed()
        return self.mesh.closed

    def _looks_closed(self) -> bool:
        device, shown = self.device, 0
        sides = np.array(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3)).reshape(3, -1).T
        with device.scope():
            maps = {left_out: device.texture(CLOSED_SIDE, CLOSED_SIDE, 1) for left_out in ("back", "front")}
            for side in sides[np.abs(sides).sum(1) > 0]:
                frustum = parallel_frustum(side, self.center, self.radius, self.bounds, CLOSED_SIDE)
                for left_out, texture in maps.items():
                    with device.target([texture]) as target, device.keeping_least(), device.leaving_out(left_out):
                        target.clear(red=FAR_TEXEL)
                        self.mesh.draw_positions(
                            target, SHADOW, Projection(frustum.clip), {"u_depth_plane": frustum.plane})
                fronts, backs = map(device.read, maps.values())
                shown += int((backs < fronts - frustum.texel).sum())
                if shown > CLOSED_TEXELS:
                    return False
        return True

    def lit_maps(
        self, light: Light, cameras: list[GBufferMaps], pixels: float = inf,
    ) -> Iterator[list[moderngl.Texture]]:
        """For each camera's pixel grid, a R16F map: the share of the light that arrives, 0..1.

        ``pixels``: the diameter of the subject's sphere in the finest of the pictures; shadows are drawn as fine as
        that asks for.  A generator so that the caller may yield between shadow maps; its last item is complete.
        """
        maps = [self._new_map(camera, 1, 0.0 if light.cast_shadow else 1.0) for camera in cameras]
        if light.cast_shadow:
            points, shares = shadow_points(light, self.center, pixels)
            one = len(points) == 1
            size = self._fit(pixels * (PIXEL_TEXELS if one else SOFT_PIXEL_TEXELS))
            with self.device.scope():
                sums = maps if one else [self._new_map(camera, 2, 0.0) for camera in cameras]
                for point, share in zip(points, shares, strict=True):
                    for frustum in frusta(point, self.center, self.radius, self.bounds, size):
                        self._draw_shadow(frustum)
                        for camera, of_camera in zip(cameras, sums, strict=True):
                            self._look_up(frustum, camera, of_camera, None if one else share)
                    yield maps
                if not one:
                    for camera, of_camera, lit in zip(cameras, sums, maps, strict=True):
                        with self.device.target([lit]) as target:
                            self.device.draw(
                                "observe/lit_share.frag", target, Inputs({"u_sums": of_camera}), cells=camera.cells)
        yield maps

    def _new_map(self, camera: GBufferMaps, numbers: int, value: float) -> moderngl.Texture:
        """Of a camera's pixels, half floats."""
        made = self.device.texture(camera.position.width, camera.position.height, numbers, dtype="f2")
        with self.device.target([made]) as target:
            target.clear(red=value, green=value)
        return made

    def _fit(self, texels: float) -> int:
        """Make the shadow map as large as that asks for; returns its size."""
        size = min(max(ceil(min(texels, self.size) / SIZE_STEP) * SIZE_STEP, LEAST_SIZE), self.size)
        if size != self._map.width:
            self._target.release()
            self._map.release()
            self._map = self.device.texture(size, size, 1)
            self._target = self.device.framebuffer([self._map])
        return size

    def _draw_shadow(self, frustum: Frustum) -> None:
        self._target.clear(red=FAR_TEXEL)
        projection, uniforms = Projection(frustum.clip), {"u_depth_plane": frustum.plane}
        with self.device.keeping_least():
            self.mesh.draw_positions(self._target, SHADOW, projection, uniforms)
            self.occluders.draw(self._target, SHADOW, projection, uniforms)

    def _look_up(self, frustum: Frustum, camera: GBufferMaps, lit: moderngl.Texture, share: float | None) -> None:
        """Add a point's light to a camera's map, or to its sums where the lamp has several."""
        several: dict[str, object] = {} if share is None else {"u_share": share}
        with self.device.target([lit]) as target, self.device.adding():
            self.device.draw("observe/lit.frag", target, Inputs({
                "u_position": camera.position, "u_normal": camera.normal, "u_facet": camera.facet,
                "u_shadow": self._map,
            }, uniforms={
                "u_shadow_clip": column_major(frustum.clip), "u_depth_plane": frustum.plane,
                "u_texel": frustum.texel, "u_parallel": frustum.parallel,
                "u_face": frustum.face, "u_origin": frustum.origin, **several,
            }, defines={"SEVERAL": "1"} if several else {}), cells=camera.cells)
