"""Our maps are known, whatever is done with their folder; pictures by the same names are not taken for them."""

from __future__ import annotations

import numpy as np
import OpenImageIO
import pytest

from irpso_addon.core.data import Maps
from irpso_addon.core.images.image_writer import write_image
from irpso_addon.core.maps import export, own_files, targets


def make_maps() -> Maps:
    flat, colour = np.full((8, 8), 0.5, np.float32), np.full((8, 8, 3), 0.5, np.float32)
    return Maps(colour, flat, flat, flat, flat > 1, flat > 0, flat, flat, specular=flat)


@pytest.mark.parametrize("kind", export.KINDS)
def test_exported_maps_are_known(tmp_path, kind) -> None:
    paths = export.write_maps(make_maps(), "Vase of a.b", tmp_path, kind)
    assert len(paths) > 6 and all(own_files.is_own(path) for path in paths)
    moved = paths[0].rename(tmp_path / f"Shot 1{paths[0].suffix}")
    assert not own_files.is_own(moved)  # its name is a picture's; nothing is opened


def test_names_of_all_targets_are_looked_at(tmp_path) -> None:
    for target in targets.TARGETS.values():
        for file in target.files:
            path = tmp_path / f"{file.name.format('Vase')}.1001.png"
            write_image(path, np.full((2, 2, 3), 0.5, np.float32), kind="png8", color=False)
            assert own_files.is_own(path), path


def test_a_picture_by_that_name_is_a_picture(tmp_path) -> None:
    path = tmp_path / "Vase_roughness.exr"
    file = OpenImageIO.ImageOutput.create(str(path))
    file.open(str(path), OpenImageIO.ImageSpec(2, 2, 3, "float"))
    file.write_image(np.ones((2, 2, 3), np.float32))
    file.close()
    assert not own_files.is_own(path)
    (tmp_path / "Vase_error.png").write_bytes(b"no image")
    assert not own_files.is_own(tmp_path / "Vase_error.png")
