"""AliceVision's ``.sfm`` files (JSON), which Meshroom's node StructureFromMotion writes: views, intrinsics, poses.

Source: AliceVision's own reader and writer (``sfmDataIO/jsonIO.cpp``, ``camera/``, ``mesh/Mesh.cpp``).  Numbers may
be text.  A pose's ``rotation`` leads from the world to the camera and is listed by columns, so that its nine numbers
by rows lead from the camera (x right, y down, z forward) to the world; ``center`` is the camera's place.  The file's
version decides the rest:

* The principal point counts from the corner before 1.2.1 and from the middle since.
* The focal length is ``pxFocalLength`` (one number, two from 1.2.0) before 1.2.2, and since then ``focalLength`` in
  millimetres on a sensor ``sensorWidth`` wide.  ``pixelRatio`` is fx / fy before 1.2.5 and fy / fx since.  From 1.2.11
  on, the millimetres are the vertical ones.
* The distortion has a field of its own from 1.2.8.
* The meshes that go with the file are turned half round the x axis from 1.2.3 (AliceVision 3.0).  The cameras are
  turned with them here.

A pixel's centre has whole coordinates in AliceVision, so half a pixel is added to the principal point.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..data import F64
from ..errors import BadInput
from ..lens import Lens
from .json_project import records, text
from .project import Draft, Project, Unusable, checked, number, numbers, size

Version = tuple[int, int, int]
Radial = tuple[float, float, float, float]

EXPORT = "choose the cameras.sfm or sfm.json that Meshroom's node StructureFromMotion or ConvertSfMFormat wrote"
BINARY_SFM = b"ASFM"  # at byte 4 of its other format, FlatBuffers
TURNED_MESHES: Version = (1, 2, 3)
HALF_TURN = np.diag([1.0, -1.0, -1.0])
# Names of the distortions since 1.2.8 and, as the camera's type, before; how many parameters each has.
DISTORTIONS = {"": 0, "none": 0, "pinhole": 0, "radialk1": 1, "radial1": 1, "radialk3": 3, "radial3": 3, "brown": 5,
               "fisheye": 4, "fisheye4": 4}
NO_RIG = 2**32 - 1


def is_alicevision(content: dict[str, Any]) -> bool:
    """Whether a JSON object is such a file."""
    return "views" in content and ("intrinsics" in content or "poses" in content or "version" in content)


def read_alicevision(path: Path, content: dict[str, Any]) -> Project:
    """The project in ``content``, the JSON object of the file ``path``.  Raises BadInput."""
    draft = Draft(path, "AliceVision")
    version = _version(content, path)
    intrinsics = {str(each.get("intrinsicId")): each for each in records(content, "intrinsics", path)}
    poses = {str(each.get("poseId")): each for each in records(content, "poses", path)}
    upright = False
    for view in records(content, "views", path):
        name = text(view.get("path"), str(path), "the path of a view")
        who, which = draft.camera(name), str(view.get("intrinsicId"))
        pose = poses.get(str(view.get("poseId", view.get("viewId"))))
        if str(view.get("rigId", NO_RIG)) not in (str(NO_RIG), "-1"):
            draft.left_out.append((name, "it belongs to a rig of cameras, whose poses cannot be read"))
            continue
        if pose is None or which not in intrinsics:
            draft.left_out.append((name, "it was not reconstructed"))
            continue
        lens = draft.lens(which, name, _lens, intrinsics[which], version, who)
        if lens is None:
            continue
        upright |= lens.height > lens.width and version >= (1, 2, 10)
        draft.add(name, lens, *_placed(pose, version, who))
    if upright:
        draft.warnings.append("AliceVision of 2024 writes the focal length of upright pictures by their height and "
                              "reads it by their width; compare a camera with its picture")
    return draft.finished()


def _version(content: dict[str, Any], path: Path) -> Version:
    major, minor, revision = numbers(content.get("version", ["1", "0", "0"]), (3,), str(path), "its version")
    if major != 1:
        raise BadInput(f"{path}: has the unknown version {major:g}; {EXPORT} with version 1")
    return 1, int(minor), int(revision)


def _placed(pose: dict[str, Any], version: Version, who: str) -> tuple[F64, F64]:
    """Rotation (3, 3) from the camera to the world of the meshes, and place (3,)."""
    inner = pose.get("pose")
    transform = inner.get("transform") if isinstance(inner, dict) else None
    if not isinstance(transform, dict):
        raise BadInput(f"{who}: its pose has no transform; {EXPORT}")
    rotation = numbers(transform.get("rotation"), (9,), who, "its rotation").reshape(3, 3)
    center = numbers(transform.get("center"), (3,), who, "its center")
    turn = HALF_TURN if version >= TURNED_MESHES else np.eye(3)
    return turn @ rotation, turn @ center


def _lens(record: dict[str, Any], version: Version, who: str) -> Lens:
    width, height = size(record.get("width"), record.get("height"), who)
    middle = np.array([width, height]) / 2
    x, y = numbers(record.get("principalPoint", [0, 0] if version >= (1, 2, 1) else list(middle)), (2,), who,
                   "principalPoint") + (middle if version >= (1, 2, 1) else 0) + 0.5
    radial, tangential, fisheye = _distortion(record, version, who)
    fx, fy = _focal(record, width, version, who)
    return checked(Lens(width, height, fx, fy, float(x), float(y), radial, tangential, fisheye=fisheye), who)


def _focal(record: dict[str, Any], width: int, version: Version, who: str) -> tuple[float, float]:
    """fx and fy in pixels."""
    if version < (1, 2, 2):
        given = record.get("pxFocalLength")
        fx, fy = numbers(given if isinstance(given, list) else [given, given], (2,), who, "pxFocalLength")
        return float(fx), float(fy)
    sensor = number(record.get("sensorWidth", 36.0), who, "sensorWidth")
    ratio = number(record.get("pixelRatio", 1.0), who, "pixelRatio")
    if sensor <= 0 or ratio <= 0:
        raise BadInput(f"{who}: its sensorWidth or pixelRatio is not above 0; {EXPORT}")
    pixels = number(record.get("focalLength"), who, "focalLength") / sensor * width
    if version >= (1, 2, 11):
        return pixels / ratio, pixels
    return pixels, pixels * ratio if version >= (1, 2, 5) else pixels / ratio


def _distortion(record: dict[str, Any], version: Version, who: str) -> tuple[Radial, tuple[float, float], bool]:
    kind = str(record.get("type", "")).lower()
    named = str(record.get("distortionType", "")).lower() if version >= (1, 2, 8) else kind
    backward = str(record.get("undistortionType", "none")).lower() if version >= (1, 2, 8) else "none"
    if named not in DISTORTIONS or backward != "none" or (version >= (1, 2, 8) and kind != "pinhole"):
        model = " ".join(dict.fromkeys([kind, named, backward]))[:60]
        raise Unusable(f"its camera model '{model}' cannot be used; reconstruct with brown, radial3 or fisheye4")
    values = numbers(record.get("distortionParams") or [0.0] * DISTORTIONS[named], (DISTORTIONS[named],), who,
                     "distortionParams")
    found = [float(value) for value in values] + [0.0] * 5
    if named == "brown":
        return (found[0], found[1], found[2], 0.0), (found[3], found[4]), False
    return (found[0], found[1], found[2], found[3]), (0.0, 0.0), named.startswith("fisheye")
