"""The pictures of a project: their files, their headers, and the cameras as the pictures are read."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...core.errors import BadInput
from ...core.images import decoder_pool
from ...core.images.image_file import ImageFile, open_image
from ...core.images.mask import ASPECT
from ...core.images.shot_settings import relative_exposures
from ...core.job import Progress, Result, Steps
from ...core.phrases import counted, some
from ...core.shoot.picture_files import PictureFiles, PictureFolder
from ...core.shoot.picture_lens import UPRIGHT, PictureCamera, picture_camera, read_as_stored
from ...core.shoot.project import Project, ProjectCamera

WAIT = 0.01  # seconds between two steps


@dataclass(frozen=True)
class ShootPictures:
    """What the pictures say."""

    files: PictureFiles
    cameras: tuple[PictureCamera, ...]  # of those that have a picture
    exposures: dict[str, float]  # EV
    messages: tuple[str, ...]


class Headers:
    """The headers of picture files, each read once, several at a time.  Leaving it ends what is still to be read."""

    def __init__(self, folder: PictureFolder) -> None:
        self._folder = folder
        self._jobs: dict[Path, Future[ImageFile]] = {}
        self._threads = ThreadPoolExecutor(decoder_pool.MOST, "irpso-headers")
        self._reader = ThreadPoolExecutor(1, "irpso-project")

    def __enter__(self) -> Headers:
        return self

    def __exit__(self, *_: object) -> None:
        for threads in (self._threads, self._reader):
            threads.shutdown(wait=True, cancel_futures=True)

    def size(self, name: str) -> tuple[int, int] | None:
        """Width and height of a picture by its name in the project.  Raises BadInput where it is damaged."""
        path = self._folder.find(name)
        if path is None:
            return None
        if not self._jobs:  # whoever wants one size wants all
            self._begin(self._folder.found())
        file = self._job(path).result()
        return file.width, file.height

    def of(self, path: Path) -> ImageFile:
        """Of one file.  Raises BadInput."""
        return self._job(path).result()

    def read(self, paths: Sequence[Path]) -> Steps[None]:
        """All of them.  Raises BadInput for the first that cannot be read."""
        self._begin(paths)
        for done, path in enumerate(paths):
            step = Progress(done / len(paths), "pictures", f"{done} of {len(paths)}")
            yield step
            yield from _until(self._job(path), step)
            self.of(path)

    def while_working(self, work: Callable[[], Result], stage: str) -> Steps[Result]:
        """Does ``work``, which may ask for sizes, in another thread.  Raises what it raises."""
        job = self._reader.submit(work)
        yield from _until(job, Progress(0.0, stage))
        return job.result()

    def _begin(self, paths: Iterable[Path]) -> None:
        for path in paths:
            self._job(path)

    def _job(self, path: Path) -> Future[ImageFile]:
        if path not in self._jobs:
            self._jobs[path] = self._threads.submit(open_image, path)
        return self._jobs[path]


def _until(job: Future[Any], step: Progress) -> Steps[None]:
    """Waits for it, a little at a time."""
    while not job.done():
        wait([job], WAIT)
        yield step


def read_pictures(project: Project, folder: PictureFolder, headers: Headers) -> Steps[ShootPictures]:
    """Raises BadInput, before anything is made, for whatever will not do."""
    files = folder.match([camera.name for camera in project.cameras], [name for name, _ in project.left_out],
                         {camera.name: camera.mask for camera in project.cameras if camera.mask is not None})
    cameras = [camera for camera in project.cameras if camera.name in files.files]
    paths = [*files.files.values(), *files.masks.values()]
    for path in paths:
        check_path(path)
    yield from headers.read(paths)
    opened = {camera.name: headers.of(files.files[camera.name]) for camera in cameras}
    for name, mask in files.masks.items():
        _check_mask(headers.of(mask), opened[name])
    found, lines = _turned(cameras, opened)
    exposures, exposed = relative_exposures({name: file.shot for name, file in opened.items()})
    return ShootPictures(files, tuple(found), exposures, (
        *_missing(project, files), *lines, *_masked(found, files), *_mixed(list(opened.values())), *exposed))


def check_path(path: Path) -> None:
    """Raises BadInput for a path that a .blend cannot hold."""
    try:
        str(path.resolve()).encode()
    except UnicodeEncodeError:
        raise BadInput(f"{path}: its name is not UTF-8, which Blender cannot keep; rename the file or its folder"
                       ) from None


def _check_mask(mask: ImageFile, picture: ImageFile) -> None:
    if abs(mask.width / mask.height * picture.height / picture.width - 1) > ASPECT:
        raise BadInput(f"{mask.path}: is {mask.width} x {mask.height} pixels, but the picture that it masks is "
                       f"{picture.width} x {picture.height}, upright; turn or scale the mask, or move it away")


def _turned(
    cameras: Sequence[ProjectCamera], files: dict[str, ImageFile],
) -> tuple[list[PictureCamera], list[str]]:
    """Each camera as its picture is read, and lines for the user.  Raises BadInput."""
    votes = {camera.name: read_as_stored(camera, files[camera.name]) for camera in cameras}
    told = [vote for vote in votes.values() if vote is not None]
    rest = sum(told) * 2 > len(told)  # what the others say holds for those that do not tell
    found = []
    for camera in cameras:
        vote = votes[camera.name]
        found.append(picture_camera(camera, files[camera.name], rest if vote is None else vote))
    lines = []
    turned, cropped = sum(camera.turned for camera in found), [each for each in found if each.cropped]
    if turned:
        lines.append(f"{counted(turned, 'picture')}: the project stores them as the camera did, not upright; "
                     "their cameras are turned to the upright pictures")
    unclear = [name for name, vote in votes.items() if vote is None and files[name].orientation in UPRIGHT
               and files[name].orientation != 1]
    if unclear and not told:
        lines.append(f"{some(unclear)}: turned upright by their EXIF tag; the project does not state whether its "
                     "program did the same; if they do not fit the mesh, remove the orientation tag")
    if cropped:
        lens = cropped[0].lens
        lines.append(f"{counted(len(cropped), 'picture')}: the RAW files hold a few more pixels ({lens.width} x "
                     f"{lens.height}) than the pictures of the project; both are taken to have the same centre")
    return found, lines


def _masked(cameras: Sequence[PictureCamera], files: PictureFiles) -> list[str]:
    """A line where a mask may be of less than its RAW file."""
    names = [camera.name for camera in cameras if camera.cropped and camera.name in files.masks]
    return [f"{some(names)}: the mask is taken to cover the whole RAW file, which shows more than the project's "
            "picture; if it was made from the smaller picture, make it again from the RAW file"] if names else []


def _mixed(files: Sequence[ImageFile]) -> list[str]:
    """A line where some pictures are RAW files and others are not."""
    developed = [file.path.name for file in files if file.camera is None]
    return [f"{some(developed)}: not RAW as the other pictures are, and developed pictures differ from those in "
            "brightness and colour; put their RAW files into the folder, or choose a folder of one kind"
            ] if 0 < len(developed) < len(files) else []


def _missing(project: Project, pictures: PictureFiles) -> list[str]:
    lines = []
    for why in dict.fromkeys(why for _, why in project.left_out):
        lines.append(f"{some([name for name, each in project.left_out if each == why])}: left out: {why}")
    if pictures.missing:
        lines.append(f"{some(pictures.missing)}: the project has a camera, but the folder has no picture of that name; "
                     "left out")
    if pictures.lost_masks:
        lines.append(f"{some(pictures.lost_masks)}: the project states a mask, but there is no such file, so the whole "
                     f"picture counts; put it where {project.path.name} has it")
    if pictures.unused:
        lines.append(f"{counted(pictures.unused, 'picture')} of the folder: not in the project, and not used")
    return lines


def already_there(files: PictureFiles, views: Sequence[str]) -> list[str]:
    """A line where pictures are views of the scene before: ``views``, absolute paths."""
    known = {os.path.realpath(path) for path in views}
    count = sum(os.path.realpath(path) in known for path in files.files.values())
    return [f"{counted(count, 'picture')}: already views of the scene, so they now count twice; undo one of the "
            "imports"] if count else []
