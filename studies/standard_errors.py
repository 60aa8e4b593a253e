"""``python -m studies.standard_errors``: makes docs/standard_errors.md, how far stated standard errors hold.

Random shoots of three assets that Cycles has rendered: two or three cameras and six to ten of 24 lamps.  The scenes
have all of them honestly wrong, and solves put them right.  Needs Blender as a module and matplotlib.  Pictures and
results are kept in build/standard_errors.  --assets: these alone, and no page; a run without then finds what they kept.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from irpso_addon.blender.oiio import ensure_openimageio
from irpso_addon.core.change_records import Calibration, CameraChange, LampChange
from irpso_addon.core.checks.camera_changes import changed_camera
from irpso_addon.core.data import F64, Light, SceneData, Solution
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.projection import pixels_of
from irpso_addon.gpu.device import thread
from irpso_addon.solve import pipeline
from studies import pages
from studies.calibration import NAMES, Case, wrong
from studies.intervals.assets import ASSETS
from studies.intervals.measure import Z90, scene_of
from studies.intervals.page import made_on

KEPT = pages.ROOT / "build" / "standard_errors"
PAGE = pages.DOCS / "standard_errors.md"
SHOOTS, LAMPS, SIZE = 200, 24, 128
FEWEST_LAMPS, MOST_LAMPS = 6, 10
WRONG = Case("everything", lamps=True, cameras=True)
EVERY = 7  # corner of the mesh, for the shift of a camera
KINDS = {"place": "places of lamps, % of the distance", "power": "powers, %", "exposure": "exposures, %",
         "shift": "cameras, pixels", "focal": "focal lengths, %"}
SCALE = {"place": 100.0, "power": 100.0, "exposure": 100.0, "shift": 1.0, "focal": 100.0}
HEAD = ("of", "asset", "numbers", "hold in 90 % intervals", "error, median", "stated standard error, median",
        "error over stated, root mean square")


@dataclass(frozen=True)
class Number:
    """What a solve said of one number, in the unit of KINDS over SCALE."""

    kind: str
    off: float  # found less true
    error: float  # stated standard error


def chosen(whole: SceneData, rng: np.random.Generator) -> SceneData:
    """A shoot: some of the cameras under some of the lamps."""
    def some(names: set[str], count: int) -> set[str]:
        return set(rng.choice(sorted(names), count, replace=False))

    cameras = some({view.camera.name for view in whole.views}, int(rng.integers(2, 4)))
    lamps = some({view.lights[0].name for view in whole.views}, int(rng.integers(FEWEST_LAMPS, MOST_LAMPS + 1)))
    return replace(whole, views=tuple(
        view for view in whole.views if view.camera.name in cameras and view.lights[0].name in lamps))


def numbers(
    right: SceneData, given: SceneData, calibration: Calibration | None, cameras: Sequence[CameraChange] = (),
) -> list[Number]:
    """All that a solve changed of the given scene; powers and exposures apart from what all of them share."""
    found: list[Number] = []
    if calibration is not None:
        was, true = _lights(given), _lights(right)
        powers = []
        for lamp in calibration.lamps:
            before, after = was[lamp.lights[0]], true[lamp.lights[0]]
            found += _places(lamp, before, after)
            ratio = float(np.mean(before.power) / np.mean(after.power))
            powers.append((float(np.log(lamp.power * ratio)), lamp.power_error))
        gains = {(view.image, view.camera.name): other.gain / view.gain
                 for view, other in zip(right.views, given.views, strict=True)}
        stops = [(float(np.log(gains[view.image, view.camera])) + view.stops * np.log(2), view.error * np.log(2))
                 for view in calibration.exposures]
        found += _apart("power", powers) + _apart("exposure", stops)
    for change in cameras:
        before, after = (next(view.camera for view in scene.views if view.camera.name == change.camera)
                         for scene in (given, right))
        now, points = changed_camera(before, change), right.mesh.positions.reshape(-1, 3)[::EVERY].astype(np.float64)
        shift = np.nanmean(pixels_of(now, points, change.size) - pixels_of(after, points, change.size), axis=0)
        found += [Number("shift", float(by), change.error) for by in shift]
        found.append(Number("focal", float(now.projection[0, 0] / after.projection[0, 0] - 1), change.focal_error))
    return found


def _places(lamp: LampChange, before: Light, after: Light) -> list[Number]:
    reach = float(np.linalg.norm(before.matrix[:3, 3]))
    off = before.matrix[:3, 3] + lamp.offset - after.matrix[:3, 3]
    return [Number("place", float(by) / reach, error / reach) for by, error in zip(off, lamp.offset_error, strict=True)]


def _apart(kind: str, pairs: Sequence[tuple[float, float]]) -> list[Number]:
    shared = np.median([off for off, _ in pairs]) if pairs else 0.0
    return [Number(kind, off - float(shared), error) for off, error in pairs]


def _lights(scene: SceneData) -> dict[str, Light]:
    return {light.name: light for view in scene.views for light in view.lights}


def measure(name: str, shoots: range, folder: Path) -> None:
    """Solve an asset's shoots that are not kept yet; each is a line of a file."""
    asset = next(asset for asset in ASSETS if asset.name == name)
    whole = scene_of(asset, folder / name, lamps=LAMPS)
    path = folder / f"{name}.jsonl"
    path.touch()
    done = {json.loads(line)["shoot"] for line in path.read_text(encoding="utf-8").splitlines()}
    for shoot in shoots:
        if shoot in done:
            continue
        rng = np.random.default_rng(shoot)
        right = chosen(whole, rng)
        given = wrong(right, WRONG, rng)
        settings = SolveSettings(size=SIZE, model="one-lobe", normals="mesh", indirect="off")
        solution: Solution = thread.run(lambda given=given, settings=settings: pipeline.solve(given, settings))
        told = numbers(right, given, solution.calibration, solution.cameras)
        line = {"shoot": shoot, "made": made_on(solution), "told": [asdict(one) for one in told]}
        with path.open("a", encoding="utf-8") as file:
            file.write(f"{json.dumps(line)}\n")
        print(f"{name}, shoot {shoot}: {len(told)} numbers", flush=True)


