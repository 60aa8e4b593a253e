"""A photogrammetry project as all readers give it, and the checks that every one of its cameras has to pass."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from ..data import F64
from ..errors import BadInput
from ..lens import Lens
from ..phrases import some
from ..projection import FLIP
from ..storage.text_file import first_bytes

MOST_CAMERAS = 100_000
MOST_PIXELS = 1_000_000  # of a side
MOST_VALUE = 1e9  # of a lens's number or a coordinate: nothing that was photographed needs more
NOT_RIGID = 1e-3  # how far R^T R may be from 1: files have six digits, or fewer
FAR = 1e4  # distance of the cameras from the origin, in widths of the rig: single floats keep less than a thousandth
LONGEST_NAME = 1024
MESH_SUFFIXES = (".obj", ".ply", ".fbx", ".glb", ".gltf", ".stl", ".dae", ".usd", ".usda", ".usdc", ".usdz")
PLY_HEADER = 4096  # bytes
OPENCV_FROM_OPENGL = FLIP[:3, :3]  # camera axes: y down and z forward, from y up and z back; and back

# Width and height in pixels of the picture that has this name; None: there is no such file
SizeOf = Callable[[str], tuple[int, int] | None]
NO_PICTURE = "its picture is not in the folder"


@dataclass(frozen=True)
class ProjectCamera:
    """One picture that the program placed."""

    name: str  # the picture's name as the project has it, perhaps with folders, perhaps without suffix
    lens: Lens
    world_from_camera: F64  # (4, 4) rigid; camera axes x right, y down, z forward; the project's units
    mask: Path | None = None  # where the project states one; perhaps there is no such file


@dataclass(frozen=True)
class Project:
    """The cameras of a project, in the coordinates in which its program exports the mesh by default."""

    path: Path
    kind: str  # "Metashape", "RealityScan", "COLMAP", "AliceVision", "transforms.json"
    cameras: tuple[ProjectCamera, ...]  # at least one; every name once
    left_out: tuple[tuple[str, str], ...] = ()  # pictures without a camera: name, why
    warnings: tuple[str, ...] = ()
    meshes: tuple[Path, ...] = ()  # files beside the project that can be its mesh
    metres_per_unit: float | None = None  # where the project states it


class Unusable(Exception):
    """Why no picture through a lens can be used, and what to do: other pictures of the project may be."""


@dataclass
class Draft:
    """What a reader has found so far."""

    path: Path
    kind: str
    cameras: list[ProjectCamera] = field(default_factory=list)
    left_out: list[tuple[str, str]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    metres_per_unit: float | None = None
    folders: tuple[Path, ...] = ()  # where a mesh may lie, beside the project's own folder
    _lenses: dict[object, Lens | str] = field(default_factory=dict)  # or why it cannot be used

    def camera(self, name: object) -> str:
        """How messages name a camera."""
        return f"{self.path}: camera '{str(name)[:80]}'"

    def lens(self, which: object, name: str, read: Callable[..., Lens], *given: object) -> Lens | None:
        """The lens ``which`` of the picture ``name``, read once of what is ``given``.

        None: it is `Unusable`, and the picture is left out.
        """
        if which not in self._lenses:
            try:
                self._lenses[which] = read(*given)
            except Unusable as why:
                self._lenses[which] = str(why)
        found = self._lenses[which]
        if isinstance(found, Lens):
            return found
        self.left_out.append((name, found))
        return None

    def add(self, name: str, lens: Lens, rotation: F64, position: F64, mask: Path | None = None) -> None:
        """One more camera; ``rotation`` (3, 3) turns its axes (y down) into the world's.  Raises BadInput."""
        if not name.strip() or len(name) > LONGEST_NAME or not name.isprintable():
            raise BadInput(f"{self.camera(name)}: its name is not a picture's name; rename it in the project")
        if len(self.cameras) == MOST_CAMERAS:
            raise BadInput(f"{self.path}: has more than {MOST_CAMERAS} cameras; export fewer of them")
        self.cameras.append(ProjectCamera(name, lens, rigid(rotation, position, self.camera(name)), mask))

    def finished(self) -> Project:
        """The project, after the checks of all cameras together.  Raises BadInput."""
        absent = [name for name, why in self.left_out if why == NO_PICTURE]
        if not self.cameras and absent:
            raise BadInput(f"{self.path}: the chosen folder has none of the project's pictures ({some(absent)}); "
                           "choose the folder of the pictures")
        for name, why in self.left_out:
            if not self.cameras and "; " in why:
                raise BadInput(f"{self.camera(name)}: {why}")
        if not self.cameras:
            why = f" ('{self.left_out[0][0][:80]}': {self.left_out[0][1]})" if self.left_out else ""
            raise BadInput(f"{self.path}: has no camera with a pose{why}; align the pictures in {self.kind}")
        twice = [name for name, count in Counter(camera.name for camera in self.cameras).items() if count > 1]
        if twice:
            raise BadInput(f"{self.camera(twice[0])}: two cameras have that name; rename one in the project")
        warnings = [*self.warnings, *_far(self.cameras), *_folded(self.cameras)]
        folders = dict.fromkeys([self.path if os.path.isdir(self.path) else self.path.parent, *self.folders])
        meshes = [mesh for folder in folders for mesh in _meshes(folder)]
        return Project(self.path, self.kind, tuple(self.cameras), tuple(self.left_out), tuple(warnings), tuple(meshes),
                       self.metres_per_unit)


