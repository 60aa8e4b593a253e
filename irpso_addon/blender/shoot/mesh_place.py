"""Where a mesh lies among the cameras of its project: axes and unit are told from what the cameras look at."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

import bpy
import numpy as np
from mathutils import Matrix

from ...core.data import F64
from ...core.errors import BadInput
from ...core.lens import Lens
from ...core.phrases import percent
from ...core.shoot.picture_lens import PictureCamera

LEAST_SEEN = 0.5  # share of the cameras whose picture must show the mesh's middle
SIZES = 0.05, 20.0  # the mesh's diagonal in a picture over the picture's: what somebody takes pictures of
ORDINARY = 0.15, 3.0  # the same of all but a few: cameras and mesh of two programs may differ by any factor
USUAL = 0.5  # the same of most objects
# Turns of the mesh about x: some programs write meshes with Y up beside cameras with Z up, and the other way round.
TURNS = {"": 0.0, "turned by +90 degrees about X": math.pi / 2, "turned by -90 degrees about X": -math.pi / 2}
UNITS = (1.0, 100.0, 0.01, 1000.0, 0.001)  # FBX counts in centimetres, others in millimetres


def place(mesh: bpy.types.Object, cameras: Sequence[PictureCamera], scale: float) -> list[str]:
    """Brings the mesh into the cameras' coordinates, times ``scale``; lines for the user.  Raises BadInput."""
    own = np.array(mesh.matrix_world, np.float64)
    corners = np.array([corner[:] for corner in mesh.bound_box]) @ own[:3, :3].T + own[:3, 3]
    middle, diagonal = corners.mean(0), float(np.linalg.norm(np.ptp(corners, axis=0)))
    straight, fallback, fitting = 0.0, None, {}
    for unit, turn in product(UNITS, TURNS):
        axes = np.array(Matrix.Rotation(TURNS[turn], 3, "X"), np.float64)
        share, size = _seen(axes @ middle * unit, diagonal * unit, cameras)
        straight = share if (unit, turn) == (1.0, "") else straight
        if share > LEAST_SEEN and SIZES[0] < size < SIZES[1]:
            fitting.setdefault(unit, (turn, size))
        elif share > LEAST_SEEN and unit == 1 and fallback is None:
            fallback = turn, size  # far off, or all round the cameras
    if fitting:  # centimetres and millimetres may both do
        unit = 1.0 if 1.0 in fitting else min(fitting, key=lambda each: abs(math.log(fitting[each][1] / USUAL)))
        turn, size = fitting[unit]
    elif fallback is not None:
        unit, (turn, size) = 1.0, fallback
    else:
        raise BadInput(f"mesh '{mesh.name}': {percent(straight)} of the cameras look at it; its coordinates differ "
                       "from those of the project's cameras; export both from the same project, in the same "
                       "coordinate system")
    mesh.matrix_world = Matrix.Scale(scale * unit, 4) @ Matrix.Rotation(TURNS[turn], 4, "X") @ mesh.matrix_world
    lines = [f"'{mesh.name}': its axes differ from those of the cameras; the mesh was {turn}"] if turn else []
    if unit != 1:
        lines.append(f"'{mesh.name}': its unit differs from that of the cameras; the mesh was scaled by {unit:g}")
    if not ORDINARY[0] <= size <= ORDINARY[1]:
        lines.append(f"'{mesh.name}': its diagonal is {size:.2g} times that of the pictures, as if its unit differed "
                     "from that of the cameras; look through a camera, and export mesh and cameras from the same "
                     "project where mesh and picture disagree")
    return lines


def _seen(point: F64, diagonal: float, cameras: Sequence[PictureCamera]) -> tuple[float, float]:
    """Share of the cameras whose picture shows a place; a ball's diameter there in the picture, median of those."""
    lenses: dict[Lens, list[F64]] = {}
    for camera in cameras:
        lenses.setdefault(camera.lens, []).append(camera.world_from_camera)
    sizes: list[float] = []
    for lens, found in lenses.items():
        poses = np.array(found)
        local = ((point - poses[:, :3, 3])[:, None] @ poses[:, :3, :3])[:, 0]
        u, v = lens.project(local).T
        seen = (u >= 0) & (u <= lens.width) & (v >= 0) & (v <= lens.height)
        away = np.maximum(np.linalg.norm(local[seen], axis=-1), 1e-30)
        sizes += (diagonal * lens.fx / away / math.hypot(lens.width, lens.height)).tolist()
    return len(sizes) / len(cameras), float(np.median(sizes)) if sizes else 0.0
