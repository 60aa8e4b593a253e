"""What the maps say that each view should show, beside what it shows: at the camera's own pixels, one view at a time.

The same prediction as the base colour's (shaders/maps): base colour averaged over the pixel's footprint, times the
diffuse, plus the lobes.  solve_checks.py and registration.py make of it what a user should know.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence

import moderngl
import numpy as np

from ...core.checks.view_check_data import CheckedView, PixelWindow
from ...core.data import F32, ViewPicture
from ...core.resampling import on_grid
from ..device.context import Device, Inputs
from ..device.draw_budget import Rectangle
from ..device.programs import UNLIT_BELOW
from ..gbuffer.drawn_outline import DrawnOutline
from ..observe.observations import EDGE_QUALITY, HALF_MOST, ObservedCamera, ObservedView
from ..observe.picture_outlines import is_outlined, middle_rows
from .albedo import AlbedoSolver

MIN_COS_V = 0.2  # of a pixel that is unlit: seen flatter, shaders/include/observed.glsl says nothing of it
PICTURE_SIDE = 512  # pixels


def check_views(
    albedo: AlbedoSolver, base: moderngl.Texture, cameras: Sequence[ObservedCamera],
    outline: DrawnOutline | None = None,
) -> Iterator[CheckedView]:
    """Each view of ``cameras`` in turn; runs on the GL thread.  ``base``: the texture found, holes filled.

    ``outline``: draws the object's where references have one; None: nobody asks for it.
    """
    device = albedo.device
    for texture in (base, *albedo.known.values()):
        texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
    for camera in cameras:
        part = middle_rows(camera)
        with device.scope():
            drawn = _diffuse(albedo, camera, base)
            diffuse = device.read(drawn[0], part)
            window, shown = _window(device, camera, part, diffuse[..., 3], outline), _rgb(diffuse)
            for view in camera.views:
                yield _check(albedo, camera, view, window, part, shown, drawn[-1])
    for texture in (base, *albedo.known.values()):
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)


def with_view_pictures(
    views: Iterator[CheckedView], pictures: list[ViewPicture],
) -> Generator[CheckedView, None, None]:
    """The views, and of each, as it passes, a picture of at most PICTURE_SIDE pixels on a side."""
    for seen in views:
        step = -(-max(seen.window.covered.shape) // PICTURE_SIDE)
        covered = seen.window.covered[::step, ::step, None]
        reference = np.where(covered, seen.radiance[::step, ::step], np.nan)
        predicted = np.where(covered, seen.predicted[::step, ::step] * seen.irradiance[::step, ::step], np.nan)
        scale = max(float(np.nanmax(reference)) if np.isfinite(reference).any() else 0.0, 1e-20)
        pictures.append(ViewPicture(
            seen.view.image.name, seen.view.camera.name, seen.view.light_names,
            (reference / scale).astype(np.float16), np.minimum(predicted / scale, HALF_MOST).astype(np.float16), scale))
        yield seen


def _window(
    device: Device, camera: ObservedCamera, part: Rectangle, cos_v: F32, outline: DrawnOutline | None,
) -> PixelWindow:
    maps = camera.maps
    assert maps.uv is not None
    position, normal, uv = (device.read(grid, part) for grid in (maps.position, maps.normal, maps.uv))
    covered = (position[..., 3] > 0.5) & on_grid(uv)
    share = None
    if outline is not None and is_outlined(camera):
        share = outline.shares(camera.camera, maps.position.size, part)
    return PixelWindow(corner=part[:2], image=maps.position.size, covered=covered,
                       position=position[..., :3], normal=normal[..., :3], uv=uv,
                       slot=normal[..., 3], cos_v=cos_v, share=share)


def _diffuse(albedo: AlbedoSolver, camera: ObservedCamera, base: moderngl.Texture) -> list[moderngl.Texture]:
    """What the base colour shows, and cos_v; the same in all the camera's views.

    Of metals, and below a rough diffuse, also the base colour.
    """
    device, maps = albedo.device, camera.maps
    inputs = Inputs({**albedo.looked_up(camera), "u_uv_slope": maps.uv_slope, "u_base": base},
                    {**camera.viewpoint, "u_footprint": camera.uniforms["u_footprint"]}, albedo.defines)
    textures = [device.texture(*maps.position.size) for _ in range(2 if albedo.by_base else 1)]
    with device.target(textures, clear=True) as target:
        device.draw("maps/check_diffuse.frag", target, inputs, cells=maps.cells)
    return textures


def _rgb(values: F32) -> F32:
    """Of (h, w, 4); arrays without gaps are several times as fast."""
    return np.ascontiguousarray(values[..., :3])


def _check(
    albedo: AlbedoSolver, camera: ObservedCamera, view: ObservedView, window: PixelWindow, part: Rectangle,
    diffuse: F32, base: moderngl.Texture,
) -> CheckedView:
    """``base``: colour at the camera's pixels, where more than ``diffuse`` depends on it."""
    device = albedo.device
    with device.scope():
        drawn = albedo.specular(camera, view, base)
        specular = _rgb(device.read(drawn[0], part))
        if albedo.rough:
            diffuse = diffuse[..., :3] + _rgb(device.read(drawn[-1], part))
    colour = device.read(view.colour, part)
    quality = colour[..., 3]
    observed = np.where(quality[..., None] > 0, _rgb(colour), np.float32(0))
    x, y = part[0] - camera.window[0], part[1] - camera.window[1]
    lobes = [device.read(lobe, part) for lobe in view.lobes]
    away = [np.where(lobe[..., 3] > 0, lobe[..., 0], np.float32(1)) for lobe in lobes]  # no light, no highlight
    if view.nodes is not None:  # light from everywhere
        away.append(np.zeros_like(quality))
    reference = view.reference[y:y + part[3], x:x + part[2]].astype(np.float32)
    radiance = _rgb(reference) * np.float32(view.scale)
    seen = np.isfinite(radiance[..., 0])
    lit = (quality > 0)[..., None] & (observed > UNLIT_BELOW) & (observed != 0)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        irradiance = np.where(lit, radiance / observed, np.float32(0))
    return CheckedView(
        view=view.view, window=window, observed=observed, predicted=diffuse + specular, specular=specular,
        quality=quality, edge=quality < EDGE_QUALITY * window.cos_v**2, radiance=radiance, irradiance=irradiance,
        sin2h=np.minimum.reduce(away),
        coverage=reference[..., 3], clipped=view.clipped,
        unlit=window.covered & seen & (window.cos_v > MIN_COS_V) & (quality == 0))
