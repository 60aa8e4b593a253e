"""Exports by the command and by the operator."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import bpy
import pytest

from irpso_addon.blender.material import material
from irpso_addon.core.data import Maps
from irpso_addon.core.errors import BadInput
from irpso_addon.core.maps.targets import TARGETS
from tests.blender.export_ball import ball, export, smooth_maps, solution
from tests.blender.materials import principled_of


@pytest.fixture
def solved(tmp_path: Path) -> Path:
    """A .blend of the ball with maps."""
    obj = ball()
    material.write_maps(obj, solution("one-lobe-specular", levels={"Skin": 0.2}))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "ball.blend"))
    return tmp_path / "ball.blend"


def test_the_command(solved: Path, irpso_here, tmp_path: Path) -> None:
    done = irpso_here("export", solved, "--target", "gltf", "--out", tmp_path / "gltf")
    assert (done.returncode, done.stderr) == (0, "")
    assert [Path(line).name for line in done.stdout.splitlines()] == [
        "Ball_baseColor.png", "Ball_occlusionRoughnessMetallic.png", "Ball.glb"]
    assert all(Path(line).is_file() for line in done.stdout.splitlines())
    done = irpso_here("export", solved, "--target", "unity", "--out", tmp_path / "unity")
    assert done.returncode == 0 and done.stderr.startswith("irpso: warning: material 'Skin': Unity has no Specular")
    assert done.stderr.count("\n") == 1


def test_wrong_usage(solved: Path, irpso_here, tmp_path: Path) -> None:
    done = irpso_here("export", solved, "--target", "gltf", "--format", "tiff", "--out", tmp_path / "out")
    assert done.returncode == 3 and "--format" in done.stderr and done.stderr.count("\n") == 1
    assert irpso_here("export", solved, "--target", "godot").returncode == 2
    assert not (tmp_path / "out").exists()


def test_a_mesh_that_lost_its_uv_map(solved: Path, irpso_here, tmp_path: Path) -> None:
    bpy.ops.wm.open_mainfile(filepath=str(solved))
    mesh = bpy.data.objects["Ball"].data
    mesh.uv_layers.remove(mesh.uv_layers[0])
    bpy.ops.wm.save_mainfile()
    done = irpso_here("export", solved, "--target", "gltf", "--out", tmp_path / "out")
    assert done.returncode == 3 and "UV map" in done.stderr and done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()
    with pytest.raises(BadInput, match="UV map"):
        export(bpy.data.objects["Ball"], "unreal", tmp_path / "out")


def test_a_mesh_of_another_scene(tmp_path: Path) -> None:
    """Its modifiers are not known there; the line names the scene that is open."""
    obj = ball()
    obj.modifiers.new("Smooth", "SUBSURF")
    material.write_maps(obj, solution("one-lobe"))
    empty_scene = bpy.data.scenes.new("Other")
    with bpy.context.temp_override(scene=empty_scene, view_layer=empty_scene.view_layers[0]), pytest.raises(
            BadInput, match=r"object 'Ball': is not in scene 'Other', .*; open a scene that has it"):
        export(obj, "gltf", tmp_path)


def test_the_operator(extension, module, tmp_path: Path) -> None:
    """Folder and target are the panel's; what is lost is a warning; the file stays as it is."""
    obj = ball()
    bpy.context.view_layer.objects.active = obj
    Solved = module("core.data").Solution
    maps = module("core.data").Maps(**{name: getattr(smooth_maps(), name) for name in Maps.__dataclass_fields__})
    found = replace(Solved.of_maps(maps, {"Skin": "one-lobe-specular"}), levels={"Skin": 0.2})
    module("blender.jobs.session").session.keep(obj, found)
    before = {name: list(getattr(bpy.data, name)) for name in ("images", "materials", "meshes", "objects", "scenes")}
    settings = bpy.context.scene.irpso
    settings.out, settings.target = str(tmp_path / "panel"), "unreal"
    assert bpy.ops.irpso.export_maps() == {"FINISHED"}
    assert sorted(os.listdir(tmp_path / "panel")) == ["T_Ball_BC.png", "T_Ball_ORM.png", "T_Ball_S.png"]
    assert bpy.ops.irpso.export_maps(directory=str(tmp_path / "glb"), target="gltf") == {"FINISHED"}
    assert "Ball.glb" in os.listdir(tmp_path / "glb")
    settings.out = " "
    with pytest.raises(RuntimeError, match="Folder: is empty"):  # not into the folder where Blender was started
        bpy.ops.irpso.export_maps()
    assert bpy.ops.irpso.export_maps(directory=str(tmp_path / "all"), target="irpso", format="png") == {"FINISHED"}
    assert "Ball_roughness_sigma.png" in os.listdir(tmp_path / "all")
    assert {name: list(getattr(bpy.data, name)) for name in before} == before


@pytest.mark.parametrize("target", TARGETS)
def test_the_operator_and_the_command_write_the_same(extension, module, irpso_here, tmp_path: Path, target) -> None:
    """What the user has set on the material counts in both; of what the material does not show, the result counts."""
    obj = ball()
    bpy.context.view_layer.objects.active = obj
    maps = module("core.data").Maps(**{name: getattr(smooth_maps(), name) for name in Maps.__dataclass_fields__})
    made = module("core.data").Solution.of_maps(maps, {"Skin": "one-lobe"})
    module("blender.jobs.session").session.keep(obj, made)
    inputs = principled_of(obj.data.materials[0]).inputs
    inputs["Metallic"].default_value, inputs["Coat Weight"].default_value = 0.75, 0.5
    assert bpy.ops.irpso.export_maps(directory=str(tmp_path / "solved"), target=target) == {"FINISHED"}
    assert bpy.ops.irpso.write_maps() == {"FINISHED"}
    assert bpy.ops.irpso.export_maps(directory=str(tmp_path / "panel"), target=target) == {"FINISHED"}
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "ball.blend"))
    assert irpso_here("export", tmp_path / "ball.blend", "--target", target, "--out", tmp_path / "cli").returncode == 0
    panel, command, solved = ({path.name: path.read_bytes() for path in (tmp_path / folder).iterdir()}
                              for folder in ("panel", "cli", "solved"))
    assert panel == command != solved
