"""``python -m studies.calibration``: makes docs/calibration.md, what lamps and exposures that are off cost, and do not.

Cycles' pictures of the assets of studies/intervals are solved with scenes that are wrong about them.  Needs Blender as
a module.  Pictures are kept in build/intervals.  --assets: these alone, and no page.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from irpso_addon.blender.oiio import ensure_openimageio
from irpso_addon.core.checks.light_checks import moved
from irpso_addon.core.checks.mended_cameras import moved as shifted
from irpso_addon.core.data import Camera, Light, SceneData, Solution
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.phrases import percent
from irpso_addon.core.shading.lights import with_extent
from irpso_addon.gpu.device import thread
from irpso_addon.solve import one_round, pipeline
from irpso_addon.solve.kept_images import ReadImage
from studies import charts, pages
from studies.intervals.assets import ASSETS, TEXELS, Asset, truth
from studies.intervals.measure import scene_of
from studies.intervals.page import made_on

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "build" / "intervals"
PAGE = pages.DOCS / "calibration.md"
NAMES = ("knot", "slab", "machine part")
PLACE, POWER, EXPOSURE = 0.01, 0.03, 0.02  # of a lamp's distance; relative; relative
VIGNETTING = 4.0
BLACK = 0.002  # of pictures whose median is 0.06 to 0.35
WIDTH = 1.2  # metres, of lamps 3 m away that are points or 0.3 m wide
SHIFT, FOCAL = 0.5, 0.003  # pixels; relative
PIXELS = 192
SEED = 1


@dataclass(frozen=True)
class Case:
    """What the scene is wrong about."""

    name: str
    lamps: bool = False  # and exposures
    cameras: bool = False
    exposures: bool = False  # these alone
    vignetting: float = 0.0  # power of the cosine that the scene takes out of pictures that have none
    black: float = 0.0  # that the pictures hold, and the scene does not know of
    width: float = 0.0  # metres, of all lamps in the scene


CASES = (Case("nothing"), Case("exposures", exposures=True), Case("vignetting", vignetting=VIGNETTING),
         Case("black level", black=BLACK), Case("width of the lamps", width=WIDTH),
         Case("lamps, exposures", lamps=True),
         Case("lamps, exposures, cameras", lamps=True, cameras=True))


@dataclass(frozen=True)
class Row:
    """One solve."""

    asset: str
    case: str
    told: str  # "given" or "auto"
    base: float  # dB
    rough: float  # mean error
    fails: float  # share of the solved texels that are off by more than 0.1
    places: float  # mean distance of the lamps from where they were, of their distance to the object
    seconds: float


def wrong(scene: SceneData, case: Case, rng: np.random.Generator | None = None, pixels: int = PIXELS) -> SceneData:
    """The scene with honest errors; without ``rng`` the same in every run.  ``pixels``: width of the pictures."""
    rng = rng or np.random.default_rng(SEED)
    lights: dict[str, Light] = {}
    cameras: dict[str, Camera] = {}
    for view in scene.views:
        for light in view.lights:
            if light.name not in lights:
                wide = with_extent(light, case.width / 2) if case.width else light
                lights[light.name] = _off(wide, rng) if case.lamps else wide
        if view.camera.name not in cameras:
            cameras[view.camera.name] = _aside(view.camera, rng, pixels) if case.cameras else view.camera
    spread = EXPOSURE if case.lamps or case.exposures else 0.0
    gains = np.exp(spread * rng.standard_normal(len(scene.views)))
    return replace(scene, views=tuple(
        replace(view, lights=tuple(lights[light.name] for light in view.lights), camera=cameras[view.camera.name],
                gain=view.gain * float(gain), vignetting=view.vignetting + case.vignetting,
                black_level=(-case.black,) * 3)
        for view, gain in zip(scene.views, gains, strict=True)))


def _off(light: Light, rng: np.random.Generator) -> Light:
    way = rng.standard_normal(3)
    by = PLACE * np.linalg.norm(light.matrix[:3, 3]) * way / np.linalg.norm(way)
    for axis in range(3):
        light = moved(light, axis, float(by[axis]))
    return replace(light, power=light.power * np.exp(POWER * rng.standard_normal()))


def _aside(camera: Camera, rng: np.random.Generator, pixels: int) -> Camera:
    """Its focal length and where it looks."""
    projection = camera.projection.copy()
    projection[:2] *= 1 + FOCAL * rng.choice([-1, 1])
    way = rng.uniform(0, 2 * np.pi)
    size = pixels, round(pixels / camera.aspect)
    return shifted(replace(camera, projection=projection), (SHIFT * np.cos(way), SHIFT * np.sin(way)), size)


def solved(
    scene: SceneData, told: str, read_image: ReadImage | None = None, size: int = TEXELS,
) -> tuple[one_round.Outcome, float]:
    """The outcome and its seconds."""
    start = time.perf_counter()
    settings = SolveSettings(size=size, lamps=told, exposures=told)
    outcome: one_round.Outcome = thread.run(lambda: pipeline.outcome(scene, settings, read_image))
    return outcome, time.perf_counter() - start


def judged(asset: Asset, case: Case, told: str, scene: SceneData, found: tuple[one_round.Outcome, float]) -> Row:
    """``scene``: as it is."""
    outcome, seconds = found
    base, roughness = truth(asset)
    solution: Solution = outcome.solution
    maps = solution.maps
    where = maps.coverage & ~maps.filled
    error = np.abs(maps.roughness - roughness)[where]
    square = float(np.mean((maps.base_color - base)[where] ** 2, dtype=np.float64))
    right = {light.name: light for view in scene.views for light in view.lights}
    now = {light.name: light for view in outcome.scene.views for light in view.lights}
    away = [np.linalg.norm(now[name].matrix[:3, 3] - light.matrix[:3, 3]) / np.linalg.norm(light.matrix[:3, 3])
            for name, light in right.items()]
    return Row(asset.name, case.name, told, -10 * float(np.log10(square)), float(error.mean(dtype=np.float64)),
               float(np.mean(error > 0.1)), float(np.mean(away)), seconds)


def line(row: Row) -> str:
    """Of the table."""
    return (f"| {row.asset} | {row.case} | {row.told} | {row.base:.1f} | {row.rough:.4f} | {percent(row.fails, 1)} | "
            f"{percent(row.places, 2)} | {row.seconds:.0f} |")


HEAD = """\
| asset | wrong | lamps, exposures | base color, dB | roughness | off | lamps | seconds |
|---|---|---|---|---|---|---|---|"""


def asked(study: str, doc: str | None, pictures: Path) -> argparse.Namespace:
    """The command line of a study that fills this page."""
    parser = argparse.ArgumentParser(prog=f"python -m studies.{study}", description=(doc or "").splitlines()[0])
    parser.add_argument("--assets", nargs="+", choices=NAMES, metavar="NAME", help=f"of {', '.join(NAMES)}")
    parser.add_argument("--pictures", type=Path, default=pictures, help="folder that keeps them")
    parser.add_argument("--out", type=Path, default=PAGE, help="the page")
    return parser.parse_args()


def main() -> int:
    """Command line."""
    options = asked("calibration", __doc__, PICTURES)
    ensure_openimageio()
    lines = []
    for asset in ASSETS:
        if asset.name in (options.assets or NAMES):
            scene = scene_of(asset, options.pictures / asset.name)
            for case in CASES:
                for told in ("given", "auto"):
                    found = solved(wrong(scene, case), told)
                    lines.append(line(judged(asset, case, told, scene, found)))
                    print(lines[-1], flush=True)
    if options.assets is None:
        pages.fill(PAGE, {"made": made_on(found[0].solution), "table": "\n".join([HEAD, *lines])}, options.out)
        charts.draw("calibration")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
