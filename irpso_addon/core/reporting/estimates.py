"""How long a solve will take, and how much memory, before it starts.

Seconds of a stage are a sum over what it has to do, measured once on a small machine, times a factor that the last
solves on this machine have shown.  Bytes are counted from the textures and arrays that are alive together.
"""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..errors import BadInput
from ..maps.stride import stride_of
from ..params import SolveSettings
from ..shading.environment import COUNT, LEVELS, NODE_ROWS, NODES, PARTS, SHADOW_SIDE
from ..storage.text_file import read_text
from ..tiled.uv_blocks import BLOCK, FIRST_UDIM, HALO, PICTURES, all_blocks, is_large, layout
from .report import write_report

COVERED = 0.8  # of a map's texels lie in UV islands ...
SHOWN = 0.35  # ... and of a picture's pixels show the object, ...
SIDE = 0.5  # ... of whose texels a camera sees so many
ATLAS_BYTES = 134_000_000  # at most, see gpu/observe/observation_atlas.py
GRID_BYTES = 3 * 16  # of a texel: its G-buffer, ...
SOLVE_BYTES = 14 * 16  # ... the search's textures, of the texels that are solved, ...
MAPS_BYTES = 10 * 16  # ... and those of the maps, which come later
HOST_BYTES = 150_000_000  # of a process before it reads anything
HOST_TEXEL_BYTES = 48
TRIANGLE_BYTES = 168  # of a triangle on the device, see gpu/gbuffer/gbuffer.py, ...
HOST_TRIANGLE_BYTES = 500  # ... and in the process, Blender's evaluated mesh included
ENVIRONMENT_BYTES = 8 * NODES + 16  # of a pixel, see gpu/observe/environment_light.py
# Of an environment's shadow maps and its directions with all their parts, see gpu/observe/environment_light.py, ...
AROUND_BYTES = COUNT * (SHADOW_SIDE**2 * 2 + 32 * sum(PARTS**n for n in range(LEVELS + 1)))
AROUND_PIXEL_BYTES = 16 * (1 + NODES) + 64  # ... and of a pixel's sums, and a batch's light: freed before the search
REDUCED = 0.99  # share of the pixels below which that is told
KEPT_PIXEL, KEPT_BYTES = 17, 400_000_000  # of pictures that are kept for a second look, and the most of all of them
READING = 3  # pictures in memory at a time
FURTHEST = 1000.0  # times faster or slower than the small machine: beyond, something else was measured

# Of the small machine (2 cores, software OpenGL): what a stage takes in any case, in seconds.
FIXED = {"start": 1.5, "gbuffer": 0.1, "observe": 0.8, "maps": 0.4}
# Microseconds of a triangle: to read the mesh, to make its buffers, to draw it through a camera, into a shadow map.
MESH_READ, MESH_BUFFERS, MESH_DRAWN, MESH_SHADOW = 2.2, 0.7, 0.35, 0.2
# More for programs that were never compiled on this machine (drivers keep them); those of the search are made for a
# number of views and cameras.
COMPILING = {"observe": 1.0, "solve": 2.0, "maps": 1.0}  # of the search: for each of
PROGRAMS = {"lambert": ("one",), "one-lobe": ("one",), "one-lobe-specular": ("one",), "one-lobe-metallic": ("one",),
            "two-lobe": ("two",), "auto": ("one", "two")}
COMPILED = "compiled "  # begins the keys that remember for which
MOSTLY = 3.0  # a solve takes this much less without compiling, at most
WHOLE = "whole "  # begins the keys of what the last solve took in all, over the sum of its stages
# Of the search: seconds in any case, microseconds a texel, and more for each view.
SEARCH = {"lambert": (0.4, 2.0, 0.2), "one-lobe": (0.4, 2.0, 0.2), "one-lobe-specular": (1.6, 1.7, 0.2),
          "one-lobe-metallic": (0.4, 4.0, 0.4), "two-lobe": (0.8, 4.0, 0.4), "auto": (0.6, 4.5, 0.3)}
