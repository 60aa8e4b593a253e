"""``python -m studies.relief``: makes the table of reliefs in docs/normals.md.

Cycles photographs flat samples under a flash beside the lens.  Their meshes are planes; what their highlights show of
bumps is known here.  Needs Blender as a module.  Pictures are kept in build/relief.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from irpso_addon.blender import files
from irpso_addon.blender.oiio import ensure_openimageio
from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.core.data import F32, F64, SceneData, Solution
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.phrases import percent
from irpso_addon.gpu.device import thread
from irpso_addon.solve import pipeline
from studies import pages
from studies.intervals.capture import NAME, add_material, add_noise, set_up, truth_image
from studies.intervals.page import made_on

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "build" / "relief"
PAGE = pages.DOCS / "normals.md"
SIDE, HEIGHT = 0.15, 0.24  # metres: of the sample, of the camera above it
BESIDE = 0.02  # metres: the flash is right of the lens
TEXELS, PIXELS, SAMPLES, NOISE = 256, 256, 32, 0.01
PLACES = ((0, 0), (6, 1), (-5, 3), (1, 6), (2, -6), (4, 5), (-5, -4), (5, -4), (-3, 6))  # centimetres, of the camera
ENERGY = 4.0  # watts


@dataclass(frozen=True)
class Sample:
    """A flat surface."""

    name: str
    slope: float  # root mean square, of its bumps
    levels: tuple[float, float] = (0.5, 0.5)
    roughness: tuple[float, float] = (0.32, 0.32)
    base: tuple[float, float] = (0.1, 0.7)
    bumps: float = 14.0  # across the sample, about


SAMPLES_OF = (
    Sample("print with varnish in places", 0.0, (0.1, 1.0)),
    Sample("the same, embossed", 0.07, (0.1, 1.0)),
    Sample("leather", 0.09, roughness=(0.38, 0.52), base=(0.06, 0.15), bumps=25.0),
)


@dataclass(frozen=True)
class Truth:
    """Arrays of (TEXELS, TEXELS, ...), row 0 at the bottom."""

    base: F32
    roughness: F32
    level: F32
    normal: F64  # unit; x to the right, y up


def waves(seed: int, across: float) -> F64:
    """(TEXELS, TEXELS) a smooth random field of standard deviation 1, with about so many waves across at most."""
    rng = np.random.default_rng(seed)
    frequency = np.fft.fftfreq(TEXELS, 1 / TEXELS)
    shape = np.exp(-0.5 * (np.hypot(frequency[:, None], frequency) / (across / 2)) ** 2)
    field = np.fft.ifft2(np.fft.fft2(rng.standard_normal((TEXELS, TEXELS))) * shape).real
    return np.asarray((field - field.mean()) / field.std())


def truth_of(sample: Sample) -> Truth:
    """What is painted, and embossed."""
    share = np.clip(0.5 + 0.8 * waves(1, 6), 0, 1)
    paint = np.stack([np.clip(0.5 + 0.4 * waves(2 + channel, 20), 0, 1) for channel in range(3)], -1)

    def between(ends: tuple[float, float], share: F64) -> F32:
        return np.asarray(ends[0] + (ends[1] - ends[0]) * share, np.float32)

    height = waves(9, sample.bumps)
    slopes = np.stack(np.gradient(height)[::-1], -1)
    slopes *= sample.slope / np.sqrt((slopes**2).sum(-1).mean())
    normal = np.concatenate([-slopes, np.ones((TEXELS, TEXELS, 1))], -1)
    return Truth(between(sample.base, paint), between(sample.roughness, share), between(sample.levels, share),
                 normal / np.linalg.norm(normal, axis=-1, keepdims=True))


def photograph(sample: Sample, folder: Path) -> None:
    """``folder``: scene.blend without a trace of the truth, captures.json, refs."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    set_up(PIXELS, SAMPLES, bounces=0)
    mesh = bpy.data.meshes.new(NAME)
    h = SIDE / 2
    mesh.from_pydata([(-h, -h, 0), (h, -h, 0), (h, h, 0), (-h, h, 0)], [], [(0, 1, 2, 3)])
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", np.float32([0, 0, 1, 0, 1, 1, 0, 1]))
    blank, painted = add_material(NAME), _painted(truth_of(sample))
    mesh.materials.append(painted)
    bpy.context.scene.collection.objects.link(bpy.data.objects.new(NAME, mesh))
    (folder / "refs").mkdir(parents=True, exist_ok=True)
    views = _render_all(folder)
    mesh.materials[0] = blank
    bpy.data.materials.remove(painted)
    for image in [i for i in bpy.data.images if i.name.startswith("truth ")]:
        bpy.data.images.remove(image)
    (folder / "captures.json").write_text(json.dumps({"views": views}, indent=1), encoding="utf-8")
    bpy.ops.wm.save_as_mainfile(filepath=str((folder / "scene.blend").resolve()), compress=True)


