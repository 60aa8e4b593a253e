"""Cameras by way of Alembic and USD: Blender exports a rig that is known, and the import is asked for it again."""

from __future__ import annotations

import math
from pathlib import Path

import bpy
import numpy as np
import pytest

from irpso_addon.blender import files
from irpso_addon.blender.scene.scene_objects import read_camera
from irpso_addon.blender.shoot import rollback
from irpso_addon.blender.shoot.import_shoot import Shoot, import_shoot
from irpso_addon.core.errors import BadInput
from irpso_addon.core.job import run_to_end
from irpso_addon.core.params import ShootSettings
from tests.support.picture_files import save

SIZE = 60, 40
SUFFIXES = (".abc", ".usd", ".usda", ".usdc", ".usdz")
ZOOMS = bpy.app.version >= (5, 0, 0)  # older ones read no change of the focal length from Alembic


def new_scene() -> bpy.types.Scene:
    files.new_blend()
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    return scene


def add_camera(name: str, turn: float, **more) -> bpy.types.Object:
    """At 4 m from the origin, towards it, not level."""
    data = bpy.data.cameras.new("data of " + name)
    for key, value in {"lens": 40.0, "sensor_width": 36.0, "sensor_height": 24.0, **more}.items():
        setattr(data, key, value)
    obj = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(obj)
    place(obj, turn)
    return obj


def place(obj: bpy.types.Object, turn: float) -> None:
    from mathutils import Quaternion, Vector

    at = Vector((math.cos(turn), math.sin(turn), 0.4 * math.sin(3 * turn))) * 4
    obj.location = at
    obj.rotation_euler = ((-at).to_track_quat("-Z", "Y") @ Quaternion((0, 0, 1), 0.3 * turn)).to_euler()


def export(path: Path, frames: tuple[int, int] = (1, 1)) -> Path:
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = frames
    if path.suffix == ".abc":
        bpy.ops.wm.alembic_export(filepath=str(path), start=frames[0], end=frames[1], as_background_job=False)
    else:
        bpy.ops.wm.usd_export(filepath=str(path), export_animation=frames[0] < frames[1])
    return path


def pictures(folder: Path, names: list[str], size: tuple[int, int] = SIZE) -> Path:
    folder.mkdir()
    for name in names:
        save(folder / f"{name}.tif", np.full((size[1], size[0], 3), 0.5, np.float32), "uint16")
    return folder


def matrices(scene: bpy.types.Scene, cameras: list[bpy.types.Object]) -> list[np.ndarray]:
    """(4, 4) of each, from world to clip space: place, focal length and shift in one, as Blender itself says."""
    graph = bpy.context.evaluated_depsgraph_get()
    found = []
    for obj in cameras:
        clip = obj.evaluated_get(graph).calc_matrix_camera(graph, x=scene.render.resolution_x,
                                                          y=scene.render.resolution_y)
        found.append(np.array(clip) @ np.linalg.inv(np.array(obj.evaluated_get(graph).matrix_world)))
    return found


def bring(project: Path, images: Path, mesh: Path | None = None):
    settings = ShootSettings(flash_power=5.0)
    return run_to_end(import_shoot(Shoot(project, images, mesh), settings, str), lambda step: None)


def compare(want: list[np.ndarray], places: list[np.ndarray]) -> None:
    """Where points of the world are in the pictures, to a thousandth of a pixel; where cameras are, to 1e-5 m."""
    scene = bpy.context.scene
    graph = bpy.context.evaluated_depsgraph_get()
    assert len(scene.irpso.views) == len(want)
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 3))
    by_name = {Path(view.image).stem: view.camera for view in scene.irpso.views}
    for name, clip, at in zip(sorted(by_name), want, places, strict=True):
        camera = read_camera(by_name[name], scene, graph)
        x, y, _, w = clip @ np.concatenate([points, np.ones((20, 1))], 1).T
        expected = np.stack([(x / w + 1) / 2 * SIZE[0], (1 - y / w) / 2 * SIZE[1]], -1)
        local = camera.world_to_camera @ np.concatenate([points, np.ones((20, 1))], 1).T
        found = camera.lens.project(local[:3].T * (1, -1, -1))
        np.testing.assert_allclose(found, expected, atol=1e-3)
        np.testing.assert_allclose(camera.position, at, atol=1e-5)


@pytest.fixture
def irpso():
    """The views' properties, without the operators."""
    files.new_blend()


