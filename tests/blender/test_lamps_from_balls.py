"""Lamps by chrome balls that Cycles renders: two balls, three lamps, two cameras."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from mathutils import Matrix, Vector

bpy = pytest.importorskip("bpy")

from irpso_addon.blender import properties  # noqa: E402
from irpso_addon.blender.shoot.ball_lamps import place_lamps  # noqa: E402
from irpso_addon.blender.shoot.ball_pictures import ChromeBall, find_balls  # noqa: E402
from irpso_addon.blender.shoot.view_pictures import listed_views, read_picture  # noqa: E402
from irpso_addon.core.errors import BadInput  # noqa: E402
from irpso_addon.core.images.image_writer import write_image  # noqa: E402
from irpso_addon.core.lens import Lens  # noqa: E402
from tests.blender import cycles_rig as rig  # noqa: E402
from tests.support import mirror_ball  # noqa: E402

WIDTH, HEIGHT, ANGLE, RADIUS = 640, 320, 36.0, 0.16  # pixels, degrees, metres
BALLS = np.array([(-0.26, 0.0, 0.02), (0.27, 0.06, -0.01)])
LAMPS = np.array([(-0.7, -0.9, 0.9), (0.9, -0.5, 0.5), (0.1, -1.2, -0.5)])
EYE = (0.05, -1.6, 0.3)


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    """A folder: scene.blend with the cameras 'Front' and 'Side', and three EXR files, one a lamp, of 'Front'."""
    folder = tmp_path_factory.mktemp("balls")
    scene = rig.scene(HEIGHT, samples=32)
    scene.render.resolution_x = WIDTH
    scene.cycles.max_bounces = scene.cycles.glossy_bounces = 3
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 1.5
    if not hasattr(bpy.types.Scene, "irpso"):
        properties.register()
    rig.camera(EYE, degrees=ANGLE)
    camera = scene.camera
    camera.name = "Front"
    camera.data.shift_x, camera.data.shift_y = 0.02, -0.03
    for centre in BALLS:
        ball = rig.sphere(RADIUS)
        ball.location = centre
        rig.principled(ball, (0.5, 0.5, 0.5), 0.0).inputs["Metallic"].default_value = 1.0
    node = rig.principled(rig.sphere(4.0), (0, 0, 0), 1.0, 0.0)  # the room
    node.inputs["Emission Strength"].default_value = 0.4
    squares = node.id_data.nodes.new("ShaderNodeTexChecker")
    squares.inputs["Scale"].default_value = 30.0
    node.id_data.links.new(squares.outputs["Color"], node.inputs["Emission Color"])
    glowing = rig.sphere(0.03)
    node = rig.principled(glowing, (0, 0, 0), 1.0, 0.0)
    node.inputs["Emission Color"].default_value, node.inputs["Emission Strength"].default_value = (1, 1, 1, 1), 3000.0
    for number, lamp in enumerate(LAMPS):
        glowing.location = lamp
        rgb = rig.render()["rgb"]
        write_image(folder / f"front{number}.exr", rgb[::-1].astype(np.float32), kind="exr", color=True)
    bpy.data.batch_remove([obj for obj in scene.objects if obj.type == "MESH"])
    side = bpy.data.objects.new("Side", bpy.data.cameras.new("Side"))
    side.matrix_world = Matrix.LocRotScale(Vector((2, 0, 0)), Vector((1, 0, 0)).to_track_quat("Z", "Y"), None)
    scene.collection.objects.link(side)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
    return folder


@pytest.fixture
def scene(studio, tmp_path):
    """A private copy, open, with three views of 'Front' and three of 'Side', without lights."""
    shutil.copytree(studio, tmp_path, dirs_exist_ok=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"), load_ui=False)
    scene = bpy.context.scene
    for camera in ("Front", "Side"):
        for number in range(3):
            view = scene.irpso.views.add()
            view.image, view.camera = f"//{camera.lower()}{number}.exr", bpy.data.objects[camera]
    return scene


def pixels_of(ball):
    """The circle around a ball by its place: near enough to be drawn."""
    from bpy_extras.object_utils import world_to_camera_view
    camera = bpy.data.objects["Front"]
    x, y, far = world_to_camera_view(bpy.context.scene, camera, Vector(ball))
    return x * WIDTH + 3, (1 - y) * HEIGHT - 2, 0.9 * RADIUS / far * WIDTH / 2 / np.tan(np.radians(ANGLE / 2))


def both(scene):
    return [ChromeBall(bpy.data.objects["Front"], pixels_of(ball), RADIUS) for ball in BALLS]


def degrees(first, second):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(first, second)), np.dot(first, second)))


def check_places(scene, objects):
    """Positions to 2 % of the distance from the balls."""
    for obj, lamp in zip(objects, LAMPS, strict=True):
        assert obj.data.type == "POINT"
        middle = BALLS.mean(0)
        found = np.array(obj.matrix_world.translation)
        assert np.linalg.norm(found - lamp) < 0.02 * np.linalg.norm(lamp - middle), (found, lamp)


def test_new_lamps(scene):
    """The k-th view of each camera gets lamp k; all share one data block; the power counts as unknown."""
    placed = place_lamps(bpy.context, both(scene))
    bpy.context.view_layer.update()
    objects = [bpy.data.objects[f"Lamp 00{number}"] for number in (1, 2, 3)]
    assert list(placed.lamps) == [obj.name for obj in objects]
    check_places(scene, objects)
    assert len({obj.data for obj in objects}) == 1 and not scene.irpso.scale_known
    for at, view in enumerate(scene.irpso.views):
        assert [item.light for item in view.lights] == [objects[at % 3]]
    assert [line.split(":")[0] for line in placed.messages] == [
        "ball 1 (camera 'Front')", "ball 2 (camera 'Front')", "Lamp 001", "Lamp 002", "Lamp 003", "light 'Lamps'"]
    assert "standard error" in placed.messages[2]


def test_lights_that_the_views_have(scene):
    """They are moved and keep their own data; a parent does not mislead them; a sun that has a place becomes a lamp."""
    holder = bpy.data.objects.new("Holder", None)
    holder.matrix_world = Matrix.LocRotScale(Vector((1, 2, 3)), Vector((1, 1, 0)).to_track_quat("Z", "Y"), None)
    scene.collection.objects.link(holder)
    objects = [rig.lamp("SUN" if k == 1 else "POINT", (k, 0, 3)) for k in range(3)]
    objects[0].parent = holder
    bpy.context.view_layer.update()
    for view, obj in zip(scene.irpso.views, objects, strict=False):
        view.lights.add().light = obj
    for view in list(scene.irpso.views)[3:]:
        view.lights.add().light = objects[0]
    data = [obj.data for obj in objects]
    place_lamps(bpy.context, both(scene))
    bpy.context.view_layer.update()
    check_places(scene, objects)
    assert [obj.data == before for obj, before in zip(objects, data, strict=True)] == [True, False, True]
    assert not any(obj.name.startswith("Lamp ") for obj in scene.objects)


def test_one_ball_gives_suns(scene):
    """Within 0.2 degrees of the direction from the ball; the suns shine from there."""
    placed = place_lamps(bpy.context, both(scene)[1:])
    bpy.context.view_layer.update()
    for number, lamp in enumerate(LAMPS):
        obj = bpy.data.objects[f"Lamp 00{number + 1}"]
        assert obj.data.type == "SUN" and "gives a direction only" in placed.lamps[obj.name].line
        direction = placed.lamps[obj.name].direction
        assert degrees(np.array(obj.matrix_world)[:3, 2], direction) < 0.01
        # The ray begins on the ball, at most a radius from its centre: where, the law of reflection says.
        half = _half(BALLS[1], np.array(EYE), lamp)
        assert degrees(direction, lamp - (BALLS[1] + RADIUS * half)) < 0.2


@pytest.mark.parametrize("count", [1, 2])
def test_several_pictures_of_one_lamp(scene, count):
    """An exposure bracket: a ball is one ball, and three like pictures say no more than one, nor more surely."""
    light = rig.lamp("POINT", (0, 0, 3))

    def placed(pictures):
        scene.irpso.views.clear()
        for _ in range(pictures):
            view = scene.irpso.views.add()
            view.image, view.camera = "//front0.exr", bpy.data.objects["Front"]
            view.lights.add().light = light
        return place_lamps(bpy.context, both(scene)[:count]).lamps[light.name]

    once, again = placed(1), placed(3)
    assert again.line == once.line and ("one ball gives a direction only" in once.line) == (count == 1)
    assert (again.position is None) == (count == 1)
    assert degrees(again.direction, once.direction) < 0.01


def _half(centre, eye, lamp):
    """Unit normal (3,) at the point of a ball that mirrors the lamp to the eye, by steps to a fixed point."""
    normal = (eye - centre) / np.linalg.norm(eye - centre)
    for _ in range(200):
        point = centre + RADIUS * normal
        both = sum((at - point) / np.linalg.norm(at - point) for at in (eye, lamp))
        normal = both / np.linalg.norm(both)
    return normal


def test_a_ball_is_found_without_a_circle(empty, tmp_path):
    """In a picture of another renderer; the rays' axes are Blender's.  Two balls need circles."""
    if not hasattr(bpy.types.Scene, "irpso"):
        properties.register()
    lens = Lens(300, 200, 400.0, 400.0, 150.0, 100.0)
    ball, lamp = mirror_ball.MirrorBall((0.05, 0.02, 1.2), 0.1), mirror_ball.Lamp((0.5, -0.7, 0.1), 0.05)
    picture = mirror_ball.picture(lens, [ball], [lamp])
    write_image(tmp_path / "one.exr", picture[::-1].astype(np.float32), kind="exr", color=True)
    camera = bpy.data.objects.new("Eye", bpy.data.cameras.new("Eye"))
    camera.data.sensor_width, camera.data.lens = 36.0, 36.0 * lens.fx / lens.width
    camera.matrix_world = Matrix.LocRotScale(Vector((1, 2, 3)), Vector((1, 1, 0.5)).to_track_quat("-Z", "Y"), None)
    empty.collection.objects.link(camera)
    empty.render.resolution_x, empty.render.resolution_y = lens.width, lens.height
    view = empty.irpso.views.add()
    view.image, view.camera = str(tmp_path / "one.exr"), camera
    placed = place_lamps(bpy.context, [ChromeBall(camera, None, 0.1)])
    middle = placed.balls[0].ball.centre(0.1)
    assert np.linalg.norm(middle - ball.centre) < 0.003
    across = Vector((lamp.position[0] - 0.05, -(lamp.position[1] - 0.02), -(lamp.position[2] - 1.2)))  # y up, z back
    expected = camera.matrix_world.to_3x3() @ across
    assert degrees(placed.lamps["Lamp 001"].direction, np.array(expected)) < np.degrees(0.1 / expected.length)
    with pytest.raises(BadInput, match=r"ball 2 .* is found where ball 1"):
        find_balls(listed_views(bpy.context), [ChromeBall(camera, None, 0.1)] * 2)


def state(scene):
    return ([obj.name for obj in scene.objects], [len(view.lights) for view in scene.irpso.views],
            len(bpy.data.lights), scene.irpso.scale_known)


@pytest.mark.parametrize("fault", ["uneven", "no ball", "dark", "twice", "orthographic", "size", "no views", "unit",
                                   "radius"])
def test_what_is_refused_changes_nothing(scene, fault, tmp_path):
    """One line that names the picture or camera, and the ball."""
    balls, words = both(scene), ("ball 1", "Front")
    views = scene.irpso.views
    if fault == "uneven":
        views.remove(5)
        words = ("camera 'Side'", "2 views", "camera 'Front'", "3")
    elif fault == "no ball":
        balls[1] = ChromeBall(balls[1].camera, (WIDTH / 2, 30.0, 12.0), RADIUS)
        words = ("ball 2", "no ball's outline")
    elif fault == "dark":  # no lamp: what the room alone lights
        values = np.minimum(read_picture(listed_views(bpy.context)[1].view)[0][::-1], 0.25)
        write_image(tmp_path / "front1.exr", values, kind="exr", color=True)
        words = ("front1.exr", "ball 1", "no lamp's highlight")
    elif fault == "twice":
        balls[1] = ChromeBall(balls[1].camera, balls[0].circle, RADIUS)
        words = ("ball 2", "is found where ball 1")
    elif fault == "orthographic":
        balls[0].camera.data.type = "ORTHO"
    elif fault == "size":
        write_image(tmp_path / "front2.exr", np.full((HEIGHT // 2, WIDTH // 2, 3), 0.1, np.float32), kind="exr",
                    color=True)
        words = ("front2.exr", "one size")
    elif fault == "no views":
        scene.irpso.views[0].enabled = scene.irpso.views[1].enabled = scene.irpso.views[2].enabled = False
        words = ("ball 1", "no view in use")
    elif fault == "unit":
        scene.unit_settings.scale_length = 0.01
        words = ("scene 'Scene'", "Unit Scale is 0.01")
    else:
        balls[1] = ChromeBall(balls[1].camera, balls[1].circle, float("nan"))
        words = ("ball 2", "radius")
    before = state(scene)
    with pytest.raises(BadInput) as caught:
        place_lamps(bpy.context, balls)
    assert all(word in str(caught.value) for word in words) and "\n" not in str(caught.value), caught.value
    assert state(scene) == before


def test_command(scene, tmp_path, irpso_here):
    """irpso lamps: into another folder, whose .blend finds the pictures; wrong numbers and names write nothing."""
    bpy.ops.wm.save_mainfile()
    out = tmp_path / "elsewhere" / "lit.blend"
    given = [[*("Front", *map(str, pixels_of(ball)), str(1000 * RADIUS))] for ball in BALLS]
    command = ["lamps", tmp_path / "scene.blend", "--out", out]
    for wrong, word in ((["Front", "a", "1", "2", "3"], "numbers"), (["Front", "0", "0", "0", "-1"], "positive"),
                        (["Front", "300", "150", "3", "160"], "pixels around a ball (Draw Circle, or X Y R of --ball)"),
                        (["Back", "0", "0", "0", "50"], "camera 'Back'")):
        refused = irpso_here(*command, "--ball", *wrong)
        assert refused.returncode == 3 and word in refused.stderr and not out.parent.exists(), refused.stderr
        assert len(refused.stderr.strip().splitlines()) == 1
    done = irpso_here(*command, "--ball", *given[0], "--ball", *given[1])
    assert done.returncode == 0, done.stderr
    assert "3 lamps by 2 balls" in done.stdout and "Lamp 002: " in done.stderr
    away = [float(words.split()[0]) for words in done.stderr.split(" pixels, so ")[1:]]
    np.testing.assert_allclose(away, np.linalg.norm(BALLS - EYE, axis=1), rtol=0.01)
    bpy.ops.wm.open_mainfile(filepath=str(out), load_ui=False)
    scene = bpy.context.scene
    check_places(scene, [bpy.data.objects[f"Lamp 00{number}"] for number in (1, 2, 3)])
    assert (out.parent / scene.irpso.views[0].image[2:]).exists() and scene.irpso.views[0].image.startswith("//../")
    assert len(scene.irpso.shoot.balls) == 2 and scene.irpso.shoot.balls[0].support > 0.5


def test_operators_and_undo(scene, extension, tmp_path):
    """Add, find, place, take back."""
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"), load_ui=False)
    scene = bpy.context.scene
    scene.camera = bpy.data.objects["Front"]
    assert not bpy.ops.irpso.lamps_from_balls.poll()
    for number in range(3):
        view = scene.irpso.views.add()
        view.image, view.camera = f"//front{number}.exr", scene.camera
    for centre in BALLS:
        assert bpy.ops.irpso.add_ball() == {"FINISHED"}
        ball = scene.irpso.shoot.balls[-1]
        ball.x, ball.y, ball.circle = pixels_of(centre)
        ball.radius = 1000 * RADIUS
    bpy.ops.irpso.add_ball()
    assert scene.irpso.shoot.balls[2].camera == scene.camera
    assert scene.irpso.shoot.balls[2].radius == pytest.approx(1000 * RADIUS)
    bpy.ops.irpso.remove_ball(index=2)
    assert bpy.ops.irpso.find_balls() == {"FINISHED"}
    assert all(ball.support > 0.5 and ball.residual > 0 for ball in scene.irpso.shoot.balls)
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.irpso.lamps_from_balls("EXEC_DEFAULT", True) == {"FINISHED"}
    scene = bpy.context.scene
    bpy.context.view_layer.update()
    check_places(scene, [bpy.data.objects[f"Lamp 00{number}"] for number in (1, 2, 3)])
    bpy.ops.ed.undo()
    assert "Lamp 001" not in bpy.data.objects and not any(view.lights for view in bpy.context.scene.irpso.views)
    bpy.context.scene.irpso.shoot.balls[0].camera = None
    with pytest.raises(RuntimeError, match="ball 1: has no camera"):
        bpy.ops.irpso.lamps_from_balls()
