"""Output that appears whole or not at all: written aside inside the folder, renamed at the end."""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import shutil
from pathlib import Path
from types import TracebackType

from ..errors import BadInput
from .atomic_io import FolderLock, flush, flush_folder, remove_leftovers

SET = ".irpso-set-"  # begins the name of a folder with a set of files, and of files that lie beside it
READY = ".irpso-ready"  # in that folder: the set is whole and on the disk, and is being moved to its place
_NAME = re.compile(rf"({re.escape(SET)}[a-z0-9_]{{8}})(.*)", re.DOTALL)


class OutputTransaction:
    """A temporary folder inside ``out``; `publish` moves what was written there to its names in ``out``.

    Entering makes ``out``, proves that it can be written, and keeps other runs out of it, so a long job fails before
    it starts.  What a killed run has left is put in order: a set that was being published is published to its end,
    another is removed.  Leaving without `publish` removes everything that was made, also the folders.  Raises BadInput.
    """

    def __init__(self, out: Path) -> None:
        self.out = Path(out)
        self._lock = FolderLock(self.out)
        self._made: list[Path] = []
        self._published = False
        self._unfinished = False  # publishing stopped half-way: what is left of the set is to be kept

    def __enter__(self) -> OutputTransaction:
        missing = self.out
        while not os.path.exists(missing) and missing != missing.parent:
            self._made.append(missing)
            missing = missing.parent
        try:
            self.out.mkdir(parents=True, exist_ok=True)
            self._lock.__enter__()
        except OSError as error:
            self._remove_folders()
            raise self._unwritable(error) from None
        try:
            if self._lock.real:
                remove_leftovers(self.out)
                self._finish_others()
            self.folder = self._new_folder()
        except BaseException as error:
            self._lock.__exit__(None, None, None)
            self._remove_folders()
            if isinstance(error, OSError):
                raise self._unwritable(error) from None
            raise
        return self

    def beside(self, name: str) -> Path:
        """Where to write a file that is to become ``out/name`` and must not lie deeper than that.

        A .blend keeps paths relative to its own folder, which a move out of a sub-folder would break.
        """
        return self.out / f"{self.folder.name}{name}"

    def publish(self) -> list[Path]:
        """Rename everything to its place (one file system, so no file is ever half there); sorted paths.

        Killed on the way, the rest follows when the folder is next written to.
        """
        pairs = self._pairs(self.folder)
        for path, target in pairs:
            if target.is_dir():
                raise BadInput(f"{target}: is a folder, but a file of that name must be written; move the folder away")
            flush(path)
        (self.folder / READY).touch()
        flush_folder(self.folder)
        flush_folder(self.out)
        self._unfinished = True
        self._move(pairs)
        self._unfinished, self._published = False, True
        return sorted(target for _, target in pairs)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None,
    ) -> None:
        if not self._unfinished:
            self._remove(self.folder)
        self._lock.__exit__(None, None, None)
        if not self._published:
            self._remove_folders()
        if isinstance(error, BadInput):  # the user knows the folder, not the staging place in it
            error.args = (str(error).replace(str(self.folder), str(self.out)),)
        elif isinstance(error, OSError):
            raise self._unwritable(error) from None

    def _new_folder(self) -> Path:
        """Made as any other: one of ``tempfile`` is its owner's alone, and on Windows so stays what is moved out."""
        while True:
            folder = self.out / f"{SET}{secrets.token_hex(4)}"
            with contextlib.suppress(FileExistsError):
                folder.mkdir()
                return folder

    def _pairs(self, folder: Path) -> list[tuple[Path, Path]]:
        """What lies in a set's folder and beside it, and where it belongs; what lies beside comes last."""
        pairs = [(path, self.out / path.name) for path in sorted(folder.iterdir()) if path.name != READY]
        return pairs + [(p, self.out / p.name[len(folder.name):]) for p in sorted(self.out.glob(f"{folder.name}?*"))]

    def _move(self, pairs: list[tuple[Path, Path]]) -> None:
        for path, target in pairs:
            try:
                os.replace(path, target)
            except OSError as error:
                raise BadInput(f"{target}: cannot be written ({error.strerror}); close or move it; irpso writes the "
                               "missing files when it next writes to this folder") from None
        flush_folder(self.out)

    def _finish_others(self) -> None:
        """Put in order what killed runs have left.  Nobody else is in the folder: it is locked."""
        for path in sorted(self.out.iterdir()):
            match = _NAME.fullmatch(path.name)
            if match and not match[2] and path.is_dir() and not path.is_symlink():
                if (path / READY).exists():
                    self._move(self._pairs(path))
                self._remove(path)
        for path in self.out.iterdir():  # beside a folder that is gone already
            if _NAME.fullmatch(path.name) and not path.is_dir():
                path.unlink(missing_ok=True)

    def _remove(self, folder: Path) -> None:
        """A set and all of it; what shows that it is whole goes first."""
        (folder / READY).unlink(missing_ok=True)
        for stray in self.out.glob(f"{folder.name}?*"):
            stray.unlink(missing_ok=True)
        shutil.rmtree(folder, ignore_errors=True)

    def _remove_folders(self) -> None:
        for folder in self._made:
            try:
                folder.rmdir()
            except OSError:  # never made, or in use by someone else by now
                return

    def _unwritable(self, error: OSError) -> BadInput:
        return BadInput(f"{self.out}: cannot write there ({error.strerror}); free space or choose another folder")
