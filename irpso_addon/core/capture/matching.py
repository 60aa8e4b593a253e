"""Which camera and lights a picture belongs to, by the names in its path, else by order."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath

MASK = "mask"  # last word of a file that masks another

Words = tuple[str, ...]


@dataclass(frozen=True)
class Match:
    """A picture with what its name, or its place in the order, says of it."""

    file: PurePath  # relative to the folder that was chosen
    camera: str | None = None
    lights: tuple[str, ...] = ()  # none: nothing says which
    mask: PurePath | None = None
    camera_by_order: bool = False
    lights_by_order: bool = False


def words(text: str) -> Words:
    """Words and numbers of a name: "Cam01_light-3", "cam 1 LIGHT.003" are the same.

    Accents that are letters of their own, as Mac OS may write them, join the letter before.
    """
    words = re.findall(r"\d+|[^\W\d_]+", unicodedata.normalize("NFC", text).lower())
    return tuple(str(int(word)) if word.isdecimal() else word for word in words)


def natural(path: PurePath) -> tuple[tuple[bool, int, str], ...]:
    """Key that sorts "view 2" before "view 10"."""
    return tuple((word.isdecimal(), int(word) if word.isdecimal() else 0, word) for word in words(str(path)))


def match(
    files: Sequence[PurePath], cameras: Sequence[str], lights: Sequence[str],
    flashes: Mapping[str, Sequence[str]] | None = None,
) -> list[Match]:
    """Files in natural order, masks beside their pictures.  ``flashes``: lights that hang on a camera.

    Names are looked for in the relative path; the longest win.  Where no file names a camera, cameras are taken in
    order if as many files come to each; likewise lights, one by one, where each camera has as many files as there are
    lights.
    """
    pictures = _pictures(sorted(files, key=natural))
    known = [(name, words(name), kind) for kind, names in enumerate((cameras, lights)) for name in names]
    matches = [_by_name(file, mask, known) for file, mask in pictures.items()]
    if not any(m.camera for m in matches):
        matches = _cameras_in_order(matches, cameras, lights)
    if not any(m.lights for m in matches):
        matches = _lights_in_order(matches, lights, flashes or {})
    return [m if m.lights or m.camera is None else replace(m, lights=tuple((flashes or {}).get(m.camera, ())))
            for m in matches]


def _pictures(files: Sequence[PurePath]) -> dict[PurePath, PurePath | None]:
    """Each picture with its mask."""
    stems = {words(str(file.with_suffix(""))): file for file in files}
    masks = {stems[stem[:-1]]: file for stem, file in stems.items() if stem[-1:] == (MASK,) and stem[:-1] in stems}
    return {file: masks.get(file) for file in files if file not in masks.values()}


def _by_name(
    file: PurePath, mask: PurePath | None, known: Sequence[tuple[str, tuple[str, ...], int]],
) -> Match:
    """A word of the path speaks for one name only; two cameras' names in one path say nothing.

    ``known``: name, its words, and whether it is a camera's (0) or a light's (1).
    """
    text = words(str(file.with_suffix("")))
    places = [(len(look), -at, name, kind) for name, look, kind in known if look
              for at in range(len(text) - len(look) + 1) if text[at:at + len(look)] == look]
    free, said = [True] * len(text), (dict[str, None](), dict[str, None]())
    for length, at, name, kind in sorted(places, key=lambda place: (-place[0], -place[1], place[3])):
        if all(free[-at:-at + length]):
            free[-at:-at + length] = [False] * length
            said[kind][name] = None
    camera = next(iter(said[0])) if len(said[0]) == 1 else None
    return Match(file, camera, tuple(said[1]), mask)


def _cameras_in_order(matches: list[Match], cameras: Sequence[str], lights: Sequence[str]) -> list[Match]:
    """One picture for each camera, or one under each light; all to the only camera."""
    if not cameras:
        return matches
    each, rest = divmod(len(matches), len(cameras))
    if rest or not each or (len(cameras) > 1 and each not in {1, len(lights)}):
        return matches
    order = sorted(cameras, key=lambda name: natural(PurePath(name)))
    return [replace(m, camera=order[i // each], camera_by_order=len(cameras) > 1) for i, m in enumerate(matches)]


def _lights_in_order(matches: list[Match], lights: Sequence[str], flashes: Mapping[str, Sequence[str]]) -> list[Match]:
    """The lights one by one, where every camera that is used has a picture for each and none has its own flash."""
    order = sorted(lights, key=lambda name: natural(PurePath(name)))
    used = [m.camera for m in matches]
    if None in used or len(order) < 2 or any(used.count(c) != len(order) or c in flashes for c in set(used)):
        return matches
    return [replace(m, lights=(order[used[:i].count(m.camera)],), lights_by_order=True) for i, m in enumerate(matches)]
