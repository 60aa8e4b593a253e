"""The object's outlines in observed pictures beside those that its mesh has through given cameras."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...core.checks.outline_cameras import OutlinedCamera, Silhouettes
from ...core.data import F16, Camera, View
from ..device.draw_budget import Rectangle
from ..gbuffer.drawn_outline import DrawnOutline
from .observations import ObservedCamera

WINDOW = 1_500_000  # pixels of a view that are looked at, at most: its middle rows
OUTLINED = 0.5  # coverage below which a reference has an outline; the middle


def middle_rows(camera: ObservedCamera) -> Rectangle:
    """The part of a camera's pictures that is looked at: its window (``ObservedCamera.window``), or what fits."""
    x, y, w, h = camera.window
    rows = min(h, max(WINDOW // w, 1))
    return x, y + (h - rows) // 2, w, rows


def is_outlined(camera: ObservedCamera) -> bool:
    """Whether some reference of it has an outline."""
    return any(bool((view.reference[..., 3] < OUTLINED).any()) for view in camera.views)


def outlined_cameras(
    seen_by: Sequence[ObservedCamera], outline: DrawnOutline, cameras: Mapping[tuple[Path, str], Camera],
) -> Iterator[OutlinedCamera]:
    """Those whose references have outlines.

    ``cameras``: through which the mesh is to be drawn beside a picture, by its file and the name of the camera that it
    was observed by; they may see differently.
    """
    for observed in seen_by:
        if not is_outlined(observed):
            continue
        x, y, w, h = part = middle_rows(observed)
        rows, columns = (slice(at - edge, at - edge + count) for at, edge, count in (
            (y, observed.window[1], h), (x, observed.window[0], w)))
        size = observed.maps.position.size
        groups: dict[str, list[tuple[View, F16]]] = {}  # by the cameras that they are drawn through
        for seen in observed.views:
            camera = cameras[seen.view.image, seen.view.camera.name]
            groups.setdefault(camera.name, []).append((replace(seen.view, camera=camera), seen.reference))
        for group in groups.values():
            camera = group[0][0].camera
            silhouettes = Silhouettes(outline.shares(camera, size, part), part[:2], size)
            yield OutlinedCamera([view for view, _ in group], part[:2], size, [
                silhouettes.of(camera, reference[rows, columns, 3].astype(np.float32)) for _, reference in group])
