"""Pictures and tables of docs/head.md, from what tools/head_experiment.py found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from irpso_addon.blender.sample import contact_sheet
from irpso_addon.core.data import F32, F64, Bool, Solution
from irpso_addon.core.evaluation.metrics import FAIL, psnr
from irpso_addon.core.images.colour import linear_to_srgb
from irpso_addon.core.phrases import percent
from irpso_addon.core.resampling import at_size
from studies import pages

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "head.md"
IMAGES = ROOT / "docs" / "images"
TILE, CROP = 256, (24, 232)  # pixels: height of a picture's tile, and its columns that show the head
EXPOSURE = 1.25  # of the pictures of the head
GAINS = {"composite": 20, "base": 5, "lobes": 3, "relit": 5}  # errors are shown so many times larger
VISIBLE = 0.01  # of white: the paper's "error below 1 %"
SURE = 0.02
APART, SHARES = 1.5, (0.2, 0.8)  # roughness2 / roughness1, and weights, for which there are two lobes to be told apart


@dataclass(frozen=True)
class Options:
    """How much of everything."""

    folder: Path
    out: Path
    size: int = 512  # texels of the maps
    pixels: int = 384
    samples: int = 16
    cameras: int = 3
    lamps: int = 24
    one_passes: int = 1600  # of method paper, from one image
    many_passes: int = 800  # and from many, on maps half as wide: it takes so long


@dataclass(frozen=True)
class Pixels:
    """The truth as camera 1 sees it; row 0 at the bottom."""

    uv: F32  # (h, w, 2) of the pixels' centres
    shown: Bool  # (h, w)
    base: F32  # (h, w, 3) linear
    lobes: F32  # (h, w, 3) roughness1, roughness2, weight of lobe 1
    fit: F32  # (h, w, 4) the picture of the paper's setting
    relit: F32  # (h, w, 4) under the lamp held out


@dataclass(frozen=True)
class Result:
    """What one method found on its own grid, and what camera 1 then sees."""

    method: str
    base: F32
    lobes: F32
    true_base: F64 | F32
    true_lobes: F64 | F32
    seen: Bool  # where it is judged
    seconds: float
    view_base: F32  # (h, w, 3) in camera 1's pixels
    view_lobes: F32
    view_seen: Bool
    fit: F32  # (h, w, 4) as Pixels.fit, rendered with the maps found
    relit: F32
    solution: Solution | None = None


@dataclass(frozen=True)
class Record:
    """All of the experiment."""

    options: Options
    pixels: Pixels
    one: Sequence[Result]  # from one image
    many: Sequence[Result]  # from all of them
    auto: Solution  # of model auto, from all
    near: Bool  # texels that a highlight came near
    rendering: float  # seconds
    views: int


@dataclass(frozen=True)
class Row:
    """Figures of a result over some of its texels."""

    texels: int
    base: float  # dB, linear
    mae: tuple[float, ...]  # of roughness1, roughness2, weight
    fail: tuple[float, ...]  # share of them off by more than FAIL


@dataclass(frozen=True)
class Match:
    """How like two renders are."""

    db: float  # as displayed
    mean: float  # sum of absolute differences of radiance over the truth's sum
    visible: float  # share of pixels off by more than VISIBLE as displayed


def figures(result: Result, where: Bool) -> Row:
    """Over ``where``, which must hold a texel."""
    off = np.abs(result.lobes[where] - result.true_lobes[where]).astype(np.float64)
    base = psnr(float(np.mean((result.base[where].astype(np.float64) - result.true_base[where]) ** 2)))
    return Row(int(where.sum()), base, tuple(off.mean(0)), tuple((off > FAIL).mean(0)))


def composite(estimate: F32, truth: F32, where: Bool) -> Match:
    """Two renders (h, w, 4) compared over pixels that hold nothing but the head."""
    where = where & (truth[..., 3] > 0.999)
    off = np.abs(display(estimate)[where] - display(truth)[where]).astype(np.float64)
    a, b = estimate[where][:, :3].astype(np.float64), truth[where][:, :3].astype(np.float64)
    return Match(psnr(float(np.mean(off**2))), float(np.abs(a - b).sum() / b.sum()),
                 float((off.max(-1) > VISIBLE).mean()))


def parts(record: Record, result: Result) -> dict[str, Bool]:
    """The texels of many lights: all, those where there is something to be found, and the others by what is missing."""
    r1, r2, weight = np.moveaxis(result.true_lobes, -1, 0)
    apart, both = r2 > APART * r1, (weight > SHARES[0]) & (weight < SHARES[1])
    seen, near = result.seen, at_size(record.near.astype(np.float32), len(r1))[..., 0] > 0.5
    assert result.solution is not None
    sigma = result.solution.maps.roughness_sigma
    return {
        "all seen": seen,
        "two lobes apart, both with a share, a highlight near": seen & apart & both & near,
        "the same, no highlight near": seen & apart & both & ~near,
        "lobes alike (neck)": seen & ~apart,
        "one lobe with hardly a share (cheeks)": seen & apart & ~both,
        f"standard error of r1, r2 given as below {SURE}": seen & (sigma > 0) & (sigma < SURE),
    }


# ---- pictures


def draw(record: Record, folder: Path) -> None:
    """Write both pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    contact_sheet.save(folder / "head_one_image.jpg", _rows(record.pixels, record.one))
    contact_sheet.save(folder / "head_many_lights.jpg", _rows(record.pixels, record.many))


