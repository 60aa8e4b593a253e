"""Cameras that RealityScan and RealityCapture export as CSV ("Internal/External camera parameters").

Source: RealityCapture's article "XMP camera math" and two public readers that agree with it (nerfstudio's, brush's).
``f`` is in millimetres on a picture whose longer side measures 36 mm.  ``px`` and ``py`` count from the picture's
middle, in longer sides.  k1 to k4, t1 and t2 are Brown's, in OpenCV's order.  The pose is (x, y, alt) with z up, and

    camera to world = Rz(-heading) Rx(pitch) Ry(roll)

for a camera with y up that looks along its -z: it looks down at pitch 0 and at the horizon at pitch 90; heading runs
clockwise from +y.  The columns can be chosen in the program, so they are found by their names.  Lines before that
heading are comments; below it, "#" begins a picture's name.  The file has no picture sizes, and does not say that a
lens was fitted by the division model, which it cannot hold: export Brown's.

A spreadsheet that has saved the file again may have separated the columns by semicolons or tabs, with decimal commas.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from ..data import F64
from ..errors import BadInput
from ..lens import Lens
from ..storage.text_file import read_text
from .project import NO_PICTURE, OPENCV_FROM_OPENGL, Draft, Project, SizeOf, checked, number, size

EXPORT = 'in RealityScan, choose Export, Registration, "Internal/External camera parameters"'
POSE = ("x", "y", "alt", "heading", "pitch", "roll")
SEPARATORS = ",;\t"
OPTIONAL = ("px", "py", "k1", "k2", "k3", "k4", "t1", "t2")
FILM = 36.0  # mm, the longer side


def header_of(line: str) -> tuple[list[str], str] | None:
    """The columns' names and what separates them, if ``line`` is the heading of cameras."""
    for separator in SEPARATORS:
        names = [name.strip(" \t#\"").lower() for name in line.strip().split(separator)]
        if {"name", "x", "y"} <= set(names):
            return names, separator
    return None


def read_realityscan(path: Path, size_of: SizeOf) -> Project:
    """The project in ``path``; ``size_of`` gives the size of a picture by its name.  Raises BadInput."""
    draft = Draft(path, "RealityScan")
    file = io.StringIO(read_text(path), newline="")
    columns, separator = next(found for line in file if (found := header_of(line)) is not None)
    _require(columns, path)
    try:
        for row in csv.reader(file, delimiter=separator):
            if any(cell.strip() for cell in row):
                _add(draft, columns, row, size_of, comma=separator != ",")
    except csv.Error as error:
        raise BadInput(f"{path}: is not complete CSV ({error}); {EXPORT}") from None
    return draft.finished()


def _require(columns: list[str], path: Path) -> None:
    if "yaw" in columns and "heading" not in columns:
        raise BadInput(f"{path}: has a column 'yaw' instead of 'heading', and what RealityScan measures it from is not "
                       "documented; export the cameras as a COLMAP model, and choose its folder")
    missing = [name for name in (*POSE, "f") if name not in columns]
    if missing:
        raise BadInput(f"{path}: has no column '{missing[0]}'; {EXPORT}")


def _add(draft: Draft, columns: list[str], row: list[str], size_of: SizeOf, comma: bool) -> None:
    """``comma``: whether decimals may follow one."""
    if len(row) != len(columns):
        raise BadInput(f"{draft.camera(row[0])}: has {len(row)} columns, not {len(columns)}; {EXPORT}")
    cells = {column: cell.strip() for column, cell in zip(columns, row, strict=True)}
    name = cells["name"]
    who = draft.camera(name)
    value = {column: number(cells[column].replace(",", ".") if comma else cells[column], who, column)
             for column in (*POSE, "f", *OPTIONAL) if column in cells}
    sides = size_of(name)
    if sides is None:
        draft.left_out.append((name, NO_PICTURE))
        return
    width, height = size(*sides, who)
    longer = max(width, height)
    focal = value["f"] * longer / FILM
    radial = (value.get("k1", 0.0), value.get("k2", 0.0), value.get("k3", 0.0), value.get("k4", 0.0))
    lens = Lens(width, height, focal, focal, width / 2 + longer * value.get("px", 0.0),
                height / 2 + longer * value.get("py", 0.0), radial, (value.get("t1", 0.0), value.get("t2", 0.0)))
    turned = _turn(2, -value["heading"]) @ _turn(0, value["pitch"]) @ _turn(1, value["roll"])
    draft.add(name, checked(lens, who), turned @ OPENCV_FROM_OPENGL,
              np.array([value["x"], value["y"], value["alt"]]))


def _turn(axis: int, degrees: float) -> F64:
    """(3, 3) right-handed rotation about one axis."""
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[[i, i, j, j], [i, j, i, j]] = cosine, -sine, sine, cosine
    return matrix