# An environment: seconds of its shadows, microseconds of a pixel that it lights; and of the search for each view.
AROUND, AROUND_PIXEL, AROUND_SEARCH = 2.0, 50.0, 3.4
# Seconds of a view whose lamps and exposures are corrected, and of a world whose turn is.
CORRECTED, TURNED = 0.09, 1.4
# Of models that `auto` tries under worlds: seconds of each view, and more of each that has lamps, too, under which
# models predict about alike, so that more are tried.
TRIED_AROUND, TRIED_BESIDE_LAMPS = 0.25, 1.0
# Of a picture that is reduced: seconds of each pixel that its file has more.  24 megapixels of a JPEG, of a TIFF of
# 16 bits and of a DNG take 0.03, 0.07 and 0.1 microseconds each.
READING_PIXEL = 0.07e-6
METHODS = {"refined": 1.0, "draft": 0.8, "swarm": 3.5}  # times the above; "paper" goes by its iterations
PAPER = 0.04  # microseconds a texel, view and iteration
PICTURE_SECONDS = 1.0  # of indirect light, by Cycles
STAGES = ("start", "gbuffer", "observe", "calibrate", "solve", "maps", "indirect")
BLOCK_SECONDS = 1.0  # of maps in blocks: of one in any case, ...
GROWN = ((BLOCK + 2 * HALO) / BLOCK) ** 2  # ... what is solved for a texel that is kept, ...
SEEN = 3.0  # ... and how many blocks take a pixel
PICTURE_BYTES = 16  # of a developed pixel
BLOCK_BYTES = 60  # of a texel in a block's file, ...
MAP_BYTES = 56  # ... and in the files of all maps, where they do not compress
DEVELOPING = 200_000_000  # bytes at most while a picture is developed

Factors = Mapping[str, float]  # seconds on this machine / on the small one, by stage; of the search, by its kind


@dataclass(frozen=True)
class ViewSize:
    """A view as far as it makes work."""

    width: int
    height: int
    camera: str
    lights: int
    environment: str = ""  # key of the one that lights it, "" where none does


@dataclass(frozen=True)
class Estimate:
    """What a solve will need."""

    seconds: float
    gpu_bytes: int
    host_bytes: int  # of its process, without what a software renderer holds
    disk_bytes: int  # at most, while it runs; the maps' files alone are less
    learnt: bool  # from solves on this machine
    reduced: float = 1.0  # share of the pictures' pixels that fits into the memory
    bounced: float = 0.0  # seconds if light bounces, where a solve finds that out on the way; else 0


def bytes_per_pixel(views: int, lobes: int, cameras: int, environments: int = 0) -> int:
    """GPU memory that all views take together, for each pixel that one of them has; ``lobes`` over all views.

    ``environments``: pairs of a camera and an environment that shines on what it sees.
    """
    return 16 * (2 * views + lobes) + 72 * cameras + ENVIRONMENT_BYTES * environments


def estimate(
    views: Sequence[ViewSize], settings: SolveSettings, factors: Factors, memory: float, *, rounds: bool | None = False,
    udims: tuple[int, ...] = (FIRST_UDIM,), triangles: int = 0,
) -> Estimate:
    """``memory``: GB that pictures may take.  ``rounds``: indirect light is likely to be rendered, and solved again.

    None: a solve looks on the way whether that is needed.  ``udims``: of the squares that are solved.  ``triangles``:
    of the mesh.
    """
    if rounds is None:
        without, bounced = (estimate(views, settings, factors, memory, rounds=some, udims=udims, triangles=triangles)
                            for some in (False, True))
        return replace(without, bounced=bounced.seconds)
    large, reduced = is_large(settings.size, udims), reduced_share(views, settings, memory, udims)
    lit, each = _lit(views), _bytes_of_each(views)
    largest = max((v.width * v.height for v in views), default=0)
    taken = predicted(views, settings, factors, reduced, rounds, udims, triangles)
    known = [factors.get(key) for key in (_key(stage, settings) for stage in taken)]
    usual = _usual(factors)
    seconds = sum(s * (factor or usual) for s, factor in zip(taken.values(), known, strict=True))
    seconds *= factors.get(_whole(settings, rounds), 1.0)
    side = layout(settings.size, udims).size if large else settings.size
    texels, pixels = side**2, largest * reduced
    around = AROUND_BYTES + AROUND_PIXEL_BYTES * pixels if lit else 0.0
    blocks = sum(2 + v.lights + (2 * NODE_ROWS if lit else 0) for v in views)
    atlas = min(ATLAS_BYTES, 512 * 128 * 16 * blocks)
    solving = atlas + SOLVE_BYTES * texels / _stride(views, replace(settings, size=side), reduced) ** 2
    reading = DEVELOPING if large else int(READING * min(60 * largest, DEVELOPING + 20 * pixels))
    found = Estimate(
        seconds=seconds, disk_bytes=2 * MAP_BYTES * texels,
        gpu_bytes=int(each * pixels + max(GRID_BYTES * texels + max(solving, MAPS_BYTES * texels), around)
                      + TRIANGLE_BYTES * triangles),
        host_bytes=int(HOST_BYTES + HOST_TEXEL_BYTES * texels + 8 * pixels * len(views) + reading
                       + min(KEPT_PIXEL * pixels * len(views), KEPT_BYTES) + HOST_TRIANGLE_BYTES * triangles),
        learnt=bool(factors), reduced=reduced)
    if not large:
        return found
    whole = len(udims) * settings.size**2
    disk = PICTURE_BYTES * sum(v.width * v.height for v in views) + (BLOCK_BYTES + MAP_BYTES) * whole
    return replace(found, disk_bytes=disk, reduced=1.0)  # blocks take pictures as they are


