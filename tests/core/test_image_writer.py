"""Maps out: exact, the same bytes each time, and whole or not at all."""

from __future__ import annotations

import resource
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.errors import BadInput
from irpso_addon.core.images import image_file
from irpso_addon.core.images.image_writer import write_image
from tests.support.random_pictures import RNG, noise


@pytest.mark.parametrize("channels", [3, 1])
def test_exr_round_trip_is_exact(tmp_path, channels):
    pixels = RNG.normal(size=(20, 30, channels)).astype(np.float32)
    pixels[0, 0] = 1e-30
    write_image(tmp_path / "a.exr", pixels, kind="exr", color=True)
    back = image_file.open_image(tmp_path / "a.exr").read(0, 20)[::-1]
    assert back[..., :channels].tobytes() == pixels.tobytes()


@pytest.mark.parametrize("kind", ["png", "tiff"])
@pytest.mark.parametrize("color", [True, False])
def test_sixteen_bits_round_trip(tmp_path, kind, color):
    pixels = RNG.uniform(-0.2, 1.2, (20, 30, 3)).astype(np.float32)
    path = tmp_path / f"a.{kind}"
    write_image(path, pixels, kind=kind, color=color)
    file = image_file.open_image(path)
    assert file.bits == 16 and file.integer
    stored = file.read(0, 20)[::-1]
    x = pixels.clip(0, 1).astype(np.float64)
    want = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055) if color else x
    np.testing.assert_allclose(stored, want, atol=0.51 / 65535)


@pytest.mark.parametrize("kind", ["exr", "png", "tiff"])
def test_same_pixels_same_bytes(tmp_path, kind):
    pixels = noise()
    write_image(tmp_path / f"a.{kind}", pixels, kind=kind, color=True)
    first = (tmp_path / f"a.{kind}").read_bytes()
    time.sleep(1.1)  # time stamps count seconds
    write_image(tmp_path / f"a.{kind}", pixels, kind=kind, color=True)
    assert (tmp_path / f"a.{kind}").read_bytes() == first
    assert [p.name for p in tmp_path.iterdir()] == [f"a.{kind}"]


def test_unwritable_places(tmp_path):
    for path in (tmp_path / "none" / "a.exr", Path("/dev/null/a.exr"), Path("/proc/a.exr")):
        with pytest.raises(BadInput, match=r"a\.exr: cannot be written"):
            write_image(path, noise(), kind="exr", color=False)


@pytest.mark.parametrize("kind", ["exr", "png", "tiff"])
def test_full_disk_leaves_the_old_file(tmp_path, kind):
    """A limit on file size stands for the full disk: the write fails half-way just so."""
    path = tmp_path / f"a.{kind}"
    path.write_bytes(b"old")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, before[1]))
    try:
        with pytest.raises(BadInput, match="cannot be written") as caught:
            write_image(path, noise(200, 300), kind=kind, color=True)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert str(caught.value) == f"{path}: cannot be written (the disk may be full); check the folder and the free space"
    assert path.read_bytes() == b"old" and len(list(tmp_path.iterdir())) == 1
