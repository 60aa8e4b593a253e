"""captures.json: which image was taken by which camera under which lights."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from ..errors import BadInput
from ..images.response import LEAST_RESPONSE, LEAST_SHOULDER, MOST_BLACK, MOST_RESPONSE, MOST_SHOULDER
from ..storage.text_file import read_text

MOST_EXPOSURE = 64  # EV, either way
MOST_TURN = 3600.0  # degrees, either way
MOST_VIGNETTING = 16.0  # power of the cosine, either way
MOST_TINT = 10.0  # factor, and 1 over it the least
MOST_AMBIENT = 1e6  # W/(m^2 sr)


@dataclass(frozen=True)
class CaptureView:
    """One entry of a capture file; objects by their names in the scene."""

    image: Path  # absolute, or relative to the working directory as the capture file's own path is
    camera: str
    lights: tuple[str, ...]  # each once; none: the world alone
    exposure: float = 0.0  # EV; image = radiance * 2^exposure
    mask: Path | None = None
    colorspace: str | None = None
    vignetting: float = 0.0  # as View's
    ambient: Path | None = None  # as View's
    flat: Path | None = None
    world: str | None = None  # of that name; None: the scene's
    turn: float = 0.0  # degrees about Z by which the world is turned, against the clock seen from above
    response: float = 1.0  # as View's
    shoulder: float = 1.0  # as View's
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)  # as View's
    black_level: tuple[float, float, float] = (0.0, 0.0, 0.0)  # as View's
    ambient_radiance: tuple[float, float, float] = (0.0, 0.0, 0.0)  # as View's


def read_captures(path: Path) -> list[CaptureView]:
    """The views of ``path``; image paths in it are relative to its folder.  Raises BadInput, one line."""
    return parse_captures(read_text(path), path)


def parse_captures(text: str, path: Path) -> list[CaptureView]:
    """The views in ``text``, the content of ``path``.  Unknown keys are ignored.  Raises BadInput."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        line = getattr(error, "lineno", None)
        cure = "write / in paths, not \\" if "escape" in str(error) else "correct or rewrite it"
        raise BadInput(f"{path}: is not JSON{f' (line {line})' if line else ''}; {cure}") from None
    views = content.get("views") if isinstance(content, dict) else None
    if not isinstance(views, list) or not views:
        raise BadInput(f'{path}: has no views; write {{"views": [{{"image", "camera", "lights"}}, ...]}}')
    found = [_view(entry, index, path) for index, entry in enumerate(views)]
    for index, entry in enumerate(views):
        if entry in views[:index]:
            raise BadInput(f"{path}: view {index}: is the same as view {views.index(entry)}; list it once")
    return found


def _view(entry: Any, index: int, path: Path) -> CaptureView:
    def bad(what: str) -> NoReturn:
        raise BadInput(f"{path}: view {index}: {what}")

    def text(key: str, needed: bool) -> str | None:
        value = entry.get(key)
        if value is None and not needed:
            return None
        if not _is_name(value):
            bad(f'"{key}" {"is missing" if value is None else "is not a name"}; it must be text')
        return str(value)

    if not isinstance(entry, dict):
        bad('is not an object; it must have "image", "camera" and "lights"')
    lights = entry.get("lights")
    if not isinstance(lights, list):
        bad('"lights" is missing; list the names of the lights that were on, [] for the world alone')
    if not all(_is_name(name) for name in lights):
        bad('"lights" contains something that is not a name; it must be text')
    if len(set(lights)) < len(lights):
        bad('"lights" names a light twice; name each once')

    def number(key: str, unit: str, most: float, least: float | None = None, missing: float = 0.0) -> float:
        value = entry.get(key)
        if value is None:
            return missing
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            bad(f'"{key}" is not a number; it must be {unit}')
        span = f"{-most:g} and {most:g} {unit}" if least is None else f"{least:g} and {most:g}"
        if not (-most if least is None else least) <= value <= most:  # so is NaN
            bad(f'"{key}" is out of range; it must be between {span}')
        return float(value)

    exposure, turn = number("exposure", "EV", MOST_EXPOSURE), number("turn", "degrees", MOST_TURN)
    vignetting = number("vignetting", "powers of the cosine", MOST_VIGNETTING)
    response = number("response", "an exponent", MOST_RESPONSE, LEAST_RESPONSE, 1.0)
    shoulder = number("shoulder", "a ratio", MOST_SHOULDER, LEAST_SHOULDER, 1.0)

    def color(key: str, least: float, most: float, missing: float = 0.0) -> tuple[float, float, float]:
        value = entry.get(key)
        if value is None:
            return missing, missing, missing
        if not isinstance(value, list) or len(value) != 3 or any(
                isinstance(part, bool) or not isinstance(part, (int, float)) or not least <= part <= most
                for part in value):
            bad(f'"{key}" is not a color; it must be [red, green, blue], each between {least:g} and {most:g}')
        red, green, blue = map(float, value)
        return red, green, blue

    def file(key: str) -> Path | None:
        name = text(key, False)
        return None if name is None else _located(path.parent, name)

    image, camera = text("image", True), text("camera", True)
    assert image is not None and camera is not None  # text() raised otherwise
    return CaptureView(
        image=_located(path.parent, image), camera=camera, lights=tuple(lights), exposure=exposure,
        mask=file("mask"), colorspace=text("colorspace", False), ambient=file("ambient"), flat=file("flat"),
        world=text("world", False), turn=turn, vignetting=vignetting, response=response, shoulder=shoulder,
        black_level=color("black_level", -MOST_BLACK, MOST_BLACK), tint=color("tint", 1 / MOST_TINT, MOST_TINT, 1.0),
        ambient_radiance=color("ambient_radiance", 0, MOST_AMBIENT),
    )


def _located(folder: Path, name: str) -> Path:
    r"""``name`` in ``folder``, also as it is written on Windows (``refs\a.exr``) where that is where the file is."""
    path, translated = folder / name, folder / name.replace("\\", "/")
    return translated if os.path.isfile(translated) and not os.path.isfile(path) else path


def _is_name(value: Any) -> bool:
    """Text that a path or an object's name can be: no control characters, no lone surrogates."""
    return (
        isinstance(value, str) and bool(value.strip())
        and not any(c < " " or c == "\x7f" or "\ud800" <= c <= "\udfff" for c in value)
    )