def reduced_share(
    views: Sequence[ViewSize], settings: SolveSettings, memory: float, udims: tuple[int, ...] = (FIRST_UDIM,),
) -> float:
    """Of the pictures' pixels, as many as fit into ``memory`` GB; of maps in blocks it is their plan's."""
    memory *= PICTURES if is_large(settings.size, udims) else 1.0
    largest = max((v.width * v.height for v in views), default=0)
    return min(1.0, memory * 1e9 / max(_bytes_of_each(views) * largest, 1))  # no picture may be readable


def _lit(views: Sequence[ViewSize]) -> set[tuple[str, str]]:
    return {(v.camera, v.environment) for v in views if v.environment}


def _bytes_of_each(views: Sequence[ViewSize]) -> int:
    """As `bytes_per_pixel`."""
    return bytes_per_pixel(len(views), sum(v.lights for v in views), len({v.camera for v in views}), len(_lit(views)))


def check_disk(folder: Path, size: int, there: int = 0) -> None:
    """Raises BadInput where ``folder`` (or where it will be) has no room for ``size`` bytes, ``there`` being used."""
    place = folder.resolve()
    while not os.path.exists(place) and place != place.parent:
        place = place.parent
    free = shutil.disk_usage(place).free
    if free < size - there:
        raise BadInput(f"{folder}: the solve may take {gigabytes(size - there)} of disk there, and {gigabytes(free)} "
                       "are free; free space, choose another folder, or lower Size")


