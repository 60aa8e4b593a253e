"""Which program wrote a project, told from the file's content, and the project itself."""

from __future__ import annotations

import os
from pathlib import Path

from ..errors import BadInput
from ..storage.text_file import UTF16, first_bytes
from .alicevision import BINARY_SFM, is_alicevision, read_alicevision
from .alicevision import EXPORT as ALICEVISION
from .colmap import FILES as COLMAP_FILES
from .colmap import model_folder, read_colmap
from .json_project import read_object
from .metashape import EXPORT as METASHAPE
from .metashape import read_metashape
from .nerf_transforms import is_transforms, read_transforms
from .project import Project, SizeOf
from .realityscan import EXPORT as REALITYSCAN
from .realityscan import header_of, read_realityscan

BEGINNING = 65536  # bytes, in which a CSV has its heading
KINDS = ("a Metashape camera XML, a RealityScan CSV, a COLMAP model, an AliceVision .sfm, a transforms.json, or an "
         "Alembic or USD file")
# What the programs save, and none but they can read.
CLOSED = {".psx": METASHAPE, ".psz": METASHAPE, ".rcproj": REALITYSCAN, ".rsproj": REALITYSCAN, ".mg": ALICEVISION,
          ".db": "choose the folder of the sparse model that COLMAP's mapper wrote"}


def read_project(path: Path, size_of: SizeOf | None = None) -> Project:
    """The cameras of the project ``path``, a file or a folder with a COLMAP model or a transforms.json.

    ``size_of`` gives width and height of the picture of that name, for projects that do not have them, or None
    where there is none; it may raise BadInput.  Raises BadInput, one line.
    """
    sizes = size_of or _unsized(path)
    if os.path.isdir(path):
        return _read_folder(path, sizes)
    if path.suffix.lower() in CLOSED:
        raise BadInput(f"{path}: only its own program can read this; {CLOSED[path.suffix.lower()]}")
    if path.suffix.lower() in (".bin", ".txt") and path.stem.lower() in COLMAP_FILES:
        return _read_folder(path.parent, sizes)
    beginning = first_bytes(path, BEGINNING)
    if beginning[4:8] == BINARY_SFM:
        raise BadInput(f"{path}: is a binary file of AliceVision; write it as JSON (.sfm) with ConvertSfMFormat")
    if beginning.startswith(UTF16):
        raise BadInput(f"{path}: is UTF-16 text; save it as UTF-8")
    beginning = beginning.removeprefix(b"\xef\xbb\xbf").lstrip()
    if beginning.startswith(b"<"):
        return read_metashape(path)
    if beginning.startswith(b"{"):
        return _read_json(path, sizes)
    lines = beginning.decode("utf-8", "replace").splitlines()
    if any(header_of(line) for line in lines[:20]):
        return read_realityscan(path, sizes)
    raise BadInput(f"{path}: is not a project that can be read; choose {KINDS}")


def _read_folder(folder: Path, sizes: SizeOf) -> Project:
    model = model_folder(folder)
    if model is not None:
        return read_colmap(model, chosen=model == folder)
    if os.path.isfile(folder / "transforms.json"):
        return _read_json(folder / "transforms.json", sizes)
    raise BadInput(f"{folder}: has neither a COLMAP model's cameras and images nor a transforms.json; choose {KINDS}")


def _read_json(path: Path, sizes: SizeOf) -> Project:
    content = read_object(path)
    if is_alicevision(content):
        return read_alicevision(path, content)
    if is_transforms(content):
        return read_transforms(path, content, sizes)
    raise BadInput(f"{path}: is JSON, but neither AliceVision's nor a transforms.json; choose {KINDS}")


def _unsized(path: Path) -> SizeOf:
    def refuse(name: str) -> tuple[int, int]:
        raise BadInput(f"{path}: has no size of the picture '{name[:80]}'; choose the folder of the pictures too")

    return refuse
