"""The list of views by operators, and what the panels say is missing: the same that a solve would refuse."""

from __future__ import annotations

import json
import shutil
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from tests.support.picture_files import save


@pytest.fixture
def scene(extension, scenes: Path, tmp_path: Path) -> bpy.types.Scene:
    """A private copy of the good scene, its ball active; ten pictures "Camera 0, Light 1.exr" in refs."""
    shutil.copytree(scenes / "good", tmp_path / "good")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "good" / "scene.blend"), load_ui=False)
    bpy.context.view_layer.objects.active = bpy.data.objects["Ball"]
    return bpy.context.scene


@pytest.fixture
def survey(module):
    """``survey()``: what is known once the files have been looked at."""
    def ask():
        thumbnails = module("blender.scene.thumbnails")
        readiness = module("blender.scene.readiness")
        readiness.survey(bpy.context)
        end = time.monotonic() + 10
        while (thumbnails._images.busy or thumbnails._captures.busy) and time.monotonic() < end:
            time.sleep(0.01)
        found = readiness.survey(bpy.context)
        while thumbnails._images.busy and time.monotonic() < end:  # of a capture file just read
            time.sleep(0.01)
        found = readiness.survey(bpy.context)
        thumbnails.release()  # the next question looks at the disk again
        return found
    return ask


def listed(scene) -> list[tuple[str, str, list[str]]]:
    return [(Path(v.image).name, v.camera.name if v.camera else "", [item.light.name for item in v.lights])
            for v in scene.irpso.views]


def test_a_folder_is_matched_by_names(scene, tmp_path: Path) -> None:
    assert bpy.ops.irpso.add_folder(directory="//refs") == {"FINISHED"}
    assert listed(scene) == [(f"Camera {c}, Light {n}.exr", f"Camera {c}", [f"Light {n}"])
                             for c in range(2) for n in range(5)]
    assert scene.irpso.views[0].image == "//refs/Camera 0, Light 0.exr"
    assert bpy.ops.irpso.add_folder(directory=str(tmp_path / "good" / "refs")) == {"CANCELLED"}  # all there
    # The same views as the capture file's: so the same solve.
    by_folder = listed(scene)
    scene.irpso.views.clear()
    scene.irpso.captures = "//captures.json"
    bpy.ops.irpso.load_captures()
    assert sorted(listed(scene)) == sorted(by_folder)


def test_a_loaded_file_keeps_all_that_it_states_of_a_picture(scene, tmp_path: Path) -> None:
    """A solve of the list is that of the file."""
    file = tmp_path / "good" / "captures.json"
    content = json.loads(file.read_text(encoding="utf-8"))
    content["views"][3] |= {"exposure": 0.5, "vignetting": 2.0, "response": 0.75, "shoulder": 8.0, "turn": 10.0,
                            "black_level": [0.25, 0, -0.125], "tint": [1.25, 1, 0.75], "ambient_radiance": [0, 0.5, 0]}
    file.write_text(json.dumps(content), encoding="utf-8")
    scene.irpso.captures = "//captures.json"
    assert bpy.ops.irpso.load_captures() == {"FINISHED"}
    view, other = scene.irpso.views[3], scene.irpso.views[2]
    assert (view.exposure, view.vignetting, view.response, view.shoulder, view.turn) == (0.5, 2.0, 0.75, 8.0, 10.0)
    assert (tuple(view.black_level), tuple(view.tint)) == ((0.25, 0, -0.125), (1.25, 1, 0.75))
    assert tuple(view.ambient_radiance) == (0, 0.5, 0)
    assert (tuple(other.black_level), tuple(other.tint)) == ((0, 0, 0), (1, 1, 1))


def test_a_folder_in_order_with_sub_folders_and_masks(scene, tmp_path: Path) -> None:
    """Without names: five files under five lights for each camera; hidden files and texts are left alone."""
    source = sorted((tmp_path / "good" / "refs").iterdir())
    for camera in range(2):
        folder = tmp_path / "shots" / "ab"[camera]
        folder.mkdir(parents=True)
        for n in range(5):
            shutil.copy(source[5 * camera + n], folder / f"IMG_{n + 8}.exr")
    shutil.copy(source[0], tmp_path / "shots" / "a" / "IMG_9_mask.exr")
    shutil.copy(source[0], tmp_path / "shots" / ".hidden.exr")
    (tmp_path / "shots" / "notes.txt").write_text("none")
    assert bpy.ops.irpso.add_folder(directory=str(tmp_path / "shots")) == {"FINISHED"}
    assert listed(scene) == [(f"IMG_{n + 8}.exr", f"Camera {c}", [f"Light {n}"]) for c in range(2) for n in range(5)]
    assert [Path(v.mask).name for v in scene.irpso.views if v.mask] == ["IMG_9_mask.exr"]
    assert "IMG_9.exr" in scene.irpso.views[1].image and scene.irpso.views[1].mask


