"""A shoot that Cycles photographs: the demo's vase through a distorting lens, a flash beside it, and project files.

    python -m tests.support.photo_shoot OUT [--views N] [--pixels N] [--kind exr|dng|tif]

OUT gets pictures/, a project of each format, mesh.obj and truth/ (maps by the names that 'solve' gives them), and
native.blend: the same vase, cameras and flash given in Blender, pictures without distortion.  The project's unit is
UNIT metres, so that the flash's offset is a tenth of the distance, as in a real shoot.  Distortion is put in here, by
`Lens.rays` in float64; nothing of the solver takes part.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

from irpso_addon.blender import properties
from irpso_addon.blender.sample import demo
from irpso_addon.core.images.image_writer import write_image
from irpso_addon.core.lens import Lens
from irpso_addon.core.samples import vase
from tests.support import dng_files, project_files

UNIT = 0.1  # metres in one unit of the project
OFFSET = (0.6, 0.1, 0.0)  # of the flash from the lens: right, up, forwards; units
FLASH_SIZE, FLASH_POWER = 0.2, 320.0  # diameter; watts in a scene of units (in metres UNIT^2 times as many)
DISTANCE = 4.6
FINER = 3  # pixels of the undistorted render to each of the picture, along each side
TEXELS = 512
GAIN = 4.0  # from radiance to the values of files that end at 1
# IEC 61966-2-1: linear Rec.709 to XYZ
XYZ_FROM_REC709 = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


@dataclass(frozen=True)
class Plan:
    """What is photographed."""

    views: int = 40
    pixels: int = 400  # of the longer side
    kind: str = "exr"
    samples: int = 4
    noise: float = 0.0  # standard deviation of white


def lens(plan: Plan, portrait: bool = False) -> Lens:
    """A wide lens, with the distortion that a 24 mm one on full frame may have."""
    width, height = plan.pixels, plan.pixels * 2 // 3
    if portrait:
        width, height = height, width
    f = 1.35 * plan.pixels
    return Lens(width, height, f, f * 1.001, width * 0.507, height * 0.489, (-0.21, 0.13, -0.05, 0.0), (6e-4, -4e-4))


def make(out: Path, plan: Plan) -> None:
    """Everything.  Leaves the last scene open."""
    if not hasattr(bpy.types.Scene, "irpso"):
        properties.register()
    (out / "pictures").mkdir(parents=True, exist_ok=True)
    (out / "truth").mkdir(exist_ok=True)
    base, rough = vase.truth(TEXELS)
    write_image(out / "truth" / "mesh_basecolor.exr", base, kind="exr", color=True)
    write_image(out / "truth" / "mesh_roughness.exr", np.repeat(rough[..., None], 3, 2), kind="exr", color=False)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    obj = demo._add_vase()
    obj.name = "mesh"
    demo._set_up_render(bpy.context.scene)
    bpy.context.scene.cycles.samples = plan.samples
    obj.material_slots[0].material = demo._truth_material(base, rough)
    shots, portraits = [], []
    light = bpy.data.lights.new("Flash", "POINT")
    light.energy, light.shadow_soft_size = FLASH_POWER, FLASH_SIZE / 2
    flash = bpy.data.objects.new("Flash", light)
    bpy.context.scene.collection.objects.link(flash)
    for number in range(plan.views):
        portrait = number % 4 == 3
        camera = _add_camera(number, plan)
        flash.parent, flash.location = camera, (OFFSET[0], OFFSET[1], -OFFSET[2])
        rendered = _render(out, camera, lens(plan, portrait))
        rng = np.random.default_rng(number)
        rendered[..., :3] += (plan.noise * rng.normal(size=rendered[..., :3].shape)).astype(np.float32)
        shots.append(_shot(f"IMG_{number:04d}.{plan.kind}", camera))
        portraits.append(portrait)
        _save(out / "pictures" / shots[-1].name, rendered)
    write_projects(out, plan, shots, portraits)
    demo_material = bpy.data.materials["Vase"]
    obj.material_slots[0].material = demo_material
    demo._forget_truth()
    bpy.ops.object.select_all(action="DESELECT")
    obj.select_set(True)
    bpy.ops.wm.obj_export(filepath=str(out / "mesh.obj"), export_selected_objects=True, forward_axis="Y", up_axis="Z",
                          export_materials=False)


def write_projects(out: Path, plan: Plan, shots: list[project_files.Shot], portraits: list[bool]) -> None:
    """The same cameras in each format; the landscape ones alone where a format's writer here has one lens."""
    one = lens(plan)
    flat = [shot for shot, portrait in zip(shots, portraits, strict=True) if not portrait]
    k, p = one.radial, one.tangential
    project_files.write_metashape(
        out / "metashape.xml", flat, {"f": one.fy, "b1": one.fx - one.fy, "cx": one.cx - one.width / 2,
                                      "cy": one.cy - one.height / 2, "k1": k[0], "k2": k[1], "k3": k[2], "p1": p[1],
                                      "p2": p[0]},
        size=(one.width, one.height))
    colmap = ("OPENCV", one.width, one.height, [one.fx, one.fy, one.cx, one.cy, k[0], k[1], *p])
    project_files.write_colmap_text(out / "colmap_text", flat, colmap)
    project_files.write_colmap_binary(out / "colmap_binary", flat, colmap)
    frames = []
    for shot, portrait in zip(shots, portraits, strict=True):
        own = lens(plan, portrait)
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = shot.rotation @ np.diag([1.0, -1.0, -1.0]), shot.place
        frames.append({
            "file_path": f"pictures/{shot.name}", "transform_matrix": matrix.tolist(), "w": own.width, "h": own.height,
            "fl_x": own.fx, "fl_y": own.fy, "cx": own.cx, "cy": own.cy, "k1": k[0], "k2": k[1], "k3": k[2], "p1": p[0],
            "p2": p[1]})
    (out / "transforms.json").write_text(json.dumps({"camera_model": "OPENCV", "frames": frames}, indent=1))


