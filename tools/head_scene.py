"""The head scan as a scene with known truth: its mesh and colours, a two-lobe paint of ours, cameras, lamps, Cycles.

For tools/head_experiment.py.  Units are metres (a real head's size); the face looks along -Y.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from irpso_addon.blender.material import material
from irpso_addon.blender.sample.demo import read_render
from irpso_addon.blender.scene.scene_mesh import read_mesh
from irpso_addon.core.data import F32, Bool, Maps, SceneData, Solution
from irpso_addon.core.errors import BadInput
from irpso_addon.core.images.colour import srgb_to_linear
from irpso_addon.core.images.image_file import open_image
from irpso_addon.core.resampling import at_size
from irpso_addon.gpu.device import thread
from irpso_addon.solve import one_round

NAME = "Head"
MESH, COLOURS = "LeePerrySmith.glb", "Map-COL.jpg"
TRUTH = 512  # texels of the true maps
UNIT = 0.05  # metres: of the scan's, so that the head is 0.22 m high
FACE = (0.0, -0.055, 0.07)  # metres: what cameras and lamps look at
DISTANCE, LENS, LAMPS_AT, WATTS = 1.1, 140.0, 0.9, 12.0  # metres, mm, metres, watts
VIEWPOINTS = ((0.0, 0.05), (0.62, 0.12), (-0.62, 0.0))  # of the cameras: turn and pitch, radians
CONE = math.radians(68)  # lamps stand this far round the face's front at most
HELD_OUT = "Lamp held out"
HELD_OUT_AT = (0.45, 0.62)  # its turn and pitch
ONE_IMAGE_AT = (-0.32, 0.34)  # of the one lamp of the paper's setting
# Scan units: (centre), (radii) of the places that are painted apart; +-: also mirrored in x.
FOREHEAD = ((0.0, -2.1, 2.55), (0.85, 0.8, 0.5))
NOSE = ((-0.03, -2.35, 1.25), (0.3, 0.6, 0.55))
LIPS = ((-0.03, -2.2, 0.33), (0.5, 0.5, 0.2))
CHIN = ((0.0, -2.2, -0.35), (0.45, 0.5, 0.3))
CHEEK = ((1.05, -1.6, 0.95), (0.5, 0.6, 0.42))
LIDS = ((0.85, -1.8, 1.8), (0.4, 0.5, 0.16))


@dataclass(frozen=True)
class Truth:
    """The true maps, (n, n, 3), row 0 at the bottom, defined on all texels."""

    base: F32  # linear
    lobes: F32  # roughness1, roughness2, weight of lobe 1


def build(folder: Path, cameras: int, lamps: int, pixels: int, samples: int) -> Truth:
    """Make the scene in place of what is open.  Raises BadInput where the scan is not in ``folder``."""
    for name in (MESH, COLOURS):
        if not (folder / name).is_file():
            raise BadInput(f"{folder}: holds no {name}; give the head scan's folder (see docs/head.md)")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    head = _load(folder / MESH)
    _add_cameras(cameras)
    for i in range(lamps):
        _add_lamp(f"Lamp {i + 1:02d}", *_on_spiral(i, lamps))
    _add_lamp("Lamp one image", *ONE_IMAGE_AT)
    _add_lamp(HELD_OUT, *HELD_OUT_AT)
    _set_up(bpy.context.scene, pixels, samples)
    position, _ = texels(head, TRUTH)
    return Truth(_colours(folder / COLOURS), paint(position / UNIT))


def paint(p: F32) -> F32:
    """(h, w, 3) roughness1, roughness2 and weight of lobe 1 at places of the scan (h, w, 3), in its units.

    Skin that shines on forehead, nose and lips (sharper, and more of the sharp lobe), powdered cheeks with hardly
    any of it, and a neck where the two lobes are nearly one: there they cannot be told apart.
    """
    oil = np.clip(_blob(p, FOREHEAD) + _blob(p, NOSE) + 0.5 * _blob(p, CHIN), 0, 1)
    lips, lids = _blob(p, LIPS), _mirrored(p, LIDS)
    powder = _mirrored(p, CHEEK)
    neck = 1 / (1 + np.exp((p[..., 2] + 0.75) / 0.18)) * np.ones_like(oil)
    x, y, z = np.moveaxis(p, -1, 0)
    wave = 0.5 * (np.sin(2.3 * x + 1.1 * z) * np.sin(1.9 * z - 0.7 * y + 0.5) + np.sin(3.7 * z + 1.3 * x))
    first = 0.32 - 0.08 * oil - 0.07 * lips - 0.03 * lids + 0.03 * powder + 0.015 * wave
    second = 0.60 - 0.08 * oil - 0.06 * lips + 0.08 * powder + 0.03 * wave
    second += (1.12 * first - second) * neck
    weight = 0.45 + 0.25 * oil + 0.22 * lips + 0.1 * lids - 0.38 * powder + 0.05 * wave
    return np.stack([first, second, np.clip(weight, 0.04, 0.95)], -1).astype(np.float32)


def texels(head: bpy.types.Object, size: int) -> tuple[F32, Bool]:
    """World position of each texel (n, n, 3), carried on past the borders of the UV islands, and which are covered."""
    mesh = read_mesh(head, bpy.context.evaluated_depsgraph_get(), {}, print)
    scene = SceneData(NAME, mesh, np.zeros((0, 3, 3), np.float32), ())
    buffers: one_round.GBuffer = thread.run(lambda: one_round.bake_gbuffer(scene, size))
    position, known = buffers.position.copy(), buffers.coverage.copy()
    for _ in range(4):
        near = [(np.roll(position * known[..., None], (dy, dx), (0, 1)), np.roll(known, (dy, dx), (0, 1)))
                for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        count = sum(k.astype(int) for _, k in near)
        grown = ~known & (count > 0)
        position[grown] = sum(p for p, _ in near)[grown] / count[grown, None]
        known |= grown
    return position, buffers.coverage


def wear(maps: Maps, *, in_pixels: bool) -> None:
    """Put two-lobe maps on the head as the product does; ``in_pixels``: they are maps of the camera's pixels."""
    head = bpy.data.objects[NAME]
    for old in list(bpy.data.materials):
        bpy.data.materials.remove(old)
    fresh = bpy.data.materials.new(NAME)
    if bpy.app.version < (5, 0):
        fresh.use_nodes = True
    head.data.materials.clear()
    head.data.materials.append(fresh)
    model = "two-lobe" if maps.lobes is not None else "one-lobe"
    material.write_maps(head, Solution(
        maps=maps, model={NAME: model}, why={}, texels={}, seconds={}, residual=0.0, views_used=(), views_skipped=(),
        warnings=(), device={}))
    if in_pixels:
        nodes, links = fresh.node_tree.nodes, fresh.node_tree.links
        window = nodes.new("ShaderNodeTexCoord").outputs["Window"]
        for node in [node for node in nodes if node.bl_idname == "ShaderNodeTexImage"]:
            node.interpolation = "Closest"
            links.new(window, node.inputs["Vector"])