def _rows(pixels: Pixels, results: Sequence[Result]) -> list[list[tuple[str, F32]]]:
    """Composite, base colour, lobes, another lamp: truth, then each result and its error."""
    rows = [
        [("Composite: truth", _tile(display(pixels.fit)))],
        [("Base colour: truth", _tile(_encode(_cut(pixels.base, pixels.shown))))],
        [("r1, r2, weight: truth", _tile(_cut(pixels.lobes, pixels.shown)))],
        [("Another lamp: truth", _tile(display(pixels.relit)))],
    ]
    for result in results:
        where, name = result.view_seen & pixels.shown, result.method
        pairs = ((result.fit, pixels.fit), (result.relit, pixels.relit))
        (fit, relit) = ((display(estimate), display(truth)) for estimate, truth in pairs)
        matches = [f", {composite(estimate, truth, where).db:.1f} dB" for estimate, truth in pairs]
        base = psnr(float(np.mean((result.view_base[where] - pixels.base[where]).astype(np.float64) ** 2)))
        rows[0] += [(name, _tile(fit[0])), _error(*fit, where, "composite", matches[0])]
        rows[1] += [(name, _tile(_encode(_cut(result.view_base, where)))),
                    _error(result.view_base, pixels.base, where, "base", f", {base:.1f} dB")]
        rows[2] += [(name, _tile(_cut(result.view_lobes, where))),
                    _error(result.view_lobes, pixels.lobes, where, "lobes")]
        rows[3] += [(name, _tile(relit[0])), _error(*relit, where, "relit", matches[1])]
    return rows


def _error(estimate: F32, truth: F32, where: Bool, kind: str, note: str = "") -> tuple[str, F32]:
    return f"error x{GAINS[kind]}{note}", _tile(_cut(GAINS[kind] * np.abs(estimate - truth), where))


def display(render: F32) -> F32:
    """A render as shown, over black."""
    return _encode(render[..., :3] * EXPOSURE)


def _encode(linear: F32) -> F32:
    return linear_to_srgb(np.clip(linear, 0, 1))


def _cut(image: F32, where: Bool) -> F32:
    return np.where(where[..., None], image, 0).astype(np.float32)


def _tile(image: F32) -> F32:
    return at_size(np.clip(image, 0, 1), TILE)[:, CROP[0]:CROP[1]].astype(np.float32)


# ---- tables


