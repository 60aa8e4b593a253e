"""irpso job: from a .blend to a job whose tasks need no Blender, and to a scene that shows what they make."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np

from irpso_addon.solve import farm

MAPS = {f"Ball_{role}.png" for role in (
    "basecolor", "roughness", "confidence", "error", "filled", "roughness_sigma", "basecolor_sigma")}
SIZE = 64


def task(job: Path, name: str, *arguments: object) -> None:
    """A task, as the template starts it, where nothing called bpy can be imported."""
    code = "import runpy, sys; sys.modules['bpy'] = None; sys.argv = sys.argv[1:]; " \
           "runpy.run_path(sys.argv[0], run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", code, job / farm.PROGRAM, name, job / farm.WORK,
                           *map(str, arguments)], capture_output=True, text=True, cwd="/")
    assert done.returncode == 0, done.stdout + done.stderr


def test_job_to_maps_on_the_material(scenes: Path, irpso, tmp_path: Path) -> None:
    job = tmp_path / "my job"
    good = scenes / "good"
    done = irpso("job", good / "scene.blend", "--captures", good / "captures.json", "--size", SIZE, "--tile", 512,
                 "--model", "one-lobe", "--format", "png", "--any-worker", "--out", job)
    assert done.returncode == 0, done.stderr
    assert "1 x Solve (512 x 512 texels each), then 1 x Merge" in done.stdout
    assert {path.name for path in job.iterdir()} == {"template.yaml", "program", "work", "maps"}

    task(job, "tile", "--udim", 1001, "--tile", 0, "--tile-size", 512)
    moved = job.rename(tmp_path / "elsewhere")  # a farm's machines find it at other places
    task(moved, "merge", "--udim", 1001, "--out", moved / "maps", "--format", "png")
    assert {path.name for path in (moved / "maps").iterdir()} == MAPS | {"scene_irpso.blend"}

    bpy.ops.wm.open_mainfile(filepath=str(moved / "maps" / "scene_irpso.blend"))
    nodes = bpy.data.objects["Ball"].material_slots[0].material.node_tree.nodes
    images = {Path(node.image.filepath).name: node.image for node in nodes if node.type == "TEX_IMAGE"}
    assert set(images) == {"Ball_basecolor.png", "Ball_roughness.png"}
    for image in images.values():
        assert image.filepath.startswith("//") and tuple(image.size) == (SIZE, SIZE)
        pixels = np.empty(SIZE * SIZE * 4, np.float32)
        image.pixels.foreach_get(pixels)
        assert pixels.reshape(-1, 4)[:, :3].std() > 0.001
