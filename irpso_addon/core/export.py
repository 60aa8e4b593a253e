"""Maps to image files: the names and the order that other programs rely on.

``<object>_basecolor``, ``_roughness``, ``_confidence``, ``_error``, ``_filled``; row 0 of the file is
the top (``core/image.py`` flips).  EXR holds linear 32-bit floats; PNG and TIFF hold 16 bits and the
base colour there is sRGB-encoded.  Either every file of a set appears, or none.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from pathlib import Path

import numpy as np

from .data import F32, Maps
from .errors import BadInput
from .image import write_image

KINDS = ("exr", "png", "tiff")
STEM_BYTES = 200  # file systems allow 255 bytes a name; the longest suffix is "_confidence.tiff"
FORBIDDEN = frozenset('/\\:*?"<>|')  # in a file name on some system that artists share files with


def safe_stem(name: str) -> str:
    """A file stem from an object's name: one path component on every system, non-ASCII letters kept.

    Names that are too long are cut at a letter and end in a hash of the whole, so that two objects
    whose names begin alike do not overwrite each other.
    """
    stem = "".join("_" if c in FORBIDDEN or not c.isprintable() else c for c in name)
    stem = stem.lstrip(". ").rstrip(". ") or "object"
    if len(stem.encode()) > STEM_BYTES:
        digest = "_" + hashlib.sha256(name.encode(errors="replace")).hexdigest()[:8]
        stem = stem.encode()[: STEM_BYTES - len(digest)].decode(errors="ignore") + digest
    return stem


def write_maps(maps: Maps, stem: str, out: Path, kind: str) -> list[Path]:
    """Writes the files of ``maps`` into the folder ``out`` (made if missing) and returns their paths.

    ``stem`` is the object's name, ``kind`` one of `KINDS`.  All files are written into a temporary
    folder inside ``out`` and moved to their names at the end.  Raises BadInput when ``out`` cannot
    be written; nothing is left behind then and older files keep their contents.
    """
    if kind not in KINDS:
        raise BadInput(f"format '{kind}': not known; use one of {', '.join(KINDS)}")
    out = Path(out)
    made = _make_folder(out)
    try:
        staging = Path(tempfile.mkdtemp(prefix=".irpso-", dir=out))
    except OSError as error:
        _remove_folders(made)
        raise BadInput(f"{out}: cannot write there ({error.strerror}); choose another folder") from None
    try:
        written = _write_all(maps, safe_stem(stem), staging, kind)
        paths = _publish(written, out)
    except BaseException:
        shutil.rmtree(staging, ignore_errors=True)
        _remove_folders(made)
        raise
    shutil.rmtree(staging, ignore_errors=True)
    return paths


def _write_all(maps: Maps, stem: str, folder: Path, kind: str) -> list[Path]:
    """One file per map in ``folder``."""
    layers: tuple[tuple[str, F32, bool], ...] = (
        ("basecolor", maps.base_color, True),
        ("roughness", np.repeat(maps.roughness[..., None], 3, axis=2), False),
        ("confidence", maps.confidence[..., None], False),
        ("error", maps.error[..., None], False),
        ("filled", maps.filled[..., None].astype(np.float32), False),
    )
    paths = []
    for suffix, array, color in layers:
        path = folder / f"{stem}_{suffix}.{kind}"
        try:
            write_image(path, array, kind=kind, color=color)
        except BadInput as error:  # the user knows the folder, not the staging place in it
            raise BadInput(str(error).replace(str(folder), str(folder.parent))) from None
        paths.append(path)
    return paths


def _publish(written: list[Path], out: Path) -> list[Path]:
    """Moves the finished files into ``out``: renames on one file system, so no file is ever half there."""
    targets = [out / path.name for path in written]
    for target in targets:
        if target.is_dir():
            raise BadInput(f"{target}: is a folder, a map was to be written there; move it away")
    for path, target in zip(written, targets, strict=True):
        try:
            os.replace(path, target)
        except OSError as error:
            raise BadInput(f"{target}: cannot be written ({error.strerror}); close or move it") from None
    return targets


def _make_folder(out: Path) -> list[Path]:
    """Makes ``out`` with its parents; returns those that were missing, deepest first."""
    missing = []
    folder = out
    while not folder.exists() and folder != folder.parent:
        missing.append(folder)
        folder = folder.parent
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"{out}: cannot make this folder ({error.strerror}); choose another") from None
    return missing


def _remove_folders(made: list[Path]) -> None:
    """Removes the folders that were made for nothing; stops at one that is in use."""
    for folder in made:
        try:
            folder.rmdir()
        except OSError:
            return