@pytest.mark.usefixtures("irpso")
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_camera_for_each_picture(tmp_path, suffix):
    """Different focal lengths, sensors and shifts; a mesh in the file; names that are not the data's."""
    scene = new_scene()
    given = [{}, {"lens": 55.0, "shift_x": 0.1, "shift_y": -0.05}, {"sensor_width": 22.3, "sensor_height": 14.9},
             {"shift_x": -0.02, "sensor_width": 30.0, "sensor_height": 20.0}]
    cameras = [add_camera(f"IMG_000{n}", 1.4 * n, **more) for n, more in enumerate(given)]
    cameras[0].data.name, cameras[1].data.name = "IMG_0001", "IMG_0000"  # which are not their pictures
    add_camera("spare", 3.0)
    bpy.ops.mesh.primitive_cube_add(size=1)
    bpy.context.view_layer.update()
    want, places = matrices(scene, cameras), [np.array(obj.location) for obj in cameras]
    project = export(tmp_path / f"shot{suffix}")
    new_scene()
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("IMG_0002", None))  # a name that is taken
    before = rollback.blocks()
    found = bring(project, pictures(tmp_path / "p", [f"IMG_000{n}" for n in range(4)]))
    compare(want, places)
    assert found.mesh.name == "shot" and len(found.mesh.data.polygons) == 6 and not found.mesh.constraints
    assert any("'spare': left out: no picture has its name" in line for line in found.messages)
    assert [scene.name for scene in bpy.data.scenes] == ["Scene"] and not bpy.data.cache_files
    kinds = sorted(type(block).__name__ for block in rollback.blocks() - before)
    # mesh, cameras, flashes, and one lens for each camera: nothing else of the file
    assert kinds.count("Object") == 9 and kinds.count("Camera") == 4 and kinds.count("Mesh") == 1
    assert set(kinds) == {"Object", "Camera", "Mesh", "PointLight", "Material", "Collection"}


@pytest.mark.usefixtures("irpso")
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_one_mesh_without_uv_map_beside_the_cameras(tmp_path, suffix):
    new_scene()
    names = [f"IMG_000{n}" for n in range(3)]
    for n, name in enumerate(names):
        add_camera(name, 1.4 * n)
    bpy.ops.mesh.primitive_cube_add(size=1, calc_uvs=False)
    project = export(tmp_path / f"shot{suffix}")
    new_scene()
    found = bring(project, pictures(tmp_path / "p", names))
    assert found.views == 3 and len(found.mesh.data.uv_layers) == 1
    assert any("has no UV map; one was made" in line for line in found.messages)


@pytest.mark.usefixtures("irpso")
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_one_camera_that_moves(tmp_path, suffix):
    """Frame 3 is picture 3.  It zooms, but not in Alembic for Blenders that do not read that."""
    scene = new_scene()
    camera = add_camera("Camera", 0.0)
    bpy.ops.mesh.primitive_cube_add(size=1)
    frames, want, places = (3, 7), [], []
    for frame in range(frames[0], frames[1] + 1):
        place(camera, 0.7 * frame)
        camera.keyframe_insert("location", frame=frame)
        camera.keyframe_insert("rotation_euler", frame=frame)
        if ZOOMS or suffix != ".abc":
            camera.data.lens = 35 + frame
            camera.data.keyframe_insert("lens", frame=frame)
    for frame in range(frames[0], frames[1] + 1):
        scene.frame_set(frame)
        want += matrices(scene, [camera])
        places.append(np.array(camera.matrix_world)[:3, 3])
    project = export(tmp_path / f"shot{suffix}", frames)
    new_scene()
    bpy.context.scene.frame_current, bpy.context.scene.frame_end = 17, 99
    bring(project, pictures(tmp_path / "p", [f"take2_{n:04d}" for n in range(3, 8)]))
    compare(want, places)
    assert not bpy.data.actions and not bpy.data.cache_files
    assert bpy.context.scene.frame_current == 17 and bpy.context.scene.frame_end == 99


