"""A shoot is imported by the panel's button while the window goes on."""

from __future__ import annotations

import math
import random

import bpy
import robot
import stalls
from mathutils import Vector
from robot import Steps


def shoot(data: str) -> Steps:
    """Press the button twice: Esc stops the first import, the second comes to its end."""
    scene = bpy.context.scene
    fields = {"project": f"{data}/transforms.json", "images": f"{data}/raw", "mesh": f"{data}/mesh.obj",
              "flash_power": 5.0, "scale": 1.0}
    for name, value in fields.items():
        setattr(scene.irpso.shoot, name, value)
    blocks = len(bpy.data.objects)
    yield from robot.open_tab()
    operator = robot.addon("operators.import_shoot").IRPSO_OT_import_shoot
    robot.invoke("irpso.import_shoot")
    yield 0.3
    robot.tell(busy=operator._reading, second=bpy.ops.irpso.import_shoot.poll())
    yield from robot.key("ESC")
    yield from robot.until(lambda: not operator._reading, 5)
    robot.tell(stopped=len(bpy.data.objects) - blocks + len(scene.irpso.views))
    robot.invoke("irpso.import_shoot")
    gaps = yield from stalls.watched(lambda: not operator._reading)
    robot.tell(gaps=stalls.figures(gaps[:-1] or gaps), views=len(scene.irpso.views))  # the longest adds what was read
    yield from robot.key("Z", ctrl=True)
    yield 0.5
    robot.tell(undone=len(bpy.context.scene.irpso.views))


def cameras(data: str) -> Steps:
    """Cameras and a mesh go to USD and Alembic by the window's own exporters and come back by the panel's button."""
    scene = bpy.context.scene
    for obj in list(scene.objects):
        bpy.data.objects.remove(obj)
    bpy.ops.mesh.primitive_cube_add()
    for number in range(2):
        camera = bpy.data.objects.new(f"IMG_000{number}", bpy.data.cameras.new("Lens"))
        camera.location = (0, 0, 6 + number)
        scene.collection.objects.link(camera)
    yield 0.3
    # A Linux distribution's Blender may have been built without one of them.
    known = dir(bpy.ops.wm)
    suffixes = [suffix for suffix, name in (("abc", "alembic_export"), ("usdc", "usd_export")) if name in known]
    meshes = []
    for suffix in suffixes:
        path = f"{data}/shot.{suffix}"
        if suffix == "abc":
            bpy.ops.wm.alembic_export(filepath=path, start=1, end=1, as_background_job=False)
        else:
            bpy.ops.wm.usd_export(filepath=path)
        fields = {"project": path, "images": f"{data}/raw", "mesh": "", "flash_power": 5.0, "scale": 1.0}
        for name, value in fields.items():
            setattr(scene.irpso.shoot, name, value)
        yield from robot.open_tab()
        views = len(scene.irpso.views)
        robot.invoke("irpso.import_shoot")
        yield from robot.until(lambda before=views: len(scene.irpso.views) > before, 20)
        added = [view.camera.location[2] for view in scene.irpso.views][views:]
        meshes.append(bpy.context.object.name)
        robot.tell(**{suffix: added})
    robot.tell(suffixes=suffixes, mesh=meshes, scenes=len(bpy.data.scenes), shown=bpy.context.window.scene == scene)


def unwrapped() -> Steps:
    """A rough ball gets its UV map in the viewport's context; one undo takes it back."""
    scene = bpy.context.scene
    for obj in list(scene.objects):
        bpy.data.objects.remove(obj)
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=7)
    mesh = bpy.context.object.data
    edge = math.sqrt(4 * math.pi / len(mesh.polygons))
    chance = random.Random(0)
    for vertex in mesh.vertices:
        vertex.co += Vector([chance.gauss(0, edge / 5) for _ in range(3)])
    while mesh.uv_layers:
        mesh.uv_layers.remove(mesh.uv_layers[0])
    yield 0.3
    with robot.within():
        bpy.ops.ed.undo_push(message="A scan")
    yield from robot.open_tab()
    mesh = bpy.context.object.data
    with robot.within():
        bpy.ops.irpso.unwrap("EXEC_DEFAULT", True)  # as a click does: with a step of undo
    yield from robot.until(lambda: mesh.uv_layers, 20)
    uvs = [tuple(corner.vector) for corner in mesh.uv_layers[0].uv]
    area = sum(abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
               for a, b, c in zip(uvs[::3], uvs[1::3], uvs[2::3], strict=True)) / 2
    robot.tell(used=area, mode=bpy.context.mode)
    yield from robot.key("Z", ctrl=True)
    yield 0.5
    data = bpy.context.scene.objects[0].data
    robot.tell(undone=len(data.uv_layers), corners=len(data.vertices))
