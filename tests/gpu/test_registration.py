"""Outlines that run through pixels' centres, as of a height field with a vertex at each pixel of its camera.

The bumpy plane (synthetic.py) straight from above: 48 pixels wide in a picture of 73, so that its sides lie at the
centres of pixels.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.check_records import LEAST_SHIFT
from irpso_addon.core.checks.mended_cameras import NEAR, bent, moved, rolled
from irpso_addon.core.checks.outline_fit import GROWTH, silhouette
from irpso_addon.core.checks.solve_checks import left_over
from irpso_addon.core.data import F32, Camera, Light, RadianceImage, View
from irpso_addon.core.job import Progress, mapped
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.gbuffer.drawn_outline import DrawnOutline
from irpso_addon.gpu.gbuffer.gbuffer import MeshBuffer
from irpso_addon.solve import one_round, pipeline
from irpso_addon.solve.gpu_path import solve_grid
from tests.support import shoots
from tests.support import synthetic as syn

PIXELS, WIDE = 73, 48
NOTHING = np.zeros((0, 3, 3), np.float32)


def above(width: float = 2 * PIXELS / WIDE) -> Camera:
    """Orthographic, its picture's middle above the plane's."""
    return syn.camera((0, 0, 4), width=width)


def shot(shift: tuple[float, float] = (0.0, 0.0)) -> syn.Shoot:
    """Pictures of areas, not of points; their content lies ``shift`` pixels beside what the scene says."""
    there = moved(above(), shift, (PIXELS, PIXELS))
    made = syn.shoot(syn.PATCHES, [(there, [light]) for light in syn.lamps(8)], (PIXELS, PIXELS), samples=6)
    views = tuple(replace(view, camera=above()) for view in made.scene.views)
    return replace(made, scene=replace(made.scene, views=views))


@pytest.mark.one_python
@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.5, 0.25)])
def test_vertices_at_pixel_centres_are_no_shift(shift: tuple[float, float]) -> None:
    """And a shift of such a camera is found as it is."""
    found = shoots.run(shot(shift), model="one-lobe", registration="given", indirect="off").checks
    assert found is not None
    for misfit in found.registration:
        assert misfit.shifted == (shift != (0.0, 0.0))
        np.testing.assert_allclose(misfit.shift, shift, atol=0.03)


def test_each_picture_is_read_once_for_all_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that is too bright asks for a second round, and large files take seconds."""
    made, rounds, read = shot(), [], Counter[str]()
    name, image = next(iter(made.images.items()))
    made = replace(made, images={**made.images, name: replace(image, rgb=1.2 * image.rgb)})
    monkeypatch.setattr(one_round, "solve_grid", lambda *given: rounds.append(given) or solve_grid(*given))

    def read_image(view: View) -> RadianceImage:
        read[view.image.name] += 1
        return made.read_image(view)

    settings = SolveSettings(size=shoots.SIZE, model="one-lobe", registration="given", lamps="given", normals="mesh",
                             exposures="solve", indirect="off")
    thread.run(lambda: pipeline.solve(made.scene, settings, read_image))
    assert len(rounds) > 1
    assert set(read.values()) == {1} and len(read) == len(made.scene.views)


def test_only_what_explains_the_pictures_better_is_put_right() -> None:
    """Pictures beside where they should be are; masks beside their pictures, drawn so by hand, are not."""
    beside = shot((0.75, -0.5))
    masked = shot()
    images = {name: replace(image, coverage=np.roll(image.coverage, 1, 1)) for name, image in masked.images.items()}
    for made, mended in ((beside, True), (replace(masked, images=images), False)):
        found = shoots.run(made, model="one-lobe", registration="auto", indirect="off")
        assert any("; corrected" in warning for warning in found.warnings) == mended
        assert found.checks is not None
        assert all(misfit.shifted != mended for misfit in found.checks.registration)


