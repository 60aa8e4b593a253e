"""Files that appear whole or not at all, and locks that end with their process, however it ends."""

from __future__ import annotations

import contextlib
import os
import platform
import re
import secrets
import stat
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType

from ..errors import BadInput

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

PART = ".irpso-part-"  # begins the names of files that are being written
LOCK = ".irpso-lock"
# The one byte that is locked, beyond the end of any file of ours: on Windows, and on a share of it wherever that is
# mounted, nobody else can read or write what is locked.
_FAR = 1 << 40


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """An empty file beside ``path`` to write to; it takes ``path``'s place, through to the disk, when the block ends.

    An error in the block removes it and leaves ``path`` as it was.  What a killed process leaves is known by its lock,
    see `remove_leftovers`.  Raises OSError.
    """
    part, handle = _fresh(path)
    try:
        try:
            yield part
            flush(part)
            if sys.platform == "win32":  # renames no file that is open
                os.close(handle)
                handle = -1
            os.replace(part, path)
        finally:
            if handle >= 0:
                os.close(handle)
    except BaseException:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise
    flush_folder(path.parent)


def write_whole(path: Path, content: bytes) -> None:
    """The file ``path`` with this content, whole or as before; what killed runs left beside it goes.

    Raises OSError.
    """
    remove_leftovers(path.parent)
    with replacing(path) as part:
        part.write_bytes(content)


def flush(path: Path) -> None:
    """A file's bytes are on the disk when this returns."""
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def flush_folder(folder: Path) -> None:
    """So are the names in a folder, on systems that can say so."""
    if sys.platform != "win32":
        with contextlib.suppress(OSError):  # network file systems may refuse; the files themselves are whole
            handle = os.open(folder, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)


def remove_leftovers(folder: Path) -> None:
    """Remove half-written files of processes that are dead; those of living ones are locked and stay."""
    for part in folder.glob(f"{PART}*"):
        with contextlib.suppress(OSError):  # gone, or not ours to remove
            if not stat.S_ISREG(part.lstat().st_mode):
                continue
            handle = os.open(part, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0))
            try:
                dead = sys.platform == "win32" or _take(handle) is True
                if dead and sys.platform != "win32":
                    part.unlink()
            finally:
                os.close(handle)
            if sys.platform == "win32":  # refuses where it is open elsewhere
                part.unlink()


def _fresh(path: Path) -> tuple[Path, int]:
    """A new file beside ``path`` with its ending, and the locked handle that tells that its writer is alive."""
    while True:
        part = path.with_name(f"{PART}{secrets.token_hex(4)}-{path.name}")
        handle = os.open(part, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        if sys.platform == "win32":
            return part, handle
        _take(handle, wait=True)
        if os.fstat(handle).st_nlink:  # else it was taken for a leftover before it was locked
            return part, handle
        os.close(handle)


def _take(handle: int, wait: bool = False) -> bool | None:
    """Lock an open file for this handle alone; False: another has it; None: this file system has no locks."""
    try:
        if sys.platform == "win32":
            os.lseek(handle, _FAR, os.SEEK_SET)
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        elif sys.platform == "linux":
            # A lock of the open file, on one byte.  fcntl.lockf takes one of the process, which ends as soon as the
            # process closes the file anywhere; fcntl.flock takes the whole file, and on SMB shares that keeps out the
            # writer's own second handle.  Python has no third call, so C's struct flock is packed here; no process.
            lock = struct.pack("hhqqi4x", fcntl.F_WRLCK, os.SEEK_SET, _FAR, 1, 0)
            fcntl.fcntl(handle, fcntl.F_OFD_SETLKW if wait else fcntl.F_OFD_SETLK, lock)
        else:  # Python names no locks of an open file's bytes here
            fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return None
    return True


class FolderLock:
    """Keeps others out of a folder while it is entered.  The folder must exist.

    Where the file system knows no locks (``real`` is False then), nobody is kept out.  Raises BadInput saying who is
    in there, and OSError where nothing can be written.
    """

    real = False

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        self.path = self.folder / LOCK
        self._handle = -1

    def __enter__(self) -> FolderLock:
        while True:
            # A link would have somebody's file overwritten, a pipe would wait.
            safely = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
            handle = os.open(self.path, os.O_RDWR | os.O_CREAT | safely, 0o666)
            try:
                taken = _take(handle)
                if taken is False:
                    who = _holder(handle)
                    raise BadInput(f"{self.folder}: another irpso{who} is working there; wait, or choose another "
                                   "folder")
                if self._is(handle):
                    os.ftruncate(handle, 0)
                    os.lseek(handle, 0, os.SEEK_SET)
                    os.write(handle, f"process {os.getpid()} on {platform.node()}\n".encode())
                    self._handle, self.real, handle = handle, bool(taken), -1
                    return self
            finally:
                if handle >= 0:
                    os.close(handle)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None,
    ) -> None:
        if sys.platform == "win32":  # removes no file that is open
            os.close(self._handle)
        with contextlib.suppress(OSError):
            self.path.unlink(missing_ok=True)
        if sys.platform != "win32":
            os.close(self._handle)
        self._handle = -1

    def _is(self, handle: int) -> bool:
        """Whether the locked file is still the one of that name: its last holder may have removed it meanwhile."""
        try:
            return os.path.samestat(os.fstat(handle), self.path.stat())
        except FileNotFoundError:
            return False


def _holder(handle: int) -> str:
    """Whom a lock's file names, in brackets; nothing where it cannot be read."""
    try:
        os.lseek(handle, 0, os.SEEK_SET)
        text = os.read(handle, 300).decode(errors="replace")
    except OSError:
        return ""
    holder = re.match(r"process \d+ on [\w.-]+", text)
    return f" ({holder[0]})" if holder else ""
