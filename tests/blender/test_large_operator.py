"""The operator at sizes that are solved in blocks: files beside the .blend, on the material, and out again."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy
import pytest

SIZE = 48


@pytest.fixture
def opened(extension, scenes, tmp_path: Path):
    """The ball with two UDIMs, its views in the scene's list, a copy of its own."""
    for name in ("good", "udims"):
        shutil.copytree(scenes / name, tmp_path / name)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "udims" / "scene.blend"))
    settings = bpy.context.scene.irpso
    settings.captures, settings.size, settings.udim = str(tmp_path / "good" / "captures.json"), SIZE, "all"
    settings.indirect, settings.model = "off", "one-lobe"
    ball = bpy.data.objects["Ball"]
    bpy.context.view_layer.objects.active = ball
    ball.select_set(True)
    return ball, tmp_path / "udims" / "irpso"


def test_maps_become_files_beside_the_scene(opened, module, tmp_path: Path) -> None:
    ball, folder = opened
    assert bpy.ops.irpso.solve() == {"FINISHED"}
    names = {path.name for path in folder.iterdir()}
    assert {"Ball_basecolor.1001.exr", "Ball_roughness.1002.exr"} <= names
    assert not any("irpso_work" in name for name in names)
    images = module("blender.material.tags").maps_of(ball)
    assert images["base_color"].filepath == "//irpso/Ball_basecolor.<UDIM>.exr"
    assert [tile.number for tile in images["roughness"].tiles] == [1001, 1002]
    assert tuple(images["roughness"].size) == (SIZE, SIZE) and images["roughness"].packed_file is None
    solution = module("blender.jobs.session").session.solution_of(ball)
    assert len(solution.maps.roughness) == 2 * SIZE  # the plan's: squares side by side

    # The files again, not the plan's maps, whatever the object is called by now.
    ball.name = "Sphere"
    assert bpy.ops.irpso.write_maps() == {"FINISHED"}
    assert module("blender.material.tags").maps_of(ball)["base_color"].filepath.endswith("Ball_basecolor.<UDIM>.exr")
    assert bpy.ops.irpso.export_maps(directory=str(tmp_path / "png"), format="png") == {"FINISHED"}
    assert {"Sphere_basecolor.1001.png", "Sphere_filled.1002.png"} <= {p.name for p in (tmp_path / "png").iterdir()}


def test_what_cannot_be_is_said_before_the_solve(opened, module, monkeypatch) -> None:
    _, folder = opened
    bpy.context.scene.irpso.start = "last"
    with pytest.raises(RuntimeError, match="solved whole and from scratch"):
        bpy.ops.irpso.solve()
    bpy.context.scene.irpso.start = "anew"
    solve_speed = module("blender.jobs.solve_speed")
    while solve_speed.of(bpy.context) is None:  # files are looked at in a thread
        pass
    usage = shutil.disk_usage(folder.parent)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=1000))
    with pytest.raises(RuntimeError, match=r"irpso: the solve may take .* are free"):
        bpy.ops.irpso.solve()
    assert not folder.exists()
