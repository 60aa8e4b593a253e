"""Which file of a folder is which picture of a project, by its name."""

from __future__ import annotations

import os
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from ..errors import BadInput
from ..images.oiio_reader import SUFFIXES
from ..images.raw_reader import SUFFIXES as RAW
from ..phrases import some

RICH = (".exr", ".hdr", ".tif", ".tiff", ".png")  # of developed pictures, those that hold more than 8 bits
UNREADABLE = (".heic", ".heif", ".hif", ".avif", ".jxl", ".psd", ".psb", ".gpr")  # pictures all the same
MASK_ENDS = ("_mask", ".mask", "-mask")  # of the stem of a file that masks another
MASK_FOLDERS = ("mask", "masks")  # below the chosen one: their files have the names of the pictures that they mask
MOST = 100_000  # files of one folder
DEEPEST = 4  # folders in folders


@dataclass(frozen=True)
class PictureFiles:
    """The files of a project's pictures."""

    files: dict[str, Path]  # by the picture's name in the project; no file has two names
    masks: dict[str, Path]
    missing: tuple[str, ...]  # pictures without a file
    lost_masks: tuple[str, ...]  # pictures whose stated mask is not there, and that have no other
    unused: int  # pictures in the folder that the project does not have; those of one stem count once


class PictureFolder:
    """The pictures and masks in a folder and in its folders, listed once."""

    def __init__(self, folder: Path) -> None:
        """Raises BadInput where ``folder`` cannot be read."""
        self.folder = folder
        self._pictures: dict[str, list[Path]] = {}  # by stem, lower case
        self._masks: dict[str, list[Path]] = {}  # by the stem of what they mask
        for path in sorted(_pictures(folder)):
            masked = _masked(_plain(path.stem))
            (self._pictures if masked is None else self._masks).setdefault(masked or _plain(path.stem), []).append(path)
        self._take_masks_out()

    def _take_masks_out(self) -> None:
        """From the pictures: what lies in a folder for masks and has the name of a picture elsewhere."""
        pictures = {stem for stem, paths in self._pictures.items() if not all(map(self._is_among_masks, paths))}
        for stem, paths in list(self._pictures.items()):
            inside = [path for path in paths if self._is_among_masks(path)]
            masked = stem if stem in pictures else _stem(PurePosixPath(stem))  # COLMAP's are called IMG_1.jpg.png
            if inside and masked in pictures:
                self._masks.setdefault(masked, []).extend(inside)
                self._pictures[stem] = [path for path in paths if path not in inside]
                if not self._pictures[stem]:
                    del self._pictures[stem]

    def _is_among_masks(self, path: Path) -> bool:
        folders = path.relative_to(self.folder).parts[:-1]
        return path.suffix.lower() not in RAW and any(folder.lower() in MASK_FOLDERS for folder in folders)

    def find(self, name: str) -> Path | None:
        """The file of one picture: of those that have its stem, the one whose folders end most like the name's.

        Of those alike, RAW is preferred to what a converter made of it, and more bits to fewer.  Raises BadInput where
        that leaves several.
        """
        wanted = PurePosixPath(name.replace("\\", "/"))
        ranked = sorted((-_alike(wanted, path), _rank(path, wanted.suffix), str(path), path)
                        for path in self._pictures.get(_stem(wanted), []))
        if len(ranked) > 1 and ranked[0][:2] == ranked[1][:2]:
            one, other = (os.path.relpath(each[3], self.folder) for each in ranked[:2])
            raise BadInput(f"{self.folder}: both '{one}' and '{other}' can be the project's picture '{name}'; choose "
                           "the folder that holds one of them")
        return ranked[0][3] if ranked else None

    def found(self) -> list[Path]:
        """All pictures, those that are not the project's too."""
        return [path for paths in self._pictures.values() for path in paths]

    def stems(self) -> list[str]:
        """The names of all pictures, without folder and suffix, each once."""
        return [paths[0].stem for paths in self._pictures.values()]

    def match(
        self, names: Sequence[str], left_out: Iterable[str] = (), stated: Mapping[str, Path] | None = None,
    ) -> PictureFiles:
        """The file of each picture and its mask.  Raises BadInput where there is none of them, or several of one.

        ``left_out``: pictures that the project has as well, but does not place.  ``stated``: the masks that it states.
        """
        files = {name: path for name in names if (path := self.find(name)) is not None}
        if not files:
            raise BadInput(f"{self.folder}: {self._other_file(names)}")
        first: dict[Path, str] = {}
        for name, path in files.items():
            if path in first:
                raise BadInput(f"{path}: is the only file for two pictures of the project, '{first[path]}' and '{name}'"
                               "; choose the folder that holds both, in folders as the project names them")
            first[path] = name
        missing = tuple(name for name in names if name not in files)
        known = {_stem(PurePosixPath(name.replace("\\", "/"))) for name in left_out}
        given = {name: path for name, path in (stated or {}).items() if name in files}
        masks = {name: path for name, path in given.items() if os.path.isfile(path)}
        masks |= {name: mask for name, path in files.items()
                  if name not in masks and (mask := self._mask(path)) is not None}
        used = {_plain(path.stem) for path in (*files.values(), *masks.values())}
        return PictureFiles(files, masks, missing, tuple(name for name in given if name not in masks),
                            len(self._pictures.keys() - used - known))

    def _other_file(self, names: Sequence[str]) -> str:
        """Why the folder has no picture: a file of such a name that is none, as a telephone's HEIC, or nothing."""
        wanted = {_stem(PurePosixPath(name.replace("\\", "/"))) for name in names}
        kinds = {path.suffix for path in self.folder.iterdir()
                 if _plain(path.stem) in wanted and path.suffix.lower() in UNREADABLE}
        if kinds:
            return f"its pictures are {min(kinds)} files, which cannot be read; convert them to 16-bit TIFF files"
        return f"has none of the project's pictures ({some(names)}); choose the folder of the pictures"

    def _mask(self, picture: Path) -> Path | None:
        """Its mask: beside it, else in the folders that end most like its own.  Raises BadInput where two may be."""
        ranked = sorted((mask.parent != picture.parent, -_alike(picture, mask), str(mask), mask)
                        for mask in self._masks.get(_plain(picture.stem), []))
        if len(ranked) > 1 and ranked[0][:2] == ranked[1][:2]:
            raise BadInput(f"{picture}: both '{ranked[0][3].name}' and '{ranked[1][3].name}' can be its mask; keep one "
                           "of them")
        return ranked[0][3] if ranked else None


