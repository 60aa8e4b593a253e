"""What is done to the list of views by buttons: look through one, set all, leave our own maps out."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import bpy
import pytest

from tests.support import glowing_scene


@pytest.fixture
def scene(extension, scenes: Path, tmp_path: Path) -> bpy.types.Scene:
    """A private copy of the good scene with its views in the list."""
    shutil.copytree(scenes / "good", tmp_path / "good")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "good" / "scene.blend"), load_ui=False)
    bpy.context.view_layer.objects.active = bpy.data.objects["Ball"]
    bpy.context.scene.irpso.size, bpy.context.scene.irpso.captures = 64, "//captures.json"
    bpy.ops.irpso.load_captures()
    return bpy.context.scene


def lamps(scene: bpy.types.Scene) -> dict[str, tuple[bool, bool]]:
    return {obj.name: (obj.hide_render, obj.hide_viewport) for obj in scene.objects if obj.type == "LIGHT"}


def test_look_through_a_view_and_back(scene) -> None:
    scene.camera = bpy.data.objects["Camera 1"]
    bpy.data.objects["Light 1"].hide_viewport = True
    before = lamps(scene)
    assert not bpy.ops.irpso.look_back.poll()
    for index in (3, 4):  # from view to view: what was before the first comes back
        scene.irpso.active_view = index
        view = scene.irpso.views[index]
        assert bpy.ops.irpso.look_through_view() == {"FINISHED"}
        assert scene.camera == view.camera
        on = {item.light.name for item in view.lights}
        assert {name for name, hidden in lamps(scene).items() if hidden == (False, False)} == on
    assert bpy.ops.irpso.look_back() == {"FINISHED"}
    assert lamps(scene) == before and scene.camera.name == "Camera 1"
    assert not bpy.ops.irpso.look_back.poll()


def test_a_scene_without_a_camera_has_none_again(scene) -> None:
    scene.camera = None
    bpy.ops.irpso.look_through_view()
    assert scene.camera is not None
    bpy.ops.irpso.look_back()
    assert scene.camera is None


def test_what_is_renamed_meanwhile_comes_back(scene, tmp_path: Path) -> None:
    """Also when the file was saved in between; a lamp that is gone does not matter."""
    bpy.ops.irpso.look_through_view()
    hidden = [obj for obj in scene.objects if obj.type == "LIGHT" and obj.hide_render]
    camera = scene.camera = bpy.data.objects["Camera 1"]
    bpy.ops.irpso.look_back()
    scene.camera = camera
    bpy.ops.irpso.look_through_view()
    camera.name, hidden[0].name, hidden[1].name = "Left", "Lamp", hidden[0].name  # one has the name of another now
    bpy.data.objects.remove(hidden[2])
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "later.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "later.blend"), load_ui=False)
    scene = bpy.context.scene
    assert bpy.ops.irpso.look_back() == {"FINISHED"}
    assert scene.camera.name == "Left" and set(lamps(scene).values()) == {(False, False)}
    assert not scene.irpso.looked_lamps and scene.irpso.looked_camera is None  # nothing is kept alive by them


def test_a_view_of_all_lamps_has_all(scene) -> None:
    scene.irpso.active_view = 0
    bpy.ops.irpso.look_through_view()
    scene.irpso.views[1].lights.clear()
    scene.irpso.active_view = 1
    bpy.ops.irpso.look_through_view()
    assert all(hidden == (False, False) for hidden in lamps(scene).values())


def test_it_is_undone_and_a_solve_has_all_lamps(scene) -> None:
    before, camera = lamps(scene), scene.camera.name
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.irpso.look_through_view("EXEC_DEFAULT", True)
    assert lamps(scene) != before
    bpy.ops.ed.undo()
    assert lamps(bpy.context.scene) == before and bpy.context.scene.camera.name == camera
    bpy.ops.irpso.look_through_view()
    for view in bpy.context.scene.irpso.views:
        view.lights.clear()
    assert bpy.ops.irpso.solve(write=False) == {"FINISHED"}
    assert lamps(bpy.context.scene) == before and bpy.context.scene.camera.name == camera


def test_meshes_that_glow_are_lights_of_views(scene) -> None:
    """One that a view names goes off and on with it; another stays on; undo takes the button back."""
    named = glowing_scene.panel("Named", (2, -2, 2), 0.5, 3.0)
    other = glowing_scene.panel("Other", (-2, -2, 2), 0.5, 3.0)
    for obj in bpy.context.selected_objects:
        obj.select_set(False)
    for obj in (named, bpy.data.objects["Light 1"], bpy.data.objects["Ball"]):
        obj.select_set(True)
    scene.irpso.active_view = 0
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.irpso.set_view_lights("EXEC_DEFAULT", True) == {"FINISHED"}
    assert {item.light.name for item in scene.irpso.views[0].lights} == {"Named", "Light 1"}
    assert bpy.ops.irpso.look_through_view() == {"FINISHED"}
    assert not named.hide_render and not other.hide_render
    scene.irpso.active_view = 1
    assert bpy.ops.irpso.look_through_view() == {"FINISHED"}
    assert named.hide_render and not other.hide_render
    assert bpy.ops.irpso.look_back() == {"FINISHED"}
    assert not named.hide_render and not named.hide_viewport
    bpy.ops.ed.undo()
    assert "Named" not in {item.light.name for item in bpy.context.scene.irpso.views[0].lights}


def test_a_panel_counts_meshes_that_glow(extension, scene) -> None:
    readiness = sys.modules["irpso_ext.irpso_addon.blender.scene.readiness"]
    glowing_scene.panel("Panel", (2, -2, 2), 0.5, 3.0)
    bpy.context.view_layer.objects.active = bpy.data.objects["Ball"]
    scene.irpso.views[0].lights.clear()
    every, one = readiness.survey(bpy.context).views[:2]
    assert (every.emitters, every.light) == (1, "All lights")
    assert (one.lights, one.emitters, one.light) == (1, 1, "2 lights")
    assert one.environment == "Panel"  # is estimated as a world is
    bpy.context.view_layer.objects.active = bpy.data.objects["Panel"]
    assert readiness.survey(bpy.context).views[1].emitters == 0  # what is solved lights nothing


def test_the_shoots_steps_and_tools_know_meshes_that_glow(extension, scene) -> None:
    """A step counts them as light; what scales or places lamps names them in one line."""
    steps, pictures, lit, balls = (sys.modules[f"irpso_ext.irpso_addon.blender.shoot.{name}"] for name in (
        "steps", "view_pictures", "lit_picture", "ball_lamps"))
    readiness = sys.modules["irpso_ext.irpso_addon.blender.scene.readiness"]
    panel = glowing_scene.panel("Panel", (2, -2, 2), 0.5, 3.0)
    bpy.context.view_layer.objects.active = bpy.data.objects["Ball"]
    for view in scene.irpso.views:
        view.lights.clear()
        view.lights.add().light = panel
    step = steps._lamps(bpy.context, readiness.survey(bpy.context).views)
    assert step.done and step.text == "Light: meshes that glow"
    view = pictures.listed_views(bpy.context)[0]
    for tool, word in ((lambda: lit.lights_of(bpy.context, view), "scaled"),
                       (lambda: balls._only_light(view), "placed")):
        with pytest.raises(Exception, match=f"is lit by 'Panel', which is not a lamp, and only lamps can be {word}; "):
            tool()


@pytest.mark.parametrize("text", ["x", "[]", "7", json.dumps({"camera": 3, "lamps": [1]}),
                                  json.dumps({"camera": "Ball", "lamps": {"Ball": 1, "Light 1": "on"}})])
def test_whatever_a_file_says_was_before(scene, text) -> None:
    before = lamps(scene)
    scene.irpso.looked = text
    assert bpy.ops.irpso.look_back() == {"FINISHED"}
    assert lamps(scene) == before and scene.irpso.looked == "" and scene.camera.type == "CAMERA"


def test_exposure_and_color_space_of_all_that_are_used(scene) -> None:
    views = scene.irpso.views
    views[2].enabled = False
    assert bpy.ops.irpso.edit_views(set_exposure=True, exposure=1.5) == {"FINISHED"}
    assert [round(view.exposure, 3) for view in views] == [0.0 if i == 2 else 1.5 for i in range(len(views))]
    assert {view.colorspace for view in views} == {""}
    assert bpy.ops.irpso.edit_views(set_colorspace=True, colorspace="sRGB") == {"FINISHED"}
    assert views[2].colorspace == "" and {view.colorspace for view in views if view.enabled} == {"sRGB"}
    assert bpy.ops.irpso.edit_views(set_curve=True, response=1.1, shoulder=5.0) == {"FINISHED"}
    curves = [(round(view.response, 3), round(view.shoulder, 3)) for view in views]
    assert curves == [(1.0, 1.0) if i == 2 else (1.1, 5.0) for i in range(len(views))]
    assert bpy.ops.irpso.edit_views(exposure=3.0, shoulder=2.0) == {"CANCELLED"}


def test_exported_maps_are_no_views(scene, tmp_path) -> None:
    bpy.ops.irpso.solve(write=False)
    for target in ("irpso", "unreal"):
        assert bpy.ops.irpso.export_maps(directory="//refs", target=target) == {"FINISHED"}
    scene.irpso.views.clear()
    assert bpy.ops.irpso.add_folder(directory="//refs") == {"FINISHED"}
    assert not [view.image for view in scene.irpso.views if "Ball" in view.image]
    assert len(scene.irpso.views) >= 10
    assert bpy.ops.irpso.export_maps(directory="//irpso") == {"FINISHED"}
    with pytest.raises(RuntimeError, match="exported map"):
        bpy.ops.irpso.add_folder(directory="//irpso")


def test_captures_are_chosen(scene) -> None:
    path = Path(bpy.data.filepath).parent / "captures.json"
    assert bpy.ops.irpso.choose_captures(filepath=str(path)) == {"FINISHED"}
    assert scene.irpso.captures == "//captures.json"
    with pytest.raises(RuntimeError, match="is not a file"):
        bpy.ops.irpso.choose_captures(filepath=str(path.parent))


# ---- from the cameras' background images


def picture(path: Path) -> Path:
    image = bpy.data.images.new(path.stem, 8, 8)
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
    bpy.data.images.remove(image)
    return path


@pytest.mark.parametrize("space", ["sRGB", "Non-Color", "Linear Rec.2020"])
def test_background_images_keep_their_color_space(scene, space) -> None:
    """A solve reads them as without the list: as the image's own settings say."""
    scene.irpso.views.clear()
    file, camera = picture(Path(bpy.data.filepath).with_name("front.png")), bpy.data.objects["Camera 0"]
    image = bpy.data.images.load(str(file))
    image.colorspace_settings.name = space
    camera.data.background_images.new().image = image
    camera.select_set(True)
    read = sys.modules["irpso_ext.irpso_addon.blender.scene.scene"].read_scene
    [before] = read(None, "Ball", None).views
    bpy.ops.irpso.add_views()
    [after] = read(None, "Ball", None).views
    assert (after.image, after.colorspace or "sRGB") == (before.image, before.colorspace) == (file, space)


def test_background_images_of_a_linked_camera(scene, tmp_path: Path) -> None:
    """Their paths are relative to the library, not to the open file."""
    home, rig = Path(bpy.data.filepath), tmp_path / "rig"
    rig.mkdir()
    file = picture(rig / "left.png")
    camera = bpy.data.objects.new("Left", bpy.data.cameras.new("Left"))
    image = camera.data.background_images.new().image = bpy.data.images.load(str(file))
    image.filepath = "//left.png"
    scene.collection.objects.link(camera)
    bpy.ops.wm.save_as_mainfile(filepath=str(rig / "rig.blend"), relative_remap=False)
    bpy.ops.wm.open_mainfile(filepath=str(home), load_ui=False)
    with bpy.data.libraries.load(str(rig / "rig.blend"), link=True) as (_, into):
        into.objects = ["Left"]
    scene = bpy.context.scene
    scene.collection.objects.link(into.objects[0])
    bpy.ops.irpso.add_views()
    view = next(view for view in scene.irpso.views if view.camera.name == "Left")
    assert Path(bpy.path.abspath(view.image)).resolve() == file.resolve()
