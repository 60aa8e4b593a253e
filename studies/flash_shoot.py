"""A whole shoot, from photographs to maps: `python -m studies.flash_shoot` writes docs/flash_shoot.md.

Cycles photographs the demo's vase (tests/support/photo_shoot.py): a distorting wide lens, portrait and landscape, a
flash beside the lens.  The pictures and the projects of several programs are all that `irpso import` and `irpso solve`
get.
The yardstick is the same vase with the same cameras and flash given in Blender, without distortion.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import textwrap
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from irpso_addon.core.evaluation.metrics import FAIL
from irpso_addon.core.phrases import percent
from irpso_addon.core.resampling import block_means
from irpso_addon.core.versions import version
from studies import charts, pages
from tests.support import project_files

ROOT = Path(__file__).resolve().parents[1]
PAGE = pages.DOCS / "flash_shoot.md"
UNIT, FLASH = 0.1, ("--flash-right", "60", "--flash-above", "10", "--flash-size", "20")  # as photo_shoot.py has them
POWER = 3.2  # watts, of the flash in metres
MANY = 400  # cameras whose import is timed
CONFIDENT = 0.5

HEAD = """\
| project and pictures | views | import | albedo | roughness: mean error | median | confident | of these off by 0.1 |
|---|---|---|---|---|---|---|---|"""
FOUND = """Import of {many} cameras with their pictures and lenses: {seconds:.1f} s.