@pytest.mark.parametrize("name", ["nosuch", "empty"])
def test_a_folder_without_images_is_refused(scene, tmp_path: Path, name) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(RuntimeError, match=name):
        bpy.ops.irpso.add_folder(directory=str(tmp_path / name))
    assert not scene.irpso.views


def test_a_flash_is_found_by_its_parent(scene) -> None:
    bpy.data.objects["Light 2"].parent = bpy.data.objects["Camera 0"]
    for path in (Path(bpy.data.filepath).parent / "refs").iterdir():
        path.rename(path.with_name(path.name.replace(", Light ", " shot ")))
    bpy.ops.irpso.add_folder(directory="//refs")
    assert {tuple(lights) for _, camera, lights in listed(scene) if camera == "Camera 0"} == {("Light 2",)}
    assert {tuple(lights) for _, camera, lights in listed(scene) if camera == "Camera 1"} == {()}


def test_order_and_duplicates_undo_too(scene) -> None:
    bpy.ops.irpso.add_folder(directory="//refs")
    before = listed(scene)
    views = scene.irpso.views
    rng = np.random.default_rng(2)
    for _ in range(20):
        views.move(*map(int, rng.integers(0, 10, 2)))
    scene.irpso.active_view = 4
    active = views[4].image
    assert listed(scene) != before
    assert bpy.ops.irpso.sort_views() == {"FINISHED"}
    assert listed(scene) == before and views[scene.irpso.active_view].image == active
    scene.irpso.active_view = 1
    assert bpy.ops.irpso.move_view(up=True) == {"FINISHED"} and listed(scene)[:2] == before[1::-1]
    assert scene.irpso.active_view == 0
    assert bpy.ops.irpso.move_view(up=True) == {"CANCELLED"}
    assert bpy.ops.irpso.move_view(up=False) == {"FINISHED"} and listed(scene) == before
    for image in ("//refs/Camera 0, Light 0.exr", "//refs/../refs/Camera 0, Light 1.exr", ""):
        views.add().image = image
    scene.irpso.active_view = 12
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.irpso.remove_duplicate_views("EXEC_DEFAULT", True) == {"FINISHED"}
    assert listed(scene) == [*before, ("", "", [])] and scene.irpso.active_view == 10
    assert bpy.ops.irpso.remove_duplicate_views() == {"CANCELLED"}
    bpy.ops.ed.undo()
    assert len(bpy.context.scene.irpso.views) == 13


def test_lights_of_a_view(scene) -> None:
    bpy.ops.irpso.add_folder(directory="//refs")
    scene.irpso.active_view = 3
    assert bpy.ops.irpso.remove_view_light(index=0) == {"FINISHED"} and not scene.irpso.views[3].lights
    assert not bpy.ops.irpso.remove_view_light.poll()
    assert bpy.ops.irpso.add_view() == {"FINISHED"} and scene.irpso.active_view == 10
    assert scene.irpso.views[10].camera == scene.camera


def lost_file(scene) -> str:
    (Path(bpy.data.filepath).parent / "refs" / "Camera 0, Light 0.exr").unlink()
    return "file missing"


def no_image(scene) -> str:
    scene.irpso.views[0].image = ""
    return "View 1: no image"


def broken_file(scene) -> str:
    (Path(bpy.data.filepath).parent / "refs" / "Camera 0, Light 0.exr").write_bytes(b"no image")
    return "cannot be read as an image"


def no_camera(scene) -> str:
    scene.irpso.views[0].camera = None
    return "no camera"


def deleted_camera(scene) -> str:
    scene.collection.objects.unlink(bpy.data.objects["Camera 0"])
    return "camera 'Camera 0' was deleted"


def panorama(scene) -> str:
    bpy.data.cameras["Camera 0"].type = "PANO"
    return "panoramic"


