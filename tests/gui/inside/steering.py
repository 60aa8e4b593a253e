"""A part marked and solved by the panel's buttons."""

from __future__ import annotations

import bpy
import jobs
import numpy as np
import robot
from robot import Steps

SPOILT = 0.9  # roughness of the result that is kept, to be told from what is new


def part(scene: str, size: int) -> Steps:
    """Solve, select the right half in the mode for it, and solve that again."""
    yield from jobs.opened(scene, size)
    yield from jobs.started()
    yield from jobs.ended()
    yield from jobs.delivered()
    maps = jobs.solution().maps
    known = ~maps.filled
    maps.roughness[:] = SPOILT
    bpy.context.scene.irpso.region = "FACES"
    yield 0.3
    yield from robot.press("irpso.paint_part(")
    mesh = jobs.subject().data
    assert jobs.subject().mode == "EDIT" and not bpy.ops.irpso.solve.poll()
    yield from robot.look("marking")
    yield from robot.press("irpso.paint_part(")
    mesh.polygons.foreach_set("select", [polygon.center.x > 0 for polygon in mesh.polygons])
    mesh.update()
    first = jobs.solution()
    yield from jobs.started()
    yield from jobs.ended()
    yield from robot.until(lambda: jobs.solution() is not first, 5)
    after = jobs.solution()
    yield from robot.look("solved")
    image = bpy.data.images[jobs.linked(jobs.subject())["Roughness"]]
    pixels = np.empty(size * size * 4, np.float32)
    image.pixels.foreach_get(pixels)
    shown = pixels.reshape(size, size, 4)[..., 0]
    robot.tell(texels=dict(after.texels), kept=float(np.isclose(shown, SPOILT, atol=1e-4)[known].mean()),
               new=float(np.median(shown[known & (shown < 0.8)])))
