"""irpso demo: make a scene with known truth, render it with Cycles, recover it, compare."""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..blender import files
from ..blender.sample import contact_sheet, demo
from ..core.data import F32, F64, Bool, Maps, Solution
from ..core.evaluation.metrics import psnr
from ..core.images.colour import linear_to_srgb
from ..core.images.image_writer import write_image
from ..core.job import Progress
from ..core.params import SolveSettings
from ..core.phrases import percent
from ..core.storage.output_transaction import OutputTransaction
from . import console
from .solve import Request, solve

CONFIDENT = 0.5
TILE = 256  # pixels in the picture
WHITE = 0.2  # error that the picture shows as white
BAR = 10  # pixels: height of the colour bar below an error


@dataclass(frozen=True)
class Scores:
    """How far the maps are from the truth, over the solved texels."""

    albedo_psnr: float  # dB, linear
    rough_mae: float
    rough_median: float
    rough_mae_confident: float
    confident: float  # share of the solved texels


def run(arguments: argparse.Namespace) -> None:
    """The command.  Raises BadInput."""
    started = time.perf_counter()
    out: Path = arguments.out
    with OutputTransaction(out) as staging:  # proves that the folder can be written
        staging.publish()
    made = make(out)
    write_truth(out / "truth", made)
    rendered = time.perf_counter()
    solution = solve(Request(
        scene=made.scene, out=out, settings=SolveSettings(size=demo.TEXELS), captures=made.captures))
    relit = out / "solved_relit.exr"
    with console.quiet():
        files.open_blend(out / "scene_irpso.blend")
        demo.render_held_out(relit)
    truth_relit, solved_relit = demo.read_render(made.relit), demo.read_render(relit)
    scores = score((made.base_color, made.roughness), solution.maps)
    relight = _psnr(_display(truth_relit), _display(solved_relit), truth_relit[..., 3] > 0.999)
    contact_sheet.save(out / "demo.jpg", _tiles(made, solution.maps, scores, relight, truth_relit, solved_relit))
    _print_scores(scores, relight, solution, rendered - started, time.perf_counter() - started)
    console.say(f"{out / 'demo.jpg'}: truth, estimate and error side by side")


def score(truth: tuple[F32, F32], maps: Maps) -> Scores:
    """The maps against the true base colour and roughness of the same size, texel by texel."""
    base, rough = truth
    solved = maps.coverage & ~maps.filled
    error = np.abs(maps.roughness - rough)
    sure = solved & (maps.confidence > CONFIDENT)
    return Scores(
        albedo_psnr=_psnr(maps.base_color, base, solved),
        rough_mae=float(error[solved].mean()), rough_median=float(np.median(error[solved])),
        rough_mae_confident=float(error[sure].mean()) if sure.any() else float("nan"),
        confident=float(sure.sum() / solved.sum()))


def write_truth(folder: Path, made: demo.Demo) -> None:
    """The true maps, under the names that `irpso compare --truth` looks for."""
    folder.mkdir(exist_ok=True)
    for role, array in (("basecolor", made.base_color), ("roughness", made.roughness[..., None])):
        write_image(folder / f"{demo.NAME}_{role}.exr", array, kind="exr", color=role == "basecolor")


def make(out: Path, plan: demo.Plan = demo.Plan()) -> demo.Demo:  # noqa: B008  # frozen
    """The demo's scene and references in ``out``, with progress shown."""
    result: demo.Demo | None = None
    with console.progress() as show, console.quiet():
        for step in demo.make(out, plan):
            if isinstance(step, Progress):
                show(step)
            else:
                result = step
    assert result is not None
    return result


def _print_scores(scores: Scores, relight: float, solution: Solution, rendering: float, total: float) -> None:
    console.say("")
    console.table(("against the truth", "value"), (
        ("base colour, PSNR (dB)", f"{scores.albedo_psnr:.1f}"),
        ("roughness, mean error", f"{scores.rough_mae:.4f}"),
        ("roughness, median error", f"{scores.rough_median:.4f}"),
        ("roughness, mean error where confident", f"{scores.rough_mae_confident:.4f}"),
        ("confident texels", f"{percent(scores.confident)}"),
        ("new light and camera, PSNR (dB)", f"{relight:.1f}"),
        ("rendering the references (s)", f"{rendering:.1f}"),
        ("solve stage (s)", f"{solution.seconds['solve']:.1f}"),
        ("everything (s)", f"{total:.1f}"),
    ))
    console.say("")


# ---- the picture


def _tiles(
    made: demo.Demo, maps: Maps, scores: Scores, relight: float, truth: F32, solved: F32,
) -> list[list[tuple[str, F32]]]:
    """Three rows, base colour, roughness and the new light: truth, estimate, error."""
    seen = maps.coverage & ~maps.filled
    base_error = np.where(seen, np.abs(maps.base_color - made.base_color).max(-1), 0)
    rough_error = np.where(seen, np.abs(maps.roughness - made.roughness), 0)
    relit_error = np.abs(_display(solved) - _display(truth)).max(-1)
    label = f"error, 0 to {WHITE:g}"
    return [
        [("Base colour: truth", _tile(_encode(made.base_color))), ("recovered", _tile(_encode(maps.base_color))),
         (f"{label}    ({scores.albedo_psnr:.1f} dB)", _with_bar(base_error))],
        [("Roughness: truth", _tile(_grey(made.roughness))), ("recovered", _tile(_grey(maps.roughness))),
         (f"{label}    (mean {scores.rough_mae:.3f})", _with_bar(rough_error))],
        [("New light: truth", _tile(_display(truth))), ("recovered", _tile(_display(solved))),
         (f"{label}    ({relight:.1f} dB)", _with_bar(relit_error))],
    ]


def _tile(image: F32) -> F32:
    """The image at TILE x TILE: each pixel the mean of those whose centres fall into it (or the nearest one).

    `resampling.at_size` would leave pixels out where the size is no multiple of TILE.
    """
    edges = np.linspace(0, image.shape[0], TILE + 1).astype(int)
    means: F32 | F64 = image
    for axis in (0, 1):
        total = np.concatenate([np.zeros_like(means.take([0], axis)), np.cumsum(means, axis, np.float64)], axis)
        shape = [1, 1, 1]
        shape[axis] = TILE
        means = np.diff(total.take(edges, axis), axis=axis) / np.maximum(np.diff(edges), 1).reshape(shape)
    return means.astype(np.float32)


def _grey(values: F32) -> F32:
    """(h, w) as (h, w, 3)."""
    return np.repeat(values[..., None], 3, axis=2)


def _encode(linear: F32) -> F32:
    """As displayed: sRGB, clipped at white."""
    return linear_to_srgb(np.clip(linear, 0, 1))


def _display(render: F32) -> F32:
    """A render as shown, over black; both renders alike, for they share light and exposure."""
    return _encode(render[..., :3] * 1.6)


def _with_bar(error: F32) -> F32:
    """An error map with its colours from 0 to WHITE in a bar below it."""
    tile = _tile(_heat(error / WHITE))
    tile[:BAR + 2] = 0.11  # as around the tiles
    tile[:BAR] = _heat(np.linspace(0, 1, TILE, dtype=np.float32))
    return tile


def _heat(value: F32) -> F32:
    """0 black over red and yellow to 1 white."""
    return np.clip(np.stack([3 * value, 3 * value - 1, 3 * value - 2], -1), 0, 1)


def _psnr(a: F32, b: F32, where: Bool) -> float:
    return psnr(float(np.mean((a[where] - b[where]) ** 2, dtype=np.float64)))
