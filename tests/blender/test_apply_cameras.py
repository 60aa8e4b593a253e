"""Apply to Scene: cameras as a solve has found them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix

SIZE = 96, 64
POINTS = np.array([(0.3, 0.2, 0.1), (-0.4, 0.1, 0.0), (0.1, -0.5, 0.3), (0.0, 0.0, 0.0)])


@pytest.fixture
def scene(ball_scene: bpy.types.Scene) -> bpy.types.Scene:
    return ball_scene


@pytest.fixture
def keep(module):
    """``keep(*cameras)``: a solution of the ball that has put these right."""
    records, session = module("core.data"), module("blender.jobs.session").session

    def of(*cameras):
        grey, none = np.full((4, 4), 0.5, np.float32), np.zeros((4, 4), bool)
        maps = records.Maps(np.full((4, 4, 3), 0.5, np.float32), grey, grey, grey, none, ~none, grey, grey)
        solution = replace(records.Solution.of_maps(maps, {"Paint": "one-lobe"}), cameras=cameras)
        session.keep(bpy.data.objects["Ball"], solution)
        return session

    return of


@pytest.fixture
def change(module):
    """Record of a change of a camera: turned by 2 degrees, zoomed by 1 %, shifted by a pixel and a half."""
    kind = module("core.change_records").CameraChange

    def of(name: str = "Camera 1", **other):
        shift = 1.0 / SIZE[0], -1.5 / SIZE[1]
        return replace(kind(name, SIZE, 1.8, 0.1, 1.01, 0.001, np.radians(2.0), 0.001, 0.0, 0.0, shift), **other)

    return of


@pytest.fixture
def read(scene, module):
    """A camera of the scene, as a solve reads it."""
    def of(name: str = "Camera 1"):
        bpy.context.view_layer.update()
        return module("blender.scene.scene_objects").read_camera(
            bpy.data.objects[name], scene, bpy.context.evaluated_depsgraph_get())

    return of


@pytest.fixture
def pixels(read, module):
    """Where a camera's picture shows some points."""
    def of(camera) -> np.ndarray:
        return module("core.projection").pixels_of(camera, POINTS, SIZE)

    return of


def apply() -> None:
    assert bpy.ops.irpso.apply_calibration() == {"FINISHED"}


def portrait(scene: bpy.types.Scene, _: bpy.types.Object) -> None:
    scene.render.resolution_x, scene.render.resolution_y = 640, 960


def wide_pixels(scene: bpy.types.Scene, camera: bpy.types.Object) -> None:
    scene.render.pixel_aspect_x, camera.data.shift_x, camera.data.shift_y = 1.6, 0.05, -0.02


def fit_height(_: bpy.types.Scene, camera: bpy.types.Object) -> None:
    camera.data.sensor_fit, camera.data.shift_x = "VERTICAL", 0.03


def fit_width(scene: bpy.types.Scene, camera: bpy.types.Object) -> None:
    portrait(scene, camera)
    camera.data.sensor_fit = "HORIZONTAL"


def orthographic(_: bpy.types.Scene, camera: bpy.types.Object) -> None:
    camera.data.type, camera.data.ortho_scale = "ORTHO", 2.0


def below_others(scene: bpy.types.Scene, camera: bpy.types.Object) -> None:
    rig = bpy.data.objects.new("Rig", None)
    scene.collection.objects.link(rig)
    rig.matrix_world = Matrix.Rotation(0.3, 4, "X") @ Matrix.Translation((0.2, 0, 0))
    camera.parent, camera.rotation_mode, camera.scale = rig, "QUATERNION", (2.0, 2.0, 2.0)


def photographed(_: bpy.types.Scene, camera: bpy.types.Object) -> None:
    lens = camera.data.irpso_lens
    lens.use, lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy = True, 192, 128, 250.0, 251.0, 97.0, 62.0
    lens.radial = -0.1, 0.02, 0.0, 0.0


