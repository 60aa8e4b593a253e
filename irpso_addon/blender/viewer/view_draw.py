"""Draws in the Image Editor what `views` says: plates by a shader, the line of the wipe, legend, curve and chart."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import bpy
import gpu
import numpy as np
from bpy.app.handlers import persistent
from gpu_extras.batch import batch_for_shader

from ...core.data import F16, F32
from ...core.evaluation.display import reduced
from ..jobs.session import session
from . import editors, plot, views
from .plot import Box, Theme

SHADERS = Path(__file__).resolve().parents[3] / "shaders" / "display"
KINDS = ("color", "data", "heat", "relative", "difference", "legend")  # as plate.frag counts them
MOST, MOST_LIVE = 1024, 512  # pixels along a side of a texture; while a job runs, with a new one every moment
LEAST = 0.05  # of a picture's white: pixels darker than that are compared as if they were so bright
TEXTURES = 4  # kept

_textures: list[tuple[F32 | F16, gpu.types.GPUTexture]] = []  # the latest last; the array is kept for its identity
_handler: object = None


def draw() -> None:
    """The draw handler."""
    context = bpy.context
    if not editors.is_ours(context.space_data.image):
        return
    theme, region = Theme.of(context), context.region
    chosen = context.window_manager.irpso_views
    whole = Box(0, 0, region.width, region.height)
    visible = _visible(context, whole)
    plot.fill(whole, theme.back)
    chart = views.chart(context) if chosen.show == "CHART" else None
    plate = views.plate(context)
    if chart is not None:
        plot.chart(chart, visible, theme)
    elif plate is not None:
        place = image_place(region)
        draw_plate(plate, place, chosen.wipe, 2.0**chosen.exposure, chosen.scale / 100)
        _furniture(plate, place, visible, chosen, theme)
    else:
        _say(chosen.show, visible, theme)
    if chosen.curve and chosen.show in ("MAPS", "VIEWS"):
        _curve(views.curve(context), visible, theme)


def image_place(region: bpy.types.Region) -> Box:
    """Where the editor puts its image, in pixels of the region."""
    left, bottom = region.view2d.view_to_region(0.0, 0.0, clip=False)
    right, top = region.view2d.view_to_region(1.0, 1.0, clip=False)
    return Box(left, bottom, right, top)


def _visible(context: bpy.types.Context, whole: Box) -> Box:
    """The part of the region that header, toolbar and sidebar leave free, where they overlap it."""
    box, region = whole, context.region
    for other in context.area.regions:
        if other.type == "WINDOW" or other.width <= 1 or other.height <= 1:
            continue
        if other.alignment == "RIGHT" and other.x < region.x + region.width and other.x > region.x:
            box = Box(box.left, box.bottom, min(box.right, other.x - region.x), box.top)
        elif other.alignment == "LEFT" and other.x + other.width > region.x and other.type == "TOOLS":
            box = Box(max(box.left, other.x + other.width - region.x), box.bottom, box.right, box.top)
        elif other.alignment == "TOP" and region.y < other.y < region.y + region.height:
            box = Box(box.left, box.bottom, box.right, min(box.top, other.y - region.y))
    return box


# ---- plates


def draw_plate(plate: views.Plate, place: Box, wipe: float, exposure: float, top: float) -> None:
    """``wipe``: 0 to 1 from the left; ``exposure``: factor of the display; ``top``: error of the brightest heat."""
    first = _texture(plate.first)
    second = first if plate.second is None else _texture(plate.second)
    line = 2.0 if plate.second is None or not plate.wipe else wipe
    _draw(plate.kind, place, first, second, _Factors(line, plate.gain * exposure, top, LEAST / plate.gain))


class _Factors(NamedTuple):
    """Numbers of plate.frag, which describes them; as they are here, they change nothing."""

    wipe: float = 2.0
    gain: float = 1.0
    top: float = 1.0
    least: float = 1.0


def _draw(
    kind: str, place: Box, first: gpu.types.GPUTexture, second: gpu.types.GPUTexture, factors: _Factors,
) -> None:
    shader = _shader()
    corners = [(place.left, place.bottom), (place.right, place.bottom), (place.left, place.top),
               (place.right, place.top)]
    batch = batch_for_shader(shader, "TRI_STRIP", {"position": corners, "place": [(0, 0), (1, 0), (0, 1), (1, 1)]})
    shader.bind()
    shader.uniform_float("mvp", gpu.matrix.get_projection_matrix() @ gpu.matrix.get_model_view_matrix())
    shader.uniform_int("kind", KINDS.index(kind))
    for name, value in factors._asdict().items():
        shader.uniform_float(name, value)
    shader.uniform_sampler("first", first)
    shader.uniform_sampler("second", second)
    gpu.state.blend_set("ALPHA")
    batch.draw(shader)
    gpu.state.blend_set("NONE")


@lru_cache
def _shader() -> gpu.types.GPUShader:
    info, between = gpu.types.GPUShaderCreateInfo(), gpu.types.GPUStageInterfaceInfo("irpso_plate")
    between.smooth("VEC2", "uv")
    info.vertex_in(0, "VEC2", "position")
    info.vertex_in(1, "VEC2", "place")
    info.vertex_out(between)
    info.push_constant("MAT4", "mvp")
    info.push_constant("INT", "kind")
    for name in _Factors._fields:
        info.push_constant("FLOAT", name)
    info.sampler(0, "FLOAT_2D", "first")
    info.sampler(1, "FLOAT_2D", "second")
    info.fragment_out(0, "VEC4", "color")
    info.vertex_source((SHADERS / "plate.vert").read_text(encoding="utf-8"))
    info.fragment_source((SHADERS / "plate.frag").read_text(encoding="utf-8"))
    return gpu.shader.create_from_info(info)


def _texture(array: F32 | F16) -> gpu.types.GPUTexture:
    """The array's; premultiplied, alpha 0 where it is not finite."""
    for i, (known, texture) in enumerate(_textures):
        if known is array:
            _textures.append(_textures.pop(i))
            return texture
    small = reduced(array, MOST if session.running is None else MOST_LIVE)
    height, width = small.shape[:2]
    if small.ndim == 2:
        small = small[..., None]
    known = np.isfinite(small[..., :1])
    pixels = np.zeros((height, width, 4), np.float32)
    np.copyto(pixels[..., :3], small, where=known)
    pixels[..., 3:] = known
    data = gpu.types.Buffer("FLOAT", pixels.size, pixels.ravel())
    texture = gpu.types.GPUTexture((width, height), format="RGBA32F", data=data)
    texture_filter(texture)
    _textures.append((array, texture))
    del _textures[:-TEXTURES]
    return texture


