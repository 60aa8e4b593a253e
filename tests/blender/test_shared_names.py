"""Objects whose files would have the same names: one line names both, and nothing is written."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy
import pytest

from irpso_addon.blender import files
from irpso_addon.blender.material import material
from tests.blender.materials import make_plane, make_solution

NAMES = [("Pot/1", "Pot:1"), ("Pot", "pot")]
SIZE = 32


def two_objects(names: tuple[str, str]) -> None:
    """The ball of the open scene, and beside it a plane out of sight."""
    bpy.data.objects["Ball"].name = names[0]
    plane = make_plane()
    plane.name, plane.hide_render = names[1], True
    bpy.context.view_layer.objects.active = bpy.data.objects[names[0]]


@pytest.mark.parametrize("names", NAMES)
def test_the_commands(scenes: Path, irpso_here, tmp_path: Path, names: tuple[str, str]) -> None:
    shutil.copytree(scenes / "good", tmp_path / "good")
    scene = tmp_path / "good" / "two.blend"
    files.open_blend(tmp_path / "good" / "scene.blend")
    two_objects(names)
    for obj in (bpy.data.objects[name] for name in names):
        material.write_maps(obj, make_solution({obj.material_slots[0].material.name: "one-lobe"}))
    bpy.ops.wm.save_as_mainfile(filepath=str(scene))
    solve = "--captures", scene.with_name("captures.json"), "--size", SIZE
    for command in (("solve", scene, *solve), ("job", scene, *solve), ("export", scene),
                    ("export", scene, "--target", "gltf")):
        done = irpso_here(*command, "--object", names[0], "--out", tmp_path / "out")
        assert done.returncode == 3 and done.stderr.splitlines()[-1] == (
            f"irpso: objects '{names[0]}' and '{names[1]}': their files would overwrite each other on some systems; "
            "rename one of them")
        assert not (tmp_path / "out").exists()


def test_the_operators(ball_scene: bpy.types.Scene, tmp_path: Path) -> None:
    """A solve whose maps are packed writes no files; once one object has another name, both have files."""
    settings, (name, other) = ball_scene.irpso, NAMES[0]
    two_objects((name, other))
    settings.size, settings.model, settings.out = SIZE, "one-lobe", str(tmp_path / "out")
    assert bpy.ops.irpso.solve() == {"FINISHED"}
    line = f"objects '{name}' and '{other}': their files would overwrite each other"
    for wrong in (lambda: bpy.ops.irpso.export_maps(target="irpso"), lambda: bpy.ops.irpso.export_maps(target="unity"),
                  lambda: bpy.ops.irpso.write_maps(packed=False)):
        with pytest.raises(RuntimeError, match=line):
            wrong()
    settings.size = 4096  # in blocks, to files
    with pytest.raises(RuntimeError, match=line):
        bpy.ops.irpso.solve()
    assert not (tmp_path / "out").exists()
    bpy.data.objects[other].name = "Lid"
    assert bpy.ops.irpso.export_maps(target="irpso") == {"FINISHED"}
    assert (tmp_path / "out" / "Pot_1_basecolor.exr").is_file()
