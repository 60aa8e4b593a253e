"""The result that lives with the file: its record on the object, beside the images that hold its maps.

The record is a custom property of the object, so that it is saved, undone and appended with it.  A file may hold
anything under its name.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from math import ceil, sqrt
from typing import Any

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...core.data import F32, Bool, Maps, Solution, ViewPicture
from ...core.errors import BadInput
from ...core.resampling import block_means, nearest
from ...core.tiled import npz_archive
from ..files import map_files, read_maps
from ..material.shown_model import shown_solution
from ..material.slot_names import names_of
from ..material.tags import maps_of
from .session import Result, object_by_uid, session

RECORD_TAG = "irpso_result"  # on an object: number and record of the result that its maps are
SMALL = 256  # texels of the maps that stand for those of a large solve, which are files
PICTURES = 2_000_000  # bytes of all pictures together
FORMAT = 1
UNNAMED = "maps of the file"
WHOLE = {"base_color", "roughness", "confidence", "error", "roughness_sigma", "basecolor_sigma"}  # that each result has


@dataclass(frozen=True)
class _Masks:
    """What the images do not tell."""

    covered: Bool
    filled: Bool


def write(obj: bpy.types.Object, result: Result) -> None:
    """The record of ``result``, whose maps have been put on ``obj``."""
    attach(obj, result, packed(obj, result))


def attach(obj: bpy.types.Object, result: Result, record: bytes) -> None:
    """The same, where `packed` has made the record before."""
    obj[RECORD_TAG] = {"number": str(result.number), "record": record}


def detach(obj: bpy.types.Object) -> None:
    """The maps of ``obj`` are about to be no result's."""
    if RECORD_TAG in obj:
        del obj[RECORD_TAG]


def packed(obj: bpy.types.Object, result: Result) -> bytes:
    """The record; some hundredths of a second."""
    solution = result.presented(obj)
    solution = replace(solution, pictures=_fewer_pixels(solution.pictures))
    maps = solution.maps
    content: dict[str, Any] = {
        "format": FORMAT, "label": result.label, "large": result.files is not None,
        "shape": tuple(maps.coverage.shape), "covered": np.packbits(maps.coverage), "filled": np.packbits(maps.filled),
        "solution": replace(solution, maps=_reduced(maps) if result.files is not None else _no_maps())}
    return npz_archive.packed(content)


def number_of(obj: bpy.types.Object) -> int:
    """Of the result whose maps the object has; 0: of none that is known."""
    told = obj.get(RECORD_TAG)
    number = told.get("number") if hasattr(told, "get") else None
    return int(number) if isinstance(number, str) and number.isdecimal() and len(number) < 30 else 0


def read(obj: bpy.types.Object) -> Result | None:
    """The result that the file has of ``obj``, its maps not read yet; None: none."""
    if "base_color" not in maps_of(obj):
        return None
    told = obj.get(RECORD_TAG)
    record = told.get("record") if hasattr(told, "get") else None
    if isinstance(record, bytes) and number_of(obj):
        with suppress(ValueError):
            return _of_record(obj, npz_archive.unpacked(record))
    if not WHOLE <= maps_of(obj).keys():  # saved while a solve ran: maps so far
        return None
    shown = shown_solution(obj, _no_maps())  # of an older file: what its materials say
    return Result(UNNAMED, shown, _files(obj), number_of(obj) or 1, names_of(obj, shown.model),
                  partial(_load, obj.session_uid, None))


def _of_record(obj: bpy.types.Object, content: Any) -> Result:
    """Raises ValueError for what `write` does not write."""
    try:
        solution, label, shape = content["solution"], content["label"], content["shape"]
        good = (content["format"] == FORMAT and isinstance(solution, Solution) and isinstance(label, str)
                and len(shape) == 2 and all(0 < side <= 1 << 16 for side in shape))
        if not good:
            raise ValueError
        if content["large"]:
            return Result(label, solution, _files(obj), number_of(obj), names_of(obj, solution.model))
        masks = _Masks(*(np.unpackbits(content[name], count=shape[0] * shape[1]).astype(bool).reshape(shape)
                         for name in ("covered", "filled")))
    except (KeyError, TypeError, AttributeError):
        raise ValueError("not written by irpso") from None
    return Result(label, solution, None, number_of(obj), names_of(obj, solution.model),
                  partial(_load, obj.session_uid, masks))


def _load(uid: int, masks: _Masks | None) -> Maps:
    """Raises BadInput where the object or an image is gone."""
    obj = object_by_uid(uid)
    if obj is None:
        raise BadInput("the object of this result was deleted; solve another")
    maps = read_maps(obj)
    if masks is None or masks.covered.shape != maps.coverage.shape:
        return maps
    return replace(maps, coverage=masks.covered, filled=masks.filled)


def _files(obj: bpy.types.Object) -> Any:
    with suppress(BadInput):
        return map_files(obj)
    return None


def _no_maps() -> Maps:
    none = np.zeros((1, 1), np.float32)
    return Maps(np.zeros((1, 1, 3), np.float32), none, none, none, none > 0, none > 0, none, none)


def _reduced(maps: Maps) -> Maps:
    """Of at most SMALL texels, to be looked at."""
    size = min(SMALL, maps.coverage.shape[0])

    def small(values: F32 | None) -> F32 | None:
        return None if values is None else np.asarray(block_means(values, size), np.float32)

    step = max(maps.coverage.shape[0] // size, 1)
    masks = {name: getattr(maps, name)[::step, ::step][:size, :size].copy() for name in ("filled", "coverage")}
    names = ("base_color", "roughness", "confidence", "error", "roughness_sigma", "base_sigma", "lobes", "specular")
    metallic = None if maps.metallic is None else nearest(maps.metallic, size)  # nothing in between
    return replace(maps, **{name: small(getattr(maps, name)) for name in names}, metallic=metallic, **masks)


def _fewer_pixels(pictures: tuple[ViewPicture, ...]) -> tuple[ViewPicture, ...]:
    """Those of the views, each so much smaller that together they take at most PICTURES."""
    step = ceil(sqrt(sum(p.reference.nbytes + p.predicted.nbytes for p in pictures) / PICTURES))
    if step <= 1:
        return pictures
    return tuple(replace(p, reference=p.reference[::step, ::step].copy(), predicted=p.predicted[::step, ::step].copy())
                 for p in pictures)


@persistent
def on_load(*_: object) -> None:
    """load_post handler: results are known by their materials before anybody renames one."""
    for obj in bpy.data.objects:
        if obj.type == "MESH" and RECORD_TAG in obj:
            session.results_of(obj)


@persistent
def on_save(*_: object) -> None:
    """save_pre handler: records go by the names that materials have now."""
    for obj in bpy.data.objects:
        if RECORD_TAG in obj and obj.is_editable:
            result = next((r for r in session.results_of(obj) if r.number == number_of(obj)), None)
            if result is not None and result.is_renamed(obj):
                with suppress(BadInput):
                    write(obj, result)


session.stored = read
