"""A small scene with everything that the add-on reads from a .blend, and that reading."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from random import Random
from typing import Any

import bpy
import numpy as np

from irpso_addon.blender import files
from irpso_addon.blender.jobs import solve_region
from irpso_addon.blender.material import material, material_preflight
from irpso_addon.blender.material.tags import TAG
from irpso_addon.blender.scene import readiness
from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.core.data import Maps, SceneData, Solution
from irpso_addon.core.errors import BadInput
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading.lights import light_irradiance, light_uniforms
from irpso_addon.core.tiled import uv_blocks

SIZE = 8  # texels of the maps
CAPTURES = "captures.json"


def prepare(folder: Path) -> list[Path]:
    """.blend files below ``folder``: the scene, the same with maps on it, and one that is linked from another."""
    folder = folder / "bases"
    folder.mkdir()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    files.properties.register()
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_uv_sphere_add(segments=8, ring_count=5, radius=1)
    subject = bpy.context.object
    subject.name = "Subject"
    group = subject.vertex_groups.new(name="part")
    group.add([0, 1, 2, 3, 4, 5], 1.0, "REPLACE")
    for name in ("Paint", "Other"):
        paint = bpy.data.materials.new(name)
        if paint.node_tree is None:
            paint.use_nodes = True
        subject.data.materials.append(paint)
        _normal_map(paint)
    for polygon in subject.data.polygons:
        polygon.material_index = polygon.index % 2
    bpy.ops.mesh.primitive_cube_add(size=1, location=(0, 0, -2))
    bpy.context.object.name = "Floor"
    for i, kind in enumerate(("POINT", "SUN", "SPOT", "AREA")):
        _add(kind.title(), bpy.data.lights.new(kind.title(), kind), (i - 1.5, -2, 3))
    for i in range(2):
        camera = _add(f"Camera {i}", bpy.data.cameras.new(f"Camera {i}"), (0, -4 - i, 0))
        camera.rotation_euler.x = 1.5708
        camera.data.type = ("PERSP", "ORTHO")[i]
    scene.render.resolution_x, scene.render.resolution_y, scene.render.engine = 36, 24, "CYCLES"
    bpy.context.view_layer.objects.active = subject
    (folder / CAPTURES).write_text(json.dumps({"views": [
        {"image": "a.exr", "camera": "Camera 0", "lights": ["Point", "Sun"]},
        {"image": "b.exr", "camera": "Camera 1", "lights": ["Spot", "Area"], "exposure": 1.0}]}), encoding="utf-8")
    for i in range(2):
        view = scene.irpso.views.add()
        view.image, view.camera, view.mask = f"//{'ab'[i]}.exr", bpy.data.objects[f"Camera {i}"], "//mask.png"[:10 * i]
        view.lights.add().light = bpy.data.objects["Point"]
    background = bpy.data.objects["Camera 0"].data.background_images.new()
    background.image = bpy.data.images.new("background", 4, 4)
    background.image.source, background.image.filepath = "FILE", "//a.exr"
    made = [folder / "plain.blend", folder / "solved.blend", folder / "linking.blend"]
    bpy.ops.wm.save_as_mainfile(filepath=str(made[0]), copy=True)
    material.write_maps(subject, solution([slot.material.name for slot in subject.material_slots]))
    bpy.ops.wm.save_as_mainfile(filepath=str(made[1]), copy=True)
    _linking(made[0], made[2])
    return made


def _add(name: str, data: Any, place: tuple[float, float, float]) -> Any:
    obj = bpy.data.objects.new(name, data)
    obj.location = place
    bpy.context.scene.collection.objects.link(obj)
    return obj


def _normal_map(paint: Any) -> None:
    tree = paint.node_tree
    texture, bump = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeNormalMap")
    texture.image = bpy.data.images.new(f"normals of {paint.name}", 4, 4, is_data=True)
    texture.image.generated_color = (0.5, 0.5, 1.0, 1.0)
    tree.links.new(texture.outputs["Color"], bump.inputs["Color"])
    tree.links.new(bump.outputs["Normal"], tree.nodes["Principled BSDF"].inputs["Normal"])


def _linking(library: Path, path: Path) -> None:
    """A file whose objects lie in ``library``."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(library), link=True, relative=False) as (there, here):
        here.objects = list(there.objects)
    for obj in here.objects:
        bpy.context.scene.collection.objects.link(obj)
    bpy.context.scene.render.resolution_x, bpy.context.scene.render.resolution_y = 36, 24
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True, relative_remap=False)


