"""Remedies of warnings, by the operator."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest


@pytest.fixture
def solved(extension, scenes: Path, module):
    """The good scene with a solution whose checks say that a lamp is off."""
    data, records = module("core.data"), module("core.check_records")
    bpy.ops.wm.open_mainfile(filepath=str(scenes / "good" / "scene.blend"), load_ui=False)
    obj = bpy.data.objects["Ball"]
    bpy.context.view_layer.objects.active = obj
    grey, none = np.full((4, 4), 0.5, np.float32), np.zeros((4, 4), bool)
    maps = data.Maps(np.full((4, 4, 3), 0.5, np.float32), grey, grey, grey, none, ~none, grey, grey)
    light = records.LightResidual("Light 0", 2, 1.25, 0.001, (0.0, 0.0, 0.0), 0.0, 0.0, 0.0)
    lights = (light, *(replace(light, name=f"Light {i}", gain=1.0) for i in range(1, 5)))
    checks = records.Checks(
        name="Ball", views=(), lights=lights, materials=(), noise=0.01, structure=0.002, highlight=0.0, slope=None,
        unlit_share=float("nan"), clipped=0.0, no_highlight=0.0, nearest=1.0, doubtful=0.0, sure=True,
        pixels_per_texel=1.0)
    solution = replace(data.Solution.of_maps(maps, {"Paint": "one-lobe"}), checks=checks)
    session = module("blender.jobs.session").session
    session.keep(obj, solution)
    return session, obj, solution


def test_a_power_is_mended_once(solved) -> None:
    session, obj, solution = solved
    lamp = bpy.data.objects["Light 0"].data
    before = lamp.energy
    assert bpy.ops.irpso.apply_remedy(index=0) == {"FINISHED"}
    assert lamp.energy == pytest.approx(1.25 * before)
    assert session.remedied(bpy.context.scene, obj) == (0,)
    with pytest.raises(RuntimeError, match="no such remedy"):
        bpy.ops.irpso.apply_remedy(index=0)
    assert lamp.energy == pytest.approx(1.25 * before)
    session.keep(obj, solution)  # the next solution's remedies are others
    assert session.remedied(bpy.context.scene, obj) == ()


def test_remedies_of_several_objects(solved) -> None:
    """What one object's solution says is done once, whatever is solved or mended of another one."""
    session, first, solution = solved
    scene, second = bpy.context.scene, first.copy()
    scene.collection.objects.link(second)
    assert bpy.ops.irpso.apply_remedy(index=0) == {"FINISHED"}
    session.keep(second, solution)
    assert session.remedied(scene, first) == (0,) and session.remedied(scene, second) == ()
    bpy.context.view_layer.objects.active = second
    assert bpy.ops.irpso.apply_remedy(index=0) == {"FINISHED"}
    assert session.remedied(scene, first) == session.remedied(scene, second) == (0,)


@pytest.mark.parametrize("parented", [False, True])
@pytest.mark.parametrize("hidden", [False, True])
def test_a_lamp_is_moved_in_the_world(solved, hidden, parented) -> None:
    """Also one that viewports hide, as an imported flash is; it keeps its rotation."""
    session, obj, solution = solved
    old = bpy.data.objects["Light 0"]
    data, _ = old.data, bpy.data.objects.remove(old)
    lamp = bpy.data.objects.new("Light 0", data)
    lamp.location, lamp.rotation_euler, lamp.hide_viewport = (0.1, 0.2, 0.3), (1.0, 0.2, 0.0), hidden
    if parented:
        lamp.parent = next(obj for obj in bpy.data.objects if obj.type == "CAMERA")
    bpy.context.scene.collection.objects.link(lamp)
    bpy.context.view_layer.update()
    above = np.array(lamp.parent.matrix_world) if parented else np.eye(4)
    known = above @ np.array(lamp.matrix_basis)
    moved = replace(solution.checks.lights[0], gain=1.0, offset=(0.5, 0.0, -0.25), offset_share=0.2, effect=0.1,
                    explained=0.9)
    checks = replace(solution.checks, lights=(moved, *solution.checks.lights[1:]))
    session.keep(obj, replace(solution, checks=checks))
    assert bpy.ops.irpso.apply_remedy(index=0) == {"FINISHED"}
    lamp.hide_viewport = False
    bpy.context.view_layer.update()
    known[:3, 3] += 0.5, 0.0, -0.25
    np.testing.assert_allclose(np.array(lamp.matrix_world), known, atol=1e-5)


def test_a_lamp_that_is_gone(solved) -> None:
    bpy.data.objects.remove(bpy.data.objects["Light 0"])
    with pytest.raises(RuntimeError, match="'Light 0': is not in the scene any more"):
        bpy.ops.irpso.apply_remedy(index=0)


def test_lamps_that_share_their_light_keep_their_power(solved) -> None:
    first, second = bpy.data.objects["Light 0"], bpy.data.objects["Light 1"]
    second.data = first.data
    before = first.data.energy
    assert bpy.ops.irpso.apply_remedy(index=0) == {"FINISHED"}
    assert (first.data.energy, second.data.energy) == (pytest.approx(1.25 * before), before)


def test_what_the_scene_has_is_not_offered_again(solved, module) -> None:
    """A registration that is 'auto' already: a button for it would do nothing."""
    records, remedies = module("core.check_records"), module("core.checks.remedies")
    session, obj, solution = solved
    off = records.Misfit(Path("0.exr"), "Camera 0", (100, 100), (1.5, 0.0), 0.01, 1.0, 0.001, False)
    right = tuple(replace(light, gain=1.0) for light in solution.checks.lights)
    session.keep(obj, replace(solution, checks=replace(solution.checks, lights=right, registration=(off,))))
    (remedy,) = remedies.remedies(session.solution_of(obj).checks)
    scene, is_done = bpy.context.scene, module("blender.scene.apply_remedy").is_done
    scene.irpso.registration = "auto"
    assert is_done(scene, remedy)
    with pytest.raises(RuntimeError, match="no such remedy"):
        bpy.ops.irpso.apply_remedy(index=0)
    scene.irpso.registration = "given"
    assert not is_done(scene, remedy)
    assert bpy.ops.irpso.apply_remedy(index=0) == {"FINISHED"} and scene.irpso.registration == "auto"
