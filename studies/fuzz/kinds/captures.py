"""captures.json: its grammar with odd values, its bytes spoilt, and places that are no file."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

from irpso_addon.core.capture.captures import read_captures

from .. import spoil
from ..case import Box

KEYS = ("image", "camera", "lights", "exposure", "mask", "colorspace", "views", "made by")
NESTED = ("[" * 100_000, '{"views":' * 100_000, '{"views": [' + "[" * 2000 + "]" * 2000 + "]}",
          '{"a":' * 900 + "1" + "}" * 900)


def prepare(_folder: Path) -> None:
    """Nothing is shared."""


def content(rng: Random) -> bytes:
    """A capture file, more or less."""
    kind = rng.random()
    if kind < 0.01:
        return rng.choice(NESTED).encode()
    if kind < 0.02:
        return rng.randbytes(rng.randrange(200))
    if kind < 0.05:
        content: Any = spoil.value(rng)
    else:
        views: list[Any] = [_view(rng) for _ in range(rng.choice((1, 1, 2, 5, 40)))]
        content = {"views": views, "version": 1}
        for _ in range(rng.choice((0, 1, 1, 2, 5))):
            _spoil_value(content, views, rng)
    try:
        text = json.dumps(content, ensure_ascii=rng.random() < 0.5, indent=rng.choice((None, 1)))
    except ValueError:  # numbers that are too long to be written
        text = '{"views": [{"image": "a", "camera": "b", "lights": ["c"], "exposure": 1' + "0" * 5000 + "}]}"
    data = text.encode("utf-8", "surrogatepass")
    data = rng.choice((b"", b"", b"", b"\xef\xbb\xbf")) + data
    if rng.random() < 0.05:
        data = text.encode(rng.choice(("utf-16", "utf-32", "utf-16-le")), "surrogatepass")
    return spoil.spoilt(data, rng) if rng.random() < 0.4 else data


def _view(rng: Random) -> dict[str, Any]:
    view = {"image": f"refs/{rng.randrange(9)}.exr", "camera": "Cam", "lights": ["Key", "Fill"][:rng.randrange(1, 3)]}
    return view | ({"exposure": rng.uniform(-3, 3)} if rng.random() < 0.5 else {})


def _spoil_value(content: dict[str, Any], views: list[Any], rng: Random) -> None:
    kind = rng.randrange(8)
    view = rng.choice(views)
    if kind == 0:
        content[rng.choice(KEYS)] = spoil.value(rng)
    elif kind == 1:
        views[rng.randrange(len(views))] = spoil.value(rng)
    elif not isinstance(view, dict):
        return
    elif kind == 2:
        view.pop(rng.choice(list(view)), None) if view else None
    elif kind == 3:
        view["exposure"] = spoil.number(rng)
    elif kind == 4:
        view["lights"] = [spoil.word(rng) for _ in range(rng.randrange(4))]
    elif kind == 5:
        view[rng.choice(("image", "mask", "camera", "colorspace"))] = spoil.word(rng)
    else:
        view[rng.choice(KEYS)] = spoil.value(rng)


def make(_shared: None, rng: Random, box: Box) -> Callable[[], None]:
    """A file with such a content, or something else in its place."""
    path = box.given / spoil.file_name(rng, ".json") if rng.random() < 0.1 else box.given / "captures.json"
    path.write_bytes(content(rng))
    if rng.random() < 0.03:
        path = spoil.odd_place(path, rng)
    elif rng.random() < 0.002:
        with path.open("wb") as file:
            file.truncate(3_000_000_000)  # a hole: no disk is taken
    box.names = (path.name,)
    return lambda: check(path)


def check(path: Path) -> None:
    """Reads it; whatever comes out keeps the contract."""
    views = read_captures(path)
    assert views
    for view in views:
        assert view.camera.strip() and len(set(view.lights)) == len(view.lights)
        assert math.isfinite(view.exposure) and -64 <= view.exposure <= 64
        assert math.isfinite(view.turn)
        for file in (view.image, view.mask):
            assert file is None or os.fsencode(file)