@pytest.mark.usefixtures("irpso")
def test_the_frame_rate(tmp_path):
    """Alembic counts seconds: at another rate the frames are not the pictures'.  USD counts frames."""
    scene = new_scene()
    scene.render.fps = 30
    camera = add_camera("Camera", 0.0)
    bpy.ops.mesh.primitive_cube_add(size=1)
    for frame in range(1, 11):
        place(camera, 0.5 * frame)
        camera.keyframe_insert("location", frame=frame)
        camera.keyframe_insert("rotation_euler", frame=frame)
    places = []
    for frame in range(1, 11):
        scene.frame_set(frame)
        places.append(np.array(camera.matrix_world)[:3, 3])
    alembic, usd = (export(tmp_path / f"a{suffix}", (1, 10)) for suffix in (".abc", ".usdc"))
    folder = pictures(tmp_path / "p", [f"{n:03d}" for n in range(1, 11)])
    new_scene()
    with pytest.raises(BadInput, match="moves from frame 1 to 8 at 24 frames a second, but the pictures are from 1 to "
                                       "10 numbered; export a frame for each picture, at the scene's frame rate"):
        bring(alembic, folder)
    for project, rate in ((alembic, 30), (usd, 24), (usd, 30)):
        new_scene().render.fps = rate
        bring(project, folder)
        graph = bpy.context.evaluated_depsgraph_get()
        views = sorted(bpy.context.scene.irpso.views, key=lambda view: view.image)
        found = [read_camera(view.camera, bpy.context.scene, graph).position for view in views]
        np.testing.assert_allclose(found, places, atol=1e-5)


@pytest.mark.usefixtures("irpso")
@pytest.mark.parametrize("suffix", [".abc", ".usdc"])
def test_upright_pictures_and_scaled_parents(tmp_path, suffix):
    """An upright picture of a film that lies, as Blender has it; a scene under a parent that counts in centimetres."""
    scene = new_scene()
    scene.render.resolution_x, scene.render.resolution_y = 40, 60
    holder = bpy.data.objects.new("holder", None)
    scene.collection.objects.link(holder)
    holder.scale = (0.01,) * 3
    camera = add_camera("IMG_1", 1.0, shift_y=0.04)
    camera.location *= 100
    bpy.ops.mesh.primitive_cube_add(size=100)
    for obj in (camera, bpy.context.object):
        obj.parent = holder
    bpy.context.view_layer.update()
    (want,) = matrices(scene, [camera])
    project = export(tmp_path / f"a{suffix}")
    new_scene()
    bring(project, pictures(tmp_path / "p", ["IMG_1"], (40, 60)))
    (view,) = bpy.context.scene.irpso.views
    found = read_camera(view.camera, bpy.context.scene, bpy.context.evaluated_depsgraph_get())
    x, y, _, w = want @ (0.1, 0.2, 0.3, 1)
    local = found.world_to_camera @ (0.1, 0.2, 0.3, 1)
    assert found.lens.project(local[:3] * (1, -1, -1)) == pytest.approx(
        ((x / w + 1) / 2 * 40, (1 - y / w) / 2 * 60), abs=1e-3)


@pytest.mark.usefixtures("irpso")
@pytest.mark.parametrize("suffix", [".abc", ".usdc"])
def test_what_cannot_be_read(tmp_path, suffix):
    """One line each, and nothing stays."""
    folder = pictures(tmp_path / "p", ["IMG_1", "IMG_2"])

    def refused(name: str, words: str) -> None:
        new_scene()
        before = rollback.blocks()
        with pytest.raises(BadInput) as caught:
            bring(tmp_path / f"{name}{suffix}", folder)
        message = str(caught.value)
        assert "\n" not in message and words in message and message.startswith(str(tmp_path)), message
        assert rollback.blocks() == before and len(bpy.data.scenes) == 1

    refused("none", "file not found")
    (tmp_path / f"noise{suffix}").write_bytes(bytes(range(256)) * 4)
    refused("noise", "Blender cannot read it")
    new_scene()
    bpy.ops.mesh.primitive_cube_add(size=1)
    export(tmp_path / f"mesh{suffix}")
    refused("mesh", "has no perspective camera; export perspective cameras")
    add_camera("Other", 1.0)
    export(tmp_path / f"other{suffix}")
    refused("other", "no picture has the name of a camera ('Other' ...)")
    new_scene()
    add_camera("IMG_1", 1.0)
    export(tmp_path / f"bare{suffix}")
    refused("bare", "has no mesh beside it; " if suffix == ".abc" else "has several meshes beside it: ")
    new_scene()
    bpy.ops.mesh.primitive_cube_add(size=1)
    add_camera("IMG_2", 2, type="ORTHO")
    export(tmp_path / f"flat{suffix}")  # Blender writes none
    refused("flat", "has no perspective camera")


@pytest.mark.usefixtures("irpso")
def test_orthographic_in_usd(tmp_path):
    (tmp_path / "a.usda").write_text('#usda 1.0\ndef Camera "IMG_1"\n{\n    token projection = "orthographic"\n}\n')
    with pytest.raises(BadInput, match="camera 'IMG_1': is orthographic"):
        bring(tmp_path / "a.usda", pictures(tmp_path / "p", ["IMG_1"]))