def texture_filter(texture: gpu.types.GPUTexture) -> None:
    """Linear: maps are shown larger than they are.  (Blender 4.5's textures are always so.)"""
    if hasattr(texture, "filter_mode"):
        texture.filter_mode(True)


# ---- what is written over a plate


def _furniture(plate: views.Plate, place: Box, visible: Box, chosen: bpy.types.PropertyGroup, theme: Theme) -> None:
    if plate.wipe:
        _wipe(plate, place, visible, place.left + chosen.wipe * (place.right - place.left), theme)
    if plate.kind in ("heat", "relative", "difference"):
        _legend(visible, chosen.scale, theme, plate.first)


def _wipe(plate: views.Plate, place: Box, visible: Box, x: float, theme: Theme) -> None:
    """The line, its handle, and what lies on either side."""
    unit, middle = theme.scale, (place.bottom + place.top) / 2
    plot.line([(x, place.bottom), (x, place.top)], (0, 0, 0, 0.6), 4 * unit)
    plot.line([(x, place.bottom), (x, place.top)], (1, 1, 1, 0.9), 1.5 * unit)
    plot.disc((x, middle), 9 * unit, (0, 0, 0, 0.6))
    plot.disc((x, middle), 7.5 * unit, (1, 1, 1, 0.95))
    for turn in (-1, 1):
        tip = x + turn * 5 * unit
        back = tip - turn * 3 * unit
        plot.line([(back, middle + 3 * unit), (tip, middle), (back, middle - 3 * unit)], (0, 0, 0, 0.9), 1.5 * unit)
    height = min(place.top, visible.top) - 22 * unit
    for text, side in zip(plate.captions, (-1, 1), strict=True):
        if visible.left < x + side * (plot.width_of(text, theme) + 18 * unit) < visible.right:
            _caption(text, x + side * 12 * unit, height, float(side < 0), theme)


