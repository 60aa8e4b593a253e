"""Film cameras as lenses, by the similar triangles of a pinhole; pictures found by name and by frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.errors import BadInput
from irpso_addon.core.shoot.scene_cameras import FilmCamera, SceneCamera, SceneFile, lens_of, numbered, project_of

FILM = FilmCamera(50.0, (36.0, 24.0), (1.8, -0.6), np.eye(4))
FILE = SceneFile(Path("shot.usdc"), (SceneCamera(("IMG_0001", "Cam"), FILM),), (0, 0), 24.0, True)


@pytest.mark.parametrize(("film", "size", "pixels"), [
    ((36.0, 24.0), (3600, 2400), 100.0),
    ((36.0, 20.0), (3600, 2400), 100.0),  # film as wide as the picture, whatever its height
    ((24.0, 36.0), (2400, 3600), 100.0),
    ((36.0, 24.0), (2400, 3600), 100.0),  # lying film, upright picture: film along the longer side
])
def test_millimetres_to_pixels(film, size, pixels):
    lens = lens_of(replace(FILM, film=film), *size, "x")
    assert (lens.fx, lens.fy) == pytest.approx((50 * pixels, 50 * pixels))
    # The picture's middle lies 1.8 mm to the right of the axis and 0.6 mm below it.
    assert (size[0] / 2 - lens.cx, lens.cy - size[1] / 2) == pytest.approx((1.8 * pixels, -0.6 * pixels))


def test_names_as_such_files_write_them():
    project = project_of(replace(FILE, cameras=(SceneCamera(("_1st_take", "x"), FILM), FILE.cameras[0])),
                         ["1st-take", "img_0001", "other"], lambda name: (60, 40))
    assert [camera.name for camera in project.cameras] == ["1st-take", "img_0001"]
    assert project.meshes == (Path("shot.usdc"),) and project.metres_per_unit == 1 and project.kind == "USD"
    np.testing.assert_array_equal(project.cameras[0].world_from_camera, np.diag([1.0, -1, -1, 1]))


def test_frames():
    assert numbered(FILE.path, ["a_0001", "b", "c3x", "d010"]) == {1: "a_0001", 10: "d010"}
    with pytest.raises(BadInput, match="both 'a_1' and 'b_01' can be the picture of frame 1"):
        numbered(FILE.path, ["b_01", "a_1"])
    moving = SceneCamera(("Cam",), FILM, {n: FILM for n in (1, 2, 3)})
    file = replace(FILE, cameras=(moving,), frames=(1, 3))
    project = project_of(file, ["f1", "f3", "g"], lambda name: (60, 40))
    assert [camera.name for camera in project.cameras] == ["f1", "f3"]
    for names, words in ((["f1", "f2"], "are from 1 to 2 numbered"), (["f"], "are not numbered")):
        with pytest.raises(BadInput, match=words):
            project_of(file, names, lambda name: (60, 40))


@pytest.mark.parametrize(("change", "words"), [
    ({"perspective": False}, "camera 'IMG_0001': is orthographic"),
    ({"film": (0.0, 24.0)}, "its film is 0 x 24 mm"),
    ({"focal_length": -3.0}, "focal length of -"),
    ({"focal_length": float("nan")}, "focal length of nan"),
    ({"world_from_camera": np.diag([1.0, 2.0, 1.0, 1.0])}, "is scaled by 1, 2, 1"),
    ({"world_from_camera": np.zeros((4, 4))}, "is scaled by 0, 0, 0"),
    ({"world_from_camera": np.full((4, 4), np.nan)}, "scaled by nan"),
    ({"world_from_camera": np.diag([-1.0, 1.0, 1.0, 1.0])}, "is not a rotation"),
])
def test_cameras_that_are_none(change, words):
    file = replace(FILE, cameras=(SceneCamera(("IMG_0001",), replace(FILM, **change)),))
    with pytest.raises(BadInput, match=words):
        project_of(file, ["IMG_0001"], lambda name: (60, 40))


def test_no_cameras_and_no_pictures():
    with pytest.raises(BadInput, match="has no perspective camera"):
        project_of(replace(FILE, cameras=()), ["a"], lambda name: (60, 40))
    with pytest.raises(BadInput, match="no picture has the name of a camera"):
        project_of(FILE, ["a"], lambda name: (60, 40))
