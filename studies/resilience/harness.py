"""Runs that are killed again and again until one comes to its end, and what must hold after each kill."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path

from irpso_addon.core.images.image_file import open_image
from irpso_addon.core.storage.atomic_io import PART
from irpso_addon.core.tiled import npz_archive

from .job import BAD, WORK, Request, make_scene

ROOT = Path(__file__).resolve().parents[2]
OLDER = b"an older result"
SLOW = 120.0  # seconds: no run takes so long


class Torn(AssertionError):
    """Something that must hold does not."""


class Server:
    """The process that runs are forked from, see job.py."""

    def __init__(self, scene: Path) -> None:
        # Threads of a library that was loaded before a fork are not there after it.
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "LP_NUM_THREADS": "0"}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "studies.resilience.job", str(scene)], cwd=ROOT, env=environment, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def start(self, request: Request) -> int:
        """The process id of a new run."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(asdict(request)) + "\n")
        self._process.stdin.flush()
        return self._number()

    def end(self) -> int:
        """Waits for it; its exit status, negative: of a signal."""
        return self._number()

    def _number(self) -> int:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError("the process that starts the runs has ended")
        return int(line)

    def close(self) -> None:
        """End it."""
        self._process.communicate()


@dataclass
class Campaign:
    """Kills in a folder of its own, from one seed."""

    folder: Path
    seed: int
    kills: int = 0
    rounds: int = 0  # from nothing, or from older results, to the end
    refusals: int = 0  # runs that found the disk full and said so
    where: Counter[str] = field(default_factory=Counter)  # how far killed runs had come, by what they left

    def __post_init__(self) -> None:
        self.random = random.Random(self.seed)
        self.folder.mkdir(parents=True, exist_ok=True)
        self.scene = make_scene(self.folder)
        self.server = Server(self.scene)
        out = self.folder / "undisturbed"
        began = time.perf_counter()
        self._expect(self._run(Request(str(out))), 0, out)
        self.seconds = time.perf_counter() - began
        self.events, self.late = json.loads(Path(f"{out}.events").read_text())
        self.whole = {path.name: path.read_bytes() for path in out.iterdir()}
        self._parse(out)
        if len(self.whole) < 8 or any(path.name.startswith(".") for path in out.iterdir()):
            raise Torn(f"an undisturbed run leaves {sorted(self.whole)}")

    def run(self, kills: int) -> None:
        """Rounds until there were so many kills."""
        while self.kills < kills:
            self._round(kills)

    def _round(self, kills: int) -> None:
        """From nothing, or from older results, to maps, killed on the way."""
        out = self.folder / f"out{self.rounds}"
        older = self.rounds % 2 == 1
        if older:
            out.mkdir()
            for name in self.whole:
                (out / name).write_bytes(OLDER)
        blocks: set[str] = set()
        while True:
            status = self._run(self._request(out)) if self.kills < kills else self._run(Request(str(out)))
            if status == 0:
                break
            if status == BAD:
                self._refused(out)
            else:
                self._expect(status, -signal.SIGKILL, out)
                self.kills += 1
            blocks = self._check(out, older, blocks)
            if status == -signal.SIGKILL:
                published = all((out / name).exists() and (out / name).read_bytes() != OLDER for name in self.whole)
                self.where["published" if published else _stage(out, blocks)] += 1
        self.compare(out)
        shutil.rmtree(out)
        self.rounds += 1

    def pairs(self, count: int) -> int:
        """Two runs at once into one folder, some of them killed; how often one was told of the other."""
        told, another = 0, Server(self.scene)
        for n in range(count):
            out = self.folder / f"pair{n}"
            event = self.random.choice((None, self.random.randint(1, self.events)))
            first = self.server.start(Request(str(out), event=event))
            time.sleep(self.random.uniform(0, self.seconds))
            beside = self.folder / f"pair{n}."  # another name of the same folder, so that each says its own
            beside.symlink_to(out)
            second = another.start(Request(str(beside)))
            for pid, status, name in ((second, another.end(), beside), (first, self.server.end(), out)):
                self._alone(pid)
                said = Path(f"{name}.said").read_text()
                if status == BAD and "another irpso" in said:
                    told += 1
                elif status not in (0, -signal.SIGKILL):
                    raise Torn(f"{name}: exit status {status}: {said}")
            self._check(out, False, set())
            self._expect(self._run(Request(str(out))), 0, out)
            self.compare(out)
            shutil.rmtree(out)
        another.close()
        return told

    def full_disks(self, count: int) -> int:
        """Runs on a disk that grows until they fit; how often one found it full.  As root on Linux."""
        found = 0
        for n in range(count):
            disk = self.folder / f"disk{n}"
            disk.mkdir()
            size = self.random.randint(8, 200)  # KiB
            _mount(disk, size)
            try:
                while (status := self._run(Request(str(disk / "out"), limit=1 << 40))) == BAD:
                    found += 1
                    self._refused(disk / "out")
                    self._check(disk / "out", False, set())
                    size = int(size * self.random.uniform(1.2, 3)) + 8
                    _mount(disk, size, "remount,")
                self._expect(status, 0, disk / "out")
                self.compare(disk / "out")
            finally:
                subprocess.run(["umount", str(disk)], check=True)
        return found

    def compare(self, out: Path) -> None:
        """A folder that a run has ended in holds the same files as after an undisturbed one, and nothing else."""
        found = {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()}
        names = sorted(path.name for path in out.iterdir())
        if names != sorted(self.whole):
            raise Torn(f"{out}: holds {names}, want {sorted(self.whole)}")
        if different := [name for name in self.whole if found[name] != self.whole[name]]:
            raise Torn(f"{out}: other bytes than undisturbed: {different}")

    def _request(self, out: Path) -> Request:
        """How the next run is to end: at a moment, at something it does to a file, by a full disk."""
        kind = self.random.choice(("moment", "moment", "moment", "event", "event", "late", "late", "limit"))
        if kind == "limit":
            return Request(str(out), limit=int(10 ** self.random.uniform(1, 6)))
        if kind == "late":
            return Request(str(out), late=self.random.randint(1, self.late))
        early = self.random.random() ** 1.5  # a run that goes on with another's blocks is shorter
        if kind == "event":
            return Request(str(out), event=1 + int(early * self.events))
        return Request(str(out), moment=early * self.seconds)

    def _run(self, request: Request) -> int:
        pid = self.server.start(request)
        status = self.server.end()
        self._alone(pid)
        return status

    def _alone(self, session: int) -> None:
        """What a run has started ends with it."""
        until = time.monotonic() + 10
        while left := [pid for pid in os.listdir("/proc") if pid.isdigit() and _session(pid) == session]:
            if time.monotonic() > until:
                raise Torn(f"processes {left} outlive the run that started them")
            time.sleep(0.02)

    def _refused(self, out: Path) -> None:
        """A run that could not write said so in one line."""
        said = Path(f"{out}.said").read_text().strip()
        if "\n" in said or str(out) not in said:
            raise Torn(f"a full disk is told as: {said}")
        self.refusals += 1

    def _check(self, out: Path, older: bool, before: set[str]) -> set[str]:
        """After a kill: files are as before, absent or whole, and no finished block is lost.  The blocks that are."""
        if not out.exists():
            return before
        for path in out.iterdir():
            if path.is_file() and not path.name.startswith(".irpso-"):
                content = path.read_bytes()
                if content != self.whole.get(path.name) and not (older and content == OLDER):
                    raise Torn(f"{path}: is torn")
            elif path.name != WORK and not path.name.startswith(".irpso-"):
                raise Torn(f"{path}: what is that?")
        work = out / WORK
        blocks = {p.name for p in work.glob("blocks/*") if not p.name.startswith(PART)}
        for path in [*(work / "blocks" / name for name in blocks - before), *work.glob("plan.npz")]:
            npz_archive.load(path)
        merged = len(before) == 4
        if (work / "irpso-work").exists() and not merged and before - blocks:
            raise Torn(f"{work}: blocks {before - blocks} are gone")
        return blocks

    def _parse(self, out: Path) -> None:
        """Files are what they are called: read by the readers of such files."""
        for path in out.iterdir():
            if path.suffix == ".json":
                json.loads(path.read_text())
            else:
                file = open_image(path)
                file.read(0, file.height)

    def _expect(self, status: int, wanted: int, out: Path) -> None:
        if status != wanted:
            raise Torn(f"{out}: exit status {status}, want {wanted}: {Path(f'{out}.said').read_text()}")

    def close(self) -> None:
        """End what was started."""
        self.server.close()


def _mount(disk: Path, size: int, how: str = "") -> None:
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"{how}size={size}k", "irpso", str(disk)], check=True)


def _stage(out: Path, blocks: set[str]) -> str:
    """How far a killed run was."""
    sets = list(out.glob(".irpso-set-*"))
    if any((path / ".irpso-ready").exists() for path in sets):
        return "publishing"
    if any(any(path.iterdir()) for path in sets if path.is_dir()):
        return "merging"
    if blocks:
        return "blocks"
    return "plan" if any((out / WORK).glob("pictures/*")) else "start"


def _session(pid: str) -> int | None:
    try:
        status = Path("/proc", pid, "stat").read_text()
    except OSError:
        return None
    state, _, _, session = status.rpartition(")")[2].split()[:4]
    return None if state == "Z" else int(session)