def make_native(out: Path, plan: Plan) -> None:
    """The landscape views again in a native.blend of metres, through pinholes, with captures.json: the yardstick."""
    if not hasattr(bpy.types.Scene, "irpso"):
        properties.register()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    obj = demo._add_vase()
    obj.name = "mesh"
    base, rough = vase.truth(TEXELS)
    scene = bpy.context.scene
    demo._set_up_render(scene)
    own = lens(plan)
    scene.cycles.samples = plan.samples
    scene.render.resolution_x, scene.render.resolution_y = own.width, own.height
    obj.scale = (UNIT,) * 3
    obj.material_slots[0].material = demo._truth_material(base, rough)
    views = []
    for number in (n for n in range(plan.views) if n % 4 != 3):
        camera = _add_camera(number, plan)
        camera.location *= UNIT
        camera.data.sensor_fit, camera.data.sensor_width = "HORIZONTAL", 36.0
        camera.data.lens = 36.0 * own.fx / own.width
        light = bpy.data.lights.new(f"Flash {number}", "POINT")
        light.energy, light.shadow_soft_size = FLASH_POWER * UNIT**2, FLASH_SIZE / 2 * UNIT
        flash = bpy.data.objects.new(light.name, light)
        flash.parent, flash.location = camera, [x * UNIT for x in (OFFSET[0], OFFSET[1], -OFFSET[2])]
        scene.collection.objects.link(flash)
        bpy.context.view_layer.update()
        views.append({"image": f"native/{camera.name}.exr", "camera": camera.name, "lights": [flash.name]})
        demo._render(out / views[-1]["image"], camera, flash)
    (out / "native.json").write_text(json.dumps({"views": views}))
    obj.material_slots[0].material = bpy.data.materials["Vase"]
    demo._forget_truth()
    demo.save(out / "native.blend")


def _add_camera(number: int, plan: Plan) -> Any:
    """On a spiral about the vase, some from above and some from below, not level."""
    turn, height = 2.399963 * number, 0.62 - 1.1 * ((number * 0.618) % 1.0)
    ring = math.sqrt(1 - height * height)
    data = bpy.data.cameras.new(f"Camera {number}")
    obj = bpy.data.objects.new(f"Camera {number}", data)
    obj.location = Vector((ring * math.cos(turn), ring * math.sin(turn), height)) * DISTANCE
    towards = Vector((0.02, -0.01, 0.02)) - obj.location
    obj.rotation_euler = towards.to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.update()
    return obj


def _shot(name: str, camera: Any) -> project_files.Shot:
    matrix = np.array(camera.matrix_world, np.float64)
    return project_files.Shot(name, matrix[:3, :3] @ np.diag([1.0, -1.0, -1.0]), matrix[:3, 3])