def kept(folder: Path) -> tuple[dict[str, list[list[Number]]], str]:
    """Of each asset, what each shoot told; and where the last was solved."""
    found, made = {}, ""
    for name in NAMES:
        lines = [json.loads(line) for line in (folder / f"{name}.jsonl").read_text(encoding="utf-8").splitlines()]
        found[name] = [[Number(**one) for one in line["told"]] for line in lines]
        made = lines[-1]["made"]
    return found, made


def pairs_of(shoots: Sequence[Sequence[Number]], kind: str) -> F64:
    """(n, 2) what is off, and its stated standard error."""
    return np.array([(one.off, one.error) for shoot in shoots for one in shoot if one.kind == kind]).reshape(-1, 2)


def held(pairs: F64) -> float:
    """Share of what is off by less than the interval says."""
    return float(np.mean(np.abs(pairs[:, 0]) <= Z90 * pairs[:, 1]))


def rows(found: dict[str, list[list[Number]]]) -> list[list[str]]:
    """Of the table."""
    lines = []
    for kind, words in KINDS.items():
        each = {name: pairs_of(shoots, kind) for name, shoots in found.items()}
        for name, pairs in {**each, "all": np.concatenate(list(each.values()))}.items():
            if len(pairs):
                off, error = np.abs(pairs[:, 0]), pairs[:, 1]
                lines.append([words, name, str(len(pairs)), f"{100 * held(pairs):.0f} %",
                              f"{SCALE[kind] * np.median(off):.3f}", f"{SCALE[kind] * np.median(error):.3f}",
                              f"{np.sqrt(np.mean((off / error) ** 2)):.2f}"])
    return lines


def draw(found: dict[str, list[list[Number]]], out: Path) -> None:
    """Shares that hold, of each kind and asset, beside the wanted 85 to 95 %."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.4, 3.4), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    axis.axvspan(85, 95, color="#dddddd", label="wanted", zorder=0)
    for name, mark, colour in zip([*found, "all"], ("o", "D", "s", "|"), ("#777777", "#D55E00", "#0072B2", "black"),
                                  strict=True):
        shoots = [shoot for each in found.values() for shoot in each] if name == "all" else found[name]
        places, shares = [], []
        for place, kind in enumerate(KINDS):
            pairs = pairs_of(shoots, kind)
            if len(pairs):
                places.append(place)
                shares.append(100 * held(pairs))
        axis.plot(shares, places, mark, color=colour, label=name, markersize=18 if name == "all" else 7)
    axis.set_yticks(range(len(KINDS)), [words.split(",")[0] for words in KINDS.values()])
    axis.invert_yaxis()
    axis.set_xlim(0, 100)
    axis.set_xlabel("share of the numbers that lie in their 90 % interval, %")
    axis.grid(axis="x", alpha=0.4)
    axis.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper left", ncols=5, frameon=False)
    figure.savefig(out, facecolor="white", metadata={"Description": "how far stated standard errors hold"},
                   pil_kwargs={"optimize": True})


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m studies.standard_errors",
                                     description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--assets", nargs="+", choices=NAMES, metavar="NAME", help=f"of {', '.join(NAMES)}")
    parser.add_argument("--shoots", type=int, default=SHOOTS, help=f"of all assets; default {SHOOTS}")
    parser.add_argument("--kept", type=Path, default=KEPT, help="folder that keeps pictures and results")
    options = parser.parse_args()
    ensure_openimageio()
    for n, name in enumerate(NAMES):
        if name in (options.assets or NAMES):
            measure(name, range(n, options.shoots, len(NAMES)), options.kept)
    found, made = ({}, "") if options.assets else kept(options.kept)
    if found:
        pages.fill(PAGE, {"made": made, "table": pages.table(HEAD, rows(found))})
        draw(found, PAGE.with_suffix(".png"))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