{short}"""
SHORT = """**What falls short.** A flash beside the lens puts its highlight only where the surface faces the camera.
{doubt} Lamps away from the camera show more ([shooting](shooting.md))."""


@dataclass(frozen=True)
class Case:
    """One way in."""

    name: str
    project: str
    pictures: str = "pictures"
    power: bool = True  # the flash's power is given


CASES = (
    Case("Metashape XML, EXR", "metashape.xml"), Case("COLMAP text, EXR", "colmap_text"),
    Case("COLMAP binary, EXR", "colmap_binary"), Case("transforms.json, EXR", "transforms.json"),
    Case("Metashape XML, DNG, power not known", "metashape.xml", "dng", power=False),
)


@dataclass(frozen=True)
class Scores:
    """Against the truth."""

    albedo: float  # dB
    mean: float
    median: float
    confident: float  # share of the solved texels
    far: float  # share of those


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, help="folder that is kept; pictures in it are used again")
    arguments = parser.parse_args()
    work = arguments.work or Path(tempfile.mkdtemp(prefix="irpso-shoot-"))
    views, pixels, size = 40, 400, 256
    photograph(work, views, pixels)
    rows, doubt = [], ""
    for case in CASES:
        blend, seconds, count = imported(work, case)
        solved = work / f"out_{CASES.index(case)}"
        said = irpso("solve", blend, "--size", size, "--indirect", "off", "--out", solved)
        doubt = doubt or next((line for line in said.splitlines() if "roughness may be off" in line), "")
        rows.append(row(case.name, count, f"{seconds:.1f} s", scores(work / "truth", solved, case.power)))
    irpso("solve", work / "native.blend", "--captures", work / "native.json", "--size", size, "--indirect", "off",
          "--out", work / "out_native")
    native = json.loads((work / "native.json").read_text())["views"]
    rows.append(row("Native", len(native), "", scores(work / "truth", work / "out_native", True)))
    print("\n".join(rows))
    said = re.sub(r".*?warning: \w+: ", "", doubt)
    report = json.loads((work / "out_native" / "report.json").read_text(encoding="utf-8"))
    short = SHORT.format(doubt=f'The solve warns: "{said}".' if said else "")
    short = textwrap.fill(" ".join(short.split()), 119)
    pages.fill(PAGE, {
        "made": pages.measured(report["device"]["renderer"], f"IRPSO {version()}"), "table": "\n".join([HEAD, *rows]),
        "found": FOUND.format(many=MANY, seconds=many(work), short=short)})
    charts.draw("flash_shoot")
    if arguments.work is None:
        shutil.rmtree(work)


def photograph(work: Path, views: int, pixels: int) -> None:
    """All picture files and projects, unless they are there."""
    options = ["--views", str(views), "--pixels", str(pixels)]
    if not (work / "native.blend").exists():
        (work / "native").mkdir(parents=True, exist_ok=True)
        for more in ([], ["--native"]):
            run(sys.executable, "-m", "tests.support.photo_shoot", str(work), *options, *more)
    if not (work / "dng").exists():
        run(sys.executable, "-c", "import sys; from pathlib import Path; from tests.support import photo_shoot as p;"
            "p.develop(Path(sys.argv[1]), 'dng')", str(work))


def imported(work: Path, case: Case) -> tuple[Path, float, int]:
    """The .blend, seconds that the import took by its own account, and views."""
    blend = work / f"shoot_{CASES.index(case)}.blend"
    blend.unlink(missing_ok=True)  # of an earlier run: an import replaces no file
    power = ("--flash-power", str(POWER)) if case.power else ()
    said = irpso("import", work / case.project, "--images", work / case.pictures, "--mesh", work / "mesh.obj",
                 "--scale", UNIT, *FLASH, *power, "--out", blend)
    found = re.search(r"(\d+) views in ([\d.]+) s", said)
    assert found, said
    return blend, float(found[2]), int(found[1])


def many(work: Path) -> float:
    """Seconds that the import of MANY cameras takes, by its own account."""
    folder = work / "many"
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "pictures").mkdir(parents=True)
    content = json.loads((work / "transforms.json").read_text())
    one = next(frame for frame in content["frames"] if frame["w"] > frame["h"])
    frames = []
    for shot in project_files.ring(MANY, ".exr"):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = shot.rotation @ np.diag([1.0, -1.0, -1.0]), shot.place
        frames.append({**one, "file_path": f"pictures/{shot.name}", "transform_matrix": matrix.tolist()})
        os.link(work / one["file_path"], folder / "pictures" / shot.name)
    (folder / "transforms.json").write_text(json.dumps({**content, "frames": frames}))
    said = irpso("import", folder / "transforms.json", "--images", folder / "pictures", "--mesh", work / "mesh.obj",
                 "--flash-power", "1", "--out", folder / "many.blend")
    found = re.search(rf"{MANY} views in ([\d.]+) s", said)
    assert found, said
    return float(found[1])


def scores(truth: Path, solved: Path, absolute: bool) -> Scores:
    """``absolute``: base color without a common factor."""
    base, rough, filled, confidence = (
        read(solved / f"mesh_{name}.exr") for name in ("basecolor", "roughness", "filled", "confidence"))
    true_base = block_means(read(truth / "mesh_basecolor.exr")[..., :3], len(rough))
    true_rough = block_means(read(truth / "mesh_roughness.exr")[..., 0], len(rough))
    inside = filled[..., 0] < 0.5
    base = base[..., :3][inside]
    if not absolute:
        base = base * np.median(true_base[inside] / np.maximum(base, 1e-3))
    error = np.abs(rough[..., 0] - true_rough)[inside]
    sure = confidence[..., 0][inside] > CONFIDENT
    return Scores(float(-10 * np.log10(((base - true_base[inside]) ** 2).mean())), float(error.mean()),
                  float(np.median(error)), float(sure.mean()),
                  float((error[sure] > FAIL).mean()) if sure.any() else 0.0)


def row(name: str, views: int, seconds: str, found: Scores) -> str:
    return (f"| {name} | {views} | {seconds} | {found.albedo:.2f} dB | {found.mean:.4f} | {found.median:.4f} | "
            f"{percent(found.confident)} | {percent(found.far, 1)} |")


def read(path: Path) -> np.ndarray:
    import OpenImageIO as oiio

    return oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)


def irpso(*arguments: object) -> str:
    """What a command prints."""
    return run(sys.executable, "-m", "irpso_addon", *(str(a) for a in arguments))


def run(*command: str) -> str:
    started = time.perf_counter()
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    print(f"{time.perf_counter() - started:6.1f} s  {' '.join(command[2:5])} ...", flush=True)
    return done.stdout + done.stderr


if __name__ == "__main__":
    main()
