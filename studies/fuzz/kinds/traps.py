"""Cases that do everything that a case must not: what the harness is tested with."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from random import Random

import numpy as np

from irpso_addon.core.errors import BadInput

from ..case import Box

WANTED = ("accepted", "refused", "crash", "died", "hang", "stray", "stray from outside Python", "no name", "two lines",
          "memory")


def prepare(_folder: Path) -> None:
    """Nothing is shared."""


def make(_shared: None, _rng: Random, box: Box) -> Callable[[], None]:
    """The one of that number."""
    what = WANTED[box.index]
    box.names, box.memory = ("victim",), 50_000_000
    victim = box.given / "victim"
    victim.write_text("mine")

    def act() -> None:
        (box.out / "fine").write_text("allowed")
        if what == "refused":
            raise BadInput(f"{victim}: is refused; change it")
        if what == "crash":
            raise ValueError("a bug")
        if what == "died":
            os.abort()
        if what == "hang":
            time.sleep(1000)
        if what == "stray":
            (box.root.parent / "escaped").write_text("outside of all that is looked at")
        if what == "stray from outside Python":
            subprocess.run(["sh", "-c", f"echo yours > '{victim}'"], check=True)
        if what == "no name":
            raise BadInput("something: is wrong")
        if what == "two lines":
            error = BadInput("victim")
            error.args = ("victim\nis wrong",)
            raise error
        if what == "memory":
            assert np.ones(10_000_000).sum()

    return act
