"""Solving by the panel's buttons, and stopping it."""

from __future__ import annotations

import time

import bpy
import robot
from robot import Steps

EARLY = 0.15  # of a solve: far enough to have something to keep
STANDS = 1.5  # seconds without progress: the step that was under way has ended, and the pause holds


def opened(scene: str, size: int, shading: str = "SOLID", indirect: str = "off") -> Steps:
    """A scene with its object in sight and active, and the tab open."""
    bpy.ops.wm.open_mainfile(filepath=f"{scene}/scene.blend", load_ui=False)
    yield 0.5
    settings = bpy.context.scene.irpso
    settings.captures, settings.size, settings.indirect = "//captures.json", size, indirect
    obj = next(o for o in bpy.context.scene.objects if o.type == "MESH")
    bpy.context.view_layer.objects.active = obj
    with robot.within():
        bpy.ops.object.select_all(action="DESELECT")
        obj.select_set(True)
        bpy.ops.view3d.view_selected()
        bpy.ops.ed.undo_push(message="Opened")
    view = robot.area().spaces.active
    view.shading.type, view.shading.color_type = shading, "TEXTURE"
    yield from robot.open_tab()


def subject() -> bpy.types.Object | None:
    """The object that is solved."""
    return bpy.context.view_layer.objects.active


def session() -> object:
    """The add-on's own memory."""
    return robot.addon("irpso_addon.blender.jobs.session").session


def running() -> object:
    """The running job, None when there is none."""
    return session().running


def solution() -> object:
    """The last one of the active object."""
    return session().solution_of(subject())


def started(wait: float = 5) -> Steps:
    """Press Solve; returns where it is."""
    spot = yield from robot.find("irpso.solve(")
    yield from robot.click(*spot)
    yield from robot.until(running, wait)
    return spot


def far_enough(part: float = EARLY) -> Steps:
    """Wait until a part of it is done, and maps of it are on show."""
    def shown() -> bool:
        live = running().live
        return live is not None and {"base_color", "roughness"} <= live.maps.keys()

    yield from robot.until(lambda: running() is None or (running().progress.fraction > part and shown()))
    assert running() is not None, "it was over before it could be stopped"


def ended(limit: float = robot.PATIENCE) -> Steps:
    """Wait for the end; returns the seconds it took from here."""
    began = time.monotonic()
    yield from robot.until(lambda: running() is None, limit, step=0.005)
    return time.monotonic() - began


def delivered() -> Steps:
    """Wait for the result of a job that has ended: it is put on the material bit by bit."""
    yield from robot.until(solution, 5)
    yield from robot.until(lambda: linked(subject()), 5)


def linked_so_far() -> bool:
    """Whether the maps on show are those of the step before the result: not packed."""
    return any(image.packed_file is None for image in bpy.data.images if image.name.startswith(f"{subject().name}_"))


def linked(obj: bpy.types.Object) -> dict[str, str]:
    """Which image feeds which input of the object's Principled node, through whatever lies between."""
    found = {}
    for node in obj.active_material.node_tree.nodes:
        if node.type == "BSDF_PRINCIPLED":
            for name in ("Base Color", "Roughness"):
                stack = [link.from_node for link in node.inputs[name].links]
                while stack:
                    source = stack.pop()
                    if source.type == "TEX_IMAGE" and source.image:
                        found[name] = source.image.name
                    stack += [link.from_node for i in source.inputs for link in i.links]
    return found


def whole(scene: str, size: int, shading: str = "MATERIAL") -> Steps:
    """From the panel to maps on the material and files."""
    yield from opened(scene, size)
    yield from robot.look("panel")
    yield from started()
    robot.tell(seconds=(yield from ended()))
    yield from delivered()
    robot.area().spaces.active.shading.type = shading
    yield from robot.look("solved", 4)
    robot.tell(texels=dict(solution().texels), linked=linked(subject()))
    with robot.within():
        bpy.ops.ed.undo()
    yield from robot.until(lambda: not linked(subject()), 10)  # the step of maps so far is stepped over after a redraw
    robot.tell(undone=linked(subject()))
    with robot.within():
        bpy.ops.ed.redo()
    yield from robot.until(lambda: linked(subject()) and not linked_so_far(), 10)
    robot.tell(redone=linked(subject()))
    yield from robot.look("redone")


def large(scene: str, size: int) -> Steps:
    """Two UDIMs: Esc keeps what is finished, Solve goes on with it, the files are on the material."""
    yield from opened(scene, size)
    ball, settings = subject(), bpy.context.scene.irpso
    for corner in ball.data.uv_layers.active.data:
        corner.uv.x *= 2
    settings.udim, settings.model, settings.out = "all", "one-lobe", str(robot.FOLDER / "maps")
    work = robot.FOLDER / "maps" / "irpso_work_Ball"
    yield from started()
    yield from robot.until(lambda: (work / "plan.npz").exists() or running() is None, 4 * robot.PATIENCE)
    yield from robot.key("ESC")
    yield from ended(10)
    robot.tell(kept=sorted(path.name for path in work.iterdir()), before=linked(ball))
    yield from started()
    yield from ended(4 * robot.PATIENCE)
    yield from robot.until(lambda: linked(ball), 5)
    yield from robot.look("large", 4)
    image = bpy.data.images[linked(ball)["Base Color"]]
    robot.tell(tiles=[tile.number for tile in image.tiles], source=image.source, warnings=list(solution().warnings),
               files=sorted(path.name for path in (robot.FOLDER / "maps").iterdir()))


def stopped(scene: str, size: int) -> Steps:
    """Esc, then the button; each keeps what was found.  And a pause."""
    yield from opened(scene, size)
    times = {}
    for way in ("esc", "button"):
        spot = yield from started()
        where = (yield from robot.find("irpso.stop(", across=(0.83,), below=spot[1] + 11)) if way == "button" else None
        yield from far_enough()
        before = time.monotonic()
        if where:
            yield from robot.click(*where)
        else:
            yield from robot.key("ESC")
        before = time.monotonic() - robot.HOVER  # both end a hover after the event that counts
        yield from robot.until(lambda: running() is None or running().job.done, 10, step=0.005)
        times[way] = time.monotonic() - before  # what was found is put on the material after it
        yield from ended(10)
        yield from delivered()
        assert solution().cancelled, way
        yield from robot.look(f"stopped-{way}")
    robot.tell(stopped=times)


def paused(scene: str, size: int) -> Steps:
    """Pause for a while; it stands still, goes on, and ends as if nothing had been."""
    yield from opened(scene, size)
    spot = yield from started()
    pause = yield from robot.find("irpso.pause(", across=(0.76,), below=spot[1] + 11)
    yield from far_enough()
    yield from robot.click(*pause)
    since = [running().progress, time.monotonic()]

    def stands() -> bool:
        assert running() is not None, "it goes on in the pause"
        if running().progress != since[0]:
            since[:] = running().progress, time.monotonic()
        return time.monotonic() - since[1] > STANDS

    yield from robot.until(stands)
    yield from robot.look("paused")
    yield from robot.click(*pause)
    yield from ended()
    yield from delivered()
    assert not solution().cancelled
    robot.tell(texels=dict(solution().texels))
