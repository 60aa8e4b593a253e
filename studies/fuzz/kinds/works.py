"""Folders of large solves and of killed runs: damaged, forged, and with things in them that lead elsewhere."""

from __future__ import annotations

import io
import json
import shutil
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from irpso_addon.core.data import Camera, Light, MeshArrays, SceneData, View
from irpso_addon.core.errors import BadInput
from irpso_addon.core.maps import block_merge
from irpso_addon.core.storage.output_transaction import READY, SET, OutputTransaction
from irpso_addon.core.tiled import npz_archive, uv_blocks
from irpso_addon.core.tiled.reference_cache import CachedReference, cache_reference
from irpso_addon.core.tiled.work_folder import WorkFolder

from .. import pictures, spoil
from ..case import Box

BLOCK = 8
WINDOWS = uv_blocks.all_blocks(2 * BLOCK, (1001,), BLOCK, 2)
LAYERS = ("basecolor", "roughness")


def prepare(folder: Path) -> dict[str, bytes]:
    """A good work folder: its files by their paths in it."""
    place = folder / "good"
    picture = folder / "picture.exr"
    pictures.write(picture, np.full((24, 36, 3), 0.5, np.float32), "float", {})
    view = _view(picture)
    with WorkFolder(place) as work:
        work.begin("f" * 64)
        work.write_plan(_scene(view))
        for window in WINDOWS:
            work.write_block(window.key, {
                "basecolor": np.full((BLOCK, BLOCK, 3), 0.5, np.float32),
                "roughness": np.ones((BLOCK, BLOCK), np.float32)})
        cache_reference(view, work.pictures / "0")
    good = {str(path.relative_to(place)): path.read_bytes() for path in place.rglob("*") if path.is_file()}
    shutil.rmtree(place)
    return good


def _view(picture: Path) -> View:
    camera = Camera("Cam", np.eye(4), np.eye(4), np.zeros(3), np.array([0.0, 0, -1]), False, 36 / 24)
    return View(picture, camera, (Light("Key", "POINT", np.ones(3), np.eye(4)),))


def _scene(view: View) -> SceneData:
    corners = np.zeros((1, 3, 3), np.float32)
    return SceneData("scene", MeshArrays("Subject", corners, corners, corners[..., :2], np.zeros(1, np.int32), ("",)),
                     corners, (view,))


def make(shared: dict[str, bytes], rng: Random, box: Box) -> Callable[[], None]:
    """That folder, made bad in one or several ways."""
    folder = box.out / "work"
    contents = dict(shared)
    for _ in range(rng.choice((0, 1, 1, 2, 4))):
        name = rng.choice(sorted(contents))
        kind = rng.randrange(6)
        if kind == 0:
            del contents[name]
        elif kind == 1:
            contents[name] = contents[rng.choice(sorted(contents))]
        elif kind == 2 and name.endswith(".npz") and contents[name] is shared.get(name):
            contents[name] = forged(contents[name], rng)
        else:
            contents[name] = spoil.spoilt(contents[name], rng)
        if not contents:
            break
    for name, data in contents.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    folder.mkdir(exist_ok=True)
    (box.given / "victim").write_bytes(b"not ours")
    (box.given / "folder").mkdir()
    (box.given / "folder" / "victim").write_bytes(b"not ours")
    for _ in range(rng.choice((0, 0, 1, 2))):
        _lead_elsewhere(folder, box.given, rng)
    box.names = (folder.name,)
    return partial(use, folder, box.out / "maps", rng)