def number(value: object, who: str, what: str) -> float:
    """A finite number from a file's text or JSON.  Raises BadInput."""
    found = math.nan
    if isinstance(value, (str, int, float)) and not isinstance(value, bool):
        try:
            found = float(value)
        except (ValueError, OverflowError):
            pass
    if not abs(found) <= MOST_VALUE:  # so is NaN
        problem = "is missing" if value is None else f"is {str(value)[:40]!r}, which is not a number of a camera"
        raise BadInput(f"{who}: {what} {problem}; export the cameras again")
    return found


def numbers(values: object, shape: tuple[int, ...], who: str, what: str) -> F64:
    """Finite numbers of that ``shape`` from a text with spaces or from nested JSON lists.  Raises BadInput."""
    flat = values.split() if isinstance(values, str) else list(_flattened(values, len(shape)))
    if len(flat) != math.prod(shape):
        raise BadInput(f"{who}: {what} has {len(flat)} numbers, not {math.prod(shape)}; export the cameras again")
    return np.array([number(value, who, what) for value in flat], np.float64).reshape(shape)


def _flattened(values: object, depth: int) -> Iterable[object]:
    if depth and isinstance(values, (list, tuple)):
        for value in values:
            yield from _flattened(value, depth - 1)
    elif values is not None:
        yield values


def size(width: object, height: object, who: str) -> tuple[int, int]:
    """Width and height in pixels.  Raises BadInput."""
    sides = [number(width, who, "the pictures' width"), number(height, who, "the pictures' height")]
    if not all(side.is_integer() and 1 <= side <= MOST_PIXELS for side in sides):
        raise BadInput(f"{who}: its pictures have {sides[0]:g} x {sides[1]:g} pixels; export the cameras again")
    return int(sides[0]), int(sides[1])


def checked(lens: Lens, who: str) -> Lens:
    """``lens``, if its numbers can be those of a lens.  Raises BadInput."""
    values = np.hstack([getattr(lens, each.name) for each in fields(lens)])
    if not (np.abs(values) <= MOST_VALUE).all() or lens.fx <= 0 or lens.fy <= 0:
        raise BadInput(f"{who}: its lens has a focal length of {lens.fx:g} or a number that is not finite; "
                       "calibrate it in the project and export again")
    return lens


def rigid(rotation: F64, position: F64, who: str) -> F64:
    """(4, 4) from a rotation (3, 3) and a place (3,); the rotation's rounding is taken out.  Raises BadInput."""
    if not (np.isfinite(rotation).all() and (np.abs(position) <= MOST_VALUE).all()):
        raise BadInput(f"{who}: its pose is not finite or too far away; align the pictures again")
    if np.abs(rotation.T @ rotation - np.eye(3)).max() > NOT_RIGID or np.linalg.det(rotation) < 0:
        raise BadInput(f"{who}: its pose is not a rotation (scaled, sheared or mirrored); export the cameras again")
    u, _, vt = np.linalg.svd(rotation)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = u @ vt, position
    return pose


def _far(cameras: Sequence[ProjectCamera]) -> list[str]:
    places = np.array([camera.world_from_camera[:3, 3] for camera in cameras])
    distance, extent = np.abs(places).max(), np.ptp(places, axis=0).max()
    if len(cameras) < 2 or distance <= FAR * extent:
        return []
    return [f"the cameras lie {distance:.3g} units from the origin and only {extent:.3g} apart, which single floats "
            "cannot resolve; export cameras and mesh in local coordinates"]


def _folded(cameras: Sequence[ProjectCamera]) -> list[str]:
    """Distortion beyond the data that it was fitted to can turn back; such corners see nothing."""
    names = [name for lens, name in {camera.lens: camera.name for camera in cameras}.items() if _folds(lens)]
    return [f"{some([name[:80] for name in names])}: the lens has a distortion that reverses before the pictures' "
            "corners; pixels beyond that are not used"] if names else []


def _folds(lens: Lens) -> bool:
    if lens.fisheye or lens.reach == math.inf:
        return False  # the circle of a fisheye may well end before the corners
    return lens.reached < math.hypot(max(lens.cx, lens.width - lens.cx) / lens.fx,
                                     max(lens.cy, lens.height - lens.cy) / lens.fy)


def _meshes(folder: Path) -> list[Path]:
    try:
        names = sorted(os.listdir(folder))
    except OSError:
        return []
    found = [folder / name for name in names if name.lower().endswith(MESH_SUFFIXES)]
    return [path for path in found if os.path.isfile(path) and (path.suffix.lower() != ".ply" or _has_faces(path))]


def _has_faces(path: Path) -> bool:
    """Whether a PLY file is a mesh, not a cloud of points."""
    try:
        return b"element face" in first_bytes(path, PLY_HEADER)
    except BadInput:
        return False
