"""Drawing on a region by its pixels: boxes, lines, letters, and charts with logarithmic axes, in the theme's colours.

Only inside a draw handler of kind POST_PIXEL.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, log10, pi, sin

import blf
import bpy
import gpu
from gpu_extras.batch import batch_for_shader

from ...core.evaluation.chart_data import COLOURS, Chart, Curve, Panel, linear_ticks, log_ticks

Color = tuple[float, float, float, float]
Point = tuple[float, float]
FONT = 0
LETTERS = 11  # points, as panels have


@dataclass(frozen=True)
class Box:
    """Pixels of a region, from its lower left corner."""

    left: float
    bottom: float
    right: float
    top: float


@dataclass(frozen=True)
class Theme:
    """Colours of the Image Editor, and the size of its letters."""

    back: Color
    text: Color
    faint: Color  # lines of a grid
    accent: Color
    scale: float  # pixels a point

    @classmethod
    def of(cls, context: bpy.types.Context) -> Theme:
        """The user's own."""
        theme = context.preferences.themes[0]
        back, text = theme.image_editor.space.back, theme.image_editor.space.text_hi
        faint = tuple(0.88 * b + 0.12 * t for b, t in zip(back, text, strict=True))
        return cls((*back, 1.0), (*text, 1.0), (*faint, 1.0), (*theme.user_interface.gizmo_primary, 1.0),
                   context.preferences.system.ui_scale)


def fill(box: Box, color: Color) -> None:
    """A rectangle."""
    corners = [(box.left, box.bottom), (box.right, box.bottom), (box.left, box.top), (box.right, box.top)]
    _draw("UNIFORM_COLOR", "TRI_STRIP", corners, color)


def line(points: Sequence[Point], color: Color, width: float = 1.0) -> None:
    """A line through the points."""
    if len(points) < 2:
        return
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    shader.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
    shader.uniform_float("lineWidth", width)
    shader.uniform_float("color", color)
    _blended(batch_for_shader(shader, "LINE_STRIP", {"pos": [(x, y, 0.0) for x, y in points]}), shader)


def disc(centre: Point, radius: float, color: Color, corners: int = 20) -> None:
    """A regular polygon, one corner upwards; of many corners a disc."""
    x, y = centre
    around = [(x + radius * sin(2 * pi * i / corners), y + radius * cos(2 * pi * i / corners))
              for i in range(corners)]
    _draw("UNIFORM_COLOR", "TRIS", [p for a, b in zip(around, [*around[1:], around[0]], strict=True)
                                    for p in (centre, a, b)], color)


def width_of(text: str, theme: Theme, size: float = LETTERS) -> float:
    """In pixels."""
    blf.size(FONT, size * theme.scale)
    return blf.dimensions(FONT, text)[0]


def write(text: str, at: Point, theme: Theme, color: Color | None = None, align: float = 0.0,
          size: float = LETTERS) -> None:
    """Letters whose base line is at ``at``; ``align``: share of the text left of it."""
    blf.size(FONT, size * theme.scale)
    blf.color(FONT, *(color or theme.text))
    blf.position(FONT, at[0] - align * blf.dimensions(FONT, text)[0], at[1], 0)
    blf.draw(FONT, text)


def fitted(text: str, pixels: float, theme: Theme, size: float = LETTERS) -> str:
    """The text, cut off with dots where it is wider than ``pixels``."""
    if width_of(text, theme, size) <= pixels:
        return text
    while text and width_of(text + "…", theme, size) > pixels:
        text = text[:-1]
    return text + "…"


def _draw(kind: str, primitive: str, points: Sequence[Point], color: Color) -> None:
    shader = gpu.shader.from_builtin(kind)
    shader.uniform_float("color", color)
    _blended(batch_for_shader(shader, primitive, {"pos": [(x, y, 0.0) for x, y in points]}), shader)


