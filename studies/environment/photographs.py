"""Photographs under one lamp each, summed as an environment weighs the lamps: real pictures under a known world."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import OpenImageIO

from irpso_addon.blender import files
from irpso_addon.blender.jobs.indirect import IndirectRenderer
from irpso_addon.blender.material import material
from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.core.change_records import PredictionError
from irpso_addon.core.data import F32, F64, Solution
from irpso_addon.core.evaluation.metrics import prediction_error
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading.environment import texel_directions
from irpso_addon.gpu.device import thread
from irpso_addon.solve import pipeline
from studies.environment.hdris import HDRI_HEIGHT, radiance, save, world_of

KINDS = ("day", "room")  # environments that weigh the lamps
COUNTS = (12, 24)  # pictures: of each environment half, under turns that divide a circle
SIZE = 512  # texels
WIDEST = math.radians(15)  # from a lamp, of the light that it stands for: about as far as the next lamp
BOUNCES = 4  # of the renders of indirect light, as of a new file's diffuse
SAMPLES = 16  # of Cycles, a pixel: a sun without a width makes no noise, edges do
View = dict[str, Any]


@dataclass(frozen=True)
class Lamps:
    """Suns."""

    toward: F64  # (n, 3) unit, to each
    irradiance: F64  # (n, 3) W/m^2 on what faces it, linear RGB
    camera: F64  # (3, 3) columns: the camera's right, up and backwards

    def weights(self, kind: str, turn: float) -> F64:
        """(n, 3) light of an environment that stands upright before the camera, turned by so many radians.

        A lamp stands for what lies nearer to it than to others, and not far from it.
        """
        unit, solid = texel_directions(HDRI_HEIGHT, 2 * HDRI_HEIGHT)
        right, up, back = self.camera.T
        cos, sin = math.cos(turn), math.sin(turn)
        frame = np.stack([cos * right - sin * back, -sin * right - cos * back, up])  # the environment's X, Y and Z
        near = (self.toward @ frame.T) @ unit.reshape(-1, 3).T
        of, close = near.argmax(0), near.max(0) > math.cos(WIDEST)
        light = (radiance(unit, kind) * solid[..., None]).reshape(-1, 3)[close]
        return np.stack([np.bincount(of[close], channel, len(self.toward)) for channel in light.T], -1)

    def picture(self, weights: F64) -> F64:
        """(h, 2 h, 3) radiance of a world in which each lamp is four pixels about its direction."""
        height, width = HDRI_HEIGHT, 2 * HDRI_HEIGHT
        solid = texel_directions(height, width)[1][:, 0]
        x, y, z = self.toward.T
        u, v = width * (0.5 - np.arctan2(y, x) / (2 * math.pi)) - 0.5, height * (0.5 + np.arcsin(z) / math.pi) - 0.5
        made = np.zeros((height, width, 3))
        for row in (0, 1):
            for column in (0, 1):
                left, low = np.floor(u).astype(int) + column, np.clip(np.floor(v).astype(int) + row, 0, height - 1)
                share = (1 - np.abs(u - left)) * (1 - np.abs(v - np.floor(v) - row))
                np.add.at(made, (low, left % width), (share / solid[low])[:, None] * self.irradiance * weights)
        return made


def compare(folder: Path, counts: Sequence[int] = COUNTS) -> Iterator[str]:
    """Lines of the table: photographs as they are, with and without refined normals, and summed."""
    lamps, fit, left_out = _read(folder)
    settings = SolveSettings(size=SIZE)
    first: PredictionError | None = None
    for words, normals in (("single lamps", "auto"), ("the same", "mesh")):
        files.open_blend(folder / "scene.blend")
        solved = _solve(fit, folder, replace(settings, normals=normals))
        error = _errors(solved, left_out, folder)
        first = first or error
        yield _row(words, solved, error, first)
    assert first is not None
    for count in counts:
        with tempfile.TemporaryDirectory() as made:
            solved = _solve(_sum(folder, lamps, fit, count, Path(made)), Path(made), settings)
        yield _row("worlds", solved, _errors(solved, left_out, folder), first)


def _read(folder: Path) -> tuple[Lamps, list[View], list[View]]:
    """Suns, photographs to fit and those that are left out, of a capture folder with one camera."""
    files.open_blend(folder / "scene.blend")
    views: list[View] = json.loads((folder / "captures.json").read_text(encoding="utf-8"))["views"]
    fit, left_out = ([v for v in views if (v["split"] == "fit") == fits] for fits in (True, False))
    suns = [bpy.data.objects[view["lights"][0]] for view in fit]
    if any(sun.data.type != "SUN" or len(view["lights"]) != 1 for sun, view in zip(suns, fit, strict=True)):
        raise SystemExit(f"{folder}: needs one SUN lamp for each photograph")
    if len({view["camera"] for view in views}) != 1:
        raise SystemExit(f"{folder}: needs one camera for all photographs")
    axes = np.array(bpy.data.objects[views[0]["camera"]].matrix_world.to_3x3())
    return Lamps(
        np.array([sun.matrix_world.to_3x3().col[2].normalized() for sun in suns], np.float64),
        np.array([sun.data.energy * np.array(sun.data.color) for sun in suns]), axes), fit, left_out


def _sum(folder: Path, lamps: Lamps, fit: Sequence[View], count: int, out: Path) -> list[View]:
    """Write so many summed photographs and a scene of their worlds; returns the views."""
    photographs = [_pixels(folder / view["image"]) for view in fit]
    inside = np.min([photograph[..., 3:] for photograph in photographs], 0)
    files.open_blend(folder / "scene.blend")
    for lamp in [o for o in bpy.data.objects if o.type == "LIGHT"]:
        bpy.data.objects.remove(lamp)
    views, turns = [], count // len(KINDS)
    for kind in KINDS:
        for n in range(turns):
            name = f"{kind}_{n:02d}"
            weights = lamps.weights(kind, 2 * math.pi * n / turns)
            weights /= weights.mean()  # the strength says nothing
            total = sum(photograph[..., :3] * w for photograph, w in zip(photographs, weights, strict=True))
            paths = {"image": out / f"{name}.exr", "world": out / f"{name}_world.exr"}
            save(np.concatenate([total, inside], -1)[::-1], paths["image"])
            save(lamps.picture(weights), paths["world"])
            world_of(name, paths["world"]).use_fake_user = True
            views.append({"image": str(paths["image"]), "camera": fit[0]["camera"], "lights": [], "world": name})
    return views


def _solve(views: Sequence[View], folder: Path, settings: SolveSettings) -> Solution:
    """The maps of the open scene's views, whose images are relative to ``folder``, as `irpso solve` makes them."""
    cycles = bpy.context.scene.cycles
    cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = BOUNCES, BOUNCES, BOUNCES
    with tempfile.TemporaryDirectory() as made:
        blend, captures = Path(made) / "scene.blend", Path(made) / "captures.json"
        bpy.ops.wm.save_as_mainfile(filepath=str(blend))
        captures.write_text(json.dumps({"views": [
            {**view, "image": str(folder.resolve() / view["image"])} for view in views]}), encoding="utf-8")
        scene, bounce = read_scene(None, None, captures), IndirectRenderer.of_open_file(blend)
        solution: Solution = thread.run(lambda: pipeline.solve(scene, settings, bounce=bounce))
    return solution