def _render(out: Path, camera: Any, own: Lens) -> np.ndarray:
    """(h, w, 4) what the lens shows, row 0 at the top: a finer picture of a pinhole, looked up pixel by pixel."""
    scene = bpy.context.scene
    edges = [(x, y) for x in (0, own.width / 2, own.width) for y in (0, own.height / 2, own.height)]
    corners = own.rays(np.array(edges))
    wide = 1.02 * np.abs(corners[:, :2] / corners[:, 2:]).max(0)
    size = np.ceil(2 * wide * own.fx * FINER).astype(int)
    scene.render.resolution_x, scene.render.resolution_y = (int(n) for n in size)
    camera.data.sensor_fit, camera.data.sensor_width = "HORIZONTAL", 36.0
    f = size[0] / (2 * wide[0])  # pixels
    camera.data.lens = 36.0 * f / size[0]
    scene.camera, scene.render.filepath = camera, str(out / "pinhole.exr")
    bpy.ops.render.render(write_still=True)
    fine = demo.read_render(out / "pinhole.exr")[::-1].astype(np.float64)
    (out / "pinhole.exr").unlink()
    picture = np.zeros((own.height, own.width, 4))
    offsets = (np.arange(FINER) + 0.5) / FINER
    for dy in offsets:
        for dx in offsets:
            x, y = np.meshgrid(np.arange(own.width) + dx, np.arange(own.height) + dy)
            rays = own.rays(np.stack([x, y], -1))
            at = f * rays[..., :2] / rays[..., 2:] + size / 2 - 0.5
            picture += _bilinear(fine, at) / FINER**2
    return picture


def _bilinear(image: np.ndarray, at: np.ndarray) -> np.ndarray:
    low = np.clip(np.floor(at).astype(int), 0, np.array(image.shape[1::-1]) - 2)
    f = (at - low)[..., None]
    (x, y), (fx, fy) = (low[..., 0], low[..., 1]), (f[..., 0, :], f[..., 1, :])
    return ((image[y, x] * (1 - fx) + image[y, x + 1] * fx) * (1 - fy)
            + (image[y + 1, x] * (1 - fx) + image[y + 1, x + 1] * fx) * fy)


def _save(path: Path, rgba: np.ndarray) -> None:
    """EXR with alpha; DNG and TIFF without, exposed, and a mask beside them."""
    if path.suffix == ".exr":
        _write(path, rgba, "float")
        return
    _write(path.with_name(f"{path.stem}_mask.png"), rgba[..., 3:], "uint16")
    if path.suffix == ".tif":
        _write(path, GAIN * rgba[..., :3], "uint16")
    else:
        save_dng(path, GAIN * rgba[..., :3])


def _write(path: Path, values: np.ndarray, form: str) -> None:
    import OpenImageIO as oiio

    spec = oiio.ImageSpec(*values.shape[1::-1], values.shape[2], form)
    if values.shape[2] >= 3:
        spec.channelnames = ("R", "G", "B", "A")[: values.shape[2]]
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec) and output.write_image(np.ascontiguousarray(values, np.float32))
    output.close()


def develop(out: Path, kind: str) -> None:
    """The EXR pictures of a shoot again, as DNG or TIFF, into out/``kind``."""
    import OpenImageIO as oiio

    (out / kind).mkdir(exist_ok=True)
    for path in sorted((out / "pictures").glob("*.exr")):
        _save(out / kind / f"{path.stem}.{kind}", oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT))


def save_dng(path: Path, rgb: np.ndarray) -> None:
    """As a sensor with a Bayer pattern records linear Rec.709: 2 x 2 samples for each pixel of the picture."""
    camera = dng_files.COLOUR_MATRIX @ XYZ_FROM_REC709
    neutral = camera.sum(1)
    values = np.clip(rgb @ camera.T / neutral.max(), 0, 1)
    shot = dng_files.Shot(neutral=tuple(float(n) for n in neutral / neutral.max()))
    raw = np.zeros((2 * rgb.shape[0], 2 * rgb.shape[1]), np.uint16)
    for y in range(2):
        for x in range(2):
            sample = values[..., dng_files.BAYER[y, x]]
            raw[y::2, x::2] = np.round(shot.black + (shot.white - shot.black) * sample)
    dng_files.save_dng(path, raw, shot)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--views", type=int, default=Plan.views)
    parser.add_argument("--pixels", type=int, default=Plan.pixels)
    parser.add_argument("--kind", choices=("exr", "dng", "tif"), default="exr")
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--native", action="store_true", help="make native.blend alone")
    arguments = parser.parse_args()
    plan = Plan(arguments.views, arguments.pixels, arguments.kind, noise=arguments.noise)
    (make_native if arguments.native else make)(arguments.out, plan)


if __name__ == "__main__":
    main()
