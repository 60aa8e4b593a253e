"""What bounced light costs and how much of it comes off again: the demo's vase on floors of growing brightness.

    python tools/indirect_curve.py [--size 256]

Cycles renders the references with 4 bounces.  Writes docs/stability/indirect.md and docs/stability/indirect.jpg.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from unittest.mock import patch

import bpy
import numpy as np
from mathutils import Vector

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from irpso_addon.blender.files import open_blend  # noqa: E402
from irpso_addon.blender.jobs.indirect import IndirectRenderer  # noqa: E402
from irpso_addon.blender.oiio import ensure_openimageio  # noqa: E402
from irpso_addon.blender.sample import contact_sheet, demo  # noqa: E402
from irpso_addon.blender.scene.scene import read_scene  # noqa: E402
from irpso_addon.cli.demo import make  # noqa: E402
from irpso_addon.core.data import F32, Solution  # noqa: E402
from irpso_addon.core.params import SolveSettings  # noqa: E402
from irpso_addon.core.phrases import percent  # noqa: E402
from irpso_addon.gpu.device import thread  # noqa: E402
from irpso_addon.solve import pipeline  # noqa: E402  # the checkout is no installed package
from studies import pages  # noqa: E402

OUT = pages.DOCS / "stability"
FOOT = -0.8  # metres: the vase's foot
PIXELS, SAMPLES = 160, 64
Colour = tuple[float, float, float]
FLOORS: dict[str, Colour | None] = {
    "red": (0.8, 0.1, 0.05), "none": None, "0.3": (0.3, 0.3, 0.3)}
SHOWN = "red"
HEAD = """\
| floor | shadows | base colour, off | auto | 95 % below, off | auto | roughness, off | auto | seconds, off | auto |
|---|---|---|---|---|---|---|---|---|---|"""


def main() -> int:
    """Render, solve, write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=256)
    size = parser.parse_args().size
    ensure_openimageio()
    OUT.mkdir(parents=True, exist_ok=True)
    rows = []
    for name, colour in FLOORS.items():
        with tempfile.TemporaryDirectory() as folder:
            made = capture(Path(folder), size, colour)
            open_blend(made.scene)
            scene = read_scene(None, demo.NAME, made.captures)
            shot = demo.read_render(scene.views[0].image)
            step = (np.arange(size) * PIXELS) // size
            view = encoded(2 * shot[step][:, step, :3])
            bounce = IndirectRenderer.of_open_file(made.scene)
            off, auto = (
                thread.run(partial(pipeline.solve, scene, SolveSettings(size=size, indirect=mode), bounce=bounce))
                for mode in ("off", "auto"))
        rows.append(row(name, made, off, auto))
        print(rows[-1], flush=True)
        if name == SHOWN:
            show(made, view, off, auto)
    pages.fill(OUT / "indirect.md", {
        "made": pages.measured(auto.device["renderer"], f"Blender {bpy.app.version_string}"),
        "table": "\n".join([HEAD, *rows])})
    return 0


def capture(folder: Path, size: int, colour: Colour | None) -> demo.Demo:
    """The demo's capture, fewer and smaller views, lamps from above, with a floor and bounces."""
    def set_up(scene: bpy.types.Scene) -> None:
        before(scene)
        scene.cycles.max_bounces, scene.cycles.samples = 4, SAMPLES
        if colour is not None:
            bpy.ops.mesh.primitive_plane_add(size=8, location=(0, 0, FOOT))
            bpy.context.object.data.materials.append(demo._material("Floor"))
            inputs = bpy.data.materials["Floor"].node_tree.nodes["Principled BSDF"].inputs
            inputs["Base Color"].default_value = (*colour, 1)
            inputs["Specular IOR Level"].default_value = 0.0

    def from_above(name: str, direction: Vector) -> bpy.types.Object:
        return add(name, Vector((direction.x, direction.y, abs(direction.z) + 0.1)))

    before, add = demo._set_up_render, demo._add_light
    with ExitStack() as stack:
        for key, value in {"_set_up_render": set_up, "_add_light": from_above}.items():
            stack.enter_context(patch.object(demo, key, value))
        return make(folder, demo.Plan(texels=size, cameras=3, lights=8, pixels=PIXELS, samples=SAMPLES))


def row(name: str, made: demo.Demo, off: Solution, auto: Solution) -> str:
    """A line of the table."""
    assert off.checks is not None
    solved = ~off.maps.filled & ~auto.maps.filled & off.maps.coverage
    cells: list[str] = []
    base = [relative(s.maps.base_color, made.base_color)[solved] for s in (off, auto)]
    cells += [f"{percent(np.median(e), 1)}" for e in base] + [f"{percent(np.percentile(e, 95))}" for e in base]
    for s in (off, auto):
        sure = solved & (s.maps.confidence > 0.5)
        cells.append(f"{np.median(np.abs(s.maps.roughness - made.roughness)[sure]):.4f}")
    cells += [f"{sum(s.seconds.values()):.0f}" for s in (off, auto)]
    return f"| {name} | {percent(off.checks.unlit_share, 2)} | " + " | ".join(cells) + " |"


def relative(estimate: F32, truth: F32) -> F32:
    """Mean absolute error over the channels, relative to the mean of the truth's."""
    return np.asarray(np.abs(estimate - truth).mean(-1) / truth.mean(-1))


def show(made: demo.Demo, view: F32, off: Solution, auto: Solution) -> None:
    """Base colours and their errors."""
    errors = [np.where(s.maps.filled, 0, relative(s.maps.base_color, made.base_color)) for s in (off, auto)]
    contact_sheet.save(OUT / "indirect.jpg", [
        [("Base colour: truth", encoded(made.base_color)), ("bounced light ignored", encoded(off.maps.base_color)),
         ("bounced light rendered", encoded(auto.maps.base_color))],
        [("A view", view), *((f"{words}: error, white: 50 %", np.repeat(2 * e[..., None], 3, -1))
                             for words, e in zip(("ignored", "rendered"), errors, strict=True))],
    ])


def encoded(linear: F32) -> F32:
    """For display, about sRGB."""
    return np.asarray(np.clip(linear, 0, 1) ** (1 / 2.2), np.float32)


if __name__ == "__main__":
    sys.exit(main())