def _errors(solution: Solution, left_out: Sequence[View], folder: Path) -> PredictionError:
    """Of Cycles' pictures of the maps under the lamps of photographs that were left out."""
    _open_with(folder / "scene.blend", solution)
    seen, told = [], []
    for view in left_out:
        photograph, shown = _pixels(folder / view["image"]).astype(np.float64), _rendered(view)
        inside = (photograph[..., 3] > 0.5) & (shown[..., 3] > 0.999)
        seen.append(photograph[inside][:, :3])
        told.append(shown[inside][:, :3])
    error = prediction_error(np.concatenate(seen), np.concatenate(told))
    assert error is not None
    return error


def _open_with(blend: Path, solution: Solution) -> None:
    """Open a scene, and put maps on its object."""
    files.open_blend(blend)
    material.write_maps(next(o for o in bpy.data.objects if o.type == "MESH"), solution)


def _rendered(view: View) -> F64:
    scene = bpy.context.scene
    for lamp in [o for o in bpy.data.objects if o.type == "LIGHT"]:
        lamp.hide_render = lamp.name not in view["lights"]
    scene.camera, scene.render.engine = bpy.data.objects[view["camera"]], "CYCLES"
    scene.cycles.samples, scene.cycles.max_bounces, scene.cycles.use_denoising = SAMPLES, 0, False
    with tempfile.TemporaryDirectory() as made:
        scene.render.filepath = str(Path(made) / "picture.exr")
        bpy.ops.render.render(write_still=True)
        return _pixels(Path(scene.render.filepath)).astype(np.float64)


def _pixels(path: Path) -> F32:
    """(h, w, C), the top row first."""
    return np.asarray(OpenImageIO.ImageBuf(str(path)).get_pixels(OpenImageIO.FLOAT))


def _row(words: str, solution: Solution, error: PredictionError, first: PredictionError) -> str:
    """A line of the table."""
    normals = "refined" if solution.normals is not None else "as given"
    return (f"| {words} | {len(solution.views_used)} | {', '.join(sorted(set(solution.model.values())))} | {normals} | "
            f"{error.relative_rms:.4f} | {error.relative_rms / first.relative_rms:.2f} | {error.lightness:.2f} | "
            f"{sum(solution.seconds.values()):.0f} |")
