"""The button Import Shoot: in a scene that has other things, with undo, and with nothing left where it fails."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector

from tests.support.picture_files import save
from tests.support.project_files import ring, write_transforms

MIDDLE = np.array([0.0, 0.0, 3.0])  # what the cameras look at, far from the origin: a mesh that is turned is seen so
SHARED = {"camera_model": "OPENCV", "w": 30, "h": 20, "fl_x": 40.0, "fl_y": 40.0, "cx": 15.0, "cy": 10.0}
CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-0.8, 0.8) for z in (-0.5, 0.5)]) * 0.5
FACES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
KINDS = ("objects", "meshes", "materials", "images", "collections", "cameras", "lights", "actions", "armatures")


def write_obj(path: Path, corners: np.ndarray, parts: int = 1) -> None:
    """A box without UV map, as ``parts`` objects of some faces each."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in corners.tolist()]
    for part in range(parts):
        lines.append(f"o part{part}")
        lines += ["f " + " ".join(str(corner + 1) for corner in face) for face in FACES[part::parts]]
    path.write_text("\n".join(lines) + "\n")


@pytest.fixture
def shoot(tmp_path: Path) -> Path:
    """A folder: four grey pictures, their transforms.json, a box."""
    folder = tmp_path / "shoot"
    (folder / "pictures").mkdir(parents=True)
    shots = ring(4, ".tif")
    write_transforms(folder / "transforms.json", shots, SHARED)
    content = json.loads((folder / "transforms.json").read_text())
    for frame in content["frames"]:
        for row, shift in zip(frame["transform_matrix"], MIDDLE, strict=False):
            row[3] += shift
    (folder / "transforms.json").write_text(json.dumps(content))
    for shot in shots:
        save(folder / "pictures" / shot.name, np.full((20, 30, 3), 0.5, np.float32), "uint16")
    write_obj(folder / "box.obj", CORNERS + MIDDLE)
    return folder