@pytest.mark.parametrize("kind", [
    None, portrait, wide_pixels, fit_height, fit_width, orthographic, below_others, photographed,
])
@pytest.mark.parametrize("bent", [False, True])
def test_the_scene_has_the_cameras_that_were_found(
    scene, keep, change, read, pixels, module, kind, bent,
) -> None:
    """Within a thousandth of a pixel; the place stays to the bit."""
    camera = bpy.data.objects["Camera 1"]
    if kind is not None:
        kind(scene, camera)
    if bent and kind is orthographic:
        pytest.skip("an orthographic camera has no lens")
    found = change(k1=-0.05 if bent else 0.0)
    given = read()
    wanted = pixels(module("core.checks.camera_changes").changed_camera(given, found))
    assert np.abs(wanted - pixels(given)).max() > 0.5
    location, others = camera.location.copy(), pixels(read("Camera 0"))
    session = keep(found)
    assert session.calibration_state(scene, bpy.data.objects["Ball"]) == "open"
    apply()
    assert session.calibration_state(scene, bpy.data.objects["Ball"]) == "applied"
    np.testing.assert_allclose(pixels(read()), wanted, atol=1e-3)
    assert camera.location == location
    np.testing.assert_array_equal(pixels(read("Camera 0")), others)
    with pytest.raises(RuntimeError, match="has these cameras, lamps and exposures already"):
        bpy.ops.irpso.apply_calibration()


def test_cameras_that_share_their_data_keep_it(scene, keep, change, read, pixels, module) -> None:
    first, second = bpy.data.objects["Camera 1"], bpy.data.objects["Camera 0"]
    second.data = first.data
    others = pixels(read("Camera 0"))
    wanted = pixels(module("core.checks.camera_changes").changed_camera(read(), change()))
    keep(change())
    apply()
    assert first.data != second.data
    np.testing.assert_array_equal(pixels(read("Camera 0")), others)
    np.testing.assert_allclose(pixels(read()), wanted, atol=1e-3)


def test_a_view_that_departs_keeps_its_camera(scene, keep, change, read) -> None:
    """The scene has no camera for it: nobody is told that it is done."""
    given, view = read(), change(image=Path("//refs/Camera 1, Light 2.exr"))
    session = keep(view)
    with pytest.raises(RuntimeError, match=r"Light 2\.exr': departs from the other views of its camera"):
        bpy.ops.irpso.apply_calibration()
    assert session.calibration_state(scene, bpy.data.objects["Ball"]) == "open"
    keep(view, change("Camera 0"))
    apply()
    np.testing.assert_array_equal(read().projection, given.projection)
    np.testing.assert_array_equal(read().world_to_camera, given.world_to_camera)


@pytest.mark.parametrize(("spoil", "words"), [
    (lambda camera: bpy.data.objects.remove(camera), "camera 'Camera 1': is not in the scene any more"),
    (lambda camera: camera.constraints.new("TRACK_TO"), "camera 'Camera 1': a constraint places it"),
    (lambda camera: camera.keyframe_insert("rotation_euler"), "camera 'Camera 1': keyframes or a driver place it"),
    (lambda camera: camera.data.keyframe_insert("lens"), "camera 'Camera 1': keyframes or a driver set its lens"),
])
def test_what_cannot_be_changed_changes_nothing(scene, keep, change, read, spoil, words) -> None:
    given = read("Camera 0")
    keep(change("Camera 0"), change("Camera 1"))
    spoil(bpy.data.objects["Camera 1"])
    with pytest.raises(RuntimeError, match=words):
        bpy.ops.irpso.apply_calibration()
    np.testing.assert_array_equal(read("Camera 0").projection, given.projection)


def test_a_camera_that_was_measured(scene, read) -> None:
    assert not read().kept
    bpy.data.objects["Camera 1"].irpso_keep = True
    assert read().kept