def solution(names: list[str], lobes: bool = False) -> Solution:
    """Maps such as a solve gives."""
    grey, flags = np.full((SIZE, SIZE), 0.5, np.float32), np.ones((SIZE, SIZE), bool)
    kinds = {"F32": grey, "Bool": flags}
    values: dict[str, Any] = {f.name: kinds.get(str(f.type)) for f in fields(Maps)}
    values["base_color"] = np.full((SIZE, SIZE, 3), 0.5, np.float32)
    values["lobes"] = values["base_color"] if lobes else None
    model = "two-lobe" if lobes else "one-lobe"
    return Solution(
        maps=Maps(**values), model=dict.fromkeys(names, model), why={}, texels={}, seconds={}, residual=0.0,
        views_used=(), views_skipped=(), warnings=(), device={})


def everything() -> Iterator[Any]:
    """All that has a name in the open file."""
    for collection in ("objects", "meshes", "materials", "images", "cameras", "lights", "scenes", "worlds",
                       "node_groups", "libraries"):
        yield from getattr(bpy.data, collection)


def read(rng: Random, folder: Path) -> None:
    """What commands and panels read of the open file.  Raises BadInput where a solve would."""
    readiness.survey(bpy.context)
    settings = getattr(bpy.context.scene, "irpso", None)
    if settings is not None and rng.random() < 0.3:
        files.properties.settings(settings)
    first: BadInput | None = None
    for step in (_maps, lambda: _scene(rng, folder)):
        try:
            step()
        except BadInput as error:
            first = first or error
    if first is not None:
        raise first


def _maps() -> None:
    if not any(obj.get(TAG) for obj in bpy.data.objects):
        return
    obj = files.solved_object(None)
    maps = files.read_maps(obj)
    assert maps.roughness.ndim == 2 and maps.base_color.shape == (*maps.roughness.shape, 3)


def _scene(rng: Random, folder: Path) -> None:
    name = rng.choice((None, "Subject", rng.choice([o.name for o in bpy.data.objects] or [""])))
    data = read_scene(None, name, rng.choice((None, None, folder / CAPTURES)))
    check(data)
    subject = files.object_named(data.mesh.name)
    material_preflight.check(subject, data.mesh.slots)
    part = rng.choice((("ALL", None), ("GROUP", "part"), ("GROUP", ""), ("FACES", None)))
    data = solve_region.with_part(None, subject, data, rng.choice(("anew", "last")), *part)
    SolveSettings()
    names = [slot.material.name if slot.material else "" for slot in subject.material_slots] or [""]
    if rng.random() < 0.5:
        try:
            material.write_maps(subject, solution(names, rng.random() < 0.5))
        except BadInput as error:
            raise AssertionError(f"homeless maps: {error}") from error  # writable.check said that they can go there


def check(data: SceneData) -> None:
    """The contract of core/data.py."""
    mesh, count = data.mesh, len(data.mesh.positions)
    assert count and mesh.positions.shape == mesh.normals.shape == (count, 3, 3) and mesh.uvs.shape == (count, 3, 2)
    for what, array in (("positions", mesh.positions), ("normals", mesh.normals), ("uvs", mesh.uvs),
                        ("occluders", data.occluders)):
        assert array.dtype == np.float32 and np.isfinite(array).all(), what
    assert mesh.slots.min() >= 0 and mesh.slots.max() < len(mesh.slot_names)
    for normals in mesh.normal_maps.values():
        assert normals.pixels.ndim == 3 and np.isfinite(normals.pixels).all() and np.isfinite(normals.strength)
    assert mesh.tangents is None or np.isfinite(mesh.tangents).all()
    assert np.isfinite(data.pixel_filter) and data.pixel_filter > 0
    assert data.views
    for udim in ("first", "all"):
        with contextlib.suppress(BadInput):  # far too many squares
            assert len(uv_blocks.solved_udims(udim, mesh.uvs)) <= uv_blocks.MOST_UDIMS
    point, normal = mesh.positions[:4].mean(1), mesh.normals[:4, 0]
    for view in data.views:
        camera = view.camera
        assert np.isfinite(camera.world_to_camera).all() and np.isfinite(camera.projection).all()
        assert np.linalg.det(camera.projection) and 0 < camera.aspect < 1e6
        assert np.isfinite(2.0**view.exposure) and np.isfinite(view.gain) and view.gain > 0
        assert view.lights
        for light in view.lights:
            assert np.isfinite(light.power).all() and np.isfinite(light.matrix).all()
            values = [np.asarray(v, np.float64) for v in light_uniforms(light).values()]
            assert all(np.isfinite(value).all() for value in values), light
            with np.errstate(all="ignore"):
                light_irradiance(light, point, normal)
