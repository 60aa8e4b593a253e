"""Indirect light by Cycles: a second Blender renders the scene with the maps found so far on its object.

What it renders is what reaches each view's pixels by way of other surfaces, and from the world or things that glow.
The open file stays as it is.  The pictures are small and noisy; ``observations.py`` smooths them along the surface.
Imports where there is no ``bpy``: in a worker process.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from ...core.checks.bounced_light import BouncedSample, LightPicture, sampled
from ...core.checks.mended_cameras import given_name
from ...core.data import F32, Bounced, MeshArrays, SceneData, Solution, View
from ...core.errors import BadInput
from ...core.job import Progress
from ...core.tiled import uv_blocks
from .. import second_blender

SAMPLES = 32  # paths of a pixel
SIDE = 256  # pixels of the longer side
TEST_VIEWS, TEST_SIDE = 4, 96  # views that tell whether the others are worth rendering; pixels of their longer side
POLL = 0.05  # seconds
# Blender 4.5 abbreviates the names of passes, 5 writes them out.
PASSES = {"DiffDir": "Diffuse Direct", "DiffInd": "Diffuse Indirect", "DiffCol": "Diffuse Color",
          "GlossDir": "Glossy Direct", "GlossInd": "Glossy Indirect", "GlossCol": "Glossy Color",
          "IndexOB": "Object Index"}
Result = TypeVar("Result")
# A camera, the lamps that shine, the world and meshes that are known light beside them, and by how many radians the
# world is turned about Z.  None of them: other things that glow, and the world where it is nobody's known light.
Picture = tuple[str, tuple[str, ...], str, tuple[str, ...], float]
NOTHING: tuple[tuple[str, ...], str, tuple[str, ...], float] = (), "", (), 0.0  # shines


def renders_direct_only() -> bool:
    """Whether the open file renders no light that bounces."""
    import bpy

    cycles = getattr(bpy.context.scene, "cycles", None)  # an add-on, which this Blender may have switched off
    return cycles is not None and cycles.max_bounces == 0


@dataclass(frozen=True)
class IndirectRenderer:
    """Renders the indirect light of a scene's views.  Made on the main thread; called on any, without ``bpy``."""

    blend: Path  # nobody changes it while a job runs
    scene: str
    view_layer: str
    command: tuple[str, ...]  # starts a Blender that runs the Python code that follows
    direct_only: bool = False  # the file itself renders no light that bounces
    copy: tempfile.TemporaryDirectory[str] | None = None  # where ``blend`` lies that we saved ourselves

    @classmethod
    def of_copy(cls) -> IndirectRenderer:
        """For a copy of what is open, with all that was changed since it was saved; the copy goes with `around`."""
        import bpy

        folder = tempfile.TemporaryDirectory(prefix="irpso-copy-")
        blend = Path(folder.name) / Path(bpy.data.filepath).name
        with _no_preview():
            bpy.ops.wm.save_as_mainfile(filepath=str(blend), copy=True, compress=False)
        return replace(cls.of_open_file(blend), copy=folder)

    @classmethod
    def of_open_file(cls, blend: Path) -> IndirectRenderer:
        """For ``blend``, which is what is open, as it was saved."""
        import bpy

        return cls(blend.resolve(), bpy.context.scene.name, bpy.context.view_layer.name, second_blender.command(),
                   direct_only=renders_direct_only())

    def __call__(self, scene: SceneData, solution: Solution) -> Generator[Progress, None, Mapping[int, Bounced]]:
        """Indirect light on the pixels of each view, by its place in the scene.

        Raises BadInput, one line, when the child fails.  Stopped, it ends the child.
        """
        wanted = _pictures(scene.views)

        def read(path: Path, picture: Picture) -> Bounced:
            return read_light(path, "Ind" if any(picture[1:]) else "Dir")

        found = yield from self._rendered(scene, solution, wanted, SIDE, read)
        return {i: _sum(found[(picture[0], *NOTHING)], found[picture]) for i, picture in enumerate(wanted)}

    def sample(self, scene: SceneData, solution: Solution) -> Generator[Progress, None, BouncedSample]:
        """What a few views, spread over all, hold of indirect light, by small pictures.

        Raises BadInput, one line, when the child fails.  Stopped, it ends the child.
        """
        wanted = _pictures(scene.views[::-(-len(scene.views) // TEST_VIEWS)])

        def read(path: Path, picture: Picture) -> dict[str, F32]:
            return _read_passes(path)

        found = yield from self._rendered(scene, solution, wanted, min(TEST_SIDE, SIDE), read)
        return sampled(light_picture(found[(picture[0], *NOTHING)], found[picture]) for picture in wanted)

    def _rendered(
        self, scene: SceneData, solution: Solution, wanted: Sequence[Picture], side: int,
        read: Callable[[Path, Picture], Result],
    ) -> Generator[Progress, None, dict[Picture, Result]]:
        """What ``read`` makes of each of the pictures, and of each of their cameras' without lamps."""
        pictures: list[Picture] = [*dict.fromkeys((camera, *NOTHING) for camera, *_ in wanted),
                                   *dict.fromkeys(wanted)]
        found: dict[Picture, Result] = {}
        with tempfile.TemporaryDirectory(prefix="irpso-indirect-") as name:
            folder = Path(name)
            self._write_job(folder, scene, solution, pictures, side)
            with _child(self.command, folder) as renderer:
                for n, picture in enumerate(pictures):
                    path = folder / f"{n}.exr"
                    while not path.exists():
                        if renderer.status is not None and not path.exists():
                            raise BadInput(f"{self.blend.name}: indirect light cannot be rendered "
                                           f"({renderer.last_line()}); use Indirect Light off")
                        yield Progress(n / len(pictures), "indirect", f"picture {n + 1} of {len(pictures)}")
                        time.sleep(POLL)
                    found[picture] = read(path, picture)
                    path.unlink()
        return found

    def around(self, job: Generator[Progress, None, Result]) -> Generator[Progress, None, Result]:
        """The job; after it the copy is gone."""
        try:
            return (yield from job)
        finally:
            if self.copy is not None:
                self.copy.cleanup()

    def _write_job(
        self, folder: Path, scene: SceneData, solution: Solution, pictures: Sequence[Picture], side: int,
    ) -> None:
        """What the child is to do: job.json, and the maps as maps.npz."""
        maps = solution.maps
        rough = maps.roughness if maps.lobes is None else maps.lobes
        arrays = {"base_color": maps.base_color, "roughness": rough}
        more = {"specular": maps.specular, "metallic": maps.metallic}
        arrays |= {name: array for name, array in more.items() if array is not None}
        np.savez(folder / "maps.npz", **arrays)
        (folder / "job.json").write_text(json.dumps({
            "blend": str(self.blend), "scene": self.scene, "view_layer": self.view_layer, "object": scene.mesh.name,
            "model": solution.model, "levels": solution.levels, "metallic": solution.metallic, "ndf": solution.ndf,
            "paint": solution.paint,
            "coats": {name: (coat.weight, coat.roughness) for name, coat in solution.coats.items()},
            "diffuse_roughness": solution.diffuse_roughness,
            "side": side, "samples": SAMPLES, "pictures": pictures, "udims": _udims(scene.mesh),
            "known_world": any(view.environment is not None and view.environment.name for view in scene.views),
        }), encoding="utf-8")


def _udims(mesh: MeshArrays) -> tuple[int, ...]:
    """The squares that the maps hold side by side, as a plan's do; none: they are of one."""
    return uv_blocks.udims_of(mesh.uvs) if mesh.extent > 1 else ()


def _pictures(views: Sequence[View]) -> list[Picture]:
    """Of each view."""
    pictures: list[Picture] = []
    for view in views:
        camera, lamps = given_name(view), tuple(light.name for light in view.lights)
        if (found := view.environment) is None:
            pictures.append((camera, lamps, "", (), 0.0))
        else:
            pictures.append((camera, lamps, found.name, tuple(emitter.name for emitter in found.emitters), found.turn))
    return pictures


@contextmanager
def _no_preview() -> Iterator[None]:
    """Files that are saved inside get no thumbnail: Blender would render one, in Material Preview for many seconds."""
    import bpy

    preferences = bpy.context.preferences
    before, dirty = preferences.filepaths.file_preview_type, preferences.is_dirty
    preferences.filepaths.file_preview_type = "NONE"
    try:
        yield
    finally:
        preferences.filepaths.file_preview_type, preferences.is_dirty = before, dirty


@contextmanager
def _child(command: tuple[str, ...], folder: Path) -> Iterator[second_blender.Child]:
    """A Blender at work on the job in ``folder``, ended on leaving."""
    renderer = second_blender.Child(command, "blender.jobs.indirect_child", folder)
    try:
        yield renderer
    finally:
        renderer.end()


def read_light(path: Path, kind: str) -> Bounced:
    """The passes of a picture, "Ind" or "Dir", as light."""
    passes = _read_passes(path)
    diffuse, glossy = passes[f"Diff{kind}"], passes[f"Gloss{kind}"] * passes["GlossCol"]
    return Bounced(np.float32(np.pi) * np.nan_to_num(diffuse, posinf=0.0), np.nan_to_num(glossy, posinf=0.0))


def light_picture(without: Mapping[str, F32], lit: Mapping[str, F32]) -> LightPicture:
    """Of the passes of two pictures of one camera, without and with a view's lamps."""
    def radiance(passes: Mapping[str, F32], kind: str) -> F32:
        parts = (passes[f"{name}{kind}"] * passes[f"{name}Col"] for name in ("Diff", "Gloss"))
        return np.asarray(np.nan_to_num(sum(parts), posinf=0.0).mean(-1), np.float32)

    rest = radiance(without, "Dir")  # from the world and from what glows
    return LightPicture(np.maximum(radiance(lit, "Dir") - rest, np.float32(0)), radiance(lit, "Ind") + rest,
                        lit["IndexOB"][..., 0] > 0.5)


def _read_passes(path: Path) -> dict[str, F32]:
    """(h, w, 3) of each pass by its short name, (h, w, 1) of the object index; row 0 at the bottom."""
    import OpenImageIO

    long = {name: short for short, name in PASSES.items()}
    found: dict[str, F32] = {}
    file = OpenImageIO.ImageInput.open(str(path))
    if file is None:
        raise BadInput(f"{path.name}: indirect light cannot be read back ({OpenImageIO.geterror()})")
    part = 0
    while file.seek_subimage(part, 0):
        names = [channel.rsplit(".", 2)[1:] for channel in file.spec().channelnames]
        pixels = np.asarray(file.read_image(part, 0, 0, len(names), OpenImageIO.FLOAT), np.float32)
        for name in {name for name, _ in names}:
            channels = [names.index([name, letter]) for letter in "RGBX" if [name, letter] in names]
            found[long.get(name, name)] = pixels[::-1, :, channels]
        part += 1
    file.close()
    return found


def _sum(a: Bounced, b: Bounced) -> Bounced:
    return Bounced(a.irradiance + b.irradiance, a.glossy + b.glossy)
