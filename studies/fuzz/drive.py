"""Runs cases in processes that may fall or stand still; keeps what came of each, so that a stopped run goes on."""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import IO, Any

from .case import Outcome

ROOT = Path(__file__).resolve().parents[2]
HANG = 10.0  # seconds
START = 180.0  # seconds in which a process has to be ready
CHUNK = 100  # cases asked for at a time


class Results:
    """What came of the cases of each kind, in files that grow."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self._files: dict[str, IO[str]] = {}

    def of(self, kind: str) -> dict[int, Outcome]:
        """By index; a line that a killed run left half written is passed over."""
        found = {}
        with contextlib.suppress(FileNotFoundError), self._path(kind).open(encoding="utf-8") as file:
            for line in file:
                with contextlib.suppress(ValueError):
                    outcome = Outcome(**json.loads(line))
                    found[outcome.index] = outcome
        return found

    def add(self, kind: str, outcome: Outcome) -> None:
        """Keeps one."""
        if kind not in self._files:
            self._files[kind] = self._path(kind).open("a", encoding="utf-8")
            with self._path(kind).open("rb") as file:
                whole = not file.seek(0, os.SEEK_END) or (file.seek(-1, os.SEEK_END), file.read())[1] == b"\n"
            if not whole:  # a killed run was writing a line
                self._files[kind].write("\n")
        if not outcome.bad:
            outcome.message = outcome.message[:200]
        print(json.dumps(asdict(outcome)), file=self._files[kind], flush=outcome.bad)

    def forget_bad(self, kind: str) -> None:
        """Those that somebody had to look at are to run again."""
        known = self.of(kind)
        self._path(kind).unlink(missing_ok=True)
        for outcome in known.values():
            if not outcome.bad and outcome.verdict != "blender":
                self.add(kind, outcome)
        self.close()

    def close(self) -> None:
        """Everything is in the files then."""
        for file in self._files.values():
            file.close()
        self._files.clear()

    def _path(self, kind: str) -> Path:
        return self.folder / f"{kind}.jsonl"


@dataclass
class _Process:
    """A worker, and what it was asked."""

    kind: str
    folder: Path
    running: subprocess.Popen[bytes]
    waiting: deque[int] = field(default_factory=deque)  # asked and not answered
    heard: float = 0.0  # when it last said something
    ready: bool = False
    note: str = ""
    buffer: bytes = b""


class Driver:
    """``jobs`` processes at a time; ``log`` takes what they say on stderr; ``hang``: seconds that a case may take."""

    def __init__(self, results: Results, seed: int, jobs: int, log: Path, hang: float = HANG) -> None:
        self.results, self.seed, self.jobs, self.log, self.hang = results, seed, jobs, log, hang
        memory = Path("/dev/shm")  # cases wait for every file to be on the disk
        self.base = Path(tempfile.mkdtemp(prefix="irpso-fuzz-", dir=memory if memory.is_dir() else None))
        self.selector = selectors.DefaultSelector()
        self.processes: list[_Process] = []
        self.queues: dict[str, deque[int]] = {}
        self.again: set[tuple[str, int]] = set()  # stood still once, perhaps because the machine is busy

    def run(self, wanted: dict[str, Iterable[int]]) -> None:
        """Every case in ``wanted`` that has no outcome yet."""
        for kind, indices in wanted.items():
            known = self.results.of(kind)
            self.queues[kind] = deque(i for i in indices if i not in known)
        try:
            while any(self.queues.values()) or self.processes:
                while len(self.processes) < self.jobs and (kind := self._next()) is not None:
                    self._start(kind)
                for key, _ in self.selector.select(timeout=0.5):
                    self._hear(key.data)
                for process in list(self.processes):
                    limit = self.hang if process.ready else START
                    if time.monotonic() - process.heard > limit:
                        self._still(process)
        finally:
            for process in list(self.processes):
                self._end(process)
            self.results.close()
            shutil.rmtree(self.base, ignore_errors=True)

    def _next(self) -> str | None:
        """The kind that has most to do for each process that does it."""
        def load(kind: str) -> float:
            return len(self.queues[kind]) / (1 + sum(p.kind == kind for p in self.processes))

        kind = max(self.queues, key=load)
        return kind if self.queues[kind] else None

    def _start(self, kind: str) -> None:
        folder = Path(tempfile.mkdtemp(prefix=f"{kind}-", dir=self.base))
        (folder / "home").mkdir()
        environment = {
            **os.environ, "HOME": str(folder / "home"), "TMPDIR": str(folder), "PYTHONDONTWRITEBYTECODE": "1",
            "LP_NUM_THREADS": "0", "OMP_NUM_THREADS": "1", "OPENIMAGEIO_THREADS": "1"}
        with self.log.open("ab") as log:
            running = subprocess.Popen(
                [sys.executable, "-X", "faulthandler", "-m", "studies.fuzz.worker", kind, str(self.seed), str(folder)],
                cwd=ROOT, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log,
                start_new_session=True)
        process = _Process(kind, folder, running, heard=time.monotonic())
        self.processes.append(process)
        assert running.stdout is not None
        os.set_blocking(running.stdout.fileno(), False)
        self.selector.register(running.stdout, selectors.EVENT_READ, process)
        self._ask(process)

    def _ask(self, process: _Process) -> None:
        """The next cases that follow each other."""
        queue = self.queues[process.kind]
        if not queue:
            return
        first = queue.popleft()
        process.waiting.append(first)
        while queue and queue[0] == process.waiting[-1] + 1 and len(process.waiting) < CHUNK:
            process.waiting.append(queue.popleft())
        assert process.running.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            process.running.stdin.write(f"{first} {process.waiting[-1] + 1}\n".encode())
            process.running.stdin.flush()

    def _hear(self, process: _Process) -> None:
        assert process.running.stdout is not None
        data = process.running.stdout.read()
        if not data:
            self._fell(process)
            return
        process.heard = time.monotonic()
        *lines, process.buffer = (process.buffer + data).split(b"\n")
        for line in lines:
            said: dict[str, Any] = json.loads(line)
            if "ready" in said:
                process.ready = True
            elif "note" in said:
                process.note = said["note"]
            else:
                process.waiting.popleft()
                process.note = ""
                self.results.add(process.kind, Outcome(**said))
        if not process.waiting:
            if self.queues[process.kind]:
                self._ask(process)
            else:
                self._end(process)

    def _fell(self, process: _Process) -> None:
        """It is gone: because of the case that it was at."""
        code = process.running.wait()
        why = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        if not process.ready:
            self._end(process)
            raise RuntimeError(f"fuzz: a process for {process.kind} does not start ({why}); see {self.log}")
        if process.waiting:
            index = process.waiting.popleft()
            verdict = "blender" if process.note == "blender" else "crash"
            self.results.add(process.kind, Outcome(index, verdict, f"the process ended: {why}"))
        self._end(process)

    def _still(self, process: _Process) -> None:
        """It says nothing: twice, and the case counts as one that stands still."""
        if not process.ready:
            self._end(process)
            raise RuntimeError(f"fuzz: a process for {process.kind} does not start in {START:.0f} s; see {self.log}")
        index = process.waiting[0]
        if (process.kind, index) in self.again or process.note == "blender":
            process.waiting.popleft()
            verdict = "blender" if process.note == "blender" else "hang"
            self.results.add(process.kind, Outcome(index, verdict, f"nothing in {self.hang:.0f} s", seconds=self.hang))
        else:
            self.again.add((process.kind, index))
        self._end(process)

    def _end(self, process: _Process) -> None:
        """Puts back what it has not done."""
        self.queues[process.kind].extendleft(reversed(process.waiting))
        process.waiting.clear()
        self.processes.remove(process)
        assert process.running.stdout is not None and process.running.stdin is not None
        self.selector.unregister(process.running.stdout)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.running.pid, signal.SIGKILL)  # its own children too
        process.running.wait()
        process.running.stdout.close()
        with contextlib.suppress(BrokenPipeError):
            process.running.stdin.close()
        shutil.rmtree(process.folder, ignore_errors=True)