def _blended(batch: gpu.types.GPUBatch, shader: gpu.types.GPUShader) -> None:
    gpu.state.blend_set("ALPHA")  # each time: letters leave it off
    batch.draw(shader)
    gpu.state.blend_set("NONE")


# ---- axes


@dataclass(frozen=True)
class Scale:
    """From values to pixels along one side of a box."""

    low: float
    high: float
    start: float
    end: float
    log: bool

    def __call__(self, value: float) -> float:
        a, b, v = (log10(x) for x in (self.low, self.high, value)) if self.log else (self.low, self.high, value)
        return self.start + (v - a) / (b - a) * (self.end - self.start)

    def ticks(self) -> list[float]:
        """Round values."""
        return log_ticks(self.low, self.high) if self.log else linear_ticks(self.low, self.high)


def axes(box: Box, x: Scale, y: Scale, theme: Theme, unit: str = "") -> None:
    """Grid and numbers; ``unit`` follows the numbers of y."""
    gap = 5 * theme.scale
    for value in y.ticks():
        line([(box.left, y(value)), (box.right, y(value))], theme.faint)
        write(f"{value:.4g}{unit}", (box.left - gap, y(value) - 3.5 * theme.scale), theme, align=1.0)
    right = -1e9
    for value in x.ticks():
        text = f"{value:g}"
        half = width_of(text, theme) / 2
        line([(x(value), box.bottom), (x(value), box.bottom + 4 * theme.scale)], theme.faint)
        if x(value) - half > right and x(value) + half < box.right + 2 * gap:
            write(text, (x(value), box.bottom - 14 * theme.scale), theme, align=0.5)
            right = x(value) + half + gap
    line([(box.left, box.bottom), (box.right, box.bottom)], theme.faint)


def span(values: Sequence[float], factor: float = 1.25) -> tuple[float, float]:
    """Ends of a logarithmic axis that holds the values with some room."""
    return min(values) / factor, max(values) * factor


# ---- convergence


def convergence(points: Sequence[Point], box: Box, theme: Theme) -> None:
    """Error in per cent against seconds, in a box of its own; one error at least is above 0."""
    fill(box, (*theme.back[:3], 0.88))
    unit = theme.scale
    inner = Box(box.left + 46 * unit, box.bottom + 24 * unit, box.right - 16 * unit, box.top - 26 * unit)
    known = [(s, 100 * e) for s, e in points if e > 0]
    last = f"{known[-1][1]:.1f} %  {known[-1][0]:.1f} s"
    write(last, (inner.right, box.top - 17 * unit), theme, align=1.0)
    free = inner.right - box.left - 20 * unit - width_of(last, theme)
    write(fitted("Best error against seconds", free, theme), (box.left + 10 * unit, box.top - 17 * unit), theme)
    low, high = span([e for _, e in known], 1.1)
    x = Scale(0.0, max(known[-1][0], 1.0), inner.left, inner.right, False)
    y = Scale(low, high, inner.bottom, inner.top, True)
    axes(inner, x, y, theme, " %")
    line([(x(s), y(e)) for s, e in known], theme.accent, 2 * unit)
    disc((x(known[-1][0]), y(known[-1][1])), 3.5 * unit, theme.accent)


# ---- error against time


def chart(made: Chart, box: Box, theme: Theme) -> None:
    """Its panels side by side, or one above the other in a narrow box."""
    fill(box, theme.back)
    unit, count = theme.scale, len(made.panels)
    write(fitted(made.title, box.right - box.left - 24 * unit, theme, 13), (box.left + 12 * unit, box.top - 24 * unit),
          theme, size=13)
    write(fitted(made.foot, box.right - box.left - 24 * unit, theme, 9), (box.left + 12 * unit, box.bottom + 8 * unit),
          theme, size=9)
    left, bottom, right, top = box.left, box.bottom + 24 * unit, box.right, box.top - 36 * unit
    wide = right - left > 1.2 * (top - bottom)
    for i, panel in enumerate(made.panels):
        if wide:
            step = (right - left) / count
            _panel(panel, Box(left + i * step, bottom, left + (i + 1) * step, top), theme)
        else:
            step = (top - bottom) / count
            _panel(panel, Box(left, top - (i + 1) * step, right, top - i * step), theme)