def tables(record: Record) -> dict[str, str]:
    """The generated parts of the page, by the name of their mark."""
    return {"one": _table_one(record), "many": _table_many(record), "auto": _table_auto(record),
            "machine": _machine(record)}


def _table_one(record: Record) -> str:
    lines = ["| method | solve, s | base colour, dB | its level, median error | its hue | r1 MAE | r2 MAE | weight MAE "
             "| r1 off by > 0.1 | r2 | weight |", "|---|---|---|---|---|---|---|---|---|---|---|"]
    for result in record.one:
        row = figures(result, result.seen)
        level, hue = _level_and_hue(result)
        lines.append(f"| `{result.method}` | {result.seconds:.1f} | {row.base:.1f} | {level:.4f} | {hue:.4f} "
                     f"| {_three(row.mae)} | {_percent(row.fail)} |")
    return "\n".join([*_table_renders(record, record.one), "", *lines])


def _table_many(record: Record) -> str:
    lines = ["| texels | share | method | base colour, dB | r1 MAE | r2 MAE | weight MAE | r1 off by > 0.1 | r2 "
             "| weight |", "|---|---|---|---|---|---|---|---|---|---|"]
    groups = [parts(record, result) for result in record.many]
    for name in groups[0]:
        for result, group in zip(record.many, groups, strict=True):
            if group[name].any():
                row = figures(result, group[name])
                lines.append(f"| {name} | {percent(row.texels / result.seen.sum())} | `{result.method}` | "
                             f"{row.base:.1f} "
                             f"| {_three(row.mae)} | {_percent(row.fail)} |")
    spent = [f"| `{result.method}` | {result.seconds:.1f} | {sum(result.solution.seconds.values()):.1f} |"
             for result in record.many if result.solution is not None]
    return "\n".join([*_table_renders(record, record.many), "", *lines, "", "| method | solve, s | everything, s |",
                      "|---|---|---|", *spent])


def _table_renders(record: Record, results: Sequence[Result]) -> list[str]:
    lines = ["| rendered by Cycles with the maps found | method | dB as displayed | mean error | pixels off by > 1 % |",
             "|---|---|---|---|---|"]
    for name, kind in (("the composite", "fit"), ("under another lamp", "relit")):
        for result in results:
            match = composite(getattr(result, kind), getattr(record.pixels, kind), result.view_seen)
            lines.append(f"| {name} | `{result.method}` | {match.db:.1f} | {percent(match.mean, 2)} | "
                         f"{percent(match.visible, 1)} |")
    return lines


def _level_and_hue(result: Result) -> tuple[float, float]:
    """Median errors of base colour: of the mean of R, G and B, and of the differences R - G and G - B."""
    off = result.base[result.seen].astype(np.float64) - result.true_base[result.seen]
    return float(np.median(np.abs(off.mean(-1)))), float(np.median(np.abs(np.diff(off, axis=-1))))


def _three(values: Sequence[float]) -> str:
    return " | ".join(f"{value:.3f}" for value in values)


def _percent(values: Sequence[float]) -> str:
    return " | ".join(f"{percent(value, 1)}" for value in values)


def _table_auto(record: Record) -> str:
    return "\n".join(f"> `{model}`: {record.auto.why[name]}" for name, model in record.auto.model.items())


def _machine(record: Record) -> str:
    o, device = record.options, record.auto.device
    return "\n".join([
        pages.measured(device["renderer"], f"Blender {bpy.app.version_string}"),
        f"{record.views} references of {o.pixels} x {o.pixels} pixels ({o.samples} samples), rendered in "
        f"{record.rendering:.0f} s. Maps of {o.size} x {o.size} texels.",
        f"Method `paper`: {o.one_passes} passes from one image; {o.many_passes} from many, on maps of {o.size // 2} x "
        f"{o.size // 2}."])


def write(record: Record, page: Path = PAGE) -> None:
    """Put the tables between the page's marks."""
    pages.fill(page, tables(record))
