"""``transforms.json`` of Instant-NGP and nerfstudio.

Source: nerfstudio's page "Data conventions" and its parser, and Instant-NGP's ``scripts/colmap2nerf.py``.  Pixels are
COLMAP's, with centres at (0.5, 0.5).  ``fl_x``, ``fl_y``, ``cx``, ``cy``, ``w``, ``h``, ``k1`` to ``k4``, ``p1`` and
``p2`` (or ``distortion_params``, in that order) hold for the file or for one frame.  Instead of a focal length there
may be ``camera_angle_x``, the whole angle in radians.  ``transform_matrix`` leads from camera axes x right, y up, z
back (OpenGL's) to the world, which both programs usually have turned, shifted and scaled: a mesh has to come from
that world.  ``mask_path`` is relative to the file's folder; such a mask is black where a picture does not count.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from ..data import F64
from ..lens import Lens
from .json_project import records, text
from .project import NO_PICTURE, OPENCV_FROM_OPENGL, Draft, Project, SizeOf, Unusable, checked, number, numbers, size

FISHEYES = ("OPENCV_FISHEYE", "FISHEYE")
BROWN = ("OPENCV", "PERSPECTIVE", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
COEFFICIENTS = ("k1", "k2", "k3", "k4", "p1", "p2")


def is_transforms(content: dict[str, Any]) -> bool:
    """Whether a JSON object is such a file."""
    frames = content.get("frames")
    return isinstance(frames, list) and any(isinstance(each, dict) and "transform_matrix" in each for each in frames)


def read_transforms(path: Path, content: dict[str, Any], size_of: SizeOf) -> Project:
    """The project in ``content``, the JSON object of ``path``.  Raises BadInput.

    ``size_of`` gives the size of the picture of that name, where the file has none.
    """
    draft = Draft(path, "transforms.json")
    shared = {key: value for key, value in content.items() if key != "frames"}
    for frame in records(content, "frames", path):
        name = text(frame.get("file_path"), str(path), "the file_path of a frame").removeprefix("./")
        who = draft.camera(name)
        given = frame.get("transform_matrix")
        if given is None:
            draft.left_out.append((name, "it has no transform_matrix"))
            continue
        matrix = _matrix(given, who, "transform_matrix")
        record = {**shared, **frame}
        sides = (record["w"], record["h"]) if {"w", "h"} <= record.keys() else size_of(name)
        if sides is None:
            draft.left_out.append((name, NO_PICTURE))
            continue
        lens = draft.lens(name, name, _lens, record, sides, who)
        if lens is None:
            continue
        mask = frame.get("mask_path")
        draft.add(name, lens, matrix[:, :3] @ OPENCV_FROM_OPENGL, matrix[:, 3],
                  path.parent / text(mask, who, "mask_path") if mask else None)
    if _moved(content, path):
        draft.warnings.append("applied_transform or applied_scale has moved the cameras; if the program that aligned "
                              "the pictures made the mesh, move the mesh in the same way")
    return draft.finished()


def _moved(content: dict[str, Any], path: Path) -> bool:
    """Whether nerfstudio has moved the cameras from where the program before it had put them."""
    given = content.get("applied_transform")
    if given is not None and not np.allclose(_matrix(given, str(path), "applied_transform"), np.eye(3, 4)):
        return True
    return number(content.get("applied_scale", 1.0), str(path), "applied_scale") != 1.0


def _matrix(given: object, who: str, what: str) -> F64:
    """(3, 4), with or without its last row in the file.  Raises BadInput."""
    rows = 3 if isinstance(given, list) and len(given) == 3 else 4
    return numbers(given, (rows, 4), who, what)[:3]


def _lens(record: dict[str, Any], sides: tuple[object, object], who: str) -> Lens:
    model = str(record.get("camera_model", "OPENCV")).upper()
    fisheye = model in FISHEYES or record.get("is_fisheye") is True
    if model not in (*FISHEYES, *BROWN) or record.get("ftheta_p0") is not None or record.get("is_equirectangular"):
        raise Unusable(f"its camera model {model[:40]} cannot be used; write it with OPENCV or OPENCV_FISHEYE")
    width, height = size(sides[0], sides[1], who)

    def value(key: str, missing: float) -> float:
        return number(record[key], who, key) if record.get(key) is not None else missing

    fx = value("fl_x", 0.0) or _focal(value("camera_angle_x", 0.0), width)
    fy = value("fl_y", 0.0) or _focal(value("camera_angle_y", 0.0), height) or fx
    listed = record.get("distortion_params")
    k1, k2, k3, k4, p1, p2 = (float(each) for each in (
        [value(key, 0.0) for key in COEFFICIENTS] if listed is None
        else numbers(listed, (6,), who, "distortion_params")))
    return checked(Lens(width, height, fx or fy, fy, value("cx", width / 2), value("cy", height / 2), (k1, k2, k3, k4),
                        (p1, p2), fisheye=fisheye), who)


def _focal(angle: float, side: int) -> float:
    """Pixels, of a whole angle in radians over ``side`` pixels; 0 for none."""
    return side / (2 * math.tan(angle / 2)) if 0 < angle < math.pi else 0.0
