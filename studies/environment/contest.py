"""IRPSO and Mitsuba 3 on the bottle under one HDRI: error against time, judged on the same texels."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import bpy
import numpy as np

from irpso_addon.blender import files
from irpso_addon.cli.chart import draw
from irpso_addon.core.data import F64, Bool, Solution
from irpso_addon.core.evaluation.chart_data import Curve, Panel
from irpso_addon.core.evaluation.metrics import map_errors
from studies import pages
from studies.bench import capture_judge
from studies.environment import shoot
from studies.environment.recover import SIZE, recover
from studies.intervals.assets import truth

RIVAL = Path(__file__).with_name("rival.py")
# Of Mitsuba: material, learning rate, samples a pixel.  The best base colour, by the truth, of .01 and .02 with 16 and
# .02 with 64 samples (matched also of .05 with 16) after a minute under one HDRI.
SETTINGS = (("matched", 0.02, 64), ("stock", 0.02, 16))
LABELS = {"irpso": "IRPSO, auto", "matched": "Mitsuba, matched", "stock": "Mitsuba, principled"}
HEAD = ("method", "seconds", "base colour, dB", "roughness, mean error", "median", "off by > 0.1")


@dataclass(frozen=True)
class Point:
    """One method's maps after some time."""

    method: str
    seconds: float
    albedo_psnr: float  # dB
    rough_mae: float
    rough_median: float
    rough_fail: float  # share of the texels off by more than 0.1

    def row(self) -> list[str]:
        """Of the table."""
        return [LABELS[self.method], f"{self.seconds:.0f}", f"{self.albedo_psnr:.1f}",
                f"{self.rough_mae:.3f}", f"{self.rough_median:.3f}", f"{100 * self.rough_fail:.0f} %"]


def contest(solved: Solution, pictures: Path, python: str, budget: float) -> Iterator[Point]:
    """``solved``: of the open file; ``python`` has Mitsuba; ``budget``: seconds of each of its runs."""
    where = solved.maps.coverage & ~solved.maps.filled
    base, rough = (np.asarray(of, np.float64) for of in truth(shoot.BOTTLE, SIZE))
    errors = asdict(map_errors(solved.maps.base_color, solved.maps.roughness, base, rough, where))
    errors.pop("albedo_rmse")
    yield Point("irpso", sum(solved.seconds.values()), **errors)
    export = pictures / "mitsuba"
    _export(export, base, rough, where)
    for bsdf, rate, samples in SETTINGS:
        out = export / f"{bsdf}.json"
        subprocess.run([python, RIVAL, pictures, export, out, "--bsdf", bsdf, "--lr", str(rate),
                        "--samples", str(samples), "--budget", str(budget)], check=True)
        for row in json.loads(out.read_text(encoding="utf-8"))["rows"]:
            row.pop("albedo_rmse")
            yield Point(bsdf, **row)


def _export(folder: Path, base: F64, rough: F64, where: Bool) -> None:
    """The open scene as `rival.py` wants it."""
    folder.mkdir(parents=True, exist_ok=True)
    capture_judge.write_ply(folder / "mesh.ply", *capture_judge.triangles_of(bpy.data.objects[shoot.NAME]))
    capture_judge.write_scene(folder / "scene.json")
    np.savez_compressed(folder / "judge.npz", base=base, rough=rough, seen=where)


def write(points: list[Point], versions: str, renderer: str, out: Path) -> None:
    """Table and chart."""
    page = out / "environment.md"
    pages.fill(page if page.exists() else pages.DOCS / "environment.md", {
        "mitsuba made": pages.measured(renderer, versions),
        "mitsuba": pages.table(HEAD, [point.row() for point in points])}, page)
    panels = [Panel(title, [
        Curve(LABELS[method], place, [p.seconds for p in own], [getattr(p, error) for p in own])
        for place, method in zip((0, 4, 5), LABELS, strict=True)
        if (own := [p for p in points if p.method == method])], log=not up, up=up)
        for title, error, up in (("base colour, PSNR in dB", "albedo_psnr", True),
                                 ("roughness, mean error", "rough_mae", False))]
    draw([panels], "A bottle under one HDRI, 12 views: error against time",
         pages.measured(renderer, versions), out / "environment_time")


def compare(pictures: Path, python: str, budget: float, out: Path) -> None:
    """All of it: the table of docs/environment.md and its chart."""
    rig, points = shoot.RIGS[0], []
    folder = pictures / rig.name
    recover(rig, folder)  # the first solve of a process waits for compilers
    _, solved = recover(rig, folder)
    for point in contest(solved, folder, python, budget):
        points.append(point)
        print(" | ".join(point.row()), flush=True)
    told = json.loads((folder / "mitsuba" / "matched.json").read_text(encoding="utf-8"))
    write(points, f"Blender {files.blender_version()}, Mitsuba {told['version']}",
          solved.device.get("renderer", ""), out)
