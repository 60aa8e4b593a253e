"""A view's picture, with the mesh that it shows and the lights that lit it: what squares on greys show, and should."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from ...core.data import F64, Camera, Light, View
from ...core.errors import BadInput
from ...core.images.image_file import open_image
from ...core.images.shot_settings import LEAST_DIFFERENCE, NOTHING_SAID, ShotSettings, exposures_off
from ...core.projection import rays_of
from ...core.shading.lights import light_irradiance
from ...core.shoot.grey_patch import Patch, measure_patch
from ...core.shoot.picture_marks import Square
from ..scene.move_light import check_power, multiply_power
from ..scene.scene_objects import read_light, rendered_objects
from .flash_power import surface_albedo
from .mesh_rays import MeshRays
from .view_pictures import ListedView, read_picture

LOOKED_AT, FEWEST = 4096, 50  # pixels of a picture, and of the mesh in it
OTHERS = 3  # views whose EXIF is read: a RAW file takes a second


class LitPicture:
    """A picture, read once."""

    def __init__(self, context: bpy.types.Context, mesh: bpy.types.Object, shown: ListedView) -> None:
        """``mesh``: what the squares are a part of, where they show it.  Raises BadInput."""
        self.shown, self.name = shown, shown.name
        self.messages: list[str] = []  # for the user, of squares that do not show the mesh
        self.ambient: F64 = np.zeros(3)  # shines beside the lights
        if shown.entry is not None:
            self.ambient = np.array(shown.entry.ambient_radiance, np.float64)
        self._context, self._mesh = context, mesh
        self._rgb, self._valid = read_picture(_as_solved(shown))
        # `read_picture` gives clipped pixels the brightest value
        self._clip = np.inf if self._valid.all() else float(self._rgb[~self._valid].max()) / 0.999

    def patch(self, square: Square, name: str | None = None) -> tuple[Patch, F64]:
        """What whole pixels in the square show, and their middle (2,), both from the upper left, the picture upright.

        Raises BadInput about the picture and the patch ``name``, and what `measure_patch` raises.
        """
        height, width = self._valid.shape
        x, y, length = square
        left, upper = x - length / 2, y - length / 2
        inside = np.isfinite(square).all() and length >= 1 and min(left, upper) >= 0
        if not inside or left + length > width or upper + length > height:
            raise BadInput(f"{self.name}: the square of {length:g} pixels at ({x:g}, {y:g}) is not inside "
                           f"the picture of {width} x {height} pixels; mark the {name or 'grey card'}")
        side = round(length)
        column, row = min(round(left), width - side), min(round(upper), height - side)
        part, ok = (pixels[row:row + side, column:column + side] for pixels in (self._rgb, self._valid))
        clip = np.inf if ok.all() else self._clip
        about = self.name if name is None else f"{self.name}, {name}"
        return measure_patch(part.astype(np.float64), clip, about), np.array([column, row]) + side / 2

    def irradiance(self, middle: F64) -> F64:
        """(3,) in W/m^2 of the view's lights at what pixel ``middle`` (2,) shows.  Nothing shades it.

        Raises BadInput.
        """
        place, normal = self._place(middle)
        return np.asarray(sum((light.power * light_irradiance(light, place, normal) for light in self._lights()),
                              np.zeros(3)))

    def whiter_line(self, factor: float) -> list[str]:
        """A line where the mesh in this picture would be whiter than white if the lights' power were ``factor`` times
        what it is: something is wrong with the card then.
        """
        height, width = self._valid.shape
        step = max(1, round((height * width / LOOKED_AT) ** 0.5))
        valid = self._valid[::-1][step // 2::step, step // 2::step]
        rows, columns = np.nonzero(valid)
        rgb = self._rgb[::-1][step // 2::step, step // 2::step][rows, columns]
        pixels = np.stack([columns, rows], -1) * step + step // 2 + 0.5
        albedo = surface_albedo(self.shown.view.camera, self._lights(), pixels, (width, height), rgb,
                                MeshRays(self._context, self._mesh))
        white = float(np.median(albedo)) / factor if len(albedo) >= FEWEST else 0.0
        return [f"{self.name}: with this power '{self._mesh.name}' is {white:.1f} times as bright as a white surface; "
                "check the card's reflectance, and that no shadow lies on it"] if white > 1 else []

    def exposure_line(self, views: Sequence[ListedView]) -> list[str]:
        """A line where EXIF states another exposure of this picture, beside some of the other ``views``, than they."""
        others = [view for view in views if view.view.image != self.shown.view.image]
        chosen = [others[i] for i in np.unique(np.linspace(0, len(others) - 1, OTHERS).astype(int))] if others else []
        given = self.shown.view.exposure
        off = exposures_off([(_shot(view), view.view.exposure) for view in (self.shown, *chosen)])[0]
        return [f"{self.name}: EXIF states an exposure of {off:+.2f} EV beside the other views and their Exposure; set "
                f"its Exposure to {given + off:.3g} and click again, unless a flash shorter than the exposure time lit "
                "all of them"] if abs(off) > LEAST_DIFFERENCE else []

    def _lights(self) -> list[Light]:
        depsgraph = self._context.evaluated_depsgraph_get()
        return [read_light(obj, depsgraph, lambda _: None) for obj in lights_of(self._context, self.shown)]

    def _place(self, middle: F64) -> tuple[F64, F64]:
        """World place and normal (3,) towards the camera; of no part of the mesh, as far away as its middle."""
        camera, (x, y) = self.shown.view.camera, middle
        height, width = self._valid.shape
        origin, direction = (both[0] for both in rays_of(camera, np.array([[x, height - y]]), (width, height)))
        if not np.isfinite(direction).all():
            raise BadInput(f"{self.name}: the lens of camera '{camera.name}' does not reach ({x:g}, {y:g}); mark the "
                           "grey card")
        direction = direction / np.linalg.norm(direction)
        hit = MeshRays(self._context, self._mesh).hit(origin, direction)
        if hit is not None:
            return hit
        far = _distance(self._mesh, camera, direction)
        if not self.messages:
            self.messages.append(f"{self.name}: the grey card is not on '{self._mesh.name}'; it is taken to stand "
                                 f"{far:.3g} m away, as the mesh's middle does, and to face the camera")
        return origin + far * direction, -direction


def _shot(view: ListedView) -> ShotSettings:
    """Of another view's picture too, which may be missing here."""
    try:
        return open_image(view.view.image).shot
    except BadInput:
        return NOTHING_SAID


