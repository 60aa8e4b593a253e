"""``python -m studies.lamp_colors``: fills docs/calibration.md, what colors of lamps that are off cost, and do not.

As `studies.calibration`.  Needs Blender as a module.  Pictures are kept in build/intervals.  --assets: these alone, and
no page.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from irpso_addon.blender.oiio import ensure_openimageio
from irpso_addon.core.data import F64, SceneData
from irpso_addon.core.phrases import percent
from studies import pages
from studies.calibration import NAMES, PAGE, PICTURES, Case, asked, judged, solved, wrong
from studies.intervals.assets import ASSETS
from studies.intervals.measure import scene_of
from studies.intervals.page import made_on

COLOR = 0.05  # standard deviation of the logarithm of a lamp's red, green and blue
SEED = 3
COLORS, ALL = Case("colors"), Case("colors, lamps, exposures", lamps=True)
HEAD = """\
| asset | wrong | lamps, exposures | base color, dB | roughness | off | colors | seconds |
|---|---|---|---|---|---|---|---|"""


def discolored(scene: SceneData) -> SceneData:
    """The scene with lamps whose colors are off.  The median of each channel is right: nothing tells what all share."""
    rng = np.random.default_rng(SEED)
    names = list(dict.fromkeys(light.name for view in scene.views for light in view.lights))
    tints = COLOR * rng.standard_normal((len(names), 3))
    tints -= np.median(_hues(tints), axis=0)
    factor = dict(zip(names, np.exp(tints), strict=True))
    return replace(scene, views=tuple(replace(view, lights=tuple(
        replace(light, power=light.power * factor[light.name]) for light in view.lights)) for view in scene.views))


def _hues(logs: F64) -> F64:
    return logs - logs.mean(-1, keepdims=True)


def colors_left(right: SceneData, now: SceneData) -> float:
    """Root mean square error of the logarithms of lamps' colors, what all lamps share apart."""
    before, after = ({light.name: light.power for view in scene.views for light in view.lights}
                     for scene in (right, now))
    off = _hues(np.log([after[name] / power for name, power in before.items()]))
    return float(np.sqrt(np.mean((off - np.median(off, axis=0)) ** 2)))


def main() -> int:
    """Command line."""
    options = asked("lamp_colors", __doc__, PICTURES)
    ensure_openimageio()
    lines = []
    for asset in ASSETS:
        if asset.name in (options.assets or NAMES):
            scene = scene_of(asset, options.pictures / asset.name)
            off = discolored(scene)
            for case, told, given in ((Case("nothing"), "auto", scene), *(
                    (case, told, wrong(off, case)) for case in (COLORS, ALL) for told in ("given", "auto"))):
                found = solved(given, told)
                row, left = judged(asset, case, told, scene, found), colors_left(scene, found[0].scene)
                lines.append(f"| {row.asset} | {row.case} | {row.told} | {row.base:.1f} | {row.rough:.4f} | "
                             f"{percent(row.fails, 1)} | {percent(left, 2)} | {row.seconds:.0f} |")
                print(lines[-1], flush=True)
    if options.assets is None:
        pages.fill(PAGE, {"colors made": made_on(found[0].solution), "colors": "\n".join([HEAD, *lines])}, options.out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
