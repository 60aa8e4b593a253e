"""The Shoot panel's buttons that are answered by the mouse in a picture: grey card, six greys, a ball's circle."""

from __future__ import annotations

import bmesh
import bpy
import jobs
import numpy as np
import robot
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector
from robot import Steps

EDITOR = "IMAGE_EDITOR"
HEADER, BELOW = 13, 29  # pixels from the top of the sidebar to the first panel's header; from a button to a header
PIXELS = 96  # of the pictures, along a side


def shoot(scene: str) -> Steps:
    """Power by a square on the paint, undone; then a circle around the ball, and Esc."""
    yield from opened(scene)
    robot.tell(power=powers())
    yield from robot.press("irpso.grey_card(", across=(0.25,))
    yield from robot.until(picture, 5)
    yield from fitted()
    yield from dragged((40, 44), (52, 56), "card")
    yield from robot.until(lambda: powers()[0] != 100.0, 5)
    done = bpy.context.window_manager.operators[-1]
    robot.tell(scaled=powers(), square=[done.properties.x, done.properties.y, done.properties.side],
               file=done.properties.image)
    with robot.within():
        bpy.ops.ed.undo()
    yield 0.3
    assert picture(), "Undo took the picture away"
    robot.tell(undone=powers())
    yield from circle()
    yield from greys()


def alone(scene: str) -> Steps:
    """No Image Editor is open, so a window is: a square in it, and once more, where the window is closed meanwhile."""
    yield from listed(scene)
    yield from unfolded()
    yield from robot.press("irpso.grey_card(", across=(0.25,))
    windows = bpy.context.window_manager.windows
    yield from robot.until(lambda: len(windows) == 2, 5)
    yield from fitted(windows[1])
    yield from dragged((40, 44), (52, 56), "window", windows[1])
    yield from robot.until(lambda: powers()[0] != 100.0, 5)
    done = bpy.context.window_manager.operators[-1]
    robot.tell(square=[done.properties.x, done.properties.y, done.properties.side])
    yield from robot.press("irpso.grey_card(", across=(0.25,))
    yield 0.3
    with bpy.context.temp_override(window=windows[1]):
        bpy.ops.wm.window_close()
    yield 0.5
    robot.tell(windows=len(windows))


def listed(scene: str) -> Steps:
    """Views in the list, lamps of half their power."""
    yield from jobs.opened(scene, 64)
    bpy.ops.irpso.load_captures()
    settings = bpy.context.scene.irpso
    settings.shoot.rig, settings.shoot.card, settings.active_view = "lamps", 0.35, 2
    for light in bpy.data.lights:
        light.energy = 100.0