def strip() -> None:
    """A plain material: what a solver is given."""
    plain = np.full((4, 4, 3), 0.5, np.float32)
    wear(bare_maps(plain, plain), in_pixels=False)


def bare_maps(base: F32, lobes: F32) -> Maps:
    """Maps that say nothing of how good they are."""
    none = np.zeros(base.shape[:2], np.float32)
    return Maps(base_color=base, roughness=lobes[..., 0], confidence=none, error=none, filled=none > 0,
                coverage=none == 0, roughness_sigma=none, base_sigma=none, lobes=lobes)


def cameras() -> list[str]:
    """Names of the cameras."""
    return [obj.name for obj in bpy.context.scene.objects if obj.type == "CAMERA"]


def lamps() -> list[str]:
    """Names of the lamps that views are taken with, the paper's one and the one held out aside."""
    return [obj.name for obj in bpy.context.scene.objects if obj.type == "LIGHT" and obj.name[-1].isdigit()]


def render(path: Path, camera: str, lamp: str) -> F32:
    """One picture with one lamp on, (h, w, 4) premultiplied radiance and coverage, row 0 at the bottom."""
    scene = bpy.context.scene
    for obj in scene.objects:
        if obj.type == "LIGHT":
            obj.hide_render = obj.name != lamp
    scene.camera, scene.render.filepath = scene.objects[camera], str(path.resolve())
    bpy.ops.render.render(write_still=True)
    for obj in scene.objects:
        obj.hide_render = False
    return read_render(path)


def write_captures(path: Path, views: Mapping[str, tuple[str, str]]) -> None:
    """captures.json: image -> camera and lamp."""
    found = [{"image": image, "camera": camera, "lights": [lamp]} for image, (camera, lamp) in views.items()]
    path.write_text(json.dumps({"views": found}, indent=1) + "\n", encoding="utf-8")


