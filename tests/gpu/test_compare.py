"""How `irpso compare` reads reference images: once for all methods, and again for another exposure."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from irpso_addon.compare import measure
from irpso_addon.core.data import View
from tests.support import synthetic as syn


def test_a_reference_is_read_once_for_moved_cameras_and_again_for_another_exposure(monkeypatch):
    views = tuple(View(Path(f"{i}.exr"), syn.camera((0, 0, 2)), ()) for i in range(2))
    read: list[tuple[Path, float]] = []
    monkeypatch.setattr(measure, "read_reference", lambda view, max_pixels: read.append((view.image, view.gain)))
    read_image = measure.read_once(views)
    first = [(view.image, 1.0) for view in views]
    assert read == first
    read_image(replace(views[0], camera=replace(views[0].camera, name="moved")))
    assert read == first
    read_image(replace(views[0], gain=1.1))
    assert read == [*first, (views[0].image, 1.1)]
