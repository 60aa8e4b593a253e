"""Maps that are files: copies of them are what a solve would have written in that format."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.data import Maps
from irpso_addon.core.errors import BadInput
from irpso_addon.core.maps import map_set
from irpso_addon.core.maps.export import file_name, layers, write_maps
from irpso_addon.core.maps.map_set import MapFiles

SIZE = 528  # texels: two rows of blocks, the second not whole


def random_maps(seed: int) -> Maps:
    rng = np.random.default_rng(seed)
    grey = [rng.random((SIZE, SIZE), np.float32) for _ in range(5)]
    return Maps(rng.random((SIZE, SIZE, 3), np.float32), *grey[:3], grey[3] > 0.5, grey[3] > 0.2, grey[4], grey[0],
                specular=grey[1])


def written(folder: Path, maps: Maps, kind: str, udim: int | None) -> dict[str, Path]:
    """As a large solve writes them; paths by layer."""
    names = {layer: file_name("Vase", layer, kind, udim) for layer in layers(maps)}
    for layer, path in zip(layers(maps), write_maps(maps, "Vase", folder / "plain", kind), strict=True):
        path.rename(folder / names[layer])
    return {layer: folder / file_name("Vase", layer if udim is None else f"{layer}.<UDIM>", kind) for layer in names}


@pytest.mark.parametrize(("udims", "source", "kind"), [((1001,), "exr", "png"), ((1001, 1012), "exr", "exr")])
def test_copies_are_what_a_solve_writes(tmp_path: Path, udims: tuple[int, ...], source: str, kind: str) -> None:
    tiled, paths = len(udims) > 1, {}
    for udim in udims:
        paths = written(tmp_path, random_maps(udim), source, udim if tiled else None)
    found = map_set.export(MapFiles(paths, udims), "Vase", tmp_path / "out", kind)
    assert len(found) == len(paths) * len(udims) == len(list((tmp_path / "out").iterdir()))
    for udim in udims:
        for layer, path in written(tmp_path, random_maps(udim), kind, udim if tiled else None).items():
            path = path.with_name(path.name.replace("<UDIM>", str(udim)))
            copy = tmp_path / "out" / path.name
            assert copy in found and copy.read_bytes() == path.read_bytes(), layer


def test_16_bits_come_back_within_their_step(tmp_path: Path) -> None:
    """From PNG to EXR: base colour is linear again."""
    maps = random_maps(0)
    map_set.export(MapFiles(written(tmp_path, maps, "png", None), (1001,)), "Vase", tmp_path / "out", "exr")
    from irpso_addon.core.images.image_file import open_image

    base = open_image(tmp_path / "out" / "Vase_basecolor.exr").read(0, SIZE)[::-1, :, :3]
    np.testing.assert_allclose(base, maps.base_color, atol=2.5e-5)  # sRGB's slope is up to 2.3, times half of 1/65535


def test_maps_that_are_gone_or_not_alike_are_named(tmp_path: Path) -> None:
    files = MapFiles(written(tmp_path, random_maps(0), "exr", None), (1001,))
    files.of("error", 1001).unlink()
    with pytest.raises(BadInput, match=r"Vase_error\.exr"):
        map_set.export(files, "Vase", tmp_path / "out", "png")
    write_maps(random_maps(1), "Vase", tmp_path / "small", "exr")
    (tmp_path / "small" / "Vase_error.exr").write_bytes((tmp_path / "Vase_filled.exr").read_bytes()[:1000])
    (tmp_path / "small" / "Vase_error.exr").rename(tmp_path / "Vase_error.exr")
    with pytest.raises(BadInput, match=r"Vase_error\.exr"):
        map_set.export(files, "Vase", tmp_path / "out", "png")
    assert not (tmp_path / "out").exists()
