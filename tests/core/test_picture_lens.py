"""Turned and cropped pictures: a place of the world falls on the same spot of the picture, however it is read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from irpso_addon.core.errors import BadInput
from irpso_addon.core.lens import Lens
from irpso_addon.core.shoot.picture_lens import picture_camera, read_as_stored
from irpso_addon.core.shoot.project import ProjectCamera

LENS = Lens(600, 400, 700.0, 690.0, 310.0, 190.0, (-0.2, 0.1, -0.05, 0.01), (2e-3, -3e-3), skew=4.0)
POINTS = np.random.default_rng(3).uniform((-1, -0.7, 3), (1, 0.7, 6), (40, 3))
# CIPA DC-008, 4.6.4: the upright picture's pixel (u, v) of stored (u, v), width, height
SHOWN = {1: lambda u, v, w, h: (u, v), 3: lambda u, v, w, h: (w - u, h - v), 6: lambda u, v, w, h: (h - v, u),
         8: lambda u, v, w, h: (v, w - u)}


@dataclass
class Picture:
    """What of an ImageFile is asked for."""

    width: int
    height: int
    orientation: int = 1
    path: Path = Path("IMG_1.jpg")


def project_camera(lens: Lens = LENS, seed: int = 0) -> ProjectCamera:
    pose = np.eye(4)
    rotation = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    pose[:3, :3], pose[:3, 3] = rotation * np.sign(np.linalg.det(rotation)), (0.3, -2.0, 1.0)
    return ProjectCamera("IMG_1.jpg", lens, pose)


def shown(camera, points: np.ndarray) -> np.ndarray:
    """(N, 2) pixels of the picture that the camera's lens is for; ``points`` of the world."""
    local = (points - camera.world_from_camera[:3, 3]) @ camera.world_from_camera[:3, :3]
    return camera.lens.project(local)


@pytest.mark.parametrize("orientation", SHOWN)
@given(fx=st.floats(300, 900), skew=st.floats(-30, 30), fisheye=st.booleans(), seed=st.integers(0, 99))
@settings(max_examples=20, deadline=None)
def test_turned_pictures_show_the_same(orientation, fx, skew, fisheye, seed):
    lens = Lens(600, 400, fx, 690.0, 310.0, 190.0, LENS.radial, LENS.tangential, skew, fisheye)
    camera = project_camera(lens, seed)
    world = POINTS @ camera.world_from_camera[:3, :3].T + camera.world_from_camera[:3, 3]
    size = (400, 600) if orientation >= 5 else (600, 400)
    found = picture_camera(camera, Picture(*size, orientation), as_stored=True)
    assert (found.lens.width, found.lens.height) == size and found.turned == (orientation != 1)
    np.testing.assert_allclose(np.linalg.det(found.world_from_camera), 1, atol=1e-12)
    want = np.stack(SHOWN[orientation](*shown(camera, world).T, 600, 400), -1)
    np.testing.assert_allclose(shown(found, world), want, atol=1e-9)


@pytest.mark.parametrize(("size", "orientation", "want"), [
    ((600, 400), 1, None), ((300, 200), 1, None), ((301, 200), 1, None), ((600, 400), 3, None),
    ((400, 600), 6, True), ((400, 600), 8, True),  # a landscape lens, and a picture that is shown upright
    ((600, 400), 6, False),  # stored upright, shown landscape, as the lens is
])
def test_what_a_pictures_shape_tells(size, orientation, want):
    assert read_as_stored(project_camera(), Picture(*size, orientation)) is want


@pytest.mark.parametrize(("size", "orientation"), [((400, 600), 1), ((500, 400), 1), ((400, 600), 5), ((500, 400), 6)])
def test_another_shape(size, orientation):
    with pytest.raises(BadInput, match=r"^IMG_1\.jpg: is \d00 x \d00 pixels, but the project's camera 'IMG_1\.jpg' is"):
        read_as_stored(project_camera(), Picture(*size, orientation))


def test_the_body_turns_with_the_camera():
    """A flash above the body of a camera whose right side is up is left of the upright picture."""
    above = np.array([0.0, -1.0])  # right and down
    for as_stored in (False, True):
        lens = LENS if as_stored else Lens(400, 600, 700.0, 700.0, 200.0, 300.0)
        turn = picture_camera(project_camera(lens), Picture(400, 600, 8), as_stored).upright_from_body
        np.testing.assert_allclose(turn @ above, (-1, 0), atol=0.01)  # as far as the skew turns it
        turn = picture_camera(project_camera(lens), Picture(400, 600, 6), as_stored).upright_from_body
        np.testing.assert_allclose(turn @ above, (1, 0), atol=0.01)


@pytest.mark.parametrize(("size", "want"), [
    ((300, 200), (600, 400)), ((303, 202), (606, 404)), ((202, 134), (606, 402)), ((150, 100), (600, 400)),
    ((330, 220), (600, 400)),  # scaled, not cropped: too much border
])
def test_raw_files_that_hold_more(size, want):
    """Binned 2 x 2 or 3 x 3; the project's pixels are samples of the middle."""
    found = picture_camera(project_camera(), Picture(*size, path=Path("IMG_1.CR2")), as_stored=False)
    assert (found.lens.width, found.lens.height) == want and found.cropped == (want != (600, 400))
    offset = (np.array(want) - (600, 400)) / 2
    points = POINTS @ project_camera().world_from_camera[:3, :3].T + project_camera().world_from_camera[:3, 3]
    np.testing.assert_allclose(shown(found, points), shown(project_camera(), points) + offset, atol=1e-9)