@pytest.fixture
def scene(extension, tmp_path: Path) -> bpy.types.Scene:
    """A saved file with a cube, a camera of its own with a view, and a lamp; the cube is selected."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_cube_add(location=(5, 0, 0))
    for name, data in (("IMG_0000", bpy.data.cameras.new("Cam")), ("Flash", bpy.data.lights.new("Flash", "POINT"))):
        scene.collection.objects.link(bpy.data.objects.new(name, data))
    scene.render.resolution_x, scene.render.resolution_y = 64, 48
    view = scene.irpso.views.add()
    view.image, view.camera = "//render.exr", bpy.data.objects["IMG_0000"]
    view.lights.add().light = bpy.data.objects["Flash"]
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    return scene


def ask(scene: bpy.types.Scene, **more) -> None:
    """Fills in the panel."""
    fields = {"project": "//shoot/transforms.json", "images": "//shoot/pictures/", "mesh": "//shoot/box.obj",
              "flash_power": 5.0, **more}
    for name, value in fields.items():
        setattr(scene.irpso.shoot, name, value)


def state(scene: bpy.types.Scene) -> dict[str, object]:
    """All that an import changes."""
    found: dict[str, object] = {kind: sorted(block.name for block in getattr(bpy.data, kind)) for kind in KINDS}
    layer = bpy.context.view_layer
    found["selected"] = sorted(obj.name for obj in layer.objects if obj.select_get())
    found["active"] = layer.objects.active and layer.objects.active.name
    found["views"] = [(view.image, view.camera.name, view.lights[0].light.name) for view in scene.irpso.views]
    found["scene"] = (scene.irpso.photographs, scene.irpso.scale_known, scene.render.resolution_x, bpy.context.mode)
    return found


def failed(scene: bpy.types.Scene, words: str, **more) -> None:
    """The operator reports one line with these words, and the file is as it was."""
    ask(scene, **more)
    before = state(scene)
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.irpso.import_shoot()
    assert len(str(caught.value).strip().splitlines()) == 1 and words in str(caught.value)
    assert state(scene) == before


def test_it_waits_for_its_fields(scene) -> None:
    assert not bpy.ops.irpso.import_shoot.poll()
    ask(scene, images="")
    assert not bpy.ops.irpso.import_shoot.poll()
    ask(scene)
    assert bpy.ops.irpso.import_shoot.poll()
    bpy.context.view_layer.objects.active = bpy.data.objects["Cube"]
    bpy.ops.object.mode_set(mode="EDIT")
    assert not bpy.ops.irpso.import_shoot.poll()


def test_into_a_scene_that_has_views(scene, shoot) -> None:
    ask(scene)
    first = state(scene)
    assert bpy.ops.irpso.import_shoot() == {"FINISHED"}
    views = scene.irpso.views
    assert state(scene)["views"][0] == first["views"][0] and scene.render.resolution_x == 64
    assert [view.image for view in views][1:] == [f"//shoot/pictures/IMG_000{n}.tif" for n in range(4)]
    assert views[1].camera.name == "IMG_0000.001" and views[1].camera.data.irpso_lens.use
    assert not bpy.data.objects["IMG_0000"].data.irpso_lens.use
    assert views[1].lights[0].light.parent == views[1].camera and views[1].lights[0].light.data.name == "Flash.001"
    box = bpy.context.view_layer.objects.active
    assert box.name == "box" and bpy.context.selected_objects == [box] and box.data.uv_layers
    assert box.material_slots[0].material is not None and scene.irpso.photographs


def test_twice(scene, shoot, module) -> None:
    """Both stay; the second is told that the pictures count twice."""
    ask(scene)
    bpy.ops.irpso.import_shoot()
    importing, settings = module("blender.shoot.import_shoot"), module("blender.properties").shoot_settings
    files = importing.Shoot(shoot / "transforms.json", shoot / "pictures", shoot / "box.obj")
    imported = module("core.job").run_to_end(
        importing.import_shoot(files, settings(scene.irpso.shoot), str), lambda _: None)
    assert [line for line in imported.messages if "they now count twice" in line] == [
        "4 pictures: already views of the scene, so they now count twice; undo one of the imports"]
    assert len(scene.irpso.views) == 9 and "box.001" in bpy.data.objects and "Shoot.001" in bpy.data.collections
    assert len({view.camera for view in scene.irpso.views}) == 9


def test_a_power_that_is_not_known_stays_so(scene, shoot) -> None:
    ask(scene, flash_power=0.0)
    bpy.ops.irpso.import_shoot()
    assert not scene.irpso.scale_known and scene.irpso.views[1].lights[0].light.data.energy > 0
    assert bpy.data.objects["Flash"].data.energy == 10.0  # Blender's default: the scene's own lamp
    ask(scene)
    bpy.ops.irpso.import_shoot()
    assert not scene.irpso.scale_known  # of the first import's views


def test_what_is_added_was_read_before(scene, shoot, module) -> None:
    """A window stands still while a shoot is added, so that no picture is read then: there is none any more."""
    ask(scene, flash_power=0.0)
    importing, run = module("blender.shoot.import_shoot"), module("core.job").run_to_end
    given = module("blender.properties").shoot_settings(scene.irpso.shoot)
    files = importing.Shoot(shoot / "transforms.json", shoot / "pictures", shoot / "box.obj")
    read = run(importing.read_shoot(files, given), lambda _: None)
    (shoot / "pictures").rename(shoot / "elsewhere")
    imported = run(importing.add_shoot(read, given, str), lambda _: None)
    (shoot / "elsewhere").rename(shoot / "pictures")
    views = list(scene.irpso.views)[1:]
    found = views[0].lights[0].light.data.energy
    power = module("blender.shoot.flash_power").flash_power
    assert found != 1.0 and found == pytest.approx(power(bpy.context, imported.mesh, views, found), rel=1e-4)


def test_a_power_does_not_hang_on_how_the_mesh_is_kept(scene, shoot, module) -> None:
    """The same with faces that point inwards, and with a scale of the object instead of the mesh; a mesh of no size."""
    ask(scene)
    bpy.ops.irpso.import_shoot()
    power, mesh = module("blender.shoot.flash_power").flash_power, bpy.context.view_layer.objects.active
    views = list(scene.irpso.views)[1:]
    found = power(bpy.context, mesh, views, 5.0)
    mesh.data.flip_normals()
    assert power(bpy.context, mesh, views, 5.0) == pytest.approx(found, rel=1e-6)
    squeeze = Matrix.Diagonal((0.2, 3.0, 1.5, 1.0))
    mesh.data.transform(squeeze)
    mesh.matrix_world = mesh.matrix_world @ squeeze.inverted()
    bpy.context.view_layer.update()
    assert power(bpy.context, mesh, views, 5.0) == pytest.approx(found, rel=1e-4)
    mesh.scale = 0, 0, 0
    bpy.context.view_layer.update()
    with pytest.raises(module("core.errors").BadInput, match="it is black in every picture"):
        power(bpy.context, mesh, views, 5.0)


def test_one_undo(scene, shoot) -> None:
    ask(scene)
    bpy.ops.ed.undo_push(message="before")
    before = state(scene)
    bpy.ops.irpso.import_shoot("EXEC_DEFAULT", True)
    assert len(bpy.context.scene.irpso.views) == 5
    bpy.ops.ed.undo()
    assert state(bpy.context.scene) == before


def test_failures_leave_nothing(scene, shoot) -> None:
    for path in (shoot / "pictures").iterdir():  # found out at the very end, when all has been made
        save(path, np.zeros((20, 30, 3), np.float32), "uint16")
    failed(scene, "mesh 'box': it is black in every picture", flash_power=0.0)
    write_obj(shoot / "box.obj", CORNERS + np.array([90, 0, 0]))
    failed(scene, "its coordinates differ from those of the project's cameras")
    (shoot / "noise.glb").write_bytes(bytes(range(256)))
    failed(scene, "noise.glb: Blender cannot read it", mesh="//shoot/noise.glb")
    bpy.context.scene.unit_settings.scale_length = 0.001
    failed(scene, "scene 'Scene': its Unit Scale is 0.001")
    bpy.context.scene.unit_settings.scale_length = 1.0
    failed(scene, "file not found", mesh="//shoot/none.ply")
    failed(scene, "folder not found", images="//nowhere")
    failed(scene, "cannot be opened", project="//nowhere.xml")


def test_relative_paths_need_a_saved_file(extension) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    ask(bpy.context.scene)
    with pytest.raises(RuntimeError, match=r"is relative to a \.blend that was never saved"):
        bpy.ops.irpso.import_shoot()


def world(obj: bpy.types.Object) -> np.ndarray:
    """(8, 3) the corners, in an order that does not depend on the file."""
    found = np.array([obj.matrix_world @ vertex.co for vertex in obj.data.vertices])
    return np.unique(found.round(4), axis=0)


def export(path: Path, corners: np.ndarray, scale: float = 1.0) -> None:
    """Two objects with a parent, a lamp and a camera beside them, by Blender's exporters; nothing of it stays."""
    write_obj(path.with_name("parts.obj"), corners * scale, parts=2)
    bpy.ops.wm.obj_import(filepath=str(path.with_name("parts.obj")), forward_axis="Y", up_axis="Z",
                          use_split_objects=True)
    parts = list(bpy.context.selected_objects)
    assert len(parts) == 2
    holder = bpy.data.objects.new("holder", None)
    extra = [holder, bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "SUN")),
             bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))]
    for obj in extra:
        bpy.context.scene.collection.objects.link(obj)
        obj.select_set(True)
    for part in parts:
        part.parent = holder
    bpy.context.view_layer.update()
    {".obj": lambda: bpy.ops.wm.obj_export(filepath=str(path), forward_axis="Y", up_axis="Z",
                                           export_selected_objects=True),
     ".ply": lambda: bpy.ops.wm.ply_export(filepath=str(path), forward_axis="Y", up_axis="Z",
                                           export_selected_objects=True),
     ".fbx": lambda: bpy.ops.export_scene.fbx(filepath=str(path), use_selection=True, axis_forward="Y", axis_up="Z"),
     ".glb": lambda: bpy.ops.export_scene.gltf(filepath=str(path), use_selection=True),
     ".usdc": lambda: bpy.ops.wm.usd_export(filepath=str(path), selected_objects_only=True)}[path.suffix]()
    bpy.data.batch_remove([*parts, *extra])
    bpy.data.orphans_purge()


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # in Blender's own exporters
@pytest.mark.parametrize("suffix", [".obj", ".ply", ".fbx", ".glb", ".usdc"])
def test_meshes_of_several_parts(scene, shoot, suffix) -> None:
    """One object where the cameras see it, with a UV map, and nothing else of the file."""
    export(shoot / f"whole{suffix}", CORNERS + MIDDLE)
    ask(scene, mesh=f"//shoot/whole{suffix}", scale=0.5)
    before = state(scene)
    assert bpy.ops.irpso.import_shoot() == {"FINISHED"}
    obj = bpy.context.view_layer.objects.active
    assert obj.name == "whole" and len(obj.data.polygons) in (6, 12) and obj.parent is None
    np.testing.assert_allclose(world(obj), np.unique(((CORNERS + MIDDLE) * 0.5).round(4), axis=0), atol=2e-4)
    assert {name for name in state(scene)["objects"] if name not in before["objects"]} == {
        "whole", *(f"IMG_000{n}" for n in range(1, 4)), "IMG_0000.001", "Flash IMG_0000.001",
        *(f"Flash IMG_000{n}" for n in range(1, 4))}
    assert [len(getattr(bpy.data, kind)) - len(before[kind]) for kind in ("meshes", "collections", "lights")] == [
        1, 1, 1]
    assert len(obj.data.uv_layers) == 1


