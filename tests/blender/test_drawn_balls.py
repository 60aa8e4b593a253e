"""Chrome balls whose circle the user has drawn: where the outline is found, and where edges mislead."""

from __future__ import annotations

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from irpso_addon.blender import properties  # noqa: E402
from irpso_addon.blender.shoot.ball_list import draw_circle, keep_circles, read_balls  # noqa: E402
from irpso_addon.blender.shoot.ball_pictures import find_balls  # noqa: E402
from irpso_addon.blender.shoot.view_pictures import listed_views  # noqa: E402
from irpso_addon.core.errors import BadInput  # noqa: E402
from irpso_addon.core.images.image_writer import write_image  # noqa: E402
from irpso_addon.core.lens import Lens  # noqa: E402
from tests.support import mirror_ball  # noqa: E402

LENS = Lens(300, 200, 400.0, 400.0, 150.0, 100.0)
BALL = mirror_ball.MirrorBall((0.05, 0.02, 1.2), 0.1)
CIRCLE = (166.7, 106.7, 33.5)  # around its outline, to half a pixel


@pytest.fixture
def scene(empty, tmp_path):
    """A camera 'Eye', a view of it that shows a ball before a backdrop, and a ball in the list without camera."""
    if not hasattr(bpy.types.Scene, "irpso"):
        properties.register()
    lamp = mirror_ball.Lamp((0.5, -0.7, 0.1), 0.05)
    picture = mirror_ball.picture(LENS, [BALL], [lamp], plain=(2.0, 3.0))
    write_image(tmp_path / "one.exr", picture[::-1].astype(np.float32), kind="exr", color=True)
    camera = bpy.data.objects.new("Eye", bpy.data.cameras.new("Eye"))
    camera.data.sensor_width, camera.data.lens = 36.0, 36.0 * LENS.fx / LENS.width
    empty.collection.objects.link(camera)
    empty.render.resolution_x, empty.render.resolution_y = LENS.width, LENS.height
    view = empty.irpso.views.add()
    view.image, view.camera = str(tmp_path / "one.exr"), camera
    empty.irpso.shoot.balls.add().radius = 100.0
    yield empty


def found(scene):
    entries = scene.irpso.shoot.balls
    balls = find_balls(listed_views(bpy.context), read_balls(entries))
    keep_circles(entries, balls)
    return balls[0]


def test_an_outline_that_agrees_is_more_exact(scene):
    draw_circle(bpy.context, 0, "one.exr", (CIRCLE[0] + 0.4, CIRCLE[1], CIRCLE[2] - 0.4))
    entry = scene.irpso.shoot.balls[0]
    assert entry.drawn and entry.camera.name == "Eye" and entry.support == 0
    ball = found(scene)
    assert np.linalg.norm(ball.ball.centre(0.1) - BALL.centre) < 0.006 and not ball.as_drawn
    assert entry.support > 0.6 and "of its outline shows" in ball.line
    assert (entry.x, entry.y, entry.circle) == pytest.approx(CIRCLE, abs=0.6)


def test_where_edges_mislead_the_circle_stays(scene):
    """6 pixels beside the ball: without the mark *Drawn* the outline is found; with it the user is right."""
    circle = (CIRCLE[0] + 6, CIRCLE[1], CIRCLE[2])
    draw_circle(bpy.context, 0, "one.exr", circle)
    entry = scene.irpso.shoot.balls[0]
    ball = found(scene)
    assert ball.as_drawn and "as drawn; the picture shows no outline that agrees" in ball.line
    assert (entry.x, entry.y, entry.circle) == pytest.approx(circle) and entry.support == 0
    entry.drawn = False
    assert np.linalg.norm(found(scene).ball.centre(0.1) - BALL.centre) < 0.006
    assert (entry.x, entry.y, entry.circle) == pytest.approx(CIRCLE, abs=0.6)


def test_what_is_refused(scene):
    for index, picture, circle, words in ((1, "one.exr", CIRCLE, "ball 2: is not in the list"),
                                          (0, "two.exr", CIRCLE, "no view has this picture"),
                                          (0, "one.exr", (100.0, 100.0, 3.0), "too small"),
                                          (0, "one.exr", (100.0, 100.0, np.nan), "too small")):
        with pytest.raises(BadInput, match=words):
            draw_circle(bpy.context, index, picture, circle)
        assert not scene.irpso.shoot.balls[0].drawn and scene.irpso.shoot.balls[0].camera is None


def test_operator_and_undo(scene, extension, tmp_path):
    """As a script calls it, and F9 after a drag; one undo."""
    bpy.ops.ed.undo_push(message="before")
    x, y, circle = CIRCLE
    assert bpy.ops.irpso.draw_ball("EXEC_DEFAULT", True, index=0, x=x, y=y, circle=circle) == {"FINISHED"}
    ball = bpy.context.scene.irpso.shoot.balls[0]
    assert ball.drawn and ball.circle == pytest.approx(circle)
    bpy.ops.ed.undo()
    assert not bpy.context.scene.irpso.shoot.balls[0].drawn
    with pytest.raises(RuntimeError, match="ball 6: is not in the list"):
        bpy.ops.irpso.draw_ball(index=5, x=x, y=y, circle=circle)