def deleted_light(scene) -> str:
    bpy.data.objects.remove(bpy.data.objects["Light 0"])
    return "no light"


def unlinked_light(scene) -> str:
    scene.collection.objects.unlink(bpy.data.objects["Light 0"])
    return "light 'Light 0' was deleted"


def dark(scene) -> str:
    for obj in [obj for obj in scene.objects if obj.type == "LIGHT"]:
        obj.hide_render = True
    for view in scene.irpso.views:
        view.lights.clear()
    return "no light in the scene renders"


def odd_space(scene) -> str:
    scene.irpso.views[0].colorspace = "Filmic"
    return "color space 'Filmic' is not known"


def odd_exposure(scene) -> str:
    scene.irpso.views[0].exposure = 100.0
    return "exposure 100 is out of range"


def lost_mask(scene) -> str:
    scene.irpso.views[0].mask = "//nosuch.png"
    return "mask: file missing"


def other_aspect(scene) -> str:
    scene.render.resolution_x *= 2
    return "not the aspect of its camera's pictures"


def no_uvs(scene) -> str:
    mesh = bpy.data.objects["Ball"].data
    mesh.uv_layers.remove(mesh.uv_layers[0])
    mesh.update_tag()
    return "Ball: has no UV map"


def no_faces(scene) -> str:
    bpy.data.objects["Ball"].data.clear_geometry()
    return "Ball: has no faces"


def all_off(scene) -> str:
    for view in scene.irpso.views:
        view.enabled = False
    return "switched off"


def no_views(scene) -> str:
    scene.irpso.views.clear()
    return "No views"


def lost_captures(scene) -> str:
    scene.irpso.captures = "//nosuch.json"
    return "nosuch.json: file missing"


def captures_of_others(scene) -> str:
    bpy.data.objects["Light 0"].name = "Lamp"
    scene.irpso.captures = "//captures.json"
    return "light 'Light 0' is not in the scene"


FAULTS = [lost_file, no_image, broken_file, no_camera, deleted_camera, panorama, deleted_light, unlinked_light, dark,
          odd_space, odd_exposure, lost_mask, other_aspect, no_uvs, no_faces, all_off, no_views, lost_captures,
          captures_of_others]


@pytest.mark.parametrize("spoil", FAULTS)
def test_what_is_missing_is_said_before_the_solve_refuses_it(scene, survey, spoil) -> None:
    """Nothing is wrong; then one thing, which the survey names and the solve refuses."""
    bpy.ops.irpso.add_folder(directory="//refs")
    scene.irpso.size = 16
    assert survey().problems() == []
    said = spoil(scene)
    problems = survey().problems()
    assert len(problems) == 1 and said in problems[0], problems
    with pytest.raises(RuntimeError):
        bpy.ops.irpso.solve()


def test_one_line_for_views_with_one_fault(scene, survey) -> None:
    bpy.ops.irpso.add_folder(directory="//refs")
    for view in list(scene.irpso.views)[:4]:
        view.camera = None
    scene.irpso.views[3].enabled = False
    assert survey().problems() == ["Camera 0, Light 0.exr and 2 more: no camera"]
    scene.irpso.views[5].image = scene.irpso.views[4].image
    assert survey().views[5].notes == ["Same image as view 5"]


def test_backgrounds_are_views_without_a_list(scene, survey) -> None:
    assert survey().problems() == ["No views; add them under Capture"]
    slot = bpy.data.cameras["Camera 0"].background_images.new()
    slot.image = bpy.data.images.load(str(Path(bpy.data.filepath).parent / "refs" / "Camera 0, Light 1.exr"))
    found = survey()
    assert found.problems() == [] and [(v.name, v.camera, v.lights) for v in found.views] == [
        ("Camera 0, Light 1.exr", "Camera 0", 5)]
    slot.image.pack()
    assert "unpack" in survey().problems()[0]


def test_names_are_shortened_to_what_differs(module) -> None:
    prefix = module("blender.scene.readiness")._prefix
    assert prefix(["Camera 1", "Camera 12", "Camera 1"]) == "Camera "
    assert prefix(["Cam.001", "Cam.002"]) == "Cam."
    assert prefix(["Only", "Only"]) == "Only"
    assert prefix(["Front", "Fro"]) == prefix(["Left", "Right"]) == prefix(["Key", "Key Left"]) == prefix([]) == ""
    assert prefix(["light1", "light2"]) == ""


