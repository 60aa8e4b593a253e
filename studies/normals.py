"""``python -m studies.normals``: makes the table of docs/normals.md, what wrong shading normals cost, and do not.

Cycles' pictures of the assets of studies/intervals are solved with meshes whose normals are wrong.  Needs Blender as a
module.  Pictures are kept in build/intervals.  --assets, --cases: these alone, and no page.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from irpso_addon.blender.oiio import ensure_openimageio
from irpso_addon.core.data import F32, F64, MeshArrays, SceneData, Solution
from irpso_addon.core.normals.tangent_map import wearing
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.phrases import percent
from irpso_addon.gpu.device import thread
from irpso_addon.solve import one_round, pipeline
from studies import charts, pages
from studies.intervals.assets import ASSETS, TEXELS, Asset, truth, unit
from studies.intervals.measure import scene_of
from studies.intervals.page import made_on

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "build" / "intervals"
NAMES = ("knot", "slab")
OFF = np.radians(2.0)  # root mean square
WAVES = 9.0  # radians a metre, of what is smooth; the objects fill a ball of 1 m
ROUNDS = 12  # of means over neighbours, by which relief is lost
SEED = 1
PAGE = pages.DOCS / "normals.md"


def _joined(mesh: MeshArrays) -> tuple[F64, np.ndarray]:
    """(places (P, 3) where corners meet, (T, 3) which of them each corner is)."""
    flat = mesh.positions.reshape(-1, 3)
    places, of = np.unique(np.round(flat, 6), axis=0, return_inverse=True)
    return places.astype(np.float64), of.reshape(-1, 3)


def _tilted(mesh: MeshArrays, offset: F64) -> MeshArrays:
    """``offset``: (T, 3, 3) added across the normals, made OFF in the mean square."""
    normal = mesh.normals.astype(np.float64)
    across = offset - normal * (offset * normal).sum(-1, keepdims=True)
    across *= np.tan(OFF) / np.sqrt((across**2).sum(-1).mean())
    return replace(mesh, normals=unit(normal + across).astype(np.float32))


def smooth(mesh: MeshArrays) -> MeshArrays:
    """Waves of about the object's half width."""
    rng = np.random.default_rng(SEED)
    total = np.zeros(mesh.positions.shape)
    for _ in range(12):
        way = WAVES * unit(rng.standard_normal(3)) * rng.uniform(0.5, 1.0)
        total += rng.standard_normal(3) * np.cos(mesh.positions @ way + rng.uniform(0, 7))[..., None]
    return _tilted(mesh, total)


def fine(mesh: MeshArrays) -> MeshArrays:
    """Each vertex by itself."""
    places, of = _joined(mesh)
    return _tilted(mesh, np.random.default_rng(SEED).standard_normal(places.shape)[of])


def flattened(mesh: MeshArrays) -> MeshArrays:
    """Normals of a surface whose relief is lost: means over neighbours, again and again."""
    places, of = _joined(mesh)
    sums = np.zeros_like(places)
    np.add.at(sums, of.ravel(), mesh.normals.reshape(-1, 3).astype(np.float64))
    for _ in range(ROUNDS):
        normal, sums = unit(sums), np.zeros_like(places)
        np.add.at(sums, of.ravel(), np.repeat(normal[of].sum(1, keepdims=True), 3, 1).reshape(-1, 3))
    return replace(mesh, normals=unit(sums)[of].astype(np.float32))


@dataclass(frozen=True)
class Case:
    """What is wrong about the normals."""

    name: str
    wrong: Callable[[MeshArrays], MeshArrays]
    assets: tuple[str, ...] = NAMES


CASES = (Case("nothing", lambda mesh: mesh), Case("smooth, 2°", smooth), Case("fine, 2°", fine),
         Case("relief is lost", flattened, ("slab",)))


def solved(scene: SceneData, normals: str) -> tuple[Solution, float]:
    """The solution and its seconds."""
    start = time.perf_counter()
    settings = SolveSettings(size=TEXELS, normals=normals)
    solution: Solution = thread.run(lambda: pipeline.solve(scene, settings))
    return solution, time.perf_counter() - start


def normals_of(mesh: MeshArrays) -> F32:
    """(n, n, 3) shading normals of the texels."""
    scene = SceneData("normals", mesh, np.zeros((0, 3, 3), np.float32), ())
    gbuffer: one_round.GBuffer = thread.run(lambda: one_round.bake_gbuffer(scene, TEXELS))
    return gbuffer.normal


def line(asset: Asset, case: Case, normals: str, right: F32, scene: SceneData, found: tuple[Solution, float]) -> str:
    """Of the table; ``right``: normals as they are."""
    solution, seconds = found
    base, roughness = truth(asset)
    maps = solution.maps
    where = maps.coverage & ~maps.filled
    error = np.abs(maps.roughness - roughness)[where]
    square = float(np.mean((maps.base_color - base)[where] ** 2, dtype=np.float64))
    shown = normals_of(scene.mesh if maps.normal is None else wearing(scene.mesh, maps.normal))
    cosine = np.clip((shown * right).sum(-1, dtype=np.float64)[where], -1, 1)
    return (f"| {asset.name} | {case.name} | {normals} | {np.degrees(np.arccos(cosine)).mean():.2f} | "
            f"{-10 * np.log10(square):.1f} | {error.mean(dtype=np.float64):.4f} | "
            f"{percent(float(np.mean(error > 0.1)), 1)} | {seconds:.0f} |")


HEAD = """\
| asset | wrong normals | normals | degrees off | base color, dB | roughness | off | seconds |
|---|---|---|---|---|---|---|---|"""


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m studies.normals", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--assets", nargs="+", choices=NAMES, metavar="NAME", help=f"of {', '.join(NAMES)}")
    parser.add_argument("--cases", nargs="+", metavar="CASE", help=f"of {'; '.join(case.name for case in CASES)}")
    parser.add_argument("--pictures", type=Path, default=PICTURES, help="folder that keeps them")
    parser.add_argument("--out", type=Path, default=PAGE, help="the page")
    options = parser.parse_args()
    ensure_openimageio()
    lines = []
    for asset in ASSETS:
        if asset.name not in (options.assets or NAMES):
            continue
        scene = scene_of(asset, options.pictures / asset.name)
        right = normals_of(scene.mesh)
        for case in CASES:
            if asset.name in case.assets and case.name in (options.cases or [case.name]):
                wrong = replace(scene, mesh=case.wrong(scene.mesh))
                for normals in ("mesh", "auto"):
                    found = solved(wrong, normals)
                    lines.append(line(asset, case, normals, right, wrong, found))
                    print(lines[-1], found[0].normals_why, flush=True)
    if options.assets is None and options.cases is None:
        pages.fill(PAGE, {"made": made_on(found[0]), "table": "\n".join([HEAD, *lines])}, options.out)
        charts.draw("normals")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
