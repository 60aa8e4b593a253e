"""Output that appears whole or not at all: written aside inside the folder, renamed at the end."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path
from types import TracebackType

from .errors import BadInput


class Staging:
    """A temporary folder inside ``out``; `publish` moves what was written there to its names in ``out``.

    Entering makes ``out`` and proves that it can be written, so a long job fails before it starts.
    Leaving without `publish` removes everything that was made, also the folders.  Raises BadInput.
    """

    def __init__(self, out: Path) -> None:
        self.out = Path(out)
        self._made: list[Path] = []
        self._published = False

    def __enter__(self) -> Staging:
        missing = self.out
        while not missing.exists() and missing != missing.parent:
            self._made.append(missing)
            missing = missing.parent
        try:
            self.out.mkdir(parents=True, exist_ok=True)
            self.folder = Path(tempfile.mkdtemp(prefix=".irpso-", dir=self.out))
        except OSError as error:
            self._remove_folders()
            raise BadInput(f"{self.out}: cannot write there ({error.strerror}); choose another folder") from None
        return self

    def beside(self, name: str) -> Path:
        """Where to write a file that is to become ``out/name`` and must not lie deeper than that.

        A .blend keeps paths relative to its own folder, which a move out of a sub-folder would break.
        """
        return self.out / f"{self.folder.name}{name}"

    def publish(self) -> list[Path]:
        """Rename everything to its place (one file system, so no file is ever half there); sorted paths."""
        pairs = [(path, self.out / path.name) for path in self.folder.iterdir()]
        prefix = self.folder.name
        pairs += [(p, self.out / p.name[len(prefix):]) for p in self.out.glob(f"{prefix}?*")]
        for _, target in pairs:
            if target.is_dir():
                raise BadInput(f"{target}: is a folder where a file is to be written; move it away")
        for path, target in pairs:
            try:
                os.replace(path, target)
            except OSError as error:
                raise BadInput(f"{target}: cannot be written ({error.strerror}); close or move it") from None
        self._published = True
        return sorted(target for _, target in pairs)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None,
    ) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)
        for stray in self.out.glob(f"{self.folder.name}?*"):
            stray.unlink(missing_ok=True)
        if not self._published:
            self._remove_folders()
        if isinstance(error, BadInput):  # the user knows the folder, not the staging place in it
            error.args = (str(error).replace(str(self.folder), str(self.out)),)
        elif isinstance(error, OSError):
            raise BadInput(f"{self.out}: cannot write there ({error.strerror}); make room or choose another") from None

    def _remove_folders(self) -> None:
        for folder in self._made:
            try:
                folder.rmdir()
            except OSError:  # never made, or in use by someone else by now
                return
