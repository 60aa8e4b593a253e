"""Pictures that other threads read ahead: their order, how many at a time, and what a stop leaves."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.errors import BadInput
from irpso_addon.core.images.image_file import open_image
from irpso_addon.core.images.read_ahead import READERS, ReadAhead
from irpso_addon.core.job import Progress, run_to_end
from tests.support.picture_files import save
from tests.support.random_pictures import noise

pytest.importorskip("OpenImageIO")
STEP = Progress(0.5, "observe")


def test_items_come_in_order_and_few_are_held() -> None:
    begun: list[int] = []
    slow = threading.Event()

    def read(n: int) -> int:
        begun.append(n)
        if n == 0:
            slow.wait(10)  # the first is the last to be done
        return n * n

    with ReadAhead(read, range(9)) as ahead:
        first = ahead.next(STEP)
        assert next(first) is STEP  # it waits
        assert max(begun) <= READERS  # those that are read, and one that is next
        slow.set()
        found = [run_to_end(first, lambda _: None), *(run_to_end(ahead.next(STEP), lambda _: None) for _ in range(8))]
    assert found == [n * n for n in range(9)]


def test_what_a_reader_raises_comes_with_its_item() -> None:
    def read(n: int) -> int:
        if n == 1:
            raise BadInput("b.exr: file not found")
        return n

    with ReadAhead(read, range(3)) as ahead:
        assert run_to_end(ahead.next(STEP), lambda _: None) == 0
        with pytest.raises(BadInput, match=r"b\.exr"):
            run_to_end(ahead.next(STEP), lambda _: None)
        assert run_to_end(ahead.next(STEP), lambda _: None) == 2


def test_who_leaves_does_not_wait_for_the_rest_of_a_picture(tmp_path: Path) -> None:
    """A picture of 40 bands, each of which takes its reader 0.1 s."""
    pixels = np.tile(noise(100, 1000), (200, 1, 1))
    file = open_image(save(tmp_path / "large.exr", pixels, "half", compression="none"))
    bands = []

    def read(_: int) -> None:
        for band in file.bands():
            bands.append(len(band))
            time.sleep(0.1)

    began = time.monotonic()
    with ReadAhead(read, range(4)) as ahead:
        next(ahead.next(STEP))
        while not bands:
            time.sleep(0.01)
    assert time.monotonic() - began < 2.5
    assert sum(bands) < 0.7 * 20_000 * READERS
    assert not any(thread.name.startswith("irpso-pictures") for thread in threading.enumerate())
