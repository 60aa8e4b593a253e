"""How `irpso compare` reads references: once for all methods, again for another exposure; and what it judges by."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.compare import measure
from irpso_addon.core.data import View
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device import thread
from tests.support import shoots
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


@pytest.mark.one_python
def test_held_out_pixels_of_faces_outside_the_square_are_not_judged(monkeypatch):
    """Half of the plane, of other paint, lies in the next square, of which no method has made a map."""
    plane = syn.shoot(syn.PATCHES, shoots.rig(), (96, 96))
    monkeypatch.setattr(measure, "read_reference", lambda view, max_pixels: plane.read_image(view))
    mesh = plane.scene.mesh
    scene = replace(plane.scene, mesh=replace(mesh, uvs=mesh.uvs * np.array([2, 1], np.float32)))
    fit, held = measure.hold_out(scene, 5, False)
    given = SolveSettings(size=64, model="one-lobe", lamps="given", exposures="given", registration="given")
    report = thread.run(lambda: measure.measure(fit, held, None, given, ()))
    errors = {row["method"]: row["held_out"] for row in report["rows"]}
    assert errors["refined"] < 0.01, errors
