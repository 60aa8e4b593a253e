"""``python -m studies.bench --gpu-report``: what a GPU does with IRPSO, in one file that a user can send.

What goes wrong in one section is written there, and the others go on.  Paths are cut to their last part.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from itertools import cycle
from pathlib import Path
from typing import Any

import moderngl

from irpso_addon.core.data import Solution
from irpso_addon.core.errors import BadInput, ShaderRefused
from irpso_addon.core.images.image_writer import write_image
from irpso_addon.core.job import Progress, Steps
from irpso_addon.core.log import without_folders
from irpso_addon.core.params import DeviceSettings, SolveSettings
from irpso_addon.core.tiled.uv_blocks import BLOCK, HALO
from irpso_addon.core.versions import versions
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.device.programs import Programs
from irpso_addon.gpu.observe.observation_atlas import Layers
from irpso_addon.solve import device_test, pipeline, tiled_solve
from irpso_addon.solve.plan_preparation import TiledRequest
from studies import pages
from studies.budget.instrument import instrumented
from studies.budget.ledger import Ledger
from studies.budget.page import row_of
from tests.support import synthetic as syn
from tests.support.texel_problem import Problem, Spec, make

from .opengl import Bench
from .peak import is_gpu, search_seconds

FILE = "irpso-gpu-report.json"
PATHS = ("fragment", "compute")
LAMPS = 12  # K
RACE = {"u_particles": 24, "u_moves": 0, "u_race_steps": 2, "u_final_steps": 0}  # all texels evaluate as often
DOCTOR_SECONDS = 300
SLOWEST = 8  # kernels whose compilation is told by itself
KERNELS = {"search": 3, "table": 8, "polish": 2, "polish_two": 3, "finish": 2, "albedo": 1}  # and their outputs
SWITCHES = ("", "ROBUST", "JOINT", "SPECULAR", "METALLIC", "COAT", "ROUGH_DIFFUSE", "SWARM")


@dataclass(frozen=True)
class Sizes:
    """How much is measured."""

    problem: int  # texels across, of the search alone; one tile holds them
    counts: tuple[int, ...]  # K of the search alone
    pixels: int  # of a picture
    whole: int  # texels across of a solve in one piece
    large: int  # and of one in blocks ...
    block: int  # ... so large
    halo: int
    views: int  # of a solve of many views, ...
    small: int  # pixels of each, and texels across
    model: str = "auto"


GPU = Sizes(224, (6, 12, 24), 1024, 1024, 4096, BLOCK, HALO, 240, 256)
SOFTWARE = Sizes(96, (6, 12, 24), 160, 256, 256, 128, 32, 120, 64)


def main(out: Path, sizes: Sizes | None = None) -> int:
    """Measure, write, print a line; the exit code of the command line: 3 where there is no OpenGL."""
    began = time.perf_counter()
    try:
        about, gpu = thread.run(_about)
    except BadInput as error:
        print(f"no report: {error}", file=sys.stderr)
        return 3
    sizes = sizes or (GPU if gpu else SOFTWARE)
    report: dict[str, Any] = {"report": 1, "date": pages.today(), "commit": pages.commit(), "versions": versions(),
                              "processors": pages.processors(), "device": about}
    for name, section in (("doctor", doctor), ("self-test", self_test), ("kernels", kernels),
                          ("rates", lambda: rates(sizes)), ("solve", lambda: solve(sizes)),
                          ("large solve", lambda: solve_large(sizes)),
                          ("many views", lambda: solve_many(sizes))):
        print(f"{time.perf_counter() - began:6.1f} s  {name}", file=sys.stderr, flush=True)
        report[name] = {"error": "the process ended here"}  # what stays in the file if the driver ends it
        _save(report, out)
        try:
            report[name] = section()
        except Exception as error:  # a driver may fail in any way; the report is to say so
            report[name] = {"error": without_folders(f"{type(error).__name__}: {error}")}
    report["seconds"] = round(time.perf_counter() - began, 1)
    _save(report, out)
    print(summary(report))
    print(f"{out}: written; send this file")
    return 0


def _save(report: Mapping[str, Any], out: Path) -> None:
    beside = out.with_name(f"{out.name}.part")
    beside.write_text(json.dumps(_rounded(report), indent=1) + "\n", encoding="utf-8")
    beside.replace(out)


def summary(report: Mapping[str, Any]) -> str:
    """The one line."""
    def said(section: str, words: Callable[[Any], str]) -> str:
        found = report[section]
        return f"{section} failed" if "error" in found else words(found)

    def compiled(found: Any) -> str:
        return ", ".join(f"{path} {of['compiled']} of {of['compiled'] + len(of['refused'])}"
                         for path, of in found.items())

    def fastest(found: Any) -> str:
        at = [row for row in found if row["K"] == LAMPS and row["lobes"] == 1 and "rate" in row]
        best = max(at, key=lambda row: row["rate"], default=None)
        return "no rate" if best is None else f"{best['rate'] / 1e6:.0f} M evaluations/s ({best['path']})"

    return "; ".join([
        f"{report['device']['renderer']}, {report['device']['version']}",
        said("doctor", lambda found: "doctor: all is well" if found["code"] == 0 else "doctor: not well"),
        f"kernels that compile: {said('kernels', compiled)}", said("rates", lambda found: fastest(found["search"])),
        *(said(name, lambda found: f"{found['texels']} x {found['texels']} of {found['K']} views in "
                                   f"{found['seconds']:.1f} s")
          for name in ("solve", "large solve", "many views"))])


def _rounded(value: Any) -> Any:
    """Four digits of each number that was measured."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return float(f"{value:.4g}") if isinstance(value, float) else value


