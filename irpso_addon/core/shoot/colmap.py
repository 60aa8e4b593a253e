"""COLMAP's sparse models: cameras and images in a folder, as text or binary (which COLMAP prefers too).

Source: COLMAP's documentation, "Output Format" and "Camera Models", and the comments of its ``sensor/models.h``.  A
pixel's centre lies at (0.5, 0.5).  An image's quaternion (w, x, y, z) and translation lead from the world to its
camera, whose axes are x right, y down, z forward.  Distortion is OpenCV's.  Binary numbers are little-endian.  The
pictures' key points are skipped; rigs and frames are not needed, because each image also has its own pose.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..data import F64
from ..errors import BadInput
from ..lens import Lens
from ..phrases import some
from ..storage.text_file import opened
from .project import LONGEST_NAME, MOST_CAMERAS, Draft, Project, Unusable, checked, number, size

EXPORT = "in COLMAP, choose File, Export model"
# Each model's parameters, in the order of their numbers in binary files.
MODELS = {
    "SIMPLE_PINHOLE": "f cx cy", "PINHOLE": "fx fy cx cy", "SIMPLE_RADIAL": "f cx cy k1", "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2", "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 d1 d2 d3", "FOV": "fx fy cx cy omega",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1", "RADIAL_FISHEYE": "f cx cy k1 k2",
    "THIN_PRISM_FISHEYE": "fx fy cx cy k1 k2 p1 p2 k3 k4 sx1 sy1",
    "RAD_TAN_THIN_PRISM_FISHEYE": "fx fy cx cy k0 k1 k2 k3 k4 k5 p0 p1 s0 s1 s2 s3",
    "SIMPLE_DIVISION": "f cx cy k", "DIVISION": "fx fy cx cy k", "SIMPLE_FISHEYE": "f cx cy", "FISHEYE": "fx fy cx cy",
    "EUCM": "fx fy cx cy alpha beta", "EQUIRECTANGULAR": "w h",
}
FISHEYES = ("OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "SIMPLE_FISHEYE", "FISHEYE")
BROWN = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
FILES = ("cameras", "images", "points3d", "rigs", "frames")
POINT = 24  # bytes of a key point in images.bin
LONGEST_LINE = 1 << 20


@dataclass(frozen=True)
class _Camera:
    model: str
    width: object
    height: object
    values: tuple[object, ...]


@dataclass(frozen=True)
class _Image:
    name: str
    camera: int
    pose: tuple[object, ...]  # qw, qx, qy, qz, tx, ty, tz


def model_folder(folder: Path) -> Path | None:
    """Where the sparse model of ``folder`` lies: there or in its sparse/0, as COLMAP's workspaces have it."""
    for candidate in (folder, folder / "sparse" / "0", folder / "sparse", folder / "0"):
        if _has_files(candidate, ".bin") or _has_files(candidate, ".txt"):
            return candidate
    return None


def _other_models(folder: Path) -> list[str]:
    """Names of the numbered models beside ``folder``, if it is one."""
    if not folder.name.isdecimal():
        return []
    return sorted(each.name for each in folder.parent.iterdir() if each.name.isdecimal() and each != folder and (
        _has_files(each, ".bin") or _has_files(each, ".txt")))


def _has_files(folder: Path, suffix: str) -> bool:
    return all(os.path.isfile(folder / f"{name}{suffix}") for name in ("cameras", "images"))


def read_colmap(folder: Path, chosen: bool = True) -> Project:
    """The sparse model that lies in ``folder`` itself; a line tells of others beside it unless it was ``chosen``.

    Raises BadInput.
    """
    workspace = folder.parent.parent if folder.parent.name == "sparse" else folder.parent
    draft = Draft(folder, "COLMAP", folders=(workspace,) if "sparse" in (folder.name, folder.parent.name) else ())
    others = [] if chosen else _other_models(folder)
    if others:
        draft.warnings.append(f"COLMAP has made several models that are not connected; '{folder.name}' is used: "
                              f"if another ({some(others)}) has more of the pictures, choose its folder")
    if _has_files(folder, ".bin"):
        cameras, images = _binary_cameras(folder / "cameras.bin"), _binary_images(folder / "images.bin")
    else:
        cameras, images = _text_cameras(folder / "cameras.txt"), _text_images(folder / "images.txt")
    for image in images:
        who = draft.camera(image.name)
        if image.camera not in cameras:
            raise BadInput(f"{who}: its camera {image.camera} is not in the model; {EXPORT}")
        lens = draft.lens(image.camera, image.name, _lens, cameras[image.camera], who)
        if lens is None:
            continue
        pose = np.array([number(value, who, "its pose") for value in image.pose])
        rotation = _rotation(pose[:4], who)
        draft.add(image.name, lens, rotation.T, -rotation.T @ pose[4:])
    return draft.finished()


def _rotation(quaternion: F64, who: str) -> F64:
    """(3, 3) of a unit quaternion (w, x, y, z), Hamilton's convention."""
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1) > 1e-3:
        raise BadInput(f"{who}: its pose is not a rotation (a quaternion of length {length:.3g}); {EXPORT}")
    w, x, y, z = quaternion / length
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + 2 * w * cross + 2 * cross @ cross, np.float64)


