"""A newcomer's path by clicks: from the zip to exported maps, then a shoot of one's own.

Each step keeps a screenshot, the seconds from the click until the window shows what it does, and the message that the
panel then highlights (reader.py).  Preferences and file browsers open in the one window that there is.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import jobs
import reader
import robot
from robot import Steps

SLOW = 400.0  # seconds that a solve may take beside others
EEVEE = 60.0  # until the viewport's engine has compiled its shaders, beside others; until then it shows no material
EDIT, PREFERENCES = (77, 14), (130, 283)  # pixels from the window's left and top edges: the menu and its last entry
EXTENSIONS, ADDONS, BACK = (56, 220), (56, 254), (330, 14)
DOWN, DISK = (1423, 44), (1311, 166)  # the menu beside the search, and its last entry
HEADER = 13  # pixels from the top of the sidebar to the first panel's header
STEP = 29  # from there to the next, where the first is folded
ASIDE = (500, 8)  # the status bar, which has no tooltips
ACCEPT = (90, 20)  # from the lower right corner of a file browser to the middle of its button


class Walk:
    """One part: the steps done so far, as they are told."""

    def __init__(self, part: str) -> None:
        self.part, self.rows, self.panels = part, [], reader.PANELS

    def step(self, text: str, hand: Steps, there: Callable[[], Any] | None = None,
             says: Callable[[], str] | None = None, settle: float = 0.8) -> Steps:
        """Do it, wait until it is done, look and read."""
        name, began = f"{self.part}{len(self.rows) + 1:02}", time.monotonic()
        yield from hand
        if there is not None:
            yield from robot.until(there, SLOW)
        seconds = time.monotonic() - began
        robot.move(*ASIDE)
        for area in robot.window().screen.areas:
            area.tag_redraw()
        yield from robot.look(name, settle)
        said = self.next_step() if says is None else says()
        self.rows.append({"name": name, "step": text, "seconds": round(seconds, 2), "says": said})
        robot.tell(**{self.part: self.rows})

    def next_step(self) -> str:
        """What the unfolded panels highlight."""
        return reader.next_step(self.panels)


def first(zipped: str) -> Steps:
    """Install, open the sample, solve, look, export."""
    view = bpy.context.preferences.view
    view.preferences_display_type = view.filebrowser_display_type = "SCREEN"
    yield 1
    path = Walk("first")
    yield from path.step("*Edit > Preferences*", _menu(EDIT, PREFERENCES), lambda: shows("PREFERENCES"), _blenders)
    yield from path.step("*Get Extensions*", _at(EXTENSIONS), None, _blenders)
    yield from path.step("Menu *v* at the upper right, *Install from Disk*", _menu(DOWN, DISK),
                         lambda: shows("FILE_BROWSER"), _blenders)
    yield from path.step("Choose the zip, *Install from Disk*", _chosen(Path(zipped)),
                         lambda: robot.PACKAGE in bpy.context.preferences.addons, _blenders, 2)
    yield from path.step("*Add-ons*", _at(ADDONS), None, _blenders)
    arrow = yield from robot.find(f'addon_expand(module="{robot.PACKAGE}"', of="PREFERENCES", kind="WINDOW",
                                  across=(0.018,))
    yield from path.step("Unfold IRPSO", robot.click(*arrow), None, _preferences, 4)
    yield from path.step("*Back to Previous*, N over the 3D Viewport", _back(), lambda: robot.region().width > 1,
                         _blenders)
    yield from path.step("The tab *IRPSO*", _tab())
    spot = yield from robot.find("irpso.sample_scene(")
    yield from path.step("*Sample Scene*", robot.click(*spot), _laid_out, settle=2)
    spot = yield from robot.find("irpso.solve(")
    yield from path.step("*Solve*; it runs", robot.click(*spot), lambda: jobs.running() and jobs.running().live)
    yield from path.step("Wait", jobs.ended(SLOW), lambda: jobs.linked(jobs.subject()), settle=2)
    spot = yield from robot.find("irpso_views.show", of="IMAGE_EDITOR", across=(0.65,))
    yield from path.step("*Predictions*", robot.click(*spot), None)
    yield from room(path, "Capture")
    yield from exported(path)


def own(data: str) -> Steps:
    """A shoot: project, pictures, mesh, flash; check, solve, look, export."""
    view = bpy.context.preferences.view
    view.preferences_display_type = view.filebrowser_display_type = "SCREEN"
    yield 1
    path, shoot = Walk("own"), Path(data)
    yield from robot.key("N")
    yield 0.5
    yield from _tab()
    yield from path.step("N over the 3D Viewport, the tab *IRPSO*", _nothing())
    yield from path.step("A and Delete over the 3D Viewport: the start file's objects go", _emptied(),
                         lambda: not bpy.context.scene.objects)
    side, path.panels = robot.region(), (reader.SHOOT, *reader.PANELS)
    yield from path.step("Unfold *Shoot*", robot.click(side.x + 60, side.y + side.height - HEADER))
    spot = yield from robot.find("wm.save_mainfile(", across=(0.75,))
    yield from path.step("*Save*", robot.click(*spot), lambda: shows("FILE_BROWSER"), _blenders)
    yield from path.step("Choose a name, *Save As*", _chosen(shoot / "own.blend"), lambda: bpy.data.filepath)
    for name, label, value in (
            ("project", "Project", "//transforms.json"), ("images", "Pictures", "//pictures/"),
            ("mesh", "Mesh", "//mesh.obj"), ("scale", "Scale", "0.1"), ("flash_right", "Right of the Lens", "60"),
            ("flash_above", "Above the Lens", "10"), ("flash_size", "Diameter", "20"),
            ("flash_power", "Power", "3.2")):
        spot = yield from robot.find(f"irpso.shoot.{name}", across=(0.6,))
        yield from path.step(f"*{label}*: type {value.strip('/')}", typed(spot, value))
    spot = yield from robot.find("irpso.import_shoot(")
    yield from path.step("*Import Shoot*", robot.click(*spot), lambda: bpy.context.scene.irpso.views, settle=2)
    spot = yield from robot.find("irpso.check_shoot(", across=(0.75,))
    yield from path.step("*Check*", robot.click(*spot), lambda: jobs.session().check_of(bpy.context.active_object),
                         settle=2)
    path.panels = reader.PANELS
    yield from path.step("Fold *Shoot*", robot.click(side.x + 60, side.y + side.height - HEADER), None)
    spot = yield from robot.find("irpso.size", across=(0.6,))
    yield from path.step("*Size*: type 256, as fine as these pictures", typed(spot, "256"))
    spot = yield from robot.find("irpso.solve(")
    yield from path.step("*Solve*; it runs", robot.click(*spot), lambda: jobs.running() and jobs.running().live)
    yield from path.step("Wait", jobs.ended(SLOW), lambda: jobs.linked(jobs.subject()), settle=2)
    yield from room(path, "Capture", "Solve")
    spot = yield from robot.find("irpso.show_in_viewport(")
    yield from path.step("*Show in Viewport*", robot.click(*spot), None, settle=EEVEE)
    yield from exported(path)


def room(path: Walk, *panels: str) -> Steps:
    """Result comes into sight: what stands between Shoot and it is folded, from the top."""
    side = robot.region()

    def hand() -> Steps:
        for number in range(len(panels)):
            yield from robot.click(side.x + 60, side.y + side.height - HEADER - (number + 1) * STEP)
            yield 0.5

    names = " and ".join(f"*{panel}*" for panel in panels)
    yield from path.step(f"Fold {names}, which makes room for *Result*", hand())


def exported(path: Walk) -> Steps:
    """To the folder that the browser begins in."""
    spot = yield from robot.find("irpso.export_maps(")
    yield from path.step("*Export Maps*", robot.click(*spot), lambda: shows("FILE_BROWSER"), _blenders)
    files = Path(bpy.path.abspath(bpy.context.scene.irpso.out))
    yield from path.step("*Export Maps* in the file browser", _accepted(), lambda: any(files.glob("*.exr")))
    robot.tell(files=sorted(file.name for file in files.iterdir()), blender=bpy.app.version_string,
               texels=dict(jobs.solution().texels), warnings=list(jobs.solution().warnings))


# ---- what the window shows


def shows(kind: str) -> bool:
    """Whether there is an area of a kind."""
    return any(area.type == kind for area in robot.window().screen.areas)


def _laid_out() -> bool:
    kinds = {area.type for area in robot.window().screen.areas}
    return bpy.data.filepath != "" and jobs.subject() is not None and {"VIEW_3D", "IMAGE_EDITOR"} <= kinds


def _blenders() -> str:
    return ""


def _preferences() -> str:
    """The note of the add-on's preferences."""
    drawn = reader.Layout()
    kept = bpy.context.preferences.addons[robot.PACKAGE].preferences
    robot.addon("irpso_addon.blender.preferences").IRPSO_AP_preferences.draw(
        SimpleNamespace(layout=drawn, device=kept.device, kernels=kept.kernels), bpy.context)
    return next(line.text for line in drawn.lines if line.icon == "INFO")