def unfolded() -> Steps:
    """The Shoot panel."""
    side = robot.region()
    yield from robot.click(side.x + side.width // 3, side.y + side.height - HEADER)
    yield 0.5


def opened(scene: str) -> Steps:
    """Likewise, with an Image Editor in the right half."""
    yield from listed(scene)
    for kind in ("PROPERTIES", "OUTLINER", "DOPESHEET_EDITOR"):
        with bpy.context.temp_override(window=robot.window(), area=robot.area(kind)):
            bpy.ops.screen.area_close()
        yield 0.2
    with robot.within():
        bpy.ops.screen.area_split(direction="VERTICAL", factor=0.45)
        bpy.ops.ed.undo_push(message="Shoot")
    max((area for area in robot.window().screen.areas if area.type == "VIEW_3D"), key=lambda area: area.x).type = EDITOR
    yield 0.3
    yield from robot.open_tab()
    yield from unfolded()


def powers() -> list[float]:
    """Of the lamps."""
    return [light.energy for light in bpy.data.lights]


def picture() -> bool:
    """Whether the editor shows a view's picture."""
    shown = robot.addon("irpso_addon.blender.shoot.picture_image").shown_picture
    return shown(robot.area(EDITOR).spaces.active.image) is not None


def fitted(window: bpy.types.Window | None = None) -> Steps:
    """Until the picture no longer moves in the editor."""
    before = None
    while before != (now := at(0, 0, window)):
        before = now
        yield 0.4


def at(x: float, y: float, window: bpy.types.Window | None = None) -> tuple[float, float]:
    """Where the window shows a pixel of the picture, which counts from its upper left corner."""
    area = robot.area(EDITOR) if window is None else window.screen.areas[0]
    region = next(region for region in area.regions if region.type == "WINDOW")
    left, bottom = region.view2d.view_to_region(0, 0, clip=False)
    right, top = region.view2d.view_to_region(1, 1, clip=False)
    return region.x + left + x / PIXELS * (right - left), region.y + top - y / PIXELS * (top - bottom)


def dragged(start: tuple[float, float], end: tuple[float, float], name: str,
            window: bpy.types.Window | None = None) -> Steps:
    """From one pixel of the picture to another, with a screenshot before the button is let go."""
    (x, y), (u, v) = at(*start, window), at(*end, window)
    events = (window or robot.window()).event_simulate
    events(type="MOUSEMOVE", value="NOTHING", x=int(x), y=int(y))
    yield 0.1
    events(type="LEFTMOUSE", value="PRESS", x=int(x), y=int(y))
    for share in np.linspace(0, 1, 6):
        yield 0.05
        events(type="MOUSEMOVE", value="NOTHING", x=int(x + share * (u - x)), y=int(y + share * (v - y)))
    yield from robot.look(name, 0.2)
    events(type="LEFTMOUSE", value="RELEASE", x=int(u), y=int(v))
    yield 0.2


def circle() -> Steps:
    """A ball is added below the buttons for greys; its camera is that of the scene, "Camera 1"."""
    x, y = yield from robot.find("irpso.grey_card(", across=(0.25,))
    yield from robot.click(x, y - BELOW)
    yield 0.5
    yield from robot.press("irpso.add_ball(", below=y)
    yield 0.3
    yield from robot.press("irpso.draw_ball(", below=y)
    yield 0.3
    camera = bpy.context.scene.irpso.shoot.balls[0].camera
    middle = world_to_camera_view(bpy.context.scene, camera, Vector((0, 0, 0)))
    yield from dragged((middle.x * PIXELS, (1 - middle.y) * PIXELS), (80, 48), "circle")
    ball = bpy.context.scene.irpso.shoot.balls[0]
    robot.tell(circle=[ball.x, ball.y, ball.circle], drawn=ball.drawn, camera=ball.camera.name,
               middle=[middle.x * PIXELS, (1 - middle.y) * PIXELS])


def greys() -> Steps:
    """Two clicks; Esc after the first leaves everything as it was."""
    yield from robot.press("irpso.grey_chart(")
    yield 0.2
    yield from robot.click(*at(20, 70))
    robot.move(*at(70, 70))
    yield from robot.look("greys", 0.2)
    yield from robot.key("ESC", *at(70, 70))
    robot.move(*at(60, 60))
    yield from robot.look("after", 0.2)
    robot.tell(after=powers())


def scan(scene: str) -> Steps:
    """*Denoise* on a ball whose corners are off, and one undo."""
    yield from opened(scene)
    ball = bpy.data.objects["Ball"]
    bpy.context.view_layer.objects.active = ball
    made, rng = bmesh.new(), np.random.default_rng(0)
    made.loops.layers.uv.new("UVMap")
    bmesh.ops.create_icosphere(made, subdivisions=6, radius=0.5, calc_uvs=True)
    for corner in made.verts:
        corner.co += Vector(rng.normal(0, 0.001, 3))
    for face in made.faces:
        face.smooth = True
    made.to_mesh(ball.data)
    with robot.within():
        bpy.ops.ed.undo_push(message="Scan")
    noise = robot.addon("irpso_addon.blender.scene.mesh_noise").degrees_of_noise
    before = noise(ball.data)
    yield from robot.look("scan")
    yield from robot.press("irpso.denoise_normals(", across=(0.75,))
    yield from robot.until(lambda: ball.data.has_custom_normals, 5)
    after = noise(ball.data)
    yield from robot.look("without_noise")
    with robot.within():
        bpy.ops.ed.undo()
    yield 0.3
    ball = bpy.data.objects["Ball"]
    robot.tell(before=before, after=after, undone=noise(ball.data), custom=ball.data.has_custom_normals)