@pytest.mark.one_python
def test_a_turn_about_the_axis_and_a_lens_that_bends_are_put_right(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three cameras with one lens, each turned by its own angle; the scene knows neither."""
    given = syn.cameras(3, degrees=34.0)
    there = {camera.name: bent(rolled(camera, angle), -0.25, (PIXELS, PIXELS))
             for camera, angle in zip(given, (0.012, -0.009, 0.006), strict=True)}
    rig = [(there[camera.name], [lamp]) for camera in given for lamp in syn.lamps(8)]
    made = syn.shoot(syn.PATCHES, rig, (PIXELS, PIXELS), samples=6)
    known = {camera.name: camera for camera in given}
    views = tuple(replace(view, camera=known[view.camera.name]) for view in made.scene.views)
    wrong = replace(made, scene=replace(made.scene, views=views))
    settings = {"model": "one-lobe", "indirect": "off"}
    as_given = shoots.run(wrong, **settings, registration="given").checks
    assert as_given is not None
    for misfit in as_given.registration:
        angle = {camera.name: angle for camera, angle in zip(given, (0.012, -0.009, 0.006), strict=True)}[misfit.camera]
        assert misfit.rolled and misfit.roll == pytest.approx(angle, abs=1e-3)
        assert misfit.bend == pytest.approx(-0.25, abs=0.03)
    rounds = []
    with monkeypatch.context() as patch:
        patch.setattr(one_round, "solve_grid", lambda *given: rounds.append(given) or solve_grid(*given))
        mended = shoots.run(wrong, **settings, registration="auto")
    assert len(rounds) == 1  # outlines are looked at first: nothing is solved under wrong cameras
    assert mended.checks is not None
    assert {"turned", "distortion"} <= {word for word in ("turned", "distortion") for line in mended.warnings
                                        if word in line and line.endswith("; corrected")}
    assert not any(misfit.rolled or misfit.bend for misfit in mended.checks.registration)
    assert left_over(mended.checks) < left_over(as_given) - np.log(4)


@pytest.mark.one_python
def test_outlines_through_cameras_that_stay_are_drawn_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of hundreds of cameras a few are off; before the first solve, and once more with its maps."""
    given = syn.cameras(3, degrees=34.0)
    sure = replace(given[0], kept=True)
    rig = [(camera, [lamp]) for camera in (sure, *(moved(camera, (0.6, 0.4), (PIXELS, PIXELS)) for camera in given[1:]))
           for lamp in syn.lamps(8)]
    made = syn.shoot(syn.PATCHES, rig, (PIXELS, PIXELS), samples=6)
    known = {camera.name: camera for camera in (sure, *given[1:])}
    views = tuple(replace(view, camera=known[view.camera.name]) for view in made.scene.views)
    shares, drawn = DrawnOutline.shares, Counter[str]()

    def counted(outline: DrawnOutline, camera: Camera, *rest: Any) -> F32:
        drawn[camera.name] += 1
        return shares(outline, camera, *rest)

    monkeypatch.setattr(DrawnOutline, "shares", counted)
    wrong, said = replace(made.scene, views=views), Counter[str]()
    settings = SolveSettings(size=shoots.SIZE, model="one-lobe", lamps="given", exposures="given", normals="mesh",
                             indirect="off")

    def told(step: Progress) -> Progress:
        said[step.message] += 1
        return step

    mended = thread.run(lambda: mapped(pipeline.solve(wrong, settings, made.read_image), told))
    assert mended.checks is not None and max(misfit.pixels for misfit in mended.checks.registration) < NEAR
    assert drawn[sure.name] == 2 and min(drawn[camera.name] for camera in given[1:]) > 2
    assert said["outline 1 of 3"] == 1 and said["outline 3 of 3"] > 1


@pytest.mark.one_python
@pytest.mark.parametrize("seed", [1, 5])
def test_outlines_are_believed_under_lamps_that_are_off(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    """Lamps 3 % of their distance and 5 % of their power off leave more over than cameras that look aside."""
    made = syn.shoot(syn.PATCHES, shoots.rig(), (96, 96), noise=0.005)
    rng = np.random.default_rng(seed)
    off = {light.name: (0.054 * rng.standard_normal(3), np.exp(0.05 * rng.standard_normal()))
           for view in made.scene.views for light in view.lights}

    def wrong(light: Light) -> Light:
        matrix = light.matrix.copy()
        matrix[:3, 3] += off[light.name][0]
        return replace(light, matrix=matrix, power=light.power * off[light.name][1])

    views = tuple(replace(view, camera=moved(view.camera, (0.4, -0.3), (96, 96)),
                          lights=tuple(map(wrong, view.lights))) for view in made.scene.views)
    rounds: list[object] = []
    monkeypatch.setattr(one_round, "solve_grid", lambda *given: rounds.append(given) or solve_grid(*given))
    mended = shoots.run(replace(made, scene=replace(made.scene, views=views)), model="one-lobe", indirect="off",
                        registration="auto", lamps="auto", exposures="auto")
    assert any("pixels off" in line and "corrected" in line for line in mended.warnings)
    assert len(rounds) == 1  # before the first solve


@pytest.mark.parametrize("width", [2 * PIXELS / WIDE, 2 * PIXELS / (WIDE + 1), 3.0])
def test_shares_are_areas(on_gl, width: float) -> None:
    """Of the plane: its sides lie at pixels' centres, between pixels, and anywhere."""
    def draw(device):
        mesh = MeshBuffer(device, syn.plane_mesh())
        try:
            return DrawnOutline(device, mesh, NOTHING, 1.0).shares(above(width), (PIXELS, PIXELS), (3, 2, 60, 50))
        finally:
            mesh.release()

    edges = (np.arange(PIXELS + 1) / PIXELS - 0.5) * width
    inside = np.maximum(np.minimum(edges[1:], 1) - np.maximum(edges[:-1], -1), 0) / np.diff(edges)
    np.testing.assert_allclose(on_gl(draw), np.outer(inside[2:52], inside[3:63]), atol=0.07)  # at corners


def test_an_outline_along_the_pixels_is_no_shift(on_gl) -> None:
    """The plane at any fraction of a pixel: to less than a correction is worth.

    The picture has the areas by formula; by four points, shifts were up to 0.13 pixels off.
    """
    places = [(n / 12, (5 * n % 12) / 12) for n in range(12)]

    def draw(device):
        mesh = MeshBuffer(device, syn.plane_mesh())
        try:
            outline = DrawnOutline(device, mesh, NOTHING, 1.0)
            return [outline.shares(moved(above(), at, (PIXELS, PIXELS)), (PIXELS, PIXELS), (0, 0, PIXELS, PIXELS))
                    for at in places]
        finally:
            mesh.release()

    first = np.arange(PIXELS)
    for at, drawn in zip(places, on_gl(draw), strict=True):
        x, y = (np.clip(np.minimum(first + 1, (PIXELS + WIDE) / 2 + beside)
                        - np.maximum(first, (PIXELS - WIDE) / 2 + beside), 0, 1) for beside in at)
        found = silhouette(drawn, np.outer(y, x).astype(np.float32))
        assert found is not None
        found = found.bent(0.0)
        assert np.abs(found.shift).max() < LEAST_SHIFT
        assert abs(found.values[GROWTH]) * WIDE / 2 < LEAST_SHIFT


def test_what_stands_in_front_is_not_the_objects(on_gl) -> None:
    def draw(device):
        mesh = MeshBuffer(device, syn.plane_mesh())
        try:
            outline = DrawnOutline(device, mesh, syn.box((-2, -2, 1), (0, 2, 2)).astype(np.float32), 1.0)
            return outline.shares(above(), (PIXELS, PIXELS), (0, 0, PIXELS, PIXELS))
        finally:
            mesh.release()

    shares = on_gl(draw)
    assert shares[20:50, :36].max() == 0
    np.testing.assert_allclose(shares[20:50, 36], 0.5)
    assert shares[20:50, 37:60].min() == 1
