"""A scene whose pixels Cycles renders without noise or filter, and its float passes back as arrays."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import OpenImageIO
from mathutils import Matrix, Vector

from irpso_addon.blender.scene.scene_objects import read_light
from irpso_addon.core.data import Light


def scene(pixels: int, samples: int = 1) -> Any:
    """An empty, black scene: one sample at each pixel's centre, no bounces, no clamping."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    made = bpy.context.scene
    made.render.engine = "CYCLES"
    made.render.resolution_x = made.render.resolution_y = pixels
    made.render.use_compositing = made.render.use_sequencer = False
    cycles = made.cycles
    cycles.device, cycles.samples, cycles.seed = "CPU", samples, 1
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.pixel_filter_type, cycles.filter_width = "BLACKMAN_HARRIS", 0.01  # of a box the width is ignored
    cycles.max_bounces = 0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.light_sampling_threshold = 0
    layer = made.view_layers[0]
    layer.use_pass_normal = layer.use_pass_position = True
    settings = made.render.image_settings
    if hasattr(settings, "media_type"):  # 5.0 on
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
    return made


def add(name: str, data: Any, position: Any, target: Any = (0, 0, 0), scale: Any = (1, 1, 1)) -> Any:
    """An object at ``position`` whose -Z points at ``target``."""
    made = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(made)
    turn = (Vector(target) - Vector(position)).to_track_quat("-Z", "Y")
    made.matrix_world = Matrix.LocRotScale(Vector(position), turn, Vector(scale))
    return made


def camera(position: Any, target: Any = (0, 0, 0), degrees: float = 50.0) -> None:
    data = bpy.data.cameras.new("camera")
    data.angle, data.clip_start = np.radians(degrees), 1e-3
    bpy.context.scene.camera = add("camera", data, position, target)


def lamp(kind: str, position: Any, target: Any = (0, 0, 0), scale: Any = (1, 1, 1), **settings: Any) -> Any:
    data = bpy.data.lights.new("lamp", kind)
    data.energy = 100.0
    if kind in {"POINT", "SPOT"}:
        data.shadow_soft_size = 0.0
    for name, value in settings.items():
        setattr(data, name, value)
    return add("lamp", data, position, target, scale)


def as_light(obj: Any) -> Light:
    """The lamp as the add-on reads it; a warning fails the test."""
    bpy.context.view_layer.update()

    def warn(text: str) -> None:
        raise AssertionError(text)

    return read_light(obj, bpy.context.evaluated_depsgraph_get(), warn)


def plane(half: float = 20.0) -> Any:
    mesh = bpy.data.meshes.new("plane")
    mesh.from_pydata([(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)], [], [(0, 1, 2, 3)])
    made = bpy.data.objects.new("plane", mesh)
    bpy.context.scene.collection.objects.link(made)
    return made


def sphere(radius: float = 1.0) -> Any:
    """A smooth sphere, fine enough that its facets do not show in shading points.

    From arrays: Blender's own operator takes two seconds for one as fine.
    """
    columns, rings = 256, 128
    phi, theta = (np.arange(columns) * 2 * np.pi / columns)[None], (np.arange(1, rings) * np.pi / rings)[:, None]
    circles = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi], -1)
    points = np.concatenate([circles.reshape(-1, 3), [(0, 0, 1), (0, 0, -1)]])
    here = np.arange((rings - 1) * columns).reshape(rings - 1, columns)
    right = np.roll(here, -1, axis=1)
    faces = np.stack([here[:-1], here[1:], right[1:], right[:-1]], -1).reshape(-1, 4).tolist()
    faces += [(len(points) - 2, a, b) for a, b in zip(here[0].tolist(), right[0].tolist(), strict=True)]
    faces += [(len(points) - 1, b, a) for a, b in zip(here[-1].tolist(), right[-1].tolist(), strict=True)]
    mesh = bpy.data.meshes.new("sphere")
    mesh.from_pydata((radius * points).tolist(), [], faces)
    mesh.shade_smooth()
    made = bpy.data.objects.new("sphere", mesh)
    bpy.context.scene.collection.objects.link(made)
    return made


def principled(obj: Any, base: Any, roughness: float, specular: float = 0.5) -> Any:
    """Give ``obj`` the Principled BSDF; returns its node."""
    material = bpy.data.materials.new("material")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    node = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    node.inputs["Base Color"].default_value = (*base, 1)
    node.inputs["Roughness"].default_value = roughness
    node.inputs["Specular IOR Level"].default_value = specular
    obj.data.materials.clear()
    obj.data.materials.append(material)
    return node


def render() -> dict[str, np.ndarray]:
    """Radiance "rgb", world "position" and unit shading "normal", (h, w, 3) float64; row 0 is the top."""
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "out.exr")
        settings = bpy.context.scene.render
        settings.filepath, settings.use_file_extension = path, False
        bpy.ops.render.render(write_still=True)
        found: dict[str, np.ndarray] = {}
        part = 0
        while True:  # 5.0 on writes one part a pass, 4.5 all passes in one
            buffer = OpenImageIO.ImageBuf(path, part, 0)
            if buffer.has_error or not buffer.spec().nchannels:
                break
            pixels = buffer.get_pixels(OpenImageIO.FLOAT)
            found |= {name: pixels[..., k] for k, name in enumerate(buffer.spec().channelnames)}
            part += 1
            if part >= buffer.nsubimages:
                break

    def stack(ending: str, channels: str) -> np.ndarray:
        names = [next(n for n in found if n.endswith(f"{ending}.{c}")) for c in channels]
        return np.stack([found[n] for n in names], -1).astype(np.float64)

    return {"rgb": stack("Combined", "RGB"), "position": stack("Position", "XYZ"), "normal": stack("Normal", "XYZ")}
