"""The folder of a large solve: its plan, its pictures and its finished blocks, for whoever goes on with them.

    irpso-work     what the folder was begun for: `WorkFolder.begin`'s fingerprint
    plan.npz       the plan                     pictures/      the references, developed
    blocks/        one bundle for each block    .irpso-lock    who works here

Each file appears whole or not at all and tells its own damage.
"""

from __future__ import annotations

import contextlib
import shutil
from pathlib import Path
from types import TracebackType
from typing import Any, TypeGuard

import numpy as np

from ..data import F32
from ..errors import BadInput
from ..storage.atomic_io import LOCK, PART, FolderLock, remove_leftovers, write_whole
from ..storage.text_file import read_text
from . import npz_archive

MARK = "irpso-work"
PLAN = "plan.npz"
BLOCKS = "blocks"
PICTURES = "pictures"
_LITTER = {".ds_store", "thumbs.db", "desktop.ini", "@eadir"}  # what file managers and servers put anywhere


class WorkFolder:
    """A work folder.  Entered, it keeps other runs out; farm tasks read and write blocks without entering it.

    Raises BadInput for a folder that is not one, is in use, or cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        self.pictures = self.folder / PICTURES
        self._blocks = self.folder / BLOCKS
        self._lock: FolderLock | None = None
        self._begun: str | None = None

    def __enter__(self) -> WorkFolder:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._check_ours()
            lock = FolderLock(self.folder)
            lock.__enter__()
        except OSError as error:
            raise self._unwritable(error) from None
        self._lock = lock
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None,
    ) -> None:
        if self._lock is not None:
            self._lock.__exit__(kind, error, trace)
            self._lock = None

    def begin(self, fingerprint: str) -> None:
        """Keep what is there if it was begun with the same fingerprint, else empty the folder.  Enter it first."""
        assert self._lock is not None
        try:
            for place in (self._blocks, self.pictures):
                if place.is_symlink():  # what it points to is not ours
                    place.unlink()
            for place in (self.folder, self._blocks, self.pictures):
                remove_leftovers(place)
            if self.fingerprint() != fingerprint:
                self._empty()
                write_whole(self.folder / MARK, f"{fingerprint}\n".encode())
            self._blocks.mkdir(exist_ok=True)
            self.pictures.mkdir(exist_ok=True)
        except OSError as error:
            raise self._unwritable(error) from None
        self._begun = fingerprint

    def fingerprint(self) -> str | None:
        """What the folder was begun with; None: nothing, or not to the end."""
        try:
            return read_text(self.folder / MARK).strip() or None
        except BadInput:
            return None

    def write_plan(self, plan: Any) -> None:
        """Keep what all blocks have in common."""
        self._save(self.folder / PLAN, plan)

    def read_plan(self) -> Any | None:
        """The plan; None where there is none that is whole and belongs here."""
        return self._load(self.folder / PLAN)

    def write_block(self, key: str, layers: dict[str, F32]) -> None:
        """Keep a finished block: arrays by name, (h, w) or (h, w, 3) those of its maps' layers.

        Raises BadInput where the folder has been begun for another solve since.
        """
        if self._blocks.is_symlink():
            raise BadInput(f"{self._blocks}: is a link to files that are not irpso's; remove it and run again")
        self._save(self._block(key), dict(layers))

    def read_block(self, key: str) -> dict[str, F32]:
        """What `write_block` kept.  Raises BadInput where it is missing or damaged."""
        layers = self._load(self._block(key))
        if not _are_layers(layers):
            raise BadInput(f"{self._block(key)}: is missing or damaged; run the solve again, which makes it again")
        return layers

    def has_block(self, key: str) -> bool:
        """Whether `read_block` would give it: whole, undamaged, and of this very solve."""
        return _are_layers(self._load(self._block(key)))

    @staticmethod
    def has_plan(folder: Path) -> bool:
        """Whether a solve there has come to its blocks, of whatever scene and settings; locks nothing."""
        return (Path(folder) / PLAN).is_file()

    @staticmethod
    def count_blocks(folder: Path) -> int:
        """How many finished blocks lie there, whole or not; locks nothing."""
        return sum(not path.name.startswith(PART) for path in (Path(folder) / BLOCKS).glob("*.npz"))

    def remove(self) -> None:
        """Remove all that is ours, and the folder if nothing else lies in it."""
        with contextlib.suppress(OSError):  # files that someone holds open on Windows: emptied by the next run
            self._empty()
        if self._lock is not None:
            self._lock.__exit__(None, None, None)
            self._lock = None
        with contextlib.suppress(OSError):
            self.folder.rmdir()

    def _block(self, key: str) -> Path:
        if not key.replace("_", "").isalnum():
            raise ValueError(f"'{key}' is not a block's key")
        return self._blocks / f"{key}.npz"

    def _save(self, path: Path, content: Any) -> None:
        of = self._fingerprint()
        if self.fingerprint() != of:
            raise BadInput(f"{self.folder}: the folder now belongs to another solve; stop the tasks of the older solve")
        npz_archive.save(path, {"of": of, "thing": content})

    def _load(self, path: Path) -> Any | None:
        """What a file holds if it was written for this very solve."""
        try:
            found = npz_archive.load(path)
        except BadInput:
            return None
        of = found.get("of") if isinstance(found, dict) else None
        ours = isinstance(of, str) and of == self._fingerprint()
        return found.get("thing") if ours else None

    def _fingerprint(self) -> str:
        """Asked once: what a task of an older solve reads or writes is never taken for the next one's.

        `_save` asks again before it writes.  A folder begun anew in that very moment may lose a block of the same name,
        which is then one that is missing.
        """
        if self._begun is None:
            self._begun = self.fingerprint()
        if self._begun is None:
            raise BadInput(f"{self.folder}: is not a work folder of irpso; make one with 'irpso job' or a large solve")
        return self._begun

    def _check_ours(self) -> None:
        """A folder with other things in it, and no mark of ours, is somebody's own."""
        known = {MARK, PLAN, BLOCKS, PICTURES, LOCK}
        others = sorted(p.name for p in self.folder.iterdir() if p.name not in known and p.name.lower() not in _LITTER
                        and not p.name.startswith((PART, ".nfs")))
        if others and self.fingerprint() is None:
            raise BadInput(f"{self.folder}: contains '{others[0]}' and is not a work folder of irpso; choose another "
                           "folder")

    def _empty(self) -> None:
        """Remove what is ours, the mark first: what is left if this is stopped belongs to no solve."""
        (self.folder / MARK).unlink(missing_ok=True)
        (self.folder / PLAN).unlink(missing_ok=True)
        for place in (self._blocks, self.pictures):
            if place.is_symlink() or not place.is_dir():
                place.unlink(missing_ok=True)
            else:
                shutil.rmtree(place)

    def _unwritable(self, error: OSError) -> BadInput:
        return BadInput(f"{self.folder}: cannot be written ({error.strerror}); make room or choose another folder")


def _are_layers(content: Any) -> TypeGuard[dict[str, F32]]:
    return isinstance(content, dict) and bool(content) and all(
        isinstance(array, np.ndarray) for array in content.values())