# ---- hands


def _nothing() -> Steps:
    yield 0.0


def _at(place: tuple[int, int]) -> Steps:
    """A click so far from the window's left and top edges."""
    yield from robot.click(place[0], robot.window().height - place[1])
    yield 0.3


def _menu(first_place: tuple[int, int], second: tuple[int, int]) -> Steps:
    yield from _at(first_place)
    yield from _at(second)


def _chosen(file: Path) -> Steps:
    """Folder and name in the file browser, then its button."""
    params = robot.area("FILE_BROWSER").spaces.active.params
    params.directory, params.filename = str(file.parent).encode(), file.name
    yield 0.7
    yield from _accepted()


def _accepted() -> Steps:
    place = robot.region("EXECUTE", "FILE_BROWSER")
    yield from robot.click(place.x + place.width - ACCEPT[0], place.y + ACCEPT[1])


def _emptied() -> Steps:
    for name in ("A", "DEL"):
        yield from robot.key(name)
        yield 0.1


def _back() -> Steps:
    yield from _at(BACK)
    yield 0.7
    yield from robot.key("N")
    yield 0.5


def _tab() -> Steps:
    """A person sees where it is."""
    sidebar = robot.region("UI")
    for y in range(sidebar.y + sidebar.height - 30, sidebar.y, -25):
        if sidebar.active_panel_category == "IRPSO":
            break
        yield from robot.click(sidebar.x + sidebar.width - 12, y)


def typed(spot: tuple[float, float], text: str) -> Steps:
    """Into a field: a double click, all of it away, the text, Enter."""
    for _ in range(2):
        yield from robot.click(*spot)
    yield 0.1
    yield from robot.key("A", *spot, ctrl=True)
    for letter in text:
        robot.window().event_simulate(type="A", value="PRESS", unicode=letter, x=int(spot[0]), y=int(spot[1]))
        robot.window().event_simulate(type="A", value="RELEASE", x=int(spot[0]), y=int(spot[1]))
        yield 0.01
    yield from robot.key("RET", *spot)
