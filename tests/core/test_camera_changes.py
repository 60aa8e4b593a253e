"""What a solve has changed of cameras: its record leads from the given cameras to the same pictures again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.check_records import Misfit
from irpso_addon.core.checks.camera_changes import camera_changes, with_cameras
from irpso_addon.core.checks.camera_lines import camera_rows, sure_cameras
from irpso_addon.core.checks.mended_cameras import corrected, given_name, name_alone, near
from irpso_addon.core.data import Camera, SceneData, View
from irpso_addon.core.lens import Lens
from irpso_addon.core.projection import pixels_of
from tests.support.synthetic import camera, plane_mesh

SIZE = 300, 200
PLACES = np.array([(0.3, 0.2, 0.1), (-0.4, 0.1, 0.0), (0.1, -0.5, 0.3), (0.0, 0.0, 0.0)])


def given(kind: str) -> Camera:
    found = camera((0.4, -3.0, 1.5), width=1.8 if kind == "orthographic" else None)
    projection = found.projection.copy()
    projection[0] *= SIZE[1] / SIZE[0]
    found = replace(found, projection=projection, aspect=SIZE[0] / SIZE[1])
    if kind != "lens":
        return found
    lens = Lens(600, 400, 800.0, 810.0, 307.0, 196.0, (-0.1, 0.02, 0.0, 0.0), (0.001, -0.002))
    return replace(found, lens=lens, projection=lens.matrix)


def scene(seen_by: Camera, views: int = 1) -> SceneData:
    return SceneData("s", plane_mesh(), np.zeros((0, 3, 3), np.float32), tuple(
        View(Path(f"{n}.exr"), seen_by, ()) for n in range(views)))


def misfit(seen_by: Camera, n: int = 0, **found: object) -> Misfit:
    return replace(Misfit(Path(f"{n}.exr"), seen_by.name, SIZE, (0.8, -0.5), 0.01, 1.0, 0.001, False,
                          growth_error=1e-4, roll_error=2e-4, bend_error=1e-3), **found)


@pytest.mark.parametrize("kind", ["perspective", "orthographic", "lens"])
@pytest.mark.parametrize("wrong", [
    {}, {"growth": 0.01, "centre": (20.0, -12.0)}, {"roll": -0.01}, {"bend": -0.05},
    {"growth": -0.004, "roll": 0.02, "bend": 0.03, "centre": (-31.0, 8.0)},
])
def test_the_record_gives_the_corrected_cameras(kind: str, wrong: dict[str, object]) -> None:
    """After two rounds, to a thousandth of a pixel, in pictures of any size."""
    if kind == "orthographic":
        wrong = {name: value for name, value in wrong.items() if name != "bend"}
    before = scene(given(kind))
    after = before
    for _ in range(2):
        after = corrected(after, [misfit(after.views[0].camera, **wrong)], shifts=True, gains=False)
    change, = camera_changes(before, after, [misfit(after.views[0].camera)])
    again = with_cameras(before, [change]).views[0].camera
    assert again.name == change.camera and change.image is None and change.sure
    for size in (SIZE, (1200, 800)):
        wanted = pixels_of(after.views[0].camera, PLACES, size)
        assert np.abs(wanted - pixels_of(before.views[0].camera, PLACES, size)).max() > 1
        np.testing.assert_allclose(pixels_of(again, PLACES, size), wanted, atol=1e-3)
    assert change.roll == pytest.approx(2 * float(wrong.get("roll", 0)), abs=1e-9)  # type: ignore[arg-type]
    assert (change.roll == 0) == ("roll" not in wrong)
    assert change.k1 == pytest.approx(2 * float(wrong.get("bend", 0)), abs=1e-9)  # type: ignore[arg-type]
    assert change.focal == pytest.approx((1 + float(wrong.get("growth", 0))) ** 2)  # type: ignore[arg-type]


def test_a_view_that_departs_is_told_alone() -> None:
    seen_by = given("perspective")
    before = scene(seen_by, 3)
    found = [misfit(seen_by, n, alone=n == 1, shift=(0.0, 0.0) if n != 1 else (3.0, 0.0)) for n in range(3)]
    after = corrected(before, found, shifts=True, gains=False)
    change, = camera_changes(before, after, [misfit(view.camera, n) for n, view in enumerate(after.views)])
    assert change.image == Path("1.exr") and change.camera == seen_by.name
    assert change.pixels == pytest.approx(3, abs=1e-9) and change.shift == pytest.approx((3 / SIZE[0], 0))
    again = with_cameras(before, [change])
    assert [view.camera.name for view in again.views] == [
        seen_by.name, name_alone(before.views[1]), seen_by.name]
    np.testing.assert_allclose(again.views[1].camera.projection, after.views[1].camera.projection, atol=1e-12)


def test_cameras_of_single_views_have_names_of_their_own() -> None:
    """One folder for each lamp may hold the same names of files."""
    seen_by = given("perspective")
    views = [View(Path(folder) / "1.exr", seen_by, ()) for folder in ("lamp 1", "lamp 2")]
    names = [name_alone(view) for view in views]
    assert len({*names, seen_by.name}) == 3
    for view, name in zip(views, names, strict=True):
        assert given_name(view) == given_name(replace(view, camera=replace(seen_by, name=name))) == seen_by.name


def test_what_is_kept_or_was_not_changed_is_not_told() -> None:
    seen_by = given("perspective")
    before = scene(replace(seen_by, kept=True))
    after = corrected(before, [misfit(seen_by)], shifts=True, gains=False)
    assert after is before and not camera_changes(before, after, [misfit(seen_by)])


def test_kept_cameras_stay_beside_others() -> None:
    first, second = replace(given("perspective"), kept=True), replace(given("perspective"), name="Second")
    before = replace(scene(first), views=(View(Path("0.exr"), first, ()), View(Path("1.exr"), second, ())))
    after = corrected(before, [misfit(first), misfit(second, 1)], shifts=True, gains=False)
    assert after.views[0].camera is first and after.views[1].camera is not second
    assert near(before, [misfit(first)], gains=False) and not near(before, [misfit(second, 1)], gains=False)


def test_rows() -> None:
    before = scene(given("perspective"))
    wrong = misfit(before.views[0].camera, growth=0.003, roll=0.0017, bend=-0.1)
    after = corrected(before, [wrong], shifts=True, gains=False)
    change, = camera_changes(before, after, [wrong])
    assert camera_rows(replace(change, pixels=1.234)) == [
        (change.camera, "1.23 ± 0.03 px"), ("Focal Length", "+0.30 % ± 0.03 %"), ("Roll", "+0.10 ± 0.03°"),
        ("Lens k1", "-0.100 ± 0.003")]
    unsure = replace(change, sure=False)
    assert sure_cameras([unsure, change, replace(change, pixels=99.0)])[0].pixels == 99
    assert unsure not in sure_cameras([unsure])
