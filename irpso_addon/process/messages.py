"""What goes over the pipe between Blender and a worker process: a record for each message."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..core.job import Progress
from ..core.live_maps import Live
from ..core.params import DeviceSettings

# ---- orders, to the worker


@dataclass(frozen=True)
class Configure:
    """How the device is used by the jobs that follow."""

    settings: DeviceSettings


@dataclass(frozen=True)
class Run:
    """Start a job: ``task`` is "module:function" below this package."""

    number: int  # of the job, in all that is said of it
    task: str
    arguments: tuple[Any, ...]


@dataclass(frozen=True)
class Feed:
    """Something for the mailbox of a running job."""

    number: int
    content: Any


@dataclass(frozen=True)
class Pause:
    """Hold the running job, or let it go on."""

    on: bool


@dataclass(frozen=True)
class Cancel:
    """Stop the running job at its next step."""


Order = Configure | Run | Feed | Pause | Cancel

# ---- answers, from the worker


@dataclass(frozen=True)
class Reached:
    """How far a job is."""

    number: int
    progress: Progress  # without a look


@dataclass(frozen=True)
class Looked:
    """What a job has found so far."""

    number: int
    live: Live


@dataclass(frozen=True)
class Done:
    """A job's value; nothing follows."""

    number: int
    value: Any


@dataclass(frozen=True)
class Failed:
    """What a job raised; nothing follows."""

    number: int
    error: BaseException


@dataclass(frozen=True)
class Logged:
    """A record of the worker's log, at any time."""

    level: str
    event: str
    fields: dict[str, Any]


Answer = Reached | Looked | Done | Failed