def size_of(folder: Path) -> int:
    """Bytes of the files below a folder; 0 where there is none."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) if os.path.isdir(folder) else 0


def predicted(
    views: Sequence[ViewSize], settings: SolveSettings, known: Collection[str], reduced: float = 1.0,
    rounds: bool = False, udims: tuple[int, ...] = (FIRST_UDIM,), triangles: int = 0,
) -> dict[str, float]:
    """Seconds of each stage on the small machine; ``known``: keys of the factors that were learnt."""
    if is_large(settings.size, udims):
        plan = predicted(views, replace(settings, size=layout(settings.size, udims).size), known, reduced, rounds,
                         triangles=triangles)
        start, squares, pixels = plan.pop("start"), len(udims), sum(v.width * v.height for v in views)
        each = _once(views, settings, SEEN)  # of one square; the plan has corrected lamps
        fixed = BLOCK_SECONDS * len(all_blocks(settings.size, udims))
        return {"start": start, "plan": sum(plan.values()), "pictures": 0.3e-6 * pixels,
                "observe": each["observe"] + fixed, "solve": GROWN * squares * each["solve"],
                "maps": GROWN * squares * each["maps"], "merge": 0.5e-6 * squares * settings.size**2}
    first = _once(views, settings, reduced)
    if rounds:  # a small round and another whole one
        small = _once(views, replace(settings, size=min(settings.size, 512)), reduced)
        first = {stage: 2 * s + small[stage] for stage, s in first.items()}
    result = {stage: first.get(stage, 0.0) + FIXED.get(stage, 0.0) for stage in STAGES[:-1]}
    for stage, microseconds in _of_a_triangle(views).items():
        result[stage] += 1e-6 * triangles * microseconds
    result["observe"] += READING_PIXEL * (1 - reduced) * sum(v.width * v.height for v in views)
    for stage, seconds in COMPILING.items():
        result[stage] += seconds * len(_to_compile(stage, views, settings, known))
    if rounds:
        lit = {(v.camera, v.width, v.height, i) for i, v in enumerate(views)}
        result["indirect"] = 2 * PICTURE_SECONDS * (len(lit) + len({v.camera for v in views}))
    return result


def _of_a_triangle(views: Sequence[ViewSize]) -> dict[str, float]:
    """Microseconds of each stage: the first one checks outlines, the last one looks once more."""
    cameras, lights = len({(v.camera, v.width, v.height) for v in views}), sum(v.lights for v in views)
    shadows = MESH_SHADOW * (lights if cameras == len(views) else lights / cameras)  # each camera sees every lamp
    return {"start": MESH_READ + 1.5 * MESH_DRAWN * cameras, "gbuffer": MESH_BUFFERS,
            "observe": MESH_DRAWN * cameras + shadows, "maps": 2 * MESH_DRAWN * cameras + shadows}


def _once(views: Sequence[ViewSize], settings: SolveSettings, reduced: float) -> dict[str, float]:
    """Seconds of one round's stages that grow with texels and pixels, of which ``reduced`` times as many are read."""
    texels, count = COVERED * settings.size**2, len(views)
    pixels = reduced * sum(v.width * v.height for v in views)
    lobes = reduced * sum(v.width * v.height * v.lights for v in views)
    cameras = {(v.camera, v.width, v.height) for v in views}
    shown = SHOWN * reduced * sum(w * h for _, w, h in cameras)
    passes = min(120, len(cameras) * (5 if shown > texels else 12))  # of gpu/maps/albedo.py
    around = {(v.camera, v.width, v.height, v.environment) for v in views if v.environment}
    shadows = AROUND * len({environment for *_, environment in around})
    around_pixels = SHOWN * reduced * sum(w * h for _, w, h, _ in around)
    fixed, base, more = SEARCH[settings.model]
    search = (base + more * count + AROUND_SEARCH * sum(bool(v.environment) for v in views)) * METHODS.get(
        settings.method, 1.0)
    if settings.method == "paper":
        search = PAPER * count * settings.iterations
    if settings.model == "auto":
        fixed += sum(TRIED_AROUND + TRIED_BESIDE_LAMPS * bool(v.lights) for v in views if v.environment)
    return {"gbuffer": 0.1e-6 * texels, "calibrate": _corrected(views, settings),
            "observe": 0.25e-6 * (pixels + lobes) + shadows + 1e-6 * AROUND_PIXEL * around_pixels,
            "solve": fixed + 1e-6 * texels / _stride(views, settings, reduced) ** 2 * search,
            "maps": 0.4e-6 * pixels + 0.09e-6 * passes * texels}


def _corrected(views: Sequence[ViewSize], settings: SolveSettings) -> float:
    """Seconds of the search for what is off of lamps, exposures and worlds."""
    environments = {v.environment for v in views if v.environment}
    if environments:
        return TURNED * len(environments) if settings.lamps == "auto" else 0.0
    return CORRECTED * len(views) if "auto" in (settings.lamps, settings.exposures) else 0.0


def _stride(views: Sequence[ViewSize], settings: SolveSettings, reduced: float) -> int:
    """Every how many-th texel will be solved, as far as sizes tell."""
    if settings.method == "paper":
        return 1
    largest = min(reduced, 1.0) * max((v.width * v.height for v in views), default=0)
    return stride_of(np.array([SHOWN * largest / (SIDE * COVERED * settings.size**2)]), settings.size)