def test_asking_is_cheap(scene, module, survey) -> None:
    """Of 500 views, in at most 20 times what reading their fields once takes; 10 were measured, 3 ms in all."""
    bpy.ops.irpso.add_folder(directory="//refs")
    for n in range(490):
        view = scene.irpso.views.add()
        view.image, view.camera = f"//refs/{n}.exr", bpy.data.objects["Camera 1"]
        view.lights.add().light = bpy.data.objects["Light 1"]
    survey()
    readiness, times = module("blender.scene.readiness"), []

    def read() -> None:
        for view in scene.irpso.views:
            assert view.enabled and view.image and view.camera.name and [item.light.name for item in view.lights]

    for _ in range(7):
        start = time.thread_time()
        readiness.survey(bpy.context)
        middle = time.thread_time()
        read()
        times.append((middle - start) / (time.thread_time() - middle))
    assert min(times) < 20, times


def test_every_selected_mesh_is_looked_at(scene, survey) -> None:
    bpy.ops.irpso.add_folder(directory="//refs")
    other = bpy.data.objects.new("Second", bpy.data.meshes.new("Second"))
    scene.collection.objects.link(other)
    assert survey().problems() == []
    other.select_set(True)
    assert survey().problems() == ["Second: has no faces"]


def test_the_estimate_counts_the_world_that_lights_views(scene, module, survey) -> None:
    """The same worlds as a solve reads: a grey one is no light beside lamps, and one with a picture is."""
    solve_speed, read_scene = module("blender.jobs.solve_speed"), module("blender.scene.scene").read_scene
    bpy.ops.irpso.add_folder(directory="//refs")
    scene.world = bpy.data.worlds.new("Room")
    if scene.world.node_tree is None:
        scene.world.use_nodes = True
    grey = survey()
    assert [state.environment for state in grey.views] == [""] * len(grey.views)
    readiness = module("blender.scene.readiness")

    def expected():
        wait(lambda: all(view.file is not None for view in readiness.survey(bpy.context).views))
        readiness.recent(bpy.context, renew=True)
        return solve_speed.of(bpy.context)

    before = expected()
    tree = scene.world.node_tree
    background = next(node for node in tree.nodes if node.type == "BACKGROUND")
    tree.links.new(tree.nodes.new("ShaderNodeTexSky").outputs[0], background.inputs["Color"])
    lit = survey()
    assert len({state.environment for state in lit.views}) == 1
    assert all(state.environment for state in lit.views)
    assert all(view.environment is not None for view in read_scene(None, "Ball", None).views)
    after = expected()
    assert after.seconds > before.seconds + 1
    assert after.gpu_bytes > before.gpu_bytes
    assert scene.cycles.max_bounces == 0 and after.bounced == 0  # pictures of direct light alone
    scene.cycles.max_bounces = 4
    assert before.bounced == 0 and expected().bounced > 1.5 * after.seconds  # a solve finds out whether light bounces
    scene.irpso.indirect = "off"
    assert expected().bounced == 0


