"""Bytes of a .blend spoilt, as far as Blender itself reads such a file; what it then holds is read by the add-on."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from random import Random

import bpy

from irpso_addon.blender import files

from .. import spoil, stage
from ..case import Box

HEAD = b"BLENDER"


prepare = stage.prepare  # the files that are spoilt


def make(shared: list[Path], rng: Random, box: Box) -> Callable[[], None]:
    """One of them: numbers and words in it exchanged, or bytes."""
    base = rng.choice(shared)
    shutil.copyfile(base.parent / stage.CAPTURES, box.given / stage.CAPTURES)
    data = bytearray(base.read_bytes())
    kind = rng.random()
    if kind < 0.7:  # in the data, not in how it is laid out: such files Blender opens
        for _ in range(rng.choice((1, 3, 10, 50))):
            at = rng.randrange(200, max(201, len(data) - 300_000))
            data[at] ^= 1 << rng.randrange(8)
    elif kind < 0.8:
        data[:] = spoil.spoilt(bytes(data), rng)
    elif kind < 0.9:
        del data[rng.randrange(len(data)):]
    else:
        data[:] = rng.choice((b"", HEAD, b"\x1f\x8b" + rng.randbytes(50), b"\x28\xb5\x2f\xfd" + rng.randbytes(50),
                              HEAD + b"-v502", rng.randbytes(100), b"\0" * 1000))
    path = box.given / spoil.file_name(rng, ".blend") if rng.random() < 0.1 else box.given / "scene.blend"
    path.write_bytes(data)
    if rng.random() < 0.05:
        path = spoil.odd_place(path, rng)
    box.memory = 3_000_000_000  # Blender's own
    box.names = (path.name,)
    return partial(run, path, rng, box)


def run(path: Path, rng: Random, box: Box) -> None:
    """Opens and reads it."""
    box.note("blender")
    files.open_blend(path)
    bpy.context.view_layer.update()
    box.names = (path.name, *({item.name for item in stage.everything()} - {""}), stage.CAPTURES)
    stage.read(rng, box.given)