def _as_solved(shown: ListedView) -> View:
    """The view with everything that a solve undoes of its picture, but for the mask."""
    entry = shown.entry
    if entry is None:
        return shown.view
    ambient, flat = (Path(bpy.path.abspath(path)) if path else None for path in (entry.ambient, entry.flat))
    return replace(shown.view, ambient=ambient, flat=flat, vignetting=entry.vignetting, response=entry.response,
                   shoulder=entry.shoulder, black_level=tuple(entry.black_level), tint=tuple(entry.tint))


def lights_of(context: bpy.types.Context, view: ListedView) -> list[bpy.types.Object]:
    """The view's own, or all that render.  Raises BadInput for an entry whose light was deleted."""
    if not view.entry.lights:
        return [obj for obj in rendered_objects(context.view_layer).values() if obj.type == "LIGHT"]
    found = [item.light for item in view.entry.lights]
    if None in found:
        raise BadInput(f"{view.name}: its view has an empty light entry; choose a light or remove the entry")
    glowing = next((obj.name for obj in found if obj.type != "LIGHT"), None)
    if glowing is not None:
        raise BadInput(f"{view.name}: is lit by '{glowing}', which is not a lamp, and only lamps can be scaled; choose "
                       "a picture under lamps")
    return found


def _distance(mesh: bpy.types.Object, camera: Camera, direction: F64) -> float:
    """Metres from the camera to the middle of the mesh's bounds; of an orthographic one along its axis."""
    corners = np.array([mesh.matrix_world @ Vector(corner) for corner in mesh.bound_box], np.float64)
    offset = corners.mean(0) - camera.position
    far = float(offset @ direction) if camera.orthographic else float(np.linalg.norm(offset))
    if not far > 0:
        raise BadInput(f"camera '{camera.name}': the mesh '{mesh.name}' is not in front of it; check the camera")
    return far


def scale_power(context: bpy.types.Context, views: Sequence[ListedView], factor: float, what: str) -> list[str]:
    """Multiplies the power of every light of the views, and marks it as known; lines for the user that name ``what``.

    Other lights that share their data keep their power.  Raises BadInput, and changes nothing then.
    """
    lights = list(dict.fromkeys(obj for view in views for obj in lights_of(context, view)))
    for obj in lights:
        check_power(obj)
        if obj.data.library is not None:
            raise BadInput(f"light data '{obj.data.name}': is linked from another file; make it local")
    multiply_power(lights, factor)
    context.scene.irpso.scale_known = True
    return [f"power of '{data.name}' x {factor:.4g} by {what}: {data.energy:.4g} "
            f"{'W/m^2' if data.type == 'SUN' else 'W'}"
            for data in dict.fromkeys(obj.data for obj in lights)]
