"""Reference images from files that OpenImageIO itself writes here."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.errors import BadInput
from irpso_addon.core.images import oiio_reader
from irpso_addon.core.images.reference_image import read_reference, reduce
from tests.support.picture_files import error_of, save, view
from tests.support.random_pictures import RNG, noise

oiio = pytest.importorskip("OpenImageIO")


# --- formats


@pytest.mark.parametrize(("suffix", "form", "tolerance"), [
    ("exr", "float", 0), ("exr", "half", 5e-4), ("tif", "float", 0), ("hdr", "float", 1e-2),
])
def test_float_files_are_linear(tmp_path, suffix, form, tolerance):
    pixels = noise()
    found = read_reference(view(save(tmp_path / f"a.{suffix}", pixels, form)))
    if tolerance:
        np.testing.assert_allclose(found.rgb, pixels[::-1], atol=tolerance)
    else:
        np.testing.assert_array_equal(found.rgb, pixels[::-1])
    assert found.rgb.dtype == np.float32 and found.valid.all() and (found.coverage == 1).all() and not found.warnings


@pytest.mark.parametrize("suffix", ["png", "tif"])
@pytest.mark.parametrize(("form", "top"), [("uint16", 65535), ("uint8", 255)])
def test_integer_files_are_srgb(tmp_path, suffix, form, top):
    stored = RNG.integers(0, top, (20, 30, 3)).astype(form)
    found = read_reference(view(save(tmp_path / f"a.{suffix}", stored, form)))
    v = stored[::-1] / top
    np.testing.assert_allclose(found.rgb, np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4), rtol=2e-5)
    assert len(found.warnings) == (top == 255 or suffix == "tif")
    assert all(("8 bits" if top == 255 else "without a colour space") in text for text in found.warnings)


def test_colour_space_of_the_view_wins(tmp_path):
    pixels = noise()
    path = save(tmp_path / "a.exr", pixels)
    wide = read_reference(view(path, colorspace="Linear Rec.2020")).rgb
    to_709 = np.array([[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]])
    np.testing.assert_allclose(wide, pixels[::-1] @ to_709.T, atol=3e-4)  # less than 0 where Rec.709 is too small
    stored = (pixels * 65535).astype(np.uint16)
    raw = read_reference(view(save(tmp_path / "a.png", stored, "uint16"), colorspace="Non-Color")).rgb
    np.testing.assert_allclose(raw, stored[::-1] / 65535, rtol=1e-6)
    assert "AgX Log" in error_of(view(path, colorspace="AgX Log"))


def test_colour_space_of_the_file(tmp_path):
    pixels = noise()
    named = read_reference(view(save(tmp_path / "a.exr", pixels, colorInteropID="lin_ap1_scene")))
    told = read_reference(view(save(tmp_path / "b.exr", pixels), colorspace="ACEScg"))
    np.testing.assert_array_equal(named.rgb, told.rgb)
    odd = read_reference(view(save(tmp_path / "c.exr", pixels, colorInteropID="moon")))
    assert "moon" in odd.warnings[0]


def test_grey_is_repeated(tmp_path):
    pixels = noise(c=1)
    found = read_reference(view(save(tmp_path / "a.exr", pixels, names="Y")))
    np.testing.assert_array_equal(found.rgb, np.repeat(pixels[::-1], 3, -1))


def test_exposure_and_gain(tmp_path):
    pixels = noise()
    found = read_reference(view(save(tmp_path / "a.exr", pixels), exposure=1.5, gain=0.8))
    np.testing.assert_allclose(found.rgb, pixels[::-1] / (2**1.5 * 0.8), rtol=1e-6)


# --- alpha and mask


def test_alpha_is_divided_out(tmp_path):
    true, alpha = noise(), RNG.choice([0, 0.25, 0.7, 1], (20, 30, 1)).astype(np.float32)
    found = read_reference(view(save(tmp_path / "a.exr", np.concatenate([true * alpha, alpha], -1))))
    np.testing.assert_array_equal(found.coverage, alpha[::-1, :, 0])
    seen = found.coverage > 0
    np.testing.assert_allclose(found.rgb[seen], true[::-1][seen], rtol=1e-6)
    assert (found.rgb[~seen] == 0).all()


def test_straight_alpha_of_png_is_left_alone(tmp_path):
    stored = RNG.integers(1, 65535, (20, 30, 4)).astype(np.uint16)
    path = save(tmp_path / "a.png", stored, "uint16", oiio__UnassociatedAlpha=1)
    found = read_reference(view(path, colorspace="Non-Color"))
    np.testing.assert_allclose(found.rgb, stored[::-1, :, :3] / 65535, rtol=1e-6)
    np.testing.assert_allclose(found.coverage, stored[::-1, :, 3] / 65535, rtol=1e-6)


def test_mask_times_alpha_of_any_size(tmp_path):
    pixels = noise(40, 60, 4)
    pixels[..., 3] = 0.5
    same = RNG.uniform(0, 1, (40, 60, 1)).astype(np.float32)
    path = save(tmp_path / "a.exr", pixels)
    found = read_reference(view(path, mask=save(tmp_path / "m.exr", same, names="Y")))
    np.testing.assert_allclose(found.coverage, 0.5 * same[::-1, :, 0], rtol=1e-6)
    halves = np.zeros((10, 15, 1), np.uint8)
    halves[:5] = 255  # the upper half, 8 bits, a quarter of the size
    found = read_reference(view(path, mask=save(tmp_path / "m.png", halves, "uint8", "Y")))
    assert found.coverage[:16].max() == 0 and found.coverage[24:] == pytest.approx(0.5)
    assert "mask" in error_of(view(path, mask=save(tmp_path / "n.png", halves[:7], "uint8", "Y")))
    assert "image not found" in error_of(view(path, mask=tmp_path / "none.png"))


# --- layers


def parts(path: Path, *layers: tuple[str, tuple[str, ...], np.ndarray]) -> Path:
    """A multi-part EXR."""
    specs = []
    for name, channels, pixels in layers:
        spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], "float")
        spec.channelnames = channels
        spec.attribute("oiio:subimagename", name)
        specs.append(spec)
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), tuple(specs)), file.geterror()
    for i, (_, _, pixels) in enumerate(layers):
        assert not i or file.open(str(path), specs[i], "AppendSubimage"), file.geterror()
        assert file.write_image(np.ascontiguousarray(pixels)), file.geterror()
    file.close()
    return path


def test_combined_is_picked_from_parts(tmp_path):
    true, other = noise(), noise()
    alpha = np.full((20, 30, 1), 0.5, np.float32)
    path = parts(
        tmp_path / "a.exr", ("ViewLayer.Depth", ("ViewLayer.Depth.Z",), noise(c=1)),
        ("ViewLayer.DiffCol", tuple(f"ViewLayer.DiffCol.{c}" for c in "RGB"), other),
        ("ViewLayer.Combined", tuple(f"ViewLayer.Combined.{c}" for c in "ABGR"),
         np.concatenate([alpha, (true * 0.5)[..., ::-1]], -1)),
    )
    found = read_reference(view(path))
    np.testing.assert_allclose(found.rgb, true[::-1], rtol=1e-6)
    assert (found.coverage == 0.5).all() and not found.warnings


def test_combined_is_picked_from_layers_of_one_part(tmp_path):
    true, other = noise(), noise()
    names = [f"ViewLayer.{p}.{c}" for p in ("AO", "Combined") for c in "RGB"]
    path = save(tmp_path / "a.exr", np.concatenate([other, true], -1), channelnames=tuple(names))
    np.testing.assert_array_equal(read_reference(view(path)).rgb, true[::-1])


def test_two_view_layers_are_named(tmp_path):
    names = [f"{layer}.Combined.{c}" for layer in ("Front", "Back") for c in "RGB"]
    found = read_reference(view(save(tmp_path / "a.exr", noise(c=6), channelnames=tuple(names))))
    assert "several pictures" in found.warnings[0]


def test_no_picture_inside(tmp_path):
    names = tuple(f"V.{p}" for p in ("Depth.Z", "Normal.X", "Normal.Y", "Normal.Z"))
    assert "V.Normal" in error_of(view(save(tmp_path / "a.exr", noise(c=4), channelnames=names)))


def test_cropped_exr_lies_where_it_belongs(tmp_path):
    inside = noise(6, 9)
    path = save(tmp_path / "a.exr", inside, x=4, y=5, full_x=0, full_y=0, full_width=30, full_height=20)
    found = read_reference(view(path))
    np.testing.assert_array_equal(found.rgb[::-1][5:11, 4:13], inside)
    assert found.rgb.shape == (20, 30, 3) and found.rgb.sum() == pytest.approx(inside.sum(), rel=1e-5)


def test_overscan_is_cut_off(tmp_path):
    wide = noise(24, 36)
    path = save(tmp_path / "a.exr", wide, x=-3, y=-2, full_x=0, full_y=0, full_width=30, full_height=20)
    np.testing.assert_array_equal(read_reference(view(path)).rgb[::-1], wide[2:22, 3:33])


def test_tiled_files(tmp_path):
    pixels = noise(40, 60)
    path = save(tmp_path / "a.exr", pixels, tile_width=16, tile_height=16)
    np.testing.assert_array_equal(read_reference(view(path)).rgb, pixels[::-1])


def test_rows_of_tall_tiles_are_refused(tmp_path, monkeypatch):
    """Each is small, but all of a row are read at once."""
    path = save(tmp_path / "a.exr", noise(40, 60), tile_width=16, tile_height=32)
    monkeypatch.setattr(oiio_reader, "MAX_TILE", 60 * 32)
    assert oiio_reader.header(path)["width"] == 60
    monkeypatch.setattr(oiio_reader, "MAX_TILE", 60 * 32 - 1)
    with pytest.raises(BadInput, match=r"tiles of 16 x 32 pixels; save it in rows or small tiles"):
        oiio_reader.header(path)


# --- reduction


def test_reduction_by_a_whole_factor(tmp_path):
    pixels = noise(40, 60)
    found = read_reference(view(save(tmp_path / "a.exr", pixels)), max_pixels=150)
    np.testing.assert_allclose(found.rgb, pixels[::-1].reshape(10, 4, 15, 4, 3).mean((1, 3)), rtol=1e-5)


def test_reduction_keeps_every_pixel_in_its_place(tmp_path):
    """A linear ramp stays the same ramp over the frame, whatever the sizes."""
    h, w = 37, 53
    x, y = (np.arange(w) + 0.5) / w, (np.arange(h) + 0.5) / h
    pixels = np.stack(np.broadcast_arrays(x, y[:, None], 0.5), -1).astype(np.float32)
    found = read_reference(view(save(tmp_path / "a.exr", pixels), aspect=w / h), max_pixels=400)
    n, m = found.rgb.shape[:2]
    assert n * m <= 400
    # A pixel's square has one value, so an edge through it is off by at most 1/8 of the pixel: no drift, though.
    for got, centres in ((found.rgb[0, :, 0], np.arange(m) + 0.5), (found.rgb[::-1, 0, 1], np.arange(n) + 0.5)):
        error = got - centres / len(centres)
        assert abs(error).max() < 1 / 8 / min(w, h) and abs(np.polyfit(centres, error, 1)).max() < 5e-4


def test_reduction_weighs_by_coverage_and_drops_blocks_with_bad_pixels(tmp_path):
    pixels = noise(8, 12, 4)
    pixels[..., 3] = RNG.uniform(0.1, 1, (8, 12))
    true = pixels[..., :3].copy()
    pixels[..., :3] *= pixels[..., 3:]
    found = read_reference(view(save(tmp_path / "a.exr", pixels)), max_pixels=24)
    blocks = (true * pixels[..., 3:])[:2, :2].sum((0, 1)) / pixels[:2, :2, 3].sum()
    np.testing.assert_allclose(found.rgb[-1, 0], blocks, rtol=1e-5)
    stored = RNG.integers(0, 65535, (8, 12, 3)).astype(np.uint16)
    stored[0, 0] = 65535
    found = read_reference(view(save(tmp_path / "a.png", stored, "uint16")), max_pixels=24)
    assert not found.valid[-1, 0] and found.valid.sum() == 23


@pytest.mark.parametrize("covered", [True, False])
def test_reduction_is_by_area_and_holds_no_copy_in_double_precision(covered):
    """Beside sums over overlaps of pixels and cells in float64; 4 bytes a value and the mean's weights are enough."""
    h, w, rows, columns = 120, 600, np.linspace(0, 120, 20), np.linspace(0, 600, 92)
    rgb, valid = noise(h, w), RNG.random((h, w)) > 0.003
    cover = np.ones((h, w), np.float32) if covered else RNG.random((h, w)).astype(np.float32)
    tracemalloc.start()
    found = reduce((rgb, cover, valid), rows, columns)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 40 * h * w
    down, across = (np.clip(np.minimum(edges[1:, None], np.arange(n) + 1) - np.maximum(edges[:-1, None], np.arange(n)),
                            0, None) for edges, n in ((rows, h), (columns, w)))
    weight = np.einsum("ih,jw,hw->ij", down, across, cover)
    expected = np.einsum("ih,jw,hwc,hw->ijc", down, across, rgb, cover, optimize=True) / weight[..., None]
    whole = np.einsum("ih,jw,hw->ij", down, across, ~valid) == 0
    np.testing.assert_array_equal(found[2], whole)
    np.testing.assert_allclose(found[0], expected, rtol=2e-6)  # of those that are not valid, too
    np.testing.assert_allclose(found[1], weight / np.outer(np.diff(rows), np.diff(columns)), rtol=2e-6)


@pytest.mark.parametrize("tiles", [{}, {"tile_width": 16, "tile_height": 16}])
def test_strips_change_nothing(tmp_path, monkeypatch, tiles):
    pixels = noise(41, 60, 4)
    path = save(tmp_path / "a.exr", pixels, x=2, y=3, full_width=60, full_height=50, **tiles)
    whole = [read_reference(view(path, aspect=1.2), max_pixels=n) for n in (None, 500)]
    monkeypatch.setattr(oiio_reader, "BAND", 300)
    strips = [read_reference(view(path, aspect=1.2), max_pixels=n) for n in (None, 500)]
    for a, b in zip(whole, strips, strict=True):
        np.testing.assert_allclose(a.rgb, b.rgb, rtol=1e-5)
        np.testing.assert_array_equal(a.valid, b.valid)
