"""A mesh from a file as an asset of studies.everything."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.errors import BadInput
from studies.everything import ALL, cases
from studies.intervals.assets import truth
from studies.mesh_asset import asset_of
from tests.support.picture_files import save

pytest.importorskip("bpy")

BOARD = """\
v 0 0 0
v 2 0 0
v 2 1 0
v 0 1 0
{uvs}f {faces}
"""
UVS = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"


def board(folder: Path, uvs: str = UVS) -> Path:
    file = folder / "board.obj"
    file.write_text(BOARD.format(uvs=uvs, faces="1/1 2/2 3/3 4/4" if uvs else "1 2 3 4"), encoding="utf-8")
    return file


def test_a_mesh_keeps_its_shape_and_its_uvs(tmp_path: Path) -> None:
    part, = asset_of(board(tmp_path), None, 32).sheets
    assert part.quads.shape == (2, 3)
    corners = part.vertices[part.quads]
    np.testing.assert_allclose(part.uvs * (2, 1), corners[..., :2], atol=1e-6)  # Y up, as the file has it
    np.testing.assert_allclose(corners[..., 2], 0, atol=1e-6)


def test_an_image_is_the_base_colour_with_its_first_row_at_the_top(tmp_path: Path) -> None:
    picture = np.full((8, 8, 4), 0.25, np.float32)
    picture[:4, :, 0] = 0.75
    base, _ = truth(asset_of(board(tmp_path), save(tmp_path / "paint.exr", picture), 32))
    np.testing.assert_allclose(base[:16], 0.25, atol=1e-6)
    np.testing.assert_allclose(base[16:], np.broadcast_to((0.75, 0.25, 0.25), (16, 32, 3)), atol=1e-6)


def test_each_error_is_made_right_in_turn() -> None:
    wrong = [errors for _, errors, _ in cases(True)]
    assert wrong[:3] == [(), ALL, ALL]
    assert [set(ALL) - set(errors) for errors in wrong[3:]] == [{error} for error in ALL]


def test_meshes_that_say_too_little_are_named(tmp_path: Path) -> None:
    file = board(tmp_path, uvs="")
    with pytest.raises(BadInput, match=r"board\.obj: has no UV map; unwrap"):
        asset_of(file, None, 32)
    with pytest.raises(BadInput, match=r"lost\.obj: is no file"):
        asset_of(tmp_path / "lost.obj", None, 32)
    other = tmp_path / "board.blend"
    other.write_bytes(b"")
    with pytest.raises(BadInput, match=r"board\.blend: is of no format"):
        asset_of(other, None, 32)
    with pytest.raises(BadInput, match=r"lost\.png: cannot be read"):
        asset_of(board(tmp_path), tmp_path / "lost.png", 32)
