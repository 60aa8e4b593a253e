"""A Blender with a window: started on a display of its own, driven from inside, photographed from outside.

Xvfb keeps the screen in a file, so that a screenshot holds whatever a person would see: menus, pop-ups, all windows.
"""

from __future__ import annotations

import json
import os
import shutil
import struct
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
WORK = ROOT / "build" / "gui"  # all of it below the checkout, the one folder that a Blender in a chroot sees too
BOOT = Path(__file__).parent / "inside" / "boot.py"
SIZE = (1280, 800)  # pixels of the screen
LIMIT = 150  # seconds that one Blender may take, on a machine that does something else too


@dataclass(frozen=True)
class Outcome:
    """What a scenario left: what it told, its screenshots and the log.  It ended well: `run` saw to that."""

    told: Mapping[str, Any]
    folder: Path

    @property
    def log(self) -> str:
        """What Blender wrote."""
        return (self.folder / "blender.log").read_text(errors="replace")

    def shot(self, name: str) -> Path:
        """The screenshot that the scenario asked for by this name."""
        return self.folder / f"{name}.png"


class Screen:
    """An Xvfb, whose picture can be read at any time."""

    def __init__(self, folder: Path, size: tuple[int, int] = SIZE) -> None:
        if not shutil.which("Xvfb"):
            raise SystemExit("tests/gui: no Xvfb here: 'apt-get install xvfb', or run tools/gui_setup.sh")
        folder.mkdir(parents=True, exist_ok=True)
        self._file = folder / "Xvfb_screen0"
        ours, theirs = os.pipe()
        self._server = subprocess.Popen(
            ["Xvfb", "-displayfd", str(theirs), "-screen", "0", f"{size[0]}x{size[1]}x24", "-nolisten", "tcp",
             "-ac", "-nocursor", "-fbdir", str(folder)], pass_fds=[theirs], stderr=subprocess.DEVNULL)
        os.close(theirs)
        with os.fdopen(ours) as told:
            number = told.readline().strip()
        if not number:
            raise SystemExit(f"tests/gui: Xvfb did not start (status {self._server.wait()})")
        self.display = f":{number}"

    def close(self) -> None:
        """End the server."""
        self._server.terminate()
        self._server.wait()

    def pixels(self) -> np.ndarray:
        """(height, width, 3) bytes sRGB, row 0 at the top: the file is an X window dump, kept up to date."""
        data = self._file.read_bytes()
        header = struct.unpack(">25I", data[:100])
        size, width, height, line, colours = header[0], header[4], header[5], header[12], header[19]
        body = np.frombuffer(data, np.uint8, line * height, size + 12 * colours).reshape(height, line // 4, 4)
        return body[:, :width, 2::-1]

    def save(self, path: Path) -> None:
        """Write the present picture."""
        from PIL import Image

        Image.fromarray(self.pixels()).save(path)


@contextmanager
def screen(folder: Path, size: tuple[int, int] = SIZE) -> Iterator[Screen]:
    """A Screen that ends with the block."""
    opened = Screen(folder, size)
    try:
        yield opened
    finally:
        opened.close()


@dataclass(frozen=True)
class Blender:
    """One program to run, with the add-on installed in ``user``."""

    program: str
    user: Path  # BLENDER_USER_RESOURCES; copied for each run, so that no run inherits another's
    home: Path  # HOME: the driver's cache of shaders is kept from run to run, as on any user's machine
    plain: bool = False  # whether viewports are drawn as plainly as may be, and not as for a user

    def environment(self, **more: str) -> dict[str, str]:
        """Of every Blender here: nothing of the caller's but its PATH and what chooses the graphics driver."""
        kept = {key: value for key, value in os.environ.items()
                if key in ("PATH", "LP_NUM_THREADS", "XAUTHORITY") or key.startswith(("LIBGL_", "MESA_", "VK_"))}
        self.home.mkdir(parents=True, exist_ok=True)
        return {**kept, "HOME": str(self.home), "LANG": "C.UTF-8", "XDG_RUNTIME_DIR": str(self.home), **more}

    def run(self, scenario: str, folder: Path, *, gpu: str = "opengl", limit: float = LIMIT,
            screen_size: tuple[int, int] = SIZE, clicks: bool = True, **arguments: Any) -> Outcome:
        """Play ``scenario`` ("module:function" below inside/) in a new window; its keyword arguments follow.

        ``clicks``: whether it uses mouse and keys.  A Blender that lets events be simulated does not sleep by itself:
        nothing can be timed in it.

        Raises AssertionError, with the end of the log, when the scenario fails, when Blender crashes or takes longer
        than ``limit`` seconds, or when its exit status is not 0.
        """
        __tracebackhide__ = True
        shutil.rmtree(folder, ignore_errors=True)
        (folder / "wanted").mkdir(parents=True)
        shutil.copytree(self.user, folder / "user", symlinks=True)
        (folder / "scenario.json").write_text(json.dumps(
            {"scenario": scenario, "arguments": arguments, "plain": self.plain}))
        command = [self.program, "--gpu-backend", gpu, *(["--enable-event-simulate"] if clicks else []),
                   "--window-geometry", "0", "0", *map(str, screen_size), "--python-exit-code", "1", "-P", str(BOOT),
                   "--", str(folder)]
        with screen(folder / "screen", screen_size) as display, open(folder / "blender.log", "wb") as log:
            environment = self.environment(
                DISPLAY=display.display, BLENDER_USER_RESOURCES=str(folder / "user"), PYTHONUNBUFFERED="1",
                PYTHONDONTWRITEBYTECODE="1")
            blender = subprocess.Popen(command, cwd=ROOT, env=environment, stdin=subprocess.DEVNULL, stdout=log,
                                       stderr=subprocess.STDOUT)
            status = _attend(blender, display, folder, limit)
        told_file = folder / "told.json"
        told = json.loads(told_file.read_text()) if told_file.exists() else {}
        outcome = Outcome(told, folder)
        wrong = _wrong(status, told, outcome.log, folder / "user")
        if wrong:
            tail = "\n".join(outcome.log.splitlines()[-40:])
            raise AssertionError(f"{scenario}: {wrong}; the end of {folder / 'blender.log'}:\n{tail}")
        return outcome


def _wrong(status: int, told: Mapping[str, Any], log: str, user: Path) -> str:
    """What no Blender may do, whatever the scenario: crash, hang, raise, leave a process behind."""
    if status != 0 or not told.get("finished"):
        return "took too long" if status == -9 else f"exit status {status}"
    if "Traceback" in log or "Error: Not freed" in log:
        return "an error in the log"
    until = time.monotonic() + 3
    while left := _processes_of(user):
        if time.monotonic() > until:
            return f"processes left behind: {left}"
        time.sleep(0.1)
    return ""


def _processes_of(user: Path) -> list[str]:
    """The command lines of processes that Blender started: they have its environment."""
    mark, found = f"BLENDER_USER_RESOURCES={user}".encode(), []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if mark in (process / "environ").read_bytes().split(b"\0"):
                found.append((process / "cmdline").read_bytes().replace(b"\0", b" ").decode()[:200])
        except OSError:  # it has ended, or is another user's
            pass
    return found


def _attend(blender: subprocess.Popen[bytes], display: Screen, folder: Path, limit: float) -> int:
    """Take the screenshots that are asked for until Blender ends; -9 when it took too long."""
    until = time.monotonic() + limit
    while blender.poll() is None:
        for wanted in (folder / "wanted").iterdir():
            display.save(folder / f"{wanted.name}.png")
            wanted.unlink()
        if time.monotonic() > until:
            display.save(folder / "time-limit.png")
            blender.kill()
        time.sleep(0.02)
    return blender.returncode


def installed(program: str) -> Blender:
    """``program`` with the add-on as a user installs it: from the zip.  Raises AssertionError with what was said."""
    blender = Blender(program, WORK / "user", WORK / "home")
    shutil.rmtree(blender.user, ignore_errors=True)
    blender.user.mkdir(parents=True)
    environment = blender.environment(BLENDER_USER_RESOURCES=str(blender.user))

    def command(*arguments: str) -> str:
        done = subprocess.run([program, *arguments], cwd=ROOT, env=environment, capture_output=True, text=True,
                              timeout=LIMIT, stdin=subprocess.DEVNULL)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    told = command("-b", "--factory-startup", "--python-expr", "import sys; print('python', *sys.version_info[:2])")
    version = next(line.split()[1:] for line in told.splitlines() if line.startswith("python "))
    shutil.rmtree(WORK / "zip", ignore_errors=True)
    done = subprocess.run(
        [sys.executable, "tools/build.py", "--python", ".".join(version), "--output-dir", str(WORK / "zip")],
        cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    zipped = next((WORK / "zip").glob("*.zip"))
    command("--command", "extension", "install-file", "-r", "user_default", "--enable", str(zipped))
    return blender
