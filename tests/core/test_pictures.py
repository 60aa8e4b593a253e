"""Developed references by windows: the same values as read at once."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.errors import BadInput
from irpso_addon.core.images import oiio_reader
from irpso_addon.core.images.reference_image import read_reference
from irpso_addon.core.tiled.reference_cache import CachedReference, cache_reference
from tests.support.picture_files import save, view
from tests.support.random_pictures import noise

pytest.importorskip("OpenImageIO")
ROOT = Path(__file__).parents[2]


@pytest.fixture
def sample(tmp_path, monkeypatch):
    """A picture with alpha, a mask of another size and clipped pixels, in several bands: (view, developed file)."""
    monkeypatch.setattr(oiio_reader, "BAND", 1000)
    pixels = noise(90, 120, 4)
    pixels[20:30, 50:60, 1] = 65504
    path = save(tmp_path / "a.exr", pixels, "half")
    mask = save(tmp_path / "m.png", (noise(45, 60, 1) * 255).astype(np.uint8), "uint8", "Y")
    shown = view(path, 120 / 90, mask=mask, exposure=0.5, colorspace="ACEScg")
    cache_reference(shown, tmp_path / "a.picture")
    return shown, tmp_path / "a.picture"


def assert_same(a, b):
    for field in dataclasses.fields(a):
        np.testing.assert_array_equal(getattr(a, field.name), getattr(b, field.name), err_msg=field.name)


def test_the_whole_is_bit_for_bit_what_is_read_at_once(sample):
    shown, path = sample
    whole, picture = read_reference(shown), CachedReference(path)
    assert_same(picture.window(0, 0, picture.width, picture.height), whole)
    assert picture.warnings == whole.warnings and picture.clipped_share == whole.clipped_share > 0
    assert not whole.valid.all() and (0 < whole.coverage).any() and (whole.coverage < 1).any()
    assert sorted(os.listdir(path.parent)) == ["a.exr", "a.picture", "m.png"]


def test_windows_lie_where_they_belong(sample):
    shown, path = sample
    whole, picture = read_reference(shown), CachedReference(path)
    part = picture.window(45, 50, 20, 15)
    np.testing.assert_array_equal(part.rgb, whole.rgb[50:65, 45:65])
    np.testing.assert_array_equal(part.coverage, whole.coverage[50:65, 45:65])
    np.testing.assert_array_equal(part.valid, whole.valid[50:65, 45:65])


def test_outside_the_picture_nothing_is_covered(sample):
    shown, path = sample
    whole, picture = read_reference(shown), CachedReference(path)
    part = picture.window(-7, -3, 140, 100)
    np.testing.assert_array_equal(part.rgb[3:93, 7:127], whole.rgb)
    outside = np.ones((100, 140), bool)
    outside[3:93, 7:127] = False
    assert not part.valid[outside].any() and not part.coverage[outside].any() and not part.rgb[outside].any()
    far = picture.window(500, 10, 8, 8)
    assert not far.valid.any() and not far.coverage.any()


def test_a_reduced_window_holds_means_by_coverage(sample):
    shown, path = sample
    whole, picture = read_reference(shown), CachedReference(path)
    small = picture.window(6, 9, 96, 60, shrink=3)
    cells = (slice(9, 69), slice(6, 102))
    weight = whole.coverage[cells].astype(np.float64).reshape(20, 3, 32, 3)
    rgb = whole.rgb[cells].astype(np.float64).reshape(20, 3, 32, 3, 3)
    valid = whole.valid[cells].reshape(20, 3, 32, 3).all((1, 3))
    np.testing.assert_array_equal(small.valid, valid)
    np.testing.assert_allclose(small.coverage, weight.mean((1, 3)), rtol=1e-6)
    expected = (rgb * weight[..., None]).sum((1, 3)) / weight.sum((1, 3))[..., None]
    np.testing.assert_allclose(small.rgb[valid], expected[valid], rtol=1e-6)
    with pytest.raises(ValueError, match="reduced by 7"):
        picture.window(0, 0, 96, 60, shrink=7)


def test_what_is_wrong_with_the_reference_is_said_and_leaves_nothing(tmp_path):
    clipped = view(save(tmp_path / "a.png", np.full((20, 30, 3), 255, np.uint8), "uint8"))
    with pytest.raises(BadInput, match=r"a\.png: every pixel is clipped"):
        (tmp_path / "out").mkdir()
        cache_reference(clipped, tmp_path / "out" / "a")
    assert not list((tmp_path / "out").iterdir())
    with pytest.raises(BadInput, match="cannot be written"):
        cache_reference(view(save(tmp_path / "b.exr", noise())), tmp_path / "nowhere" / "b.picture")


@pytest.mark.parametrize("spoil", [
    lambda b: b[:-1], lambda b: b + b"\0", lambda b: b"", lambda b: b[:10], lambda b: b.replace(b"120", b"-12"),
    lambda b: b"x" * 200_000, lambda b: b.replace(b'"width"', b'"wIdth"'), lambda b: b.replace(b"{", b"[", 1),
])
def test_a_file_that_is_not_whole_is_refused(sample, spoil):
    path = sample[1]
    path.write_bytes(spoil(path.read_bytes()))
    with pytest.raises(BadInput, match="not a developed picture") as caught:
        CachedReference(path)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


@pytest.mark.skipif(os.name == "nt", reason="no pipes in folders")
def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(BadInput, match="pipe: is not a file"):
        CachedReference(tmp_path / "pipe")


MEASURE = """
import sys
from pathlib import Path
from irpso_addon.core.images import picture_survey, reference_image
from irpso_addon.core.tiled import reference_cache as pictures
from tests.support.picture_files import view
path, out = map(Path, sys.argv[1:3])
assert picture_survey.KEEP  # of the module that reads it
picture_survey.KEEP = 0  # as if the picture were too large
reference_image.read_reference(view(path, 1.5), 600_000)
pictures.cache_reference(view(path, 1.5), out)
picture = pictures.CachedReference(out)
for x in range(0, picture.width - 512, 512):
    picture.window(x, 100, 512, 512)
picture.window(0, 0, picture.width, picture.height, shrink=20)
print(next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM")))
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_memory_does_not_grow_with_the_picture(tmp_path):
    """6 megapixels, 96 MB as they are developed: peak of a whole Python, of which 90 MB are its libraries."""
    path = save(tmp_path / "a.exr", np.full((2000, 3000, 3), 0.5, np.float16), "half", compression="none")
    told = subprocess.run([sys.executable, "-c", MEASURE, path, tmp_path / "out"], cwd=ROOT, check=True,
                          capture_output=True, text=True)
    print(told.stdout)
    assert int(told.stdout) / 1000 < 170
