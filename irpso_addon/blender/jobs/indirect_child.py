"""What the second Blender does (see indirect.py): put the maps on the object, render passes, write files."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.data import Coat, Maps, Solution
from ...core.images.image_writer import write_image
from ...core.maps.export import as_stored, layers
from ...core.tiled import uv_blocks
from .. import properties
from ..glow import shines
from ..material import material
from ..scene.camera_lens import read_lens
from ..second_blender import as_child

BOUNCES = 4  # where the file renders direct light alone


def main(name: str) -> None:
    """Does the job in the folder ``name`` and ends the process; says in one line on stderr why it could not."""
    as_child(lambda: _render(Path(name)))


def _render(folder: Path) -> None:
    """From job.json and maps.npz to 0.exr, 1.exr, ..."""
    job: dict[str, Any] = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    if not hasattr(bpy.types.Camera, "irpso_lens"):
        properties.register()
    bpy.ops.wm.open_mainfile(filepath=job["blend"], load_ui=False)
    scene = bpy.data.scenes[job["scene"]]
    with np.load(folder / "maps.npz") as arrays:
        _wear(bpy.data.objects[job["object"]], _solution(job, dict(arrays)), tuple(job["udims"]), folder)
    _set_up(scene, job)
    rendered = scene.render.resolution_x, scene.render.resolution_y
    glowing = [obj for obj in scene.objects if obj.name != job["object"] and shines(obj)]
    slots_of = {obj.name: _slots(obj) for obj in glowing}
    turned = _turntable(scene) if any(turn for *_, turn in job["pictures"]) else None
    for n, (camera, lamps, world, emitters, turn) in enumerate(job["pictures"]):
        if turned is not None:
            turned.rotation_euler.z = -turn
        if job["known_world"]:
            scene.world = bpy.data.worlds[world] if world else None
        scene.camera = bpy.data.objects[camera]
        lens = read_lens(scene.camera.data)
        scene.render.resolution_x, scene.render.resolution_y = (
            rendered if lens is None else _small(lens.width, lens.height, job["side"]))
        for obj in scene.objects:
            if obj.type == "LIGHT":
                obj.hide_render = obj.name not in (*lamps, *emitters)  # wide lamps are emitters
        for name, slots in slots_of.items():
            for slot, lit, dark in slots:
                slot.material = lit if name in emitters else dark
        scene.cycles.seed = n
        scene.render.filepath = str(folder / "rendering.exr")
        bpy.ops.render.render(write_still=True, scene=scene.name)
        os.replace(folder / "rendering.exr", folder / f"{n}.exr")


def _wear(obj: Any, solution: Solution, udims: tuple[int, ...], folder: Path) -> None:
    """Put the maps on the object; those that hold several ``udims`` side by side as files in ``folder``."""
    if not udims:
        material.write_maps(obj, solution)
        return
    maps = solution.maps
    size = len(maps.base_color)
    layout, files = uv_blocks.layout(size, udims), material.files_of(obj.name, maps, folder, "exr", udims)
    for layer, values in layers(maps).items():
        if len(values) == size:  # others are shown nowhere
            for udim in udims:
                square = as_stored(layer, layout.square_of(values, udim))
                write_image(files.of(layer, udim), square, kind="exr", color=layer == "basecolor")
    material.link_files(obj, solution, files)


def _turntable(scene: Any) -> Any:
    """An empty that holds all objects: turned, the world is turned about them the other way."""
    table = bpy.data.objects.new("Turntable", None)
    for obj in [obj for obj in scene.objects if obj.parent is None]:
        own = obj if obj.library is None else obj.make_local()
        own.parent = table
        own.matrix_parent_inverse.identity()
    scene.collection.objects.link(table)
    return table


def _slots(obj: Any) -> list[tuple[Any, Any, Any]]:
    """Slots of an object, with their materials as they are and without light."""
    obj = obj if obj.library is None else obj.make_local()
    found = []
    for slot in obj.material_slots:
        material = slot.material
        if material is not None and material.node_tree is not None:
            slot.link = "OBJECT"  # else the slots of the other objects with this mesh would change as well
            found.append((slot, material, _dark(material)))
    return found


def _dark(material: Any) -> Any:
    """A copy that does not glow."""
    copy = material.copy()
    for node in copy.node_tree.nodes:
        strength = {"EMISSION": "Strength", "BSDF_PRINCIPLED": "Emission Strength"}.get(node.type)
        if strength is not None:
            for link in list(node.inputs[strength].links):
                copy.node_tree.links.remove(link)
            node.inputs[strength].default_value = 0.0
    return copy


def _solution(job: dict[str, Any], arrays: dict[str, Any]) -> Solution:
    """What `material.write_maps` needs of a solution.  Maps that no node shows are empty."""
    rough, none = arrays["roughness"], np.zeros((1, 1), np.float32)
    maps = Maps(
        base_color=arrays["base_color"], roughness=rough if rough.ndim == 2 else rough[..., 0], confidence=none,
        error=none, filled=none > 0, coverage=none > 0, roughness_sigma=none, base_sigma=none,
        lobes=None if rough.ndim == 2 else rough, specular=arrays.get("specular"),
        metallic=arrays.get("metallic"))
    coats = {name: Coat(*values) for name, values in job["coats"].items()}
    return Solution.of_maps(maps, job["model"], job["levels"], job["ndf"], metallic=job["metallic"], coats=coats,
                             paint=job["paint"], diffuse_roughness=job["diffuse_roughness"])


def _small(width: float, height: float, side: int) -> tuple[int, int]:
    """Of a picture whose longer side is at most ``side``."""
    scale = min(1.0, side / max(width, height))
    return max(4, round(width * scale)), max(4, round(height * scale))


def _set_up(scene: Any, job: dict[str, Any]) -> None:
    """Small pictures of pixel centres: all light that there is, nothing clamped."""
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y = _small(
        render.resolution_x * render.resolution_percentage / 100,
        render.resolution_y * render.resolution_percentage / 100, job["side"])
    render.resolution_percentage = 100
    render.use_border = render.use_multiview = render.use_compositing = render.use_sequencer = False
    render.use_motion_blur = render.use_freestyle = False
    render.use_persistent_data, render.use_file_extension = True, False
    if hasattr(render.image_settings, "media_type"):  # Blender 5
        render.image_settings.media_type = "MULTI_LAYER_IMAGE"
    render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    render.image_settings.color_depth, render.image_settings.exr_codec = "32", "NONE"
    cycles.device, cycles.samples = "CPU", job["samples"]
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.light_sampling_threshold = cycles.blur_glossy = 0
    cycles.pixel_filter_type, cycles.filter_width, cycles.film_exposure = "BOX", 0.01, 1.0
    if cycles.max_bounces == 0:  # else the file says how its references were rendered
        cycles.max_bounces = BOUNCES
        cycles.diffuse_bounces, cycles.glossy_bounces = BOUNCES, BOUNCES
    for layer in scene.view_layers:
        layer.use = layer.name == job["view_layer"]
        for name in ("diffuse_direct", "diffuse_indirect", "diffuse_color", "glossy_direct", "glossy_indirect",
                     "glossy_color", "object_index"):
            setattr(layer, f"use_pass_{name}", True)
    for obj in scene.objects:
        obj.pass_index = int(obj.name == job["object"])