def _painted(truth: Truth) -> bpy.types.Material:
    material = add_material("truth")
    tree = material.node_tree
    principled = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    bent = tree.nodes.new("ShaderNodeNormalMap")
    tree.links.new(bent.outputs["Normal"], principled.inputs["Normal"])
    for name, array, socket in (
        ("base", truth.base, principled.inputs["Base Color"]),
        ("roughness", truth.roughness, principled.inputs["Roughness"]),
        ("level", truth.level, principled.inputs["Specular IOR Level"]),
        ("normal", (truth.normal / 2 + 0.5).astype(np.float32), bent.inputs["Color"]),
    ):
        node = tree.nodes.new("ShaderNodeTexImage")
        node.image = truth_image(name, array)
        tree.links.new(node.outputs["Color"], socket)
    return material


def _render_all(folder: Path) -> list[dict[str, object]]:
    """Each camera looks straight down; its lens is shifted so that the sample fills the picture."""
    scene, views, rng = bpy.context.scene, [], np.random.default_rng(1)
    rigs = []
    for n, (x, y) in enumerate(np.array(PLACES) / 100):
        camera = bpy.data.cameras.new(f"Camera {n + 1}")
        camera.sensor_width, camera.lens = 36, 36 * HEIGHT / (1.04 * SIDE)
        camera.shift_x, camera.shift_y = -x / (1.04 * SIDE), -y / (1.04 * SIDE)
        flash = bpy.data.lights.new(f"Flash {n + 1}", "POINT")
        flash.energy, flash.shadow_soft_size = ENERGY, 0.0
        rigs.append([_add(data, place) for data, place in ((camera, x), (flash, x + BESIDE))])
        for data in rigs[-1]:
            data.matrix_world = Matrix.Translation((data.location.x, y, HEIGHT))
    for n, (camera, flash) in enumerate(rigs):
        for _, other in rigs:
            other.hide_render = other is not flash
        scene.camera, scene.cycles.seed, name = camera, n, f"refs/{n + 1}.exr"
        scene.render.filepath = str(folder / name)
        bpy.ops.render.render(write_still=True)
        add_noise(folder / name, NOISE, rng)
        views.append({"image": name, "camera": camera.name, "lights": [flash.name]})
    for _, flash in rigs:
        flash.hide_render = False
    scene.render.filepath = ""
    return views


def _add(data: bpy.types.ID, x: float) -> bpy.types.Object:
    obj = bpy.data.objects.new(data.name, data)
    obj.location.x = x
    bpy.context.scene.collection.objects.link(obj)
    return obj


def solved(scene: SceneData, normals: str) -> Solution:
    """With `auto`."""
    solution: Solution = thread.run(lambda: pipeline.solve(scene, SolveSettings(size=TEXELS, normals=normals)))
    return solution


def line(sample: Sample, normals: str, found: Solution, seconds: float) -> str:
    """Of the table."""
    truth, maps = truth_of(sample), found.maps
    where = maps.coverage & ~maps.filled
    error = np.abs(maps.roughness - truth.roughness)[where]
    square = float(np.mean((maps.base_color - truth.base)[where] ** 2, dtype=np.float64))
    flat = np.broadcast_to([0.0, 0.0, 1.0], truth.normal.shape)
    shown = flat if maps.normal is None else maps.normal.astype(np.float64) * 2 - 1
    cosine = (shown * truth.normal).sum(-1) / np.linalg.norm(shown, axis=-1)
    off = np.degrees(np.arccos(np.clip(cosine, -1, 1)))[where].mean()
    return (f"| {sample.name} | {normals} | {off:.2f} | {-10 * np.log10(square):.1f} | "
            f"{error.mean(dtype=np.float64):.4f} | {percent(float(np.mean(error > 0.1)), 1)} | {seconds:.0f} |")


HEAD = """\
| sample | normals | degrees off | base color, dB | roughness | off | seconds |
|---|---|---|---|---|---|---|"""


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m studies.relief", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--pictures", type=Path, default=PICTURES, help="folder that keeps them")
    parser.add_argument("--out", type=Path, default=PAGE, help="the page")
    options = parser.parse_args()
    ensure_openimageio()
    lines = []
    for sample in SAMPLES_OF:
        folder = options.pictures / sample.name
        if not (folder / "scene.blend").exists():
            photograph(sample, folder)
        files.open_blend(folder / "scene.blend")
        scene = read_scene(None, None, folder / "captures.json")
        for normals in ("mesh", "auto"):
            start = time.perf_counter()
            found = solved(scene, normals)
            lines.append(line(sample, normals, found, time.perf_counter() - start))
            print(lines[-1], found.normals_why, flush=True)
    pages.fill(PAGE, {"relief made": made_on(found), "relief": "\n".join([HEAD, *lines])}, options.out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