def _panel(panel: Panel, box: Box, theme: Theme) -> None:
    unit = theme.scale
    inner = Box(box.left + 48 * unit, box.bottom + 34 * unit, box.right - 14 * unit, box.top - 28 * unit)
    if inner.right - inner.left < 60 * unit or inner.top - inner.bottom < 40 * unit:
        return
    title = f"{panel.title[:1].upper()}{panel.title[1:]}"
    write(fitted(title, box.right - box.left - 12 * unit, theme), (box.left + 12 * unit, box.top - 14 * unit), theme)
    seconds = [s for curve in panel.curves for s in curve.seconds or ()]
    values = [v for curve in panel.curves for v in (*curve.values, *(v for _, v in curve.hollows()))]
    low, high = span(seconds, 1.5)
    names = max(width_of(curve.label, theme) for curve in panel.curves) + 16 * unit
    room = max(1 - names / (inner.right - inner.left), 0.35)  # the names stand right of the last points
    x = Scale(low, low * (high / low) ** (1 / room), inner.left, inner.right, True)
    y = Scale(*span(values, 1.3), inner.bottom, inner.top, panel.log)
    axes(inner, x, y, theme)
    write("Seconds", (inner.right, box.bottom + 5 * unit), theme, align=1.0)
    for curve in panel.curves:
        _curve(curve, inner, x, y, theme)
    _names(panel.curves, inner, x, y, theme)


def _color(curve: Curve, theme: Theme) -> Color:
    if curve.seconds is None:
        return theme.text
    code = COLOURS[curve.place % (len(COLOURS) - 1)]
    r, g, b = (int(code[i:i + 2], 16) / 255 for i in (1, 3, 5))
    dark = sum(theme.back[:3]) < 1.5
    return 0.8 * r + 0.2 * dark, 0.8 * g + 0.2 * dark, 0.8 * b + 0.2 * dark, 1.0


def _curve(curve: Curve, box: Box, x: Scale, y: Scale, theme: Theme) -> None:
    color, unit = _color(curve, theme), theme.scale
    if curve.seconds is None:
        height, dash = y(curve.values[0]), 8 * unit
        for i in range(int((box.right - box.left) / (2 * dash))):
            line([(box.left + 2 * i * dash, height), (box.left + (2 * i + 1) * dash, height)], color)
        return
    points = [(x(s), y(v)) for s, v in zip(curve.seconds, curve.values, strict=True)]
    line(points, color, 2 * unit)
    for point, note in zip(points, curve.notes or [""] * len(points), strict=True):
        disc(point, 4.5 * unit, color, 3 + curve.place if curve.place else 20)
        if note:
            write(note, (point[0] + 4 * unit, point[1] + 7 * unit), theme, color, size=9)
    for s, v in curve.hollows():
        disc((x(s), y(v)), 5.5 * unit, color, 20)
        disc((x(s), y(v)), 3.5 * unit, theme.back, 20)


def _names(curves: Sequence[Curve], box: Box, x: Scale, y: Scale, theme: Theme) -> None:
    """Beside the ends of the curves, moved up where another name stands."""
    unit = theme.scale
    taken: list[tuple[float, float, float]] = []  # left, right, height
    for curve in sorted(curves, key=lambda curve: curve.values[-1]):
        wide = width_of(curve.label, theme)
        level = curve.seconds is None
        left = box.right - wide if curve.seconds is None else x(curve.seconds[-1]) + 9 * unit
        height = y(curve.values[-1]) + (4 if level else -4) * unit
        for other_left, other_right, other in taken:  # from the lowest
            if left < other_right and other_left < left + wide and abs(height - other) < 14 * unit:
                height = other + 14 * unit
        taken.append((left, left + wide, height))
        write(curve.label, (left, height), theme, _color(curve, theme))
