"""What a person reads in the IRPSO tab: the panels draw into a layout that writes down what it is given."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import bpy
import robot

SHOOT = "IRPSO_PT_shoot_check"  # folded at first
PANELS = ("IRPSO_PT_capture", "IRPSO_PT_solve", "IRPSO_PT_result")


@dataclass
class Line:
    """A label or a button."""

    text: str
    icon: str
    alert: bool = False  # in red
    button: bool = False
    default: bool = False  # highlighted
    enabled: bool = True


@dataclass
class Layout:
    """Takes the calls of `bpy.types.UILayout`; what is drawn in a row or a column of it inherits its colours."""

    lines: list[Line] = field(default_factory=list)
    alert: bool = False
    active_default: bool = False
    enabled: bool = True
    active: bool = True

    def _inner(self, *_: Any, **__: Any) -> Layout:
        return Layout(self.lines, self.alert, self.active_default, self.enabled)

    row = column = split = box = column_flow = grid_flow = _inner

    def panel(self, _idname: str, default_closed: bool = False) -> tuple[Layout, Layout | None]:
        """The header, and the body where it is open at first."""
        return self._inner(), None if default_closed else self._inner()

    def label(self, text: str = "", icon: str = "NONE", **_: Any) -> None:
        """A line of text; the next lines of one message have no icon."""
        before = self.lines[-1] if self.lines else None
        if icon == "BLANK1" and before is not None and not before.button and before.alert == self.alert:
            before.text += f" {text}"
        elif text:
            self.lines.append(Line(text, icon, self.alert))

    def operator(self, name: str, text: str | None = None, icon: str = "NONE", **_: Any) -> SimpleNamespace:
        """A button, with its own name where it is given none."""
        group, short = name.split(".")
        called = getattr(getattr(bpy.ops, group), short)
        self.lines.append(Line(text if text is not None else called.get_rna_type().name, icon, self.alert, True,
                               self.active_default, self.enabled and called.poll()))
        return SimpleNamespace()

    def progress(self, text: str = "", **_: Any) -> None:
        """A bar."""
        self.lines.append(Line(text, "INFO"))

    def __getattr__(self, name: str) -> Any:
        return lambda *_, **__: self._inner()


def lines(panel: str) -> list[Line]:
    """What a panel says now; nothing where it is not there."""
    drawn, kind = Layout(), getattr(bpy.types, panel)
    with robot.within(kind="UI"):
        if hasattr(kind, "poll") and not kind.poll(bpy.context):
            return []
        helpers = {name: value for name, value in vars(kind).items() if isinstance(value, staticmethod)}
        kind.draw(type("Drawn", (), {**helpers, "layout": drawn})(), bpy.context)
    return drawn.lines


def next_step(panels: tuple[str, ...] = PANELS) -> str:
    """What is highlighted, the first panel's first: a line in red, else the coloured button, else a note."""
    said = [line for panel in panels for line in lines(panel)]
    for choice in (lambda x: x.alert and not x.button, lambda x: x.default and x.enabled,
                   lambda x: x.icon == "INFO" and not x.button):
        if found := next(filter(choice, said), None):
            return f"[{found.text}]" if found.button else found.text
    return ""
