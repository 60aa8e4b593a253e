"""What the rivals need of a capture, and what judges them: mesh, cameras and lights; which texels count; the truth.

  python studies/bench/capture_judge.py CAPTURE OUT        (a Python with bpy)

CAPTURE holds scene.blend, captures.json (one point light a view), refs/*.exr and truth.npz (base_color linear and
roughness, row 0 at the bottom).  Writes into OUT:

  scene.json   cameras (matrix_world, angle_x) and point lights (position, watts)
  mesh.ply     triangles with corner normals and UVs, world space
  judge.npz    on a GRID x GRID texel grid: seen, informed, base (truth), rough (truth)
  nosolver.npz base: median over the views of pi L / E per texel (E: the light's irradiance on an unshadowed Lambert
               surface), rough 0.5: what division alone gives; seconds

A texel is `seen` where at least MIN_VIEWS views see it lit: N.L > .1, N.V > .25, nothing in the way.  It is `informed`
where in one of them a highlight was near: tan(theta_h) < 1.5 alpha.  Rays are cast by mathutils' BVH, so the judge
shares no code with the product.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from irpso_addon.blender.oiio import ensure_openimageio
from irpso_addon.core.resampling import at_size, bilinear

GRID = 256
MIN_VIEWS = 3
MIN_LIGHT, MIN_VIEW = 0.1, 0.25  # N.L, N.V
LIFT = 2e-3  # metres above the surface where rays start


def main(capture: Path, out: Path) -> None:
    out.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.open_mainfile(filepath=str((capture / "scene.blend").resolve()))
    subject = next(obj for obj in bpy.data.objects if obj.type == "MESH")
    triangles = triangles_of(subject)
    write_ply(out / "mesh.ply", *triangles)
    write_scene(out / "scene.json")
    views = json.loads((capture / "captures.json").read_text())["views"]
    at, points, normals = texel_grid(*triangles)
    geometry = Geometry(triangles[0], views, points, normals)
    truth = np.load(capture / "truth.npz")
    base, rough = at_size(truth["base_color"], GRID), at_size(truth["roughness"], GRID)[..., 0]
    seen = geometry.good.sum(0) >= MIN_VIEWS
    nearest = np.where(geometry.good, geometry.tan_h, np.inf).min(0)
    informed = seen & (nearest < 1.5 * rough[at] ** 2)
    masks = {}
    for name, chosen in (("seen", seen), ("informed", informed)):
        masks[name] = np.zeros((GRID, GRID), bool)
        masks[name][at] = chosen
    np.savez_compressed(out / "judge.npz", base=base, rough=rough, **masks)
    ensure_openimageio()
    start = time.perf_counter()
    albedo = np.zeros((GRID, GRID, 3))
    albedo[at] = divide(capture, views, points, geometry)
    np.savez_compressed(out / "nosolver.npz", base=albedo, rough=np.full((GRID, GRID), 0.5),
                        seconds=time.perf_counter() - start)
    print(f"{capture.name}: {len(points)} texels, {seen.sum()} seen, {informed.sum()} informed, {len(views)} views")


def triangles_of(obj):
    """(T, 3, 3) world positions and normals, (T, 3, 2) UVs."""
    mesh = obj.data
    mesh.calc_loop_triangles()
    corners = np.array([t.loops[:] for t in mesh.loop_triangles])
    matrix = np.array(obj.matrix_world)
    vertices = np.array([v.co[:] for v in mesh.vertices])[[loop.vertex_index for loop in mesh.loops]]
    normals = np.array([n.vector[:] for n in mesh.corner_normals])
    positions = vertices @ matrix[:3, :3].T + matrix[:3, 3]
    normals = normals @ np.linalg.inv(matrix[:3, :3])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
    uvs = np.array([d.uv[:] for d in mesh.uv_layers.active.data])
    return positions[corners], normals[corners], uvs[corners]


def write_ply(path, positions, normals, uvs):
    """Binary PLY, three vertices of its own for every triangle."""
    vertices = np.concatenate([a.reshape(-1, a.shape[-1]) for a in (positions, normals, uvs)], 1).astype("<f4")
    faces = np.empty(len(positions), [("count", "u1"), ("corner", "<i4", 3)])
    faces["count"], faces["corner"] = 3, np.arange(len(vertices)).reshape(-1, 3)
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}",
            *(f"property float {name}" for name in "x y z nx ny nz u v".split()),
            f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    path.write_bytes("\n".join(head).encode() + vertices.tobytes() + faces.tobytes())


def write_scene(path):
    cameras, lights = {}, {}
    for obj in bpy.data.objects:
        if obj.type == "CAMERA":
            cameras[obj.name] = {"matrix": [list(row) for row in obj.matrix_world], "angle_x": obj.data.angle_x}
        elif obj.type == "LIGHT":
            assert obj.data.type == "POINT", f"{obj.name}: this benchmark knows point lights alone"
            lights[obj.name] = {"position": list(obj.matrix_world.translation), "watts": obj.data.energy}
    path.write_text(json.dumps({"cameras": cameras, "lights": lights}, indent=1))


def texel_grid(positions, normals, uvs):
    """Rows and columns of the texels whose centre a face covers, with their position and unit normal."""
    where = np.zeros((GRID, GRID, 3))
    facing = np.zeros((GRID, GRID, 3))
    for corner, position, normal in zip(uvs * GRID - 0.5, positions, normals, strict=True):
        low = np.maximum(np.ceil(corner.min(0)).astype(int), 0)
        high = np.minimum(np.floor(corner.max(0)).astype(int), GRID - 1)
        edges = np.stack([corner[0] - corner[2], corner[1] - corner[2]], 1)
        if (high < low).any() or abs(np.linalg.det(edges)) < 1e-12:
            continue
        y, x = np.mgrid[low[1]:high[1] + 1, low[0]:high[0] + 1]
        ab = np.linalg.solve(edges, (np.stack([x.ravel(), y.ravel()]) - corner[2][:, None]))
        weights = np.stack([ab[0], ab[1], 1 - ab[0] - ab[1]], -1)
        inside = (weights >= 0).all(1)
        at = y.ravel()[inside], x.ravel()[inside]
        where[at], facing[at] = weights[inside] @ position, weights[inside] @ normal
    length = np.linalg.norm(facing, axis=-1)
    at = np.nonzero(length > 0)
    return at, where[at], facing[at] / length[at][:, None]


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


class Geometry:
    """Per view and texel: does the view see it lit, and how near was its highlight."""

    def __init__(self, triangles, views, points, normals):
        self.points, self.normals = points, normals
        corners = [Vector(p) for p in triangles.reshape(-1, 3)]
        self.bvh = BVHTree.FromPolygons(corners, np.arange(len(corners)).reshape(-1, 3).tolist())
        names = {name for view in views for name in (view["camera"], view["lights"][0])}
        self.place = {name: np.array(bpy.data.objects[name].matrix_world.translation) for name in names}
        clear = {name: self.clear(place) for name, place in self.place.items()}
        good, tan_h = [], []
        for view in views:
            camera, light = view["camera"], view["lights"][0]
            to_eye, to_light = unit(self.place[camera] - points), unit(self.place[light] - points)
            facing = ((normals * to_light).sum(1) > MIN_LIGHT) & ((normals * to_eye).sum(1) > MIN_VIEW)
            cos_h = np.clip((normals * unit(to_eye + to_light)).sum(1), 1e-6, 1)
            good.append(clear[camera] & clear[light] & facing)
            tan_h.append(np.sqrt(1 - cos_h**2) / cos_h)
        self.good, self.tan_h = np.array(good), np.array(tan_h)

    def clear(self, place):
        """Nothing stands between a texel and the place."""
        out = np.zeros(len(self.points), bool)
        for i, (point, normal) in enumerate(zip(self.points, self.normals, strict=True)):
            origin = Vector(point + normal * LIFT)
            way = Vector(place) - origin
            if way.dot(Vector(normal)) > 0:
                out[i] = self.bvh.ray_cast(origin, way.normalized(), way.length)[0] is None
        return out


def divide(capture, views, points, geometry):
    """Median over the views that see a texel lit of pi L / E, (N, 3); 0.5 where none does."""
    import OpenImageIO as oiio
    from bpy_extras.object_utils import world_to_camera_view

    found = np.full((len(views), len(points), 3), np.nan)
    for i, view in enumerate(views):
        buffer = oiio.ImageBuf(str(capture / view["image"]))
        picture = np.asarray(buffer.get_pixels(oiio.FLOAT))[::-1]
        camera = bpy.data.objects[view["camera"]]
        place = np.array([world_to_camera_view(bpy.context.scene, camera, Vector(p))[:2] for p in points])
        light = bpy.data.objects[view["lights"][0]]
        to_light = geometry.place[light.name] - points
        square = (to_light**2).sum(1)
        cos_l = (geometry.normals * to_light).sum(1) / np.sqrt(square)
        # A point light of W watts has intensity W / (4 pi) in every direction.
        irradiance = light.data.energy * cos_l / (4 * np.pi * square)
        radiance = bilinear(picture[..., :3], place)
        found[i] = np.where(geometry.good[i][:, None], np.pi * radiance / irradiance[:, None], np.nan)
    some = geometry.good.any(0)
    out = np.full((len(points), 3), 0.5)
    out[some] = np.nanmedian(found[:, some], axis=0)
    return np.clip(out, 0, 1)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
