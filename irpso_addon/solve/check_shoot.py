"""The check before a solve: some views, drawn and measured in seconds; core/checks/shoot_check.py says what is wrong.

A generator of Progress that must run on the GL thread: ``gpu.device.thread.run`` or a `Remote`.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace
from functools import partial

import numpy as np

from ..core.checks.drawn_view import DrawnView
from ..core.checks.edge_shift import EdgeMatch, EdgeShift, has_outline, match_of, outline_distance
from ..core.checks.epipolar import Side, neighbours, side_of
from ..core.checks.highlights import irradiance
from ..core.checks.mended_cameras import moved
from ..core.checks.outline_fit import silhouette
from ..core.checks.shoot_check import ShootCheck
from ..core.checks.shoot_measure import ShootMeasure
from ..core.data import F32, Light, RadianceImage, SceneData, View
from ..core.errors import BadInput
from ..core.images.image_file import open_image
from ..core.images.read_ahead import ReadAhead
from ..core.images.reference_image import read_reference
from ..core.job import Progress
from ..gpu.device import thread
from ..gpu.device.context import Device
from ..gpu.gbuffer.drawn_outline import DrawnOutline
from ..gpu.gbuffer.gbuffer import MeshBuffer, Occluders, draw_pixel_grid
from ..gpu.observe.visibility import LightVisibility

VIEWS = 12  # that are looked at, spread over the list
PIXELS = 500_000  # of a picture, at most
SHADOW_SIZE = 1024  # texels of a shadow map on a side


def check(scene: SceneData) -> Generator[Progress, None, ShootCheck]:
    """What fits and what does not.  Raises BadInput for what cannot be looked at: no views, unreadable pictures."""
    if not scene.views:
        raise BadInput(f"{scene.name}: has no views to check; add pictures, or import a shoot")
    if thread.settings().device == "numpy":
        raise BadInput("device numpy: the check needs the graphics device; choose device opengl, or solve without the "
                       "check")
    device = thread.device()
    chosen = [scene.views[i] for i in np.unique(np.linspace(0, len(scene.views) - 1, VIEWS).astype(int))]
    measure = ShootMeasure(scene, chosen)
    pairs = neighbours(scene.views, chosen, measure.places, measure.on_camera)
    paired = {id(view) for pair in pairs for view in pair}
    sides: dict[int, Side] = {}
    known = {id(view) for view in chosen}
    others = {id(view): view for pair in pairs for view in pair if id(view) not in known}  # that are compared alone
    looked = [*chosen, *others.values()]
    with device.scope(), ReadAhead(partial(read_reference, max_pixels=PIXELS), looked) as pictures:
        drawing = ViewDrawing(device, scene)
        for number, view in enumerate(looked):
            step = Progress(number / len(looked), "check", view.image.name)
            yield step
            image = yield from pictures.next(step)
            drawn = drawing.draw(view if id(view) in known else replace(view, lights=()), image)
            if id(view) in known:
                match = match_of(drawn, irradiance(drawn))
                measure.add(drawn, match, *drawing.shift(drawn, match))
            if id(view) in paired:
                sides[id(view)] = side_of(drawn)
        for one, other in pairs:
            measure.compare(sides[id(one)], sides[id(other)])
    yield Progress(1.0, "check")
    return measure.check()


class ViewDrawing:
    """Draws the mesh of a scene through its views' cameras.  Its textures belong to the scope."""

    def __init__(self, device: Device, scene: SceneData) -> None:
        self.device, self.scene = device, scene
        self.mesh, self.occluders = MeshBuffer(device, scene.mesh), Occluders(device, scene.occluders)
        self.outline = DrawnOutline(device, self.mesh, scene.occluders, scene.pixel_filter)
        self.shadows = LightVisibility(device, self.mesh, Occluders(device, scene.casters), SHADOW_SIZE)

    def draw(self, view: View, image: RadianceImage) -> DrawnView:
        """A view with its picture, reduced.  Raises BadInput for a file that cannot be opened."""
        file = open_image(view.image)
        height, width = image.valid.shape
        whole = 0, 0, width, height
        with self.device.scope():
            maps = draw_pixel_grid(self.device, self.mesh, self.occluders, view.camera, (width, height),
                                   self.scene.pixel_filter)
            position, normal = self.device.read(maps.position), self.device.read(maps.normal)
            lit = []
            for light in view.lights:
                *_, (arrives,) = self.shadows.lit_maps(_middle_of(light), [maps])
                lit.append(self.device.read(arrives, whole)[..., 0])
        covered = position[..., 3] > 0.5
        return DrawnView(
            view, image, position[..., :3], np.where(covered[..., None], normal[..., :3], np.float32(0)), covered,
            self.outline.shares(view.camera, (width, height), whole), tuple(lit), file.width / width,
            file.integer or file.camera is not None, file.shot)

    def shift(self, drawn: DrawnView, match: EdgeMatch) -> tuple[EdgeShift | None, float | None]:
        """By how much a view lies beside its drawing, and how far the outlines are apart then: in its pixels."""
        found, coverage = match.shift, drawn.image.coverage
        if found is None or not has_outline(coverage):
            return found, None
        share = self._moved(drawn, found)
        left = silhouette(share, coverage)
        if left is not None:
            found = replace(found, shift=(found.shift[0] + float(left.shift[0]), found.shift[1] + float(left.shift[1])))
            share = self._moved(drawn, found)
        return found, outline_distance(share, coverage)

    def _moved(self, drawn: DrawnView, found: EdgeShift) -> F32:
        """(h, w) share of each pixel that the object covers, once shifted."""
        size = drawn.size
        return self.outline.shares(moved(drawn.view.camera, found.shift, size), size, (0, 0, *size))


def _middle_of(light: Light) -> Light:
    """The light as a point, whose shadows are drawn once."""
    return replace(light, radius=0.0, size=(0.0, 0.0))
