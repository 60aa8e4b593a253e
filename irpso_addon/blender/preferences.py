"""The add-on's preferences: how the graphics device is used, and what was detected of it.

The device is looked at in a process of its own, as everything that touches OpenGL while there is a window.
"""

from dataclasses import dataclass, fields

import bpy
from bpy.types import AddonPreferences

from ..core.errors import BadInput, Cancelled
from ..core.params import DeviceSettings
from ..process.remote import Remote
from ..solve.device_test import DetectedDevice, DeviceTest
from . import logs
from .panel_common import split, wrapped
from .properties import rna

EXTENSION = (__package__ or "").rsplit(".", 2)[0]  # bl_ext.<repository>.irpso, or whatever imported us
POLL = 0.1  # seconds
KERNELS = {"compute": "Compute Shaders", "fragment": "Fragment Shaders", "numpy": "None"}


@dataclass
class _Look:
    """The look at the device."""

    job: Remote | None = None  # under way
    asked: tuple[str, str] | None = None  # for which device and kernels
    answer: DetectedDevice | DeviceTest | str | None = None  # or why it cannot be used


_look = _Look()


class IRPSO_AP_preferences(AddonPreferences):
    """Preferences of the add-on.  The fields of `DeviceSettings` are added below."""

    bl_idname = EXTENSION

    def draw(self, _context: bpy.types.Context) -> None:
        """The settings; beside them, what was detected."""
        if _look.asked != (self.device, self.kernels) and not bpy.app.timers.is_registered(detect):
            bpy.app.timers.register(detect)  # it may not be started while drawing
        self.layout.label(text="To begin, press N in the 3D Viewport and open the tab IRPSO", icon="INFO")
        column = split(self.layout).column()
        for field in fields(DeviceSettings):
            unit = field.metadata["unit"]
            column.prop(self, field.name, text=f"{field.metadata['label']} ({unit})" if unit else None)
        box = self.layout.box()
        _draw_device(box)
        row = box.row()
        row.label(text=f"Log: {logs.path()}")
        row.operator("wm.path_open", text="", icon="FILE_FOLDER").filepath = str(logs.path().parent)


IRPSO_AP_preferences.__annotations__ = {field.name: rna(field) for field in fields(DeviceSettings)}
CLASSES = (IRPSO_AP_preferences,)


def device_settings() -> DeviceSettings:
    """What the preferences say; the table's defaults where the add-on has none (loaded by a script)."""
    chosen = _chosen()
    if chosen is None:
        return DeviceSettings()
    return DeviceSettings(**{field.name: getattr(chosen, field.name) for field in fields(DeviceSettings)})


def draw_offer(layout: bpy.types.UILayout) -> None:
    """The choice of the device, for where the graphics device has failed."""
    chosen = _chosen()
    if chosen is not None:
        box = layout.box().column()
        box.label(text="The graphics device failed", icon="ERROR")
        box.prop(chosen, "device")
        if chosen.device == "numpy":
            box.label(text="One roughness, maps of 64 texels, slow", icon="INFO")


def _chosen() -> AddonPreferences | None:
    addon = bpy.context.preferences.addons.get(EXTENSION)
    return None if addon is None else addon.preferences


def detect() -> None:
    """Looks at the device, in the background."""
    _start("solve.device_test:detect")


def test() -> None:
    """Looks at the device and solves a small scene on it, in the background."""
    _start("solve.device_test:test")


def testing() -> bool:
    """Whether one of the two is under way."""
    return _look.job is not None


def forget() -> None:
    """Ends what is under way."""
    for timer in (detect, _wait):
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)
    if _look.job is not None:
        _look.job.cancel()
        _look.job = None


def _start(task: str) -> None:
    forget()
    settings = device_settings()
    _look.asked = settings.device, settings.kernels
    try:
        _look.job = Remote(task, settings=settings)
    except BadInput as error:
        _look.answer = str(error)
        return
    bpy.app.timers.register(_wait, first_interval=POLL, persistent=True)


def _wait() -> float | None:
    """Takes the answer when it is there."""
    assert _look.job is not None
    if not _look.job.done:
        return POLL
    try:
        _look.answer = _look.job.result()
    except (BadInput, Cancelled, RuntimeError) as error:  # RuntimeError: the driver took the process down
        _look.answer = str(error)
    _look.job = None
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "PREFERENCES":
                area.tag_redraw()
    return None


def _draw_device(box: bpy.types.UILayout) -> None:
    answer, row = _look.answer, box.row()
    row.label(text="Graphics Device")
    right = row.row()
    right.alignment = "RIGHT"
    right.operator("irpso.test_device", icon="PLAY")
    if testing() or answer is None:
        box.label(text="Detecting the graphics device ...", icon="SORTTIME")
    elif isinstance(answer, str):
        wrapped(box.column(align=True), answer, 90)
    else:
        device = answer.device if isinstance(answer, DeviceTest) else answer
        rows = [("Renderer", device.renderer), ("OpenGL", device.version),
                ("Shaders", KERNELS[device.kernels])]
        rows += [(name.title().replace(" Per ", " per "), f"{limit:,}") for name, limit in device.limits.items()]
        if isinstance(answer, DeviceTest):
            rows.append(("Test", f"Passed in {answer.seconds:.1f} s"))
        column = box.column(align=True)
        for name, value in rows:
            line = column.split(factor=0.4)
            left = line.row()
            left.alignment = "RIGHT"
            left.label(text=name)
            line.label(text=value)