# ---- the device


def _about() -> Generator[Progress, None, tuple[dict[str, Any], bool]]:
    """What the driver says of the device, and whether it is a GPU."""
    yield Progress(0.0, "device")
    device = thread.device()
    limits = {name: value for name, value in device.info.items() if isinstance(value, int | float | str)}
    return {**device.describe(), "opengl": device.ctx.version_code, "kernels":
            "compute" if device.prefers_compute else "fragment", "limits": limits}, is_gpu(device)


def doctor() -> dict[str, Any]:
    """The command's own output, from a process of its own: a driver may crash."""
    done = subprocess.run([sys.executable, "-m", "irpso_addon", "doctor"], cwd=pages.ROOT, capture_output=True,
                          text=True, timeout=DOCTOR_SECONDS)
    return {"code": done.returncode,  # its tables name no folder
            "says": [*done.stdout.splitlines(), *map(without_folders, done.stderr.splitlines())]}


def self_test() -> dict[str, float]:
    """The same test here, which needs no Blender."""
    found: device_test.DeviceTest = thread.run(device_test.test)
    return {"seconds": found.seconds, "base colour error": found.base_error, "roughness error": found.rough_error}


# ---- kernels


def kernels() -> dict[str, Any]:
    """By path: how many kernels the driver compiles, its words on those that it refuses, and the seconds."""
    def job() -> Generator[Progress, None, dict[str, Any]]:
        device, found = thread.device(), dict[str, Any]()
        for path in PATHS:
            if path == "compute" and device.ctx.version_code < 430:
                found[path] = {"compiled": 0, "refused": {"all": "OpenGL is older than 4.3"}, "seconds": 0.0}
                continue
            programs, refused, taken = Programs(device.ctx, device.check_alive), dict[str, str](), dict[str, float]()
            for title, name, defines in variants():
                yield Progress(0.0, "device")
                begun = time.perf_counter()
                try:
                    _compile(programs, path, name, defines)
                except ShaderRefused as error:
                    refused[title] = without_folders(str(error))
                taken[title] = time.perf_counter() - begun
            slowest = sorted(taken, key=lambda title: -taken[title])[:SLOWEST]
            found[path] = {"compiled": len(taken) - len(refused), "refused": refused, "seconds": sum(taken.values()),
                           "slowest": {title: taken[title] for title in slowest}}
        return found

    compiled: dict[str, Any] = thread.run(job)
    return compiled


def _compile(programs: Programs, path: str, name: str, defines: Mapping[str, str]) -> None:
    made: moderngl.Program | moderngl.ComputeShader = (
        programs.compute(name, defines) if path == "compute" else
        programs.get("include/screen.vert", name, defines))
    made.release()


