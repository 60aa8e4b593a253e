"""Pictures and tables of docs/head.md, from what tools/head_experiment.py found."""

from __future__ import annotations

import datetime
import os
import platform
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from irpso_addon.blender import picture
from irpso_addon.core.colour import linear_to_srgb
from irpso_addon.core.data import F32, F64, Bool, Solution
from irpso_addon.core.metrics import FAIL, at_size, psnr

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "head.md"
IMAGES = ROOT / "docs" / "images"
TILE, CROP = 256, (24, 232)  # pixels: height of a picture's tile, and its columns that show the head
EXPOSURE = 1.25  # of the pictures of the head
GAINS = {"composite": 20, "base": 5, "lobes": 3, "relit": 5}  # errors are shown so many times larger
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
    many_passes: int = 400  # and from many


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


def figures(result: Result, where: Bool) -> Row:
    """Over ``where``, which must hold a texel."""
    off = np.abs(result.lobes[where] - result.true_lobes[where]).astype(np.float64)
    base = psnr(float(np.mean((result.base[where].astype(np.float64) - result.true_base[where]) ** 2)))
    return Row(int(where.sum()), base, tuple(off.mean(0)), tuple((off > FAIL).mean(0)))


def composite(found: F32, truth: F32) -> tuple[float, float]:
    """Two renders compared over the head: dB as displayed, and the sum of absolute differences over the truth's sum."""
    where = truth[..., 3] > 0.999
    shown = psnr(float(np.mean((display(found)[where] - display(truth)[where]).astype(np.float64) ** 2)))
    a, b = found[where][:, :3].astype(np.float64), truth[where][:, :3].astype(np.float64)
    return shown, float(np.abs(a - b).sum() / b.sum())


def parts(record: Record, result: Result) -> dict[str, Bool]:
    """The texels of many lights: all, those where there is something to be found, and the others by what is missing."""
    r1, r2, weight = np.moveaxis(result.true_lobes, -1, 0)
    apart, both = r2 > APART * r1, (weight > SHARES[0]) & (weight < SHARES[1])
    seen = result.seen
    return {
        "all seen": seen,
        "two lobes apart, both with a share, a highlight near": seen & apart & both & record.near,
        "the same, no highlight near": seen & apart & both & ~record.near,
        "lobes alike (neck)": seen & ~apart,
        "one lobe with hardly a share (cheeks)": seen & apart & ~both,
    }


# ---- pictures


def draw(record: Record, folder: Path) -> None:
    """Write both pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    picture.save(folder / "head_one_image.jpg", _rows(record.pixels, record.one))
    picture.save(folder / "head_many_lights.jpg", _rows(record.pixels, record.many))


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
        rows[0] += [(name, _tile(display(result.fit))), _error(display(result.fit), display(pixels.fit), "composite")]
        rows[1] += [(name, _tile(_encode(_cut(result.view_base, pixels.shown)))),
                    _error(result.view_base, pixels.base, "base", where)]
        rows[2] += [(name, _tile(_cut(result.view_lobes, pixels.shown))),
                    _error(result.view_lobes, pixels.lobes, "lobes", where)]
        rows[3] += [(name, _tile(display(result.relit))), _error(display(result.relit), display(pixels.relit), "relit")]
    return rows


def _error(found: F32, truth: F32, kind: str, where: Bool | None = None) -> tuple[str, F32]:
    off = np.abs(found - truth)
    if where is not None:
        off = _cut(off, where)
    return f"error x{GAINS[kind]}", _tile(GAINS[kind] * off)


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
    return {"one": _table_one(record), "many": _table_many(record), "auto": _told(record), "machine": _machine(record)}


def _table_one(record: Record) -> str:
    lines = ["| method | composite, dB | mean error | another lamp, dB | mean error | base colour, dB | hue of it "
             "| r1 MAE | r2 MAE | weight MAE | solve, s |", "|---|---|---|---|---|---|---|---|---|---|---|"]
    for result in record.one:
        row = figures(result, result.seen)
        (fit, fit_off), (relit, relit_off) = _renders(record, result)
        lines.append(f"| `{result.method}` | {fit:.1f} | {fit_off:.2%} | {relit:.1f} | {relit_off:.1%} "
                     f"| {row.base:.1f} | {_hue(result):.1f} | {_three(row.mae)} | {result.seconds:.1f} |")
    return "\n".join(lines)


def _table_many(record: Record) -> str:
    lines = ["| method | composite, dB | mean error | another lamp, dB | mean error | solve, s | everything, s |",
             "|---|---|---|---|---|---|---|"]
    for result in record.many:
        assert result.solution is not None
        (fit, fit_off), (relit, relit_off) = _renders(record, result)
        lines.append(f"| `{result.method}` | {fit:.1f} | {fit_off:.2%} | {relit:.1f} | {relit_off:.1%} "
                     f"| {result.seconds:.1f} | {sum(result.solution.seconds.values()):.1f} |")
    lines += ["", "| texels | share | method | base colour, dB | r1 MAE | r2 MAE | weight MAE "
              "| r1 off by > 0.1 | r2 | weight |", "|---|---|---|---|---|---|---|---|---|---|"]
    groups = [parts(record, result) for result in record.many]
    for name in groups[0]:
        for result, group in zip(record.many, groups, strict=True):
            if group[name].any():
                row = figures(result, group[name])
                lines.append(f"| {name} | {row.texels / result.seen.sum():.0%} | `{result.method}` | {row.base:.1f} "
                             f"| {_three(row.mae)} | {' | '.join(f'{v:.1%}' for v in row.fail)} |")
    return "\n".join(lines)


def _renders(record: Record, result: Result) -> tuple[tuple[float, float], tuple[float, float]]:
    return composite(result.fit, record.pixels.fit), composite(result.relit, record.pixels.relit)


def _hue(result: Result) -> float:
    """dB of the differences R - G and G - B of base colour."""
    off = np.diff(result.base[result.seen].astype(np.float64) - result.true_base[result.seen], axis=-1)
    return psnr(float(np.mean(off**2)))


def _three(values: Sequence[float]) -> str:
    return " | ".join(f"{value:.3f}" for value in values)


def _told(record: Record) -> str:
    return "\n".join(f"> `{model}`: {record.auto.why[name]}" for name, model in record.auto.model.items())


def _machine(record: Record) -> str:
    o, device = record.options, record.auto.device
    return (f"{record.views} references of {o.pixels} x {o.pixels} pixels ({o.samples} samples) rendered in "
            f"{record.rendering:.0f} s; maps of {o.size} x {o.size} texels; method `paper`: {o.one_passes} passes from "
            f"one image, {o.many_passes} from many.\n{os.cpu_count()} CPU cores ({_processor()}), {platform.system()} "
            f"{platform.machine()}; OpenGL: {device['renderer']}, {device['version']}; Blender "
            f"{bpy.app.version_string}, Python {platform.python_version()}, numpy {np.__version__}; commit "
            f"{_commit()}; {datetime.datetime.now(datetime.UTC):%Y-%m-%d}.")


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown"


def _commit() -> str:
    done = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True)
    return done.stdout.strip() or "unknown"


def write(record: Record, page: Path = PAGE) -> None:
    """Put the tables between the page's marks."""
    text = page.read_text(encoding="utf-8")
    for name, table in tables(record).items():
        begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
        before, rest = text.split(begin)
        text = f"{before}{begin}\n{table}\n{end}{rest.split(end)[1]}"
    page.write_text(text, encoding="utf-8")

