"""The ways a job ends early that are not bugs."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def printable(text: str) -> str:
    """``text`` in one line.

    Names of files and objects may hold line breaks, letters that turn round what a terminal shows, and halves of
    letters that cannot be written at all.
    """
    return "".join(letter if letter.isprintable() else "?" for letter in text)


class BadInput(Exception):
    """Something the user gave cannot be used.

    The message is one line: which file or object, what is wrong, what to do.  The command line
    prints it and exits with 3; operators report it.
    """

    def __init__(self, message: str) -> None:
        super().__init__(printable(message))


class DeviceError(BadInput):
    """The graphics device cannot do what was asked of it.  The message names it and a way that may still work."""


class NoDevice(DeviceError):
    """There is no OpenGL here, or one that is too old."""


class OutOfDeviceMemory(DeviceError):
    """Textures or buffers do not fit, or the arrays beside them."""


class DeviceLost(DeviceError):
    """The driver was reset or gave the context up: what was on the device is gone.  The next job gets a new one."""


class ShaderRefused(DeviceError):
    """The driver cannot compile or link a shader."""


class Cancelled(Exception):
    """The user stopped the job.  What it answered with travels in ``partial``: a job's value, incomplete."""

    def __init__(self, partial: Any | None = None) -> None:
        super().__init__("cancelled")
        self.partial = partial


class StoppedWithWork(Cancelled):
    """A solve in blocks was stopped once there was a plan: plan and finished ``blocks`` stay in ``folder``."""

    def __init__(self, folder: Path, blocks: int) -> None:
        super().__init__()
        self.folder, self.blocks = folder, blocks

    def __reduce__(self) -> tuple[type[StoppedWithWork], tuple[Path, int]]:
        return type(self), (self.folder, self.blocks)