# ---- the scene


def _load(path: Path) -> bpy.types.Object:
    """The scan's mesh alone, in metres, named and placed; its texture rows are stored upside down."""
    bpy.ops.preferences.addon_enable(module="io_scene_gltf2")
    bpy.ops.import_scene.gltf(filepath=str(path.resolve()), loglevel=50)
    head = next(obj for obj in bpy.context.scene.objects if obj.type == "MESH")
    head.matrix_world = Matrix.Scale(UNIT, 4) @ head.matrix_world.copy()
    head.parent = None
    for other in [obj for obj in bpy.data.objects if obj is not head]:
        bpy.data.objects.remove(other)
    head.name = NAME
    layer = head.data.uv_layers.active.data
    uv = np.empty(2 * len(layer), np.float32)
    layer.foreach_get("uv", uv)
    uv[1::2] = 1 - uv[1::2]
    layer.foreach_set("uv", uv)
    bpy.context.view_layer.update()
    return head


def _colours(path: Path) -> F32:
    """The scan's colour map, linear, as block means of TRUTH x TRUTH texels."""
    file = open_image(path)
    linear = srgb_to_linear(file.read(0, file.height)[::-1, :, :3])
    return np.clip(at_size(linear, TRUTH), 0.02, 0.9).astype(np.float32)


def _blob(p: F32, place: tuple[tuple[float, ...], tuple[float, ...]]) -> F32:
    """1 in the middle of a place, fading to 0 (Gaussian)."""
    centre, radii = (np.array(values, np.float32) for values in place)
    return np.exp(-0.5 * (((p - centre) / radii) ** 2).sum(-1))


def _mirrored(p: F32, place: tuple[tuple[float, ...], tuple[float, ...]]) -> F32:
    (x, y, z), radii = place
    return np.clip(_blob(p, place) + _blob(p, ((-x, y, z), radii)), 0, 1)


def _direction(turn: float, pitch: float) -> Vector:
    """From the face; (0, 0) is straight ahead, a positive turn to the right of the picture."""
    return Vector((math.sin(turn) * math.cos(pitch), -math.cos(turn) * math.cos(pitch), math.sin(pitch)))


def _on_spiral(i: int, count: int) -> tuple[float, float]:
    """Turn and pitch of lamp ``i`` of ``count``: a Fibonacci spiral on the cap of directions within CONE."""
    away = 1 - (1 - math.cos(CONE)) * (i + 0.5) / count
    ring, angle = math.sqrt(1 - away * away), 2.399963 * i
    return math.atan2(ring * math.cos(angle), away), math.asin(ring * math.sin(angle))


def _add_cameras(count: int) -> None:
    for i, (turn, pitch) in enumerate(VIEWPOINTS[:count]):
        data = bpy.data.cameras.new(f"Camera {i + 1}")
        data.lens, data.clip_start = LENS, 0.01
        _add(data, _direction(turn, pitch) * DISTANCE)


def _add_lamp(name: str, turn: float, pitch: float) -> None:
    data = bpy.data.lights.new(name, "POINT")
    data.energy, data.shadow_soft_size = WATTS, 0.0
    _add(data, _direction(turn, pitch) * LAMPS_AT)


def _add(data: bpy.types.ID, offset: Vector) -> None:
    """An object of the data's name at ``offset`` from the face, looking at it."""
    obj = bpy.data.objects.new(data.name, data)
    obj.location = Vector(FACE) + offset
    obj.rotation_euler = (-offset).to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(obj)


def _set_up(scene: bpy.types.Scene, pixels: int, samples: int) -> None:
    """Linear references: direct light only, a pixel the mean over its square, nothing clamped."""
    scene.world = None
    settings, cycles = scene.render, scene.cycles
    settings.engine, settings.film_transparent, settings.use_persistent_data = "CYCLES", True, True
    settings.resolution_x = settings.resolution_y = pixels
    settings.resolution_percentage = 100
    settings.image_settings.file_format, settings.image_settings.color_mode = "OPEN_EXR", "RGBA"
    settings.image_settings.color_depth = "32"
    cycles.device, cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = "CPU", samples, False, False
    cycles.max_bounces = 0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.light_sampling_threshold = cycles.blur_glossy = 0
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0