def learnt(
    factors: Factors, views: Sequence[ViewSize], settings: SolveSettings, seconds: Mapping[str, float], wall: float,
    udims: tuple[int, ...] = (FIRST_UDIM,), reduced: float = 1.0, triangles: int = 0,
) -> dict[str, float]:
    """The factors after a solve: ``seconds`` of its stages, ``wall`` of it all; ``reduced``: as of `reduced_share`.

    The mean with what was known; and a stage that compiled and was slow was mostly slow in compiling, so that half of
    the surprise (of its logarithm) is believed.
    """
    result = dict(factors)
    expectations = predicted(views, settings, factors, reduced, "indirect" in seconds, udims, triangles)
    measured = {**seconds, "start": max(wall - sum(seconds.get(s, 0.0) for s in expectations), 0.05)}
    for stage, expected in expectations.items():
        if stage in measured and expected > 0:
            key, factor = _key(stage, settings), measured[stage] / expected
            if 1 / FURTHEST < factor < FURTHEST:
                if _to_compile(stage, views, settings, factors) and factor > 1:
                    factor = _mean([factor, 1.0])
                result[key] = _mean([factor, factors[key]]) if key in factors else factor
    compiled = {stage for stage in expectations if _to_compile(stage, views, settings, factors)}
    known = {key for stage in compiled for key in _to_compile(stage, views, settings, factors)}
    again = predicted(views, settings, {*factors, *known}, reduced, "indirect" in seconds, udims, triangles)
    usual, expected_again = _usual(result), wall
    if compiled:  # the other stages tell how slow the machine is, and so what is left without its compiler
        others = sum(taken for stage, taken in seconds.items() if stage not in expectations)
        plain = {"start": max(measured["start"] - others, 0.05), "gbuffer": seconds.get("gbuffer", 0.0)}
        slow = _mean([plain[stage] / expectations[stage] for stage in plain
                      if plain[stage] > 0 and stage in expectations])
        expected_again = min(max(slow * sum(again.values()) + others / 2, wall / MOSTLY), wall)  # they compile too
    ratio = expected_again / max(sum(s * result.get(_key(stage, settings), usual) for stage, s in again.items()), 1e-3)
    if 1 / FURTHEST < ratio < FURTHEST:
        result[_whole(settings, "indirect" in seconds)] = ratio
    return {**result, **dict.fromkeys(_to_compile("solve", views, settings, ()), 1.0)}


def read_factors(path: Path) -> dict[str, float]:
    """What was learnt; nothing where there is no such file, or something else in it."""
    try:
        content = json.loads(read_text(path))
        found = {str(key): float(value) for key, value in content["factors"].items()}
    except (BadInput, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
        return {}
    return {key: value for key, value in found.items() if 1 / FURTHEST < value < FURTHEST}


def write_factors(path: Path, factors: Factors) -> None:
    """Whole or not at all.  Raises BadInput."""
    write_report(path, {"factors": {key: round(value, 4) for key, value in sorted(factors.items())}})


def in_words(seconds: float) -> str:
    """As one would say it: "about 25 s", "about 3 min"."""
    if seconds < 90:
        step = 1 if seconds < 10 else 5
        return f"about {max(step, round(seconds / step) * step)} s"
    minutes = seconds / 60
    return f"about {round(minutes)} min" if minutes < 90 else f"about {minutes / 60:.1f} h"


def gigabytes(size: int) -> str:
    """As one would say it: "2.4 GB"."""
    return f"{size / 1e9:.1f} GB" if size >= 50_000_000 else "below 0.1 GB"


def _key(stage: str, settings: SolveSettings) -> str:
    return f"{stage} {settings.method} {settings.model}" if stage == "solve" else stage


def _whole(settings: SolveSettings, rounds: bool) -> str:
    return f"{WHOLE}{settings.method} {settings.model}{' indirect' if rounds else ''}"


def _usual(factors: Factors) -> float:
    """Of stages that nothing is known of."""
    return _mean([factor for key, factor in factors.items() if not key.startswith((COMPILED, WHOLE))])


def _to_compile(stage: str, views: Sequence[ViewSize], settings: SolveSettings, known: Collection[str]) -> list[str]:
    """Keys of the programs that a stage has to compile."""
    if stage not in COMPILING:
        return []
    names = [stage]
    if stage == "solve":
        kinds = ("paper",) if settings.method == "paper" else PROGRAMS[settings.model]
        if settings.method == "swarm":  # a search whose particles move is another program
            kinds = tuple(f"{kind} swarm" for kind in kinds)
        names = [f"{COMPILED}{kind}, {len(views)} views, {len({v.camera for v in views})} cameras" for kind in kinds]
    return [name for name in names if name not in known]


def _mean(factors: Sequence[float]) -> float:
    """Geometric; 1 of none."""
    return math.exp(sum(map(math.log, factors)) / len(factors)) if factors else 1.0
