"""Presets of the Solve panel through Blender's own operators: those that come with the add-on, and the user's."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import bpy
import pytest

from irpso_addon.core.params import SolveSettings

SHIPPED = sorted((Path(__file__).parents[2] / "presets" / "irpso").glob("*.py"))
DEFAULTS = {field.name: field.default for field in fields(SolveSettings)}


@pytest.fixture
def settings(extension, empty, tmp_path, monkeypatch):
    """The scene's, with the user's presets in a folder of their own."""
    monkeypatch.setenv("BLENDER_USER_SCRIPTS", str(tmp_path))
    return empty.irpso


def values(settings) -> dict[str, object]:
    return {name: getattr(settings, name) for name in DEFAULTS}


def choose(path: Path) -> None:
    assert bpy.ops.script.execute_preset(filepath=str(path), menu_idname="IRPSO_PT_solve_presets") == {"FINISHED"}


def test_ours_are_found() -> None:
    assert {path.stem for path in SHIPPED} == {"Exact", "Fast_Draft", "Photographs_without_Scale", "Two_Roughnesses"}


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_a_preset_sets_what_it_says_and_resets_the_rest(settings, path) -> None:
    assert str(path.parent) in bpy.utils.preset_paths("irpso")
    said = dict(line.removeprefix("settings.").split(" = ") for line in path.read_text().splitlines()
                if line.startswith("settings."))
    settings.seed, settings.c1, settings.ndf, settings.start = 5, 1.0, "beckmann", "last"
    choose(path)
    expected = DEFAULTS | {name: eval(value) for name, value in said.items()} | {"start": "last"}
    assert values(settings) == pytest.approx(expected)
    assert expected != DEFAULTS | {"start": "last"}


def test_one_of_the_users(settings, tmp_path) -> None:
    settings.size, settings.model, settings.c3, settings.start = 300, "two-lobe", 0.125, "last"
    assert bpy.ops.irpso.add_solve_preset(name="My Rig") == {"FINISHED"}
    file = tmp_path / "presets" / "irpso" / "My_Rig.py"
    assert file.exists() and "start" not in file.read_text()
    choose(SHIPPED[0])
    settings.start = "anew"
    choose(file)
    assert (settings.size, settings.model, settings.c3, settings.start) == (300, "two-lobe", 0.125, "anew")
    assert bpy.ops.irpso.add_solve_preset(name="My Rig", remove_name=True) == {"FINISHED"}
    assert not file.exists()


def test_a_preset_is_undone(settings) -> None:
    settings.size = 77
    bpy.ops.ed.undo_push(message="before")
    choose(next(path for path in SHIPPED if path.stem == "Fast_Draft"))
    assert bpy.context.scene.irpso.method == "draft"
    bpy.ops.ed.undo()
    assert (bpy.context.scene.irpso.size, bpy.context.scene.irpso.method) == (77, "refined")
