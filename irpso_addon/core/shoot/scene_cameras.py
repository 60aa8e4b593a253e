"""The cameras of an Alembic or USD file as a project: a picture for each of them, or for each frame of the only one."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..data import F64
from ..errors import BadInput
from ..lens import Lens
from .project import OPENCV_FROM_OPENGL, Draft, Project, SizeOf, checked

ALEMBIC = (".abc",)
USD = (".usd", ".usda", ".usdc", ".usdz")
SUFFIXES = ALEMBIC + USD
UNEQUAL = 1e-3  # how far a camera's axes may differ in length: then it is no camera that is merely scaled
EXPORT = "export perspective cameras, one for each picture and named as it, or one that moves, with a frame for each"


@dataclass(frozen=True)
class FilmCamera:
    """A camera as films have it.  Film lies across the picture; pixels are square."""

    focal_length: float  # mm
    film: tuple[float, float]  # width and height, mm
    shift: tuple[float, float]  # of the picture's middle from the axis, right and up, mm of film
    world_from_camera: F64  # (4, 4), perhaps scaled; camera axes x right, y up, z back
    perspective: bool = True


@dataclass(frozen=True)
class SceneCamera:
    """One camera of a file."""

    names: tuple[str, ...]  # those that may be its picture's, the likeliest first
    still: FilmCamera
    moving: Mapping[int, FilmCamera] | None = None  # by the frames that pictures are numbered by; None: it stands


@dataclass(frozen=True)
class SceneFile:
    """What Blender has found in a file."""

    path: Path
    cameras: tuple[SceneCamera, ...]
    frames: tuple[int, int]  # first and last
    rate: float  # frames a second that they are counted by
    mesh: bool  # whether there are faces


def lens_of(camera: FilmCamera, width: int, height: int, who: str) -> Lens:
    """For pictures of that size.  Raises BadInput.

    The film's width lies along the picture's; along the longer side where the picture alone is upright, as Blender's
    own cameras have it.
    """
    if not camera.perspective:
        raise BadInput(f"{who}: is orthographic or panoramic, not perspective; {EXPORT}")
    film, high = camera.film
    if not (film > 0 and high > 0):
        raise BadInput(f"{who}: its film is {film:g} x {high:g} mm; {EXPORT}")
    across = height if height > width and film > high else width
    pixels = across / film  # in a millimetre
    f = camera.focal_length * pixels
    right, up = (value * pixels for value in camera.shift)
    return checked(Lens(width, height, f, f, width / 2 - right, height / 2 + up), who)


def project_of(file: SceneFile, pictures: Sequence[str], sizes: SizeOf) -> Project:
    """The project; ``pictures``: stems of all that are in the folder.  Raises BadInput."""
    draft = Draft(file.path, "Alembic" if file.path.suffix.lower() in ALEMBIC else "USD")
    if not file.cameras:
        raise BadInput(f"{file.path}: has no perspective camera; {EXPORT}")
    stems = {plain(stem): stem for stem in pictures}
    named = [next((stems[plain(name)] for name in camera.names if plain(name) in stems), None)
             for camera in file.cameras]
    if len(file.cameras) == 1 and named == [None] and file.cameras[0].moving is not None:
        _add_frames(draft, file, numbered(file.path, pictures), sizes)
    else:
        for camera, name in zip(file.cameras, named, strict=True):
            if name is None:
                draft.left_out.append((camera.names[0], "no picture has its name"))
            else:
                _add(draft, name, camera.still, sizes)
        if not draft.cameras:
            first = file.cameras[0].names[0]
            raise BadInput(f"{file.path}: no picture has the name of a camera ('{first[:80]}' ...); {EXPORT}")
    draft.metres_per_unit = 1.0 if file.path.suffix.lower() in USD else None  # USD says it, and Blender has heeded it
    project = draft.finished()
    beside = tuple(path for path in project.meshes if path != file.path)
    return replace(project, meshes=(file.path,) if file.mesh else beside)


def numbered(path: Path, pictures: Sequence[str]) -> dict[int, str]:
    """Pictures by the number at the end of their names; others are left out.  Raises BadInput where two have one."""
    found: dict[int, str] = {}
    for stem in sorted(pictures):
        digits = re.search(r"[0-9]{1,9}$", stem)
        if digits:
            number = int(digits[0])
            if number in found:
                raise BadInput(f"{path}: both '{found[number][:80]}' and '{stem[:80]}' can be the picture of frame "
                               f"{number}; choose the folder that holds one of them")
            found[number] = stem
    return found


def plain(name: str) -> str:
    """What is left of a name in such files, which allow letters, digits and underscores alone."""
    return re.sub(r"\W", "_", unicodedata.normalize("NFC", name).lower(), flags=re.ASCII).lstrip("_")


def _add_frames(draft: Draft, file: SceneFile, pictures: Mapping[int, str], sizes: SizeOf) -> None:
    """A camera for each frame.  Raises BadInput unless the pictures are numbered from the first frame to the last."""
    (camera,) = file.cameras
    first, last = file.frames
    if not pictures or (min(pictures), max(pictures)) != (first, last):
        numbers = f"from {min(pictures)} to {max(pictures)}" if pictures else "not"
        raise BadInput(f"{draft.camera(camera.names[0])}: moves from frame {first} to {last} at {file.rate:g} frames a "
                       f"second, but the pictures are {numbers} numbered; export a frame for each picture, at the "
                       "scene's frame rate")
    for number, stem in pictures.items():
        _add(draft, stem, (camera.moving or {})[number], sizes)


def _add(draft: Draft, name: str, camera: FilmCamera, sizes: SizeOf) -> None:
    who, matrix = draft.camera(name), np.asarray(camera.world_from_camera, np.float64)
    size = sizes(name)
    assert size is not None  # it is the name of a picture that was found
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if lengths.max() - lengths.min() > UNEQUAL * lengths.max() or not lengths.min() > 0:
        raise BadInput(f"{who}: is scaled by {', '.join(f'{n:g}' for n in lengths)}; apply its scale and export again")
    draft.add(name, lens_of(camera, *size, who), matrix[:3, :3] / lengths.mean() @ OPENCV_FROM_OPENGL, matrix[:3, 3])