def test_a_thumbnail_shows_radiance_as_srgb(module) -> None:
    """Exposure taken out, encoded as IEC 61966-2-1 says, in the middle of a square; transparent around it."""
    thumbnails = module("blender.scene.thumbnails")
    side = module("core.capture.file_preview").SIDE
    linear = np.zeros((side // 2, side, 4), np.float32)
    linear[...] = 0.5, 0.02, 4.0, 1.0
    linear[:, : side // 4] *= 0.5  # half transparent: premultiplied
    pixels = thumbnails._developed(linear, 1.0, "Linear Rec.709").view(np.uint8).reshape(side, side, 4)
    expected = [round(255 * (1.055 * 0.25 ** (1 / 2.4) - 0.055)), round(255 * (1.055 * 0.01 ** (1 / 2.4) - 0.055)), 255]
    top = side // 4
    assert not pixels[:top].any() and not pixels[-top:].any()
    assert pixels[top, -1].tolist() == [*expected, 255] and pixels[-top - 1, 0].tolist() == [*expected, 128]


def test_the_estimate_learns_and_remembers(scene, module, survey, tmp_path: Path, monkeypatch) -> None:
    """What a solve took is in the file soon after; another Blender reads it.  A part teaches nothing."""
    solve_speed, read_scene = module("blender.jobs.solve_speed"), module("blender.scene.scene").read_scene
    monkeypatch.setattr(solve_speed, "path", lambda: tmp_path / "config" / "speed.json")
    solve_speed.forget()
    bpy.ops.irpso.add_folder(directory="//refs")
    survey()
    wait(lambda: all(view.file is not None for view in module("blender.scene.readiness").survey(bpy.context).views))
    before = solve_speed.of(bpy.context)
    assert not before.learnt
    data, settings = read_scene(None, "Ball", None), module("blender.properties").settings(scene.irpso)
    took = {"gbuffer": 0.1, "observe": 0.2, "solve": 0.5, "maps": 0.1}
    solution = SimpleNamespace(cancelled=False, seconds=took)
    solve_speed.learn(replace(data, region=object()), settings, solution, 1.0)
    assert not solve_speed.of(bpy.context).learnt
    solve_speed.learn(data, settings, solution, 1.0)
    wait((tmp_path / "config" / "speed.json").exists)
    solve_speed.forget()
    after = solve_speed.of(bpy.context)
    assert after.learnt and after.seconds < before.seconds
    assert 0.5 < after.seconds < 2.0  # 1 s was taken
    solve_speed.forget()


def wait(said) -> None:
    end = time.monotonic() + 10
    while not said() and time.monotonic() < end:
        time.sleep(0.02)
    assert said()


def test_exposures_by_exif_of_a_folder(scene, module, tmp_path: Path, capfd) -> None:
    """One line, and one click, after which the list is as the EXIF of the files states it.

    One view has its number already, one is off, one has no EXIF, one's file is gone; the click names the last two.
    """
    folder = tmp_path / "good" / "jpeg"
    folder.mkdir()
    for name, time_, number, iso in (("a", 1 / 60, 8.0, 100), ("b", 1 / 30, 8.0, 100), ("c", 1 / 60, 8.0, 200),
                                     ("d", 1 / 60, 16.0, 100), ("e", 1 / 60, 8.0, 100), ("g", 1 / 15, 8.0, 100)):
        save(folder / f"{name}.jpg", np.full((24, 32, 3), 0.5, np.float32), "uint8", ExposureTime=time_, FNumber=number,
             Exif__PhotographicSensitivity=iso)
    save(folder / "f.jpg", np.full((24, 32, 3), 0.5, np.float32), "uint8")
    assert bpy.ops.irpso.add_folder(directory="//jpeg") == {"FINISHED"}
    views = scene.irpso.views
    views.add().image = "//jpeg/gone.jpg"
    assert [Path(view.image).stem for view in views] == ["a", "b", "c", "d", "e", "f", "g", "gone"]
    views[2].exposure, views[5].exposure, views[6].enabled = 1.0, 0.3, False
    exposures, readiness, thumbnails = (module(f"blender.scene.{name}") for name in (
        "view_exposures", "readiness", "thumbnails"))

    def stated() -> str:
        return exposures.line(scene, [view.file for view in readiness.survey(bpy.context).views])

    assert stated() == ""  # nothing is known yet
    end = time.monotonic() + 10
    while thumbnails._images.busy and time.monotonic() < end:
        time.sleep(0.01)
    assert stated().startswith(
        "2 of 7 views: EXIF states another Exposure, most for 'd.jpg' (-2.00 EV, not +0.00 EV); set it, unless a flash")
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.irpso.exposures_by_exif("EXEC_DEFAULT", True) == {"FINISHED"}
    assert "Warning: 'f.jpg', 'gone.jpg': EXIF states no exposure" in capfd.readouterr().out
    assert [view.exposure for view in views] == pytest.approx([0, 1, 1, -2, 0, 0.3, 0, 0], abs=1e-3)
    assert stated() == "" and bpy.ops.irpso.exposures_by_exif() == {"CANCELLED"}
    bpy.ops.ed.undo()
    views = bpy.context.scene.irpso.views
    assert [view.exposure for view in views] == pytest.approx([0, 0, 1, 0, 0, 0.3, 0, 0])
    views.add()  # a view without picture, which the list itself calls so
    capfd.readouterr()
    assert bpy.ops.irpso.exposures_by_exif() == {"FINISHED"}
    assert "Warning: 'f.jpg', 'gone.jpg': EXIF" in capfd.readouterr().out