def _caption(text: str, x: float, y: float, align: float, theme: Theme) -> None:
    unit, wide = theme.scale, plot.width_of(text, theme)
    left = x - align * wide
    plot.fill(Box(left - 6 * unit, y - 6 * unit, left + wide + 6 * unit, y + 14 * unit), (0, 0, 0, 0.6))
    plot.write(text, (left, y), theme, (1, 1, 1, 1))


def _curve(points: views.Curve, visible: Box, theme: Theme) -> None:
    """Convergence in the lower left corner, as large as there is room."""
    unit = theme.scale
    wide = min(300 * unit, visible.right - visible.left - 24 * unit)
    high = min(150 * unit, 0.6 * (visible.top - visible.bottom))
    left, bottom = visible.left + 12 * unit, visible.bottom + 12 * unit
    if any(error > 0 for _, error in points) and wide > 140 * unit and high > 80 * unit:
        plot.convergence(points, Box(left, bottom, left + wide, bottom + high), theme)


def _legend(visible: Box, percent: float, theme: Theme, array: F32 | F16) -> None:
    """The heat map's scale, in per cent; in the upper left corner, out of the curve's way."""
    unit = theme.scale
    right, bottom = visible.left + 232 * unit, visible.top - 34 * unit
    bar = Box(right - 200 * unit, bottom, right, bottom + 10 * unit)
    plot.fill(Box(bar.left - 14 * unit, bottom - 22 * unit, right + 14 * unit, bar.top + 8 * unit),
              (*theme.back[:3], 0.88))
    texture = _texture(array)
    _draw("legend", bar, texture, texture, _Factors())
    for share in (0.0, 0.5, 1.0):
        text = f"{percent * share:.3g} %" + (" +" if share == 1 else "")
        plot.write(text, (bar.left + share * (bar.right - bar.left), bottom - 14 * unit), theme, align=share)


EMPTY = {
    "MAPS": "No maps yet: solve the active object",
    "VIEWS": "No views yet: solve the active object",
    "RESULTS": "Solve again, for example with another method or model, to compare two results",
    "CHART": "Not compared yet: press Compare Methods in the sidebar",
}


def _say(show: str, visible: Box, theme: Theme) -> None:
    said = EMPTY[show]
    running = session.running
    if running is not None and running.preview is not None and show in ("MAPS", "VIEWS"):
        said = "The first maps will appear here soon"
    elif running is not None and show == "CHART":
        said = f"{running.title}: {running.progress.message or running.progress.stage}"
    middle = (visible.left + visible.right) / 2, (visible.bottom + visible.top) / 2
    text = plot.fitted(said, visible.right - visible.left - 24 * theme.scale, theme)
    plot.write(text, middle, theme, align=0.5)


@persistent
def _drop(*_: object) -> None:
    """load_pre handler: what the textures show is gone."""
    _textures.clear()


def register() -> None:
    """Adds the handlers."""
    global _handler
    _handler = bpy.types.SpaceImageEditor.draw_handler_add(draw, (), "WINDOW", "POST_PIXEL")
    bpy.app.handlers.load_pre.append(_drop)


def unregister() -> None:
    """Takes them back, and the textures."""
    bpy.app.handlers.load_pre.remove(_drop)
    bpy.types.SpaceImageEditor.draw_handler_remove(_handler, "WINDOW")
    _drop()
    _shader.cache_clear()
