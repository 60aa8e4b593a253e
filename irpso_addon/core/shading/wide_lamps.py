"""Area lamps that are nearly as wide as they are far away, as meshes that glow.

A lamp is one lobe for each pixel, and its middle lies above the pixel's horizon or below it.  A soft box as large as a
wall is above and below at once.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..data import F64, Emitter, Environment, Light, SceneData, View
from .lights import area_corners, light_uniforms

WIDE = 0.4  # half of the longer side over the distance to the subject's middle
FULL_SPREAD = np.pi - 1e-3  # radians: narrower lamps do not send the same radiance in all directions
NO_WORLD = Environment("", np.zeros((1, 2, 3), np.float32), np.eye(3))


def with_wide_lamps_as_meshes(scene: SceneData) -> SceneData:
    """The scene in which such lamps are emitters of their views' environments."""
    points = scene.mesh.positions.reshape(-1, 3).astype(np.float64)
    center = (points.min(0) + points.max(0)) / 2
    wide = {light.name: emitter_of(light) for view in scene.views for light in view.lights if is_wide(light, center)}
    if not wide:
        return scene
    shared: dict[tuple[str, float, tuple[str, ...]], Environment] = {}

    def changed(view: View) -> View:
        glowing = tuple(wide[light.name] for light in view.lights if light.name in wide)
        if not glowing:
            return view
        around = view.environment or NO_WORLD
        made = replace(around, emitters=(*around.emitters, *glowing))
        return replace(view, lights=tuple(light for light in view.lights if light.name not in wide),
                       environment=shared.setdefault(made.key, made))

    return replace(scene, views=tuple(map(changed, scene.views)))


def is_wide(light: Light, center: F64) -> bool:
    """Whether patches stand for the lamp better than one lobe, and can."""
    if light.kind != "AREA" or not light.cast_shadow or light.spread < FULL_SPREAD or not light.power.any():
        return False
    u, v = _half_sides(light)
    distance = float(np.linalg.norm(light.matrix[:3, 3] - center))
    return max(float(np.linalg.norm(u)), float(np.linalg.norm(v))) > WIDE * distance


def emitter_of(light: Light) -> Emitter:
    """A one-sided mesh that sends the same light."""
    u, v = _half_sides(light)
    outline = area_corners(light.shape in ("DISK", "ELLIPSE"))
    if np.cross(u, v) @ light.matrix[:3, 2] > 0:  # it shines along its -Z
        outline = outline[::-1]
    corners = light.matrix[:3, 3] + outline @ np.stack([u, v])
    triangles = np.stack([np.broadcast_to(corners[0], corners[2:].shape), corners[1:-1], corners[2:]], 1)
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    radiance = light.power / (np.pi * np.linalg.norm(across, axis=1).sum() / 2)
    return Emitter(light.name, triangles.astype(np.float32),
                   np.broadcast_to(radiance, (len(triangles), 3)).astype(np.float32), both_sides=False)


def _half_sides(light: Light) -> tuple[F64, F64]:
    """Half extents along both axes, metres."""
    uniforms = light_uniforms(light)
    return np.asarray(uniforms["u_light_axis_u"]), np.asarray(uniforms["u_light_axis_v"])