def _pictures(folder: Path) -> Iterable[Path]:
    """All image files under ``folder``.  Raises BadInput."""
    count, depth = 0, len(folder.parts)
    try:
        if not os.path.isdir(folder):
            raise BadInput(f"{folder}: folder not found; choose the folder of the pictures")
        os.listdir(folder)  # os.walk passes over what it may not read
        for place, folders, names in os.walk(folder):
            here = Path(place)
            if len(here.parts) - depth >= DEEPEST:
                folders.clear()
            folders[:] = [name for name in folders if not name.startswith(".")]
            for name in names:
                if os.path.splitext(name)[1].lower() in SUFFIXES | RAW and not name.startswith("."):
                    count += 1
                    if count > MOST:
                        raise BadInput(f"{folder}: has more than {MOST} images; choose the folder of the pictures")
                    yield here / name
    except OSError as error:
        raise BadInput(f"{folder}: cannot be read ({error.strerror}); choose the folder of the pictures") from None
    except ValueError:  # a zero byte
        raise BadInput(f"{folder}: is not a path; choose the folder of the pictures") from None


def _masked(stem: str) -> str | None:
    """Stem of the picture that a mask's name speaks of; None: it is no mask's name."""
    return next((stem[:-len(end)] for end in MASK_ENDS if stem.endswith(end) and stem != end), None)


def _stem(name: PurePosixPath) -> str:
    """Without the suffix of a picture: programs may name pictures without it, and dots are no suffix then."""
    return _plain(name.stem if name.suffix.lower() in SUFFIXES | RAW else name.name)


def _plain(name: str) -> str:
    """``name`` for comparisons.  Mac OS may write an accent as a letter of its own, other systems do not."""
    return unicodedata.normalize("NFC", name).lower()


def _alike(name: PurePosixPath | Path, path: Path) -> int:
    """How many folders of both are the same, from the last one on."""
    pairs = zip(reversed(name.parts[:-1]), reversed(path.parts[:-1]), strict=False)
    return next((count for count, (a, b) in enumerate(pairs) if _plain(a) != _plain(b)),
                min(len(name.parts), len(path.parts)) - 1)


def _rank(path: Path, suffix: str) -> tuple[int, bool]:
    """RAW before developed, more bits before fewer, the name's own suffix before others."""
    own = path.suffix.lower()
    kind = 0 if own in RAW else RICH.index(own) + 1 if own in RICH else len(RICH) + 1
    return kind, own != suffix.lower()
