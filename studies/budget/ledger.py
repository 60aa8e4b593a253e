"""Where seconds go: each moment belongs to one part of the work and one kind of it, so that they add up to the whole.

A thread that works has a lane: a stack of parts, whose top is charged.  While the command's thread waits for the GL
thread, the GL thread's lane is charged; readers' threads have no lane, because only waiting for them costs time.
"""

from __future__ import annotations

import threading
import time
from collections import defaultdict
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TypeVar

Result = TypeVar("Result")
Entry = tuple[str, str]  # part, kind
NOTHING = "unattributed"
PYTHON, GPU, COMPILE, UPLOAD, READ_BACK = KINDS = ("Python", "GPU", "compile", "upload", "read-back")
STICKY = ("trials of models", "calibration", "normals", "checks")  # all that is done within is theirs


@dataclass
class Lane:
    """What a thread is at."""

    parts: list[str] = field(default_factory=lambda: [NOTHING])
    kinds: list[str] = field(default_factory=lambda: [PYTHON])
    since: float = 0.0


@dataclass
class Shader:
    """Of one shader in one part."""

    seconds: float = 0.0
    pieces: int = 0
    units: float = 0.0  # as of DrawBudget.piece: pixels, or observations and texels


class Ledger:
    """Seconds by part and kind, and bytes."""

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock = clock
        self.seconds: defaultdict[Entry, float] = defaultdict(float)
        self.shaders: defaultdict[tuple[str, str], Shader] = defaultdict(Shader)  # by part and shader's name
        self.bytes: defaultdict[str, int] = defaultdict(int)  # uploaded, read back, and the device's peak
        self.facts: dict[str, Any] = {}  # what else was noticed
        self.work: defaultdict[str, defaultdict[str, float]] = defaultdict(lambda: defaultdict(float))  # of kernels
        self._lanes: dict[int, Lane] = {}
        self._alive: dict[int, int] = {}  # bytes of objects on the device

    # ---- seconds

    @contextmanager
    def lane(self) -> Iterator[None]:
        """The thread's work counts within."""
        number = threading.get_ident()
        self._lanes[number] = Lane(since=self._clock())
        try:
            yield
        finally:
            self._charge(self._lanes[number])
            del self._lanes[number]

    @contextmanager
    def elsewhere(self) -> Iterator[None]:
        """The thread waits within for another one that has a lane; what that one does not use is nobody's."""
        lane = self._lanes.get(threading.get_ident())
        if lane is None:
            yield
            return
        self._charge(lane)
        start, before = self._clock(), sum(self.seconds.values())
        try:
            yield
        finally:
            lane.since = self._clock()
            used = sum(self.seconds.values()) - before
            self.seconds[NOTHING, PYTHON] += lane.since - start - used

    @contextmanager
    def within(self, part: str | None = None, kind: str | None = None) -> Iterator[None]:
        """What is done within belongs to the part, the kind, or both."""
        lane = self._lanes.get(threading.get_ident())
        if lane is None:
            yield
            return
        self._charge(lane)
        stays = part is None or any(at in STICKY for at in lane.parts)
        lane.parts.append(lane.parts[-1] if stays or part is None else part)
        lane.kinds.append(kind or (lane.kinds[-1] if stays else PYTHON))
        try:
            yield
        finally:
            self._charge(lane)
            lane.parts.pop()
            lane.kinds.pop()

    def steps(self, part: str, work: Generator[Any, Any, Result]) -> Generator[Any, Any, Result]:
        """A generator whose own time belongs to the part; what is done between its steps does not."""
        stop: BaseException | None = None
        try:
            while True:
                with self.within(part):
                    try:
                        step = next(work) if stop is None else work.throw(stop)
                    except StopIteration as end:
                        result: Result = end.value
                        return result
                stop = None
                try:
                    yield step
                except GeneratorExit:
                    raise
                except BaseException as asked:
                    stop = asked
        finally:
            work.close()

    @contextmanager
    def piece(self, shader: str, units: float, compiles: bool) -> Iterator[None]:
        """A draw and the wait for it."""
        lane = self._lanes.get(threading.get_ident())
        start = self._clock()
        with self.within(kind=COMPILE if compiles else GPU):
            yield
        if lane is not None and not compiles:
            kept = self.shaders[lane.parts[-1], shader]
            kept.seconds += self._clock() - start
            kept.pieces += 1
            kept.units += units

    def _charge(self, lane: Lane) -> None:
        now = self._clock()
        self.seconds[lane.parts[-1], lane.kinds[-1]] += now - lane.since
        lane.since = now

    # ---- bytes

    def made(self, thing: int, size: int) -> None:
        """A texture or buffer is on the device."""
        self._alive[thing] = size
        self.bytes["device"] = max(self.bytes["device"], sum(self._alive.values()))

    def freed(self, thing: int) -> None:
        """It is no longer there."""
        self._alive.pop(thing, None)

    def record(self) -> dict[str, Any]:
        """All of it, ready for JSON."""
        return {
            "seconds": [[part, kind, seconds] for (part, kind), seconds in sorted(self.seconds.items())],
            "shaders": [[part, name, of.seconds, of.pieces, of.units] for (part, name), of in
                        sorted(self.shaders.items())],
            "bytes": dict(self.bytes), "work": {name: dict(of) for name, of in self.work.items()}, **self.facts}
