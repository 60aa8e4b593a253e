"""Files find their cameras and lights by name; else by order, and only where the counts leave no doubt."""

from __future__ import annotations

from itertools import product
from pathlib import PurePath

import pytest
from hypothesis import given
from hypothesis import strategies as st

from irpso_addon.core.capture.matching import match, natural, words


def files(*names: str) -> list[PurePath]:
    return [PurePath(name) for name in names]


def matched(names, cameras, lights, flashes=None):
    return {str(m.file): (m.camera, m.lights) for m in match(files(*names), cameras, lights, flashes)}


def test_accents_as_a_mac_writes_them():
    (found,) = match([PurePath("Su\u0308d 1/x.tif")], ["S\u00fcd 1", "Nord 1"], [])
    assert found.camera == "S\u00fcd 1" and not found.camera_by_order


@pytest.mark.parametrize(("file", "camera", "lights"), [
    ("Camera 0, Light 1.exr", "Camera 0", ("Light 1",)),
    ("camera_0-light01.png", "Camera 0", ("Light 1",)),
    ("CAMERA.000 light.1 light.2.tif", "Camera 0", ("Light 1", "Light 2")),
    ("Camera 0/shot 7 Light 2.exr", "Camera 0", ("Light 2",)),  # the folder speaks too
    ("camera.exr", "Camera", ()),  # and not "Camera 0"
    ("Camera 0 Light.exr", "Camera 0", ("Light",)),
    ("Camera 10 Light 12.exr", "Camera 10", ("Light 12",)),  # not "Camera 1", "Light 1"
    ("Key Light 2.exr", None, ("Key Light 2",)),  # whose words are not "Light 2" as well
    ("Camera 0 Camera 10.exr", None, ()),  # two say nothing
    ("camera0b.exr", "Camera 0", ()),
    ("photo.exr", None, ()),
])
def test_names_in_the_path(file, camera, lights) -> None:
    cameras = ["Camera", "Camera 0", "Camera 1", "Camera 10"]
    lamps = ["Light", "Light 1", "Light 2", "Light 12", "Key Light 2"]
    assert matched([file], cameras, lamps)[file] == (camera, lights)


def test_order_where_the_counts_fit() -> None:
    cameras, lights = ["Cam 10", "Cam 2"], ["L 1", "L 2", "L 3"]
    assert matched([f"view {i}.exr" for i in (10, 9)], cameras, lights) == {
        "view 9.exr": ("Cam 2", ()), "view 10.exr": ("Cam 10", ())}
    six = matched([f"{i}.exr" for i in range(6)], cameras, lights)
    assert list(six.values()) == [(c, (light,)) for c, light in product(["Cam 2", "Cam 10"], lights)]
    # Five files fit nothing; a light by name keeps the others from being guessed; one camera takes all.
    assert set(matched([f"{i}.exr" for i in range(5)], cameras, lights).values()) == {(None, ())}
    assert matched(["a.exr", "b L 3.exr", "c.exr"], ["Cam"], lights) == {
        "a.exr": ("Cam", ()), "b L 3.exr": ("Cam", ("L 3",)), "c.exr": ("Cam", ())}
    assert match(files("a.exr"), [], lights)[0].camera is None


def test_a_flash_belongs_to_its_camera() -> None:
    flashes = {"Cam 1": ["Flash 1"], "Cam 2": ["Flash 2", "Ring"]}
    lights = ["Flash 1", "Flash 2", "Ring", "Sun"]
    found = matched(["Cam 1.exr", "Cam 2.exr", "Cam 2 Sun.exr"], ["Cam 1", "Cam 2"], lights, flashes)
    assert found == {"Cam 1.exr": ("Cam 1", ("Flash 1",)), "Cam 2.exr": ("Cam 2", ("Flash 2", "Ring")),
                     "Cam 2 Sun.exr": ("Cam 2", ("Sun",))}


def test_masks_stand_beside_their_pictures() -> None:
    found = match(files("b 1.exr", "B_01_mask.png", "a mask.png"), [], [])
    assert {str(m.file): m.mask and str(m.mask) for m in found} == {"a mask.png": None, "b 1.exr": "B_01_mask.png"}


@given(st.lists(st.integers(0, 40), min_size=1, max_size=6, unique=True),
       st.lists(st.integers(0, 40), min_size=1, max_size=6, unique=True), st.sampled_from(["_", " ", "-", ", "]))
def test_any_numbering_is_found_again(cams, lamps, between) -> None:
    """Names as Blender gives them, files as people write them: each finds its own, whatever the others are called."""
    cameras, lights = [f"Camera.{i:03d}" for i in cams], [f"Light.{i:03d}" for i in lamps]
    named = {f"cam{between}camera {c}{between}light{d}.exr": (f"Camera.{c:03d}", (f"Light.{d:03d}",))
             for c, d in product(cams, lamps)}
    assert matched(list(named), cameras, lights) == named


def test_numbers_sort_as_numbers() -> None:
    assert sorted(files("v10.exr", "v9.exr", "V1.exr"), key=natural) == files("V1.exr", "v9.exr", "v10.exr")
    assert words("Ärger-Kamera.007") == ("ärger", "kamera", "7")