def forged(data: bytes, rng: Random) -> bytes:
    """A bundle whose checksums are right and whose content is not."""
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(
            made, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as new:
        for info in old.infolist():
            content = old.read(info)
            if rng.random() < 0.5:
                content = _other(content, rng) if info.filename.endswith(".json") else spoil.spoilt(content, rng)
            name = rng.choice((info.filename,) * 9 + (spoil.word(rng) or "x",))
            try:
                new.writestr(name, content)
            except UnicodeEncodeError:
                new.writestr("x", content)
    return made.getvalue()


def _other(content: bytes, rng: Random) -> bytes:
    """JSON with something in it exchanged."""
    told = json.loads(content)
    places: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        for key in list(node) if isinstance(node, dict) else range(len(node)):
            places.append((node, key))
            if isinstance(node[key], dict | list):
                walk(node[key])

    walk(told)
    for _ in range(rng.choice((1, 1, 3))):
        node, key = rng.choice(places)
        node[key] = rng.choice((
            None, [], {}, {"array": "a0"}, {"array": "none"}, {"record": "data.View", "fields": {}},
            {"record": "os.system", "fields": {}}, {"path": "\0"}, {"scalar": "a1"}, spoil.value(rng)))
    try:
        return json.dumps(told).encode("utf-8", "surrogatepass")
    except ValueError:
        return b"{}"


def _lead_elsewhere(folder: Path, given: Path, rng: Random) -> None:
    """Links and leftovers that a careless cleaner would follow."""
    target = rng.choice((given / "victim", given / "folder", Path("nowhere"), Path("/dev/zero")))
    name = rng.choice((
        ".irpso-lock", "plan.npz", "irpso-work", "blocks", "pictures", ".irpso-part-00000000-x", f"{SET}abcdefgh",
        f"{SET}abcdefghmap.exr", f"{SET}abcdefgh..", f"blocks/{WINDOWS[0].key}.npz", "pictures/0", "something else"))
    path = folder / name
    if not path.parent.is_dir() or path.parent.is_symlink():
        return
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
    kind = rng.randrange(4)
    if kind == 0 and name == f"{SET}abcdefgh":
        path.mkdir()
        (path / READY).touch()
        (path / "map.exr").symlink_to(target)
        (path / "folder").mkdir()
    elif kind == 1:
        spoil.odd_place(path, rng)
    else:
        path.symlink_to(target)


def use(folder: Path, maps: Path, rng: Random) -> None:
    """Everything that goes on with such a folder.  Raises the first BadInput."""
    first: BadInput | None = None
    for step in (_read, _staging, _enter, _merge):
        try:
            step(folder, maps, rng)
        except BadInput as error:
            first = first or error
    if first is not None:
        raise first


def _read(folder: Path, _maps: Path, _rng: Random) -> None:
    work = WorkFolder(folder)
    try:
        work.read_plan()
        for window in WINDOWS:
            if work.has_block(window.key):
                work.read_block(window.key)
    finally:
        for path in sorted(folder.glob("*.npz")):
            npz_archive.load(path)
    for path in sorted(work.pictures.iterdir()) if work.pictures.is_dir() else ():
        image = CachedReference(path).window(0, 0, 8, 8, 2)
        assert image.rgb.shape == (4, 4, 3)


def _staging(folder: Path, _maps: Path, _rng: Random) -> None:
    with OutputTransaction(folder) as staging:
        (staging.folder / "new").write_bytes(b"new")
        staging.publish()
    assert (folder / "new").read_bytes() == b"new"
    (folder / "new").unlink()


def _enter(folder: Path, _maps: Path, rng: Random) -> None:
    with WorkFolder(folder) as work:
        work.begin(rng.choice(("f" * 64, "e" * 64)))
        work.read_plan()
        for window in WINDOWS:
            if not work.has_block(window.key):
                work.write_block(window.key, {"basecolor": np.zeros((BLOCK, BLOCK, 3), np.float32),
                                              "roughness": np.zeros((BLOCK, BLOCK), np.float32)})
            assert work.has_block(window.key)
        if rng.random() < 0.3:
            work.remove()


def _merge(folder: Path, maps: Path, _rng: Random) -> None:
    maps.mkdir(exist_ok=True)
    block_merge.merge(WorkFolder(folder).read_block, WINDOWS,
                      block_merge.Target(maps, "Subject", "exr", LAYERS))
