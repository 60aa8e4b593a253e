"""Reference images and masks: damaged, lying, odd in what they hold, or in another place than they seem."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random

import numpy as np

from irpso_addon.core.capture.file_preview import preview_image
from irpso_addon.core.data import Camera, RadianceImage, View
from irpso_addon.core.images.reference_image import read_reference
from irpso_addon.core.tiled.reference_cache import CachedReference, cache_reference

from .. import pictures, spoil
from ..case import MEMORY, Box

CAMERA = Camera("Cam", np.eye(4), np.eye(4), np.zeros(3), np.array([0.0, 0, -1]), False, 36 / 24)
ODD = (float("nan"), float("inf"), float("-inf"), -1.0, -1e-9, 1e30, 3.4e38, 65504.0, 1e-45, 0.0)
SPACES = ("sRGB", "ACEScg", "Linear Rec.709", "Non-Color", "nonsense", "", "\U0001f3fa")


def prepare(folder: Path) -> list[tuple[str, bytes]]:
    """Good pictures to begin with."""
    made = folder / "bases"
    made.mkdir()
    found = pictures.bases(made)
    made.rmdir()
    return found


def make(shared: list[tuple[str, bytes]], rng: Random, box: Box) -> Callable[[], None]:
    """A picture, or a picture with a mask, and how it is read."""
    if rng.random() < 0.85:
        suffix, data = rng.choice(shared)
        data = content(data, suffix, rng)
        if rng.random() < 0.04:
            suffix = rng.choice((".exr", ".png", ".tif", ".jpg", ".hdr", ".txt", ".null", ".term", ".mp4", ".3dl", ""))
        name = spoil.file_name(rng, suffix) if rng.random() < 0.1 else f"picture{suffix}"
        path = box.given / name
        path.write_bytes(data)
    else:
        path = box.given / "picture.exr"
        _odd_pixels(path, rng)
    if rng.random() < 0.03:
        path = spoil.odd_place(path, rng)
    box.names = (path.name,)
    image, mask = path, None
    if rng.random() < 0.15:
        image = box.given / "good.png"
        image.write_bytes(next(data for suffix, data in shared if suffix == ".png"))
        mask = path
        box.names = (path.name, image.name)
    box.memory = MEMORY + 3_000_000_000  # what is given back may be large: checked there
    view = View(image=image, camera=CAMERA, lights=(), exposure=rng.choice((0.0, 0.0, 3.5, -64.0, 64.0)), mask=mask,
                colorspace=rng.choice(SPACES) if rng.random() < 0.1 else None, gain=rng.choice((1.0, 1.0, 1e-10, 1e10)))
    return Reading(view, rng.choice((None, 1, 300, 10_000_000)), rng.random() < 0.3, rng.random() < 0.3, box)


def content(data: bytes, suffix: str, rng: Random) -> bytes:
    """A good file's bytes, made bad in one of several ways (or left good)."""
    kind = rng.random()
    if kind < 0.45:
        return spoil.spoilt(data, rng)
    if kind < 0.85:
        data = pictures.lying(data, suffix, rng)
        return spoil.spoilt(data, rng) if rng.random() < 0.2 else data
    if kind < 0.9:
        return data[:rng.randrange(len(data))] + bytes(rng.randrange(5000))
    return rng.choice((data, data, data[:12], b"", data * 3, rng.randbytes(300), b"\0" * 3000))


def _odd_pixels(path: Path, rng: Random) -> None:
    """A good file with pixels that are no radiance."""
    height, width = rng.choice(((24, 36), (24, 36), (24, 36), (2, 3), (1, 1), (10, 10), (240, 360), (20, 3000)))
    pixels = np.random.default_rng(rng.randrange(2**32)).uniform(0, 1, (height, width, rng.choice((1, 3, 3, 4, 7))))
    for _ in range(rng.choice((0, 1, 1, 3))):
        share = rng.choice((1e-3, 0.5, 1.0))
        where = np.random.default_rng(rng.randrange(2**32)).uniform(0, 1, pixels.shape) <= share
        pixels[where] = rng.choice(ODD)
    pictures.write(path, pixels.astype(np.float32), rng.choice(("float", "half")), {})


@dataclass
class Reading:
    """Everything that the product does with a picture; what it gives keeps the contract."""

    view: View
    most: int | None
    looked_at: bool
    cached: bool
    box: Box

    def __call__(self) -> None:
        """Raises BadInput."""
        if self.looked_at:
            preview = preview_image(self.view.image)
            assert len(preview.problem.splitlines()) < 2
            if preview.thumbnail is not None:
                assert max(preview.thumbnail.shape[:2]) <= 64 and np.isfinite(preview.thumbnail).all()
        if self.cached:
            self._developed()
        else:
            _check(read_reference(self.view, self.most), self.most)

    def _developed(self) -> None:
        place = self.box.out / "picture"
        cache_reference(self.view, place)
        picture = CachedReference(place)
        _check(picture.window(-1, -1, min(picture.width, 40), min(picture.height, 40)), None)


def _check(image: RadianceImage, most: int | None) -> None:
    height, width = image.coverage.shape
    assert image.rgb.shape == (height, width, 3) and image.valid.shape == (height, width)
    assert most is None or height * width <= max(most, height, width), "more pixels than were chosen"
    assert np.isfinite(image.rgb).all() and (image.rgb >= 0).all()
    assert np.isfinite(image.coverage).all() and 0 <= image.coverage.min() <= image.coverage.max() <= 1
    assert 0 <= image.clipped_share <= 1 and math.isfinite(image.clipped_share)