def variants() -> Iterator[tuple[str, str, dict[str, str]]]:
    """(title, kernel, defines): each kernel over few views and over many, with each switch by itself."""
    few = Layers((0,) * LAMPS, 1, 1, spread=True)
    many = Layers(tuple(n // 10 for n in range(40)), 2, 3, spread=True, environment=True)
    for words, layers in (("few views", few), ("many views", many)):
        for kernel, outputs in KERNELS.items():
            for switch in SWITCHES:
                two = kernel == "polish_two"
                for lobes in ((2,) if two else (1, 2) if kernel in ("search", "albedo") and not switch else (1,)):
                    if (two and switch) or (switch == "SWARM" and kernel != "search"):
                        continue
                    options = {switch: "16" if switch == "SWARM" else "1"} if switch else {}
                    title = ", ".join(filter(None, (kernel, words, f"lobes {lobes}", switch)))
                    colour = {"COLOUR": "1"} if kernel == "albedo" or switch == "ROUGH_DIFFUSE" else {}
                    yield title, f"solve/{kernel}.kernel", {
                        **layers.defines(), "LOBES": str(lobes), "OUTPUTS": str(outputs), **options, **colour}


# ---- rates


def rates(sizes: Sizes) -> dict[str, Any]:
    """Evaluations of the residual a second, of the search alone, by path, lobes and K."""
    found = []
    for lobes, model in ((1, "one-lobe"), (2, "two-lobe")):
        for count in sizes.counts:
            problem = make(Spec(model, count, sizes.problem))
            for path in PATHS:
                row: dict[str, Any] = {"path": path, "lobes": lobes, "K": count}
                try:
                    with _configured(kernels=path):
                        row["rate"] = thread.run(lambda problem=problem: _rate(problem))
                except (BadInput, ValueError) as error:
                    row["error"] = without_folders(str(error))
                found.append(row)
    return {"texels": sizes.problem, "search": found}


def _rate(problem: Problem) -> Generator[Progress, None, float]:
    yield Progress(0.0, "device")
    device: Device = thread.device()
    device.budget.choose(float("inf"))
    try:
        bench = Bench(device, problem)
        seconds = search_seconds(bench, RACE, 3)
        bench.release()
    finally:
        device.budget.choose(device.settings.slice)
    return problem.spec.size**2 * RACE["u_particles"] * (RACE["u_race_steps"] + 1) / seconds


@contextmanager
def _configured(**settings: Any) -> Iterator[None]:
    before = thread.settings()
    thread.configure(replace(DeviceSettings(), **settings))
    try:
        yield
    finally:
        thread.configure(before)


# ---- solves


def solve(sizes: Sizes) -> dict[str, Any]:
    """Of a bumpy plane under K lamps, in one piece; and where the seconds of the first one go, which compiles."""
    shoot, ledger = _shoot(sizes), Ledger()
    settings = SolveSettings(size=sizes.whole, model=sizes.model, indirect="off")

    def steps() -> Steps[Solution]:
        return pipeline.solve(shoot.scene, settings, shoot.read_image)

    with instrumented(ledger), ledger.lane():
        thread.run(steps)
    rows: defaultdict[str, float] = defaultdict(float)
    for (part, kind), taken in ledger.seconds.items():
        rows[row_of(part, kind)] += taken
    return {**_timed(sizes.whole, steps), "first": sum(rows.values()),
            "budget of the first": dict(sorted(rows.items(), key=lambda row: -row[1])), "bytes": dict(ledger.bytes)}


def solve_large(sizes: Sizes) -> dict[str, Any]:
    """The same in blocks, from pictures in files and to files.  Needs OpenImageIO."""
    shoot = _shoot(sizes)
    with suppress(ImportError):  # without Blender OpenImageIO may be there by itself
        from irpso_addon.blender.oiio import ensure_openimageio
        ensure_openimageio()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for image, picture in shoot.images.items():
            write_image(folder / image, picture.rgb * picture.coverage[..., None], kind="exr", color=True)
        views = tuple(replace(view, image=folder / view.image.name) for view in shoot.scene.views)
        settings = SolveSettings(size=sizes.large, model=sizes.model, indirect="off")
        request = TiledRequest(replace(shoot.scene, views=views), settings, block=sizes.block, halo=sizes.halo)
        return _timed(sizes.large, lambda: tiled_solve.run(request, folder, folder / "work", "exr"))


def solve_many(sizes: Sizes) -> dict[str, Any]:
    """The same plane from eight cameras in turn, each view under a lamp of its own: what a texel's loops hold."""
    rig = [(camera, [lamp]) for camera, lamp in zip(
        cycle(syn.cameras(8)), syn.lamps(sizes.views), strict=False)]
    shoot = syn.shoot(syn.PATCHES, rig, (sizes.small, sizes.small), noise=0.01)
    settings = SolveSettings(size=sizes.small, model=sizes.model, indirect="off")
    return _timed(sizes.small, lambda: pipeline.solve(shoot.scene, settings, shoot.read_image), sizes.views)


@cache
def _shoot(sizes: Sizes) -> syn.Shoot:
    rig = [(syn.cameras(1)[0], [lamp]) for lamp in syn.lamps(LAMPS)]
    return syn.shoot(syn.PATCHES, rig, (sizes.pixels, sizes.pixels), noise=0.01)


def _timed(texels: int, steps: Callable[[], Steps[Solution]], views: int = LAMPS) -> dict[str, Any]:
    """Seconds as a user sees them."""
    started = time.perf_counter()
    solution: Solution = thread.run(steps)
    return {"texels": texels, "K": views, "seconds": time.perf_counter() - started, "stages": dict(solution.seconds),
            "models": list(solution.model.values())}