def _lens(camera: _Camera, who: str) -> Lens:
    names = MODELS.get(camera.model)
    if names is None or len(names.split()) != len(camera.values):
        raise BadInput(f"{who}: its camera model '{camera.model[:40]}' with {len(camera.values)} parameters is "
                       f"unknown; {EXPORT}")
    value = {name: number(each, who, name) for name, each in zip(names.split(), camera.values, strict=True)}
    if camera.model not in (*BROWN, *FISHEYES) or any(value.get(name) for name in ("d1", "d2", "d3")):
        raise Unusable(f"its camera model {camera.model} cannot be used; run the bundle adjustment with OPENCV or "
                       "OPENCV_FISHEYE")
    width, height = size(camera.width, camera.height, who)
    focal = value.get("f", 0.0)
    radial = (value.get("k1", 0.0), value.get("k2", 0.0), value.get("k3", 0.0), value.get("k4", 0.0))
    return checked(Lens(
        width, height, value.get("fx", focal), value.get("fy", focal), value["cx"], value["cy"], radial,
        (value.get("p1", 0.0), value.get("p2", 0.0)), fisheye=camera.model in FISHEYES), who)


# -- text ----------------------------------------------------------------------------------------------------------


def _lines(file: BinaryIO, path: Path) -> Iterator[str]:
    """Lines, stripped, without comments; of a line that is too long, its beginning.  An image may have an empty one."""
    while line := file.readline(LONGEST_LINE):
        start = line
        while line and not line.endswith(b"\n"):
            line = file.readline(LONGEST_LINE)
        try:
            text = start.decode().strip().removeprefix("\ufeff")
        except UnicodeDecodeError:
            raise BadInput(f"{path}: is not UTF-8 text; {EXPORT} as text") from None
        if not text.startswith("#"):
            yield text


def _text_cameras(path: Path) -> dict[int, _Camera]:
    cameras: dict[int, _Camera] = {}
    with opened(path) as file:
        for line in _lines(file, path):
            cells = line.split()
            if not cells:
                continue
            if len(cells) < 5 or len(cameras) == MOST_CAMERAS:
                raise BadInput(f"{path}: a line is not a camera ('{line[:40]}'), or there are too many; {EXPORT} as "
                               "text")
            cameras[_identity(cells[0], path)] = _Camera(cells[1], cells[2], cells[3], tuple(cells[4:]))
    return cameras


def _text_images(path: Path) -> list[_Image]:
    images: list[_Image] = []
    with opened(path) as file:
        lines = _lines(file, path)
        for line in lines:
            if not line:
                continue
            cells = line.split(maxsplit=9)
            if len(cells) < 10 or len(images) == MOST_CAMERAS:
                raise BadInput(f"{path}: a line is not an image ('{line[:40]}'), or there are too many; {EXPORT} as "
                               "text")
            images.append(_Image(cells[9], _identity(cells[8], path), tuple(cells[1:8])))
            next(lines, None)  # its key points; the line may be empty
    return images


def _identity(cell: str, path: Path) -> int:
    if not (cell.isascii() and cell.isdigit() and len(cell) < 20):
        raise BadInput(f"{path}: '{cell[:40]}' is not a number of a camera; {EXPORT} as text")
    return int(cell)


# -- binary --------------------------------------------------------------------------------------------------------


def _unpacked(file: BinaryIO, path: Path, layout: str) -> tuple[int | float, ...]:
    form = struct.Struct("<" + layout)
    data = file.read(form.size)
    if len(data) < form.size:
        raise BadInput(f"{path}: ends too early; copy it again, or {EXPORT}")
    return form.unpack(data)


def _count(file: BinaryIO, path: Path) -> int:
    count = int(_unpacked(file, path, "Q")[0])
    if count > MOST_CAMERAS:
        raise BadInput(f"{path}: states {count} entries, which is not a COLMAP model; {EXPORT}")
    return count


def _binary_cameras(path: Path) -> dict[int, _Camera]:
    cameras = {}
    with opened(path) as file:
        for _ in range(_count(file, path)):
            identity, model, width, height = (int(value) for value in _unpacked(file, path, "IiQQ"))
            if not 0 <= model < len(MODELS):
                raise BadInput(f"{path}: has a camera of the unknown model {model}; {EXPORT} as text")
            name, parameters = list(MODELS.items())[model]
            values = _unpacked(file, path, f"{len(parameters.split())}d")
            cameras[identity] = _Camera(name, width, height, values)
    return cameras


def _binary_images(path: Path) -> list[_Image]:
    images = []
    with opened(path) as file:
        whole = file.seek(0, 2)
        file.seek(0)
        for _ in range(_count(file, path)):
            _, *pose, camera = _unpacked(file, path, "I7dI")
            name = _name(file, path)
            points = int(_unpacked(file, path, "Q")[0])
            if file.tell() + points * POINT > whole:
                raise BadInput(f"{path}: ends too early; copy it again, or {EXPORT}")
            file.seek(points * POINT, 1)
            images.append(_Image(name, int(camera), tuple(pose)))
    return images


def _name(file: BinaryIO, path: Path) -> str:
    start = file.tell()
    name, end, _ = file.read(4 * LONGEST_NAME).partition(b"\0")
    if not end:
        raise BadInput(f"{path}: has a name without an end, so it is not a COLMAP model; {EXPORT}")
    file.seek(start + len(name) + 1)
    return name.decode("utf-8", "replace")