def test_a_mesh_with_y_up(scene, shoot) -> None:
    turned = (CORNERS + MIDDLE)[:, [0, 2, 1]] * (1, 1, -1)  # Z up to Y up
    write_obj(shoot / "box.obj", turned)
    ask(scene)
    bpy.ops.irpso.import_shoot()
    np.testing.assert_allclose(world(bpy.data.objects["box"]), np.unique((CORNERS + MIDDLE).round(4), axis=0),
                               atol=2e-4)


@pytest.mark.parametrize("unit", [100, 0.01, 1000])
def test_a_mesh_in_another_unit(scene, shoot, unit) -> None:
    write_obj(shoot / "box.obj", (CORNERS + MIDDLE) * unit)
    ask(scene)
    bpy.ops.irpso.import_shoot()
    np.testing.assert_allclose(world(bpy.data.objects["box"]), np.unique((CORNERS + MIDDLE).round(4), axis=0),
                               atol=2e-4)


@pytest.mark.parametrize("scale", [0.002, 1.0, 2000.0])
def test_cameras_show_the_mesh(scene, shoot, scale) -> None:
    """Blender shows nothing nearer or further than a camera's clipping."""
    ask(scene, scale=scale)
    assert bpy.ops.irpso.import_shoot() == {"FINISHED"}
    obj = bpy.context.view_layer.objects.active
    for view in list(scene.irpso.views)[1:]:
        eye = view.camera.matrix_world.inverted()
        depths = [-(eye @ (obj.matrix_world @ vertex.co)).z for vertex in obj.data.vertices]
        assert 0 < view.camera.data.clip_start < min(depths) and max(depths) < view.camera.data.clip_end


def test_cameras_look_where_the_pictures_do(scene, shoot) -> None:
    """By Blender's own camera matrix, which is near the lens: the box is in the picture's middle."""
    ask(scene)
    bpy.ops.irpso.import_shoot()
    for view in list(scene.irpso.views)[1:]:
        local = view.camera.matrix_world.inverted() @ Vector(MIDDLE)
        assert local.z < -3 and abs(local.x / local.z) < 0.3 and abs(local.y / local.z) < 0.3
        assert tuple(view.camera.matrix_world.to_scale()) == pytest.approx((1, 1, 1), abs=1e-5)
