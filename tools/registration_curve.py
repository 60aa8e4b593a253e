"""What cameras that are off and exposures that drift cost, before and after they are corrected.

    python tools/registration_curve.py [--size 256] [--capture FOLDER ...]

Draws docs/stability/registration.png and writes docs/stability/registration.md.  The demo's vase is rendered by Cycles
into build/registration; a FOLDER is a capture with known truth (scene.blend, captures.json, held_out.json, truth.npz).
What was measured is kept in build/registration/results, one file a subject, so that --capture adds to the page.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from irpso_addon.blender.files import open_blend  # noqa: E402
from irpso_addon.blender.material import material  # noqa: E402
from irpso_addon.blender.sample import demo  # noqa: E402
from irpso_addon.blender.scene.scene import read_scene  # noqa: E402
from irpso_addon.cli.demo import make  # noqa: E402
from irpso_addon.core.checks.mended_cameras import moved  # noqa: E402
from irpso_addon.core.data import F32, Bool, SceneData, Solution  # noqa: E402
from irpso_addon.core.evaluation.metrics import map_errors, psnr  # noqa: E402
from irpso_addon.core.params import SolveSettings  # noqa: E402
from irpso_addon.core.phrases import percent  # noqa: E402
from irpso_addon.core.resampling import at_size  # noqa: E402
from irpso_addon.core.samples import vase  # noqa: E402
from irpso_addon.gpu.device import thread  # noqa: E402
from irpso_addon.solve import pipeline  # noqa: E402  # the checkout is no installed package
from studies import pages  # noqa: E402

OUT, PAGE = ROOT / "build" / "registration", pages.DOCS / "stability" / "registration.md"
RESULTS = OUT / "results"
SHIFTS, DRIFTS = (0.0, 0.25, 0.5, 1.0, 2.0), (0.0, 0.02, 0.05, 0.10)
MODES = {"shift": ({"registration": "given"}, {"registration": "auto"}),
         "drift": ({"exposures": "given"}, {"exposures": "solve"})}
COLOURS = ("#0072B2", "#D55E00", "#009E73")


@dataclass(frozen=True)
class Subject:
    """A capture, its truth, and pictures that no view shows."""

    name: str
    scene: SceneData
    base: F32  # (n, n, 3) true base colour, linear
    rough: F32  # (n, n)
    held: list[tuple[str, str, Path]]  # camera, light, picture
    size: int


@dataclass(frozen=True)
class Row:
    """One solve."""

    axis: str  # shift, drift
    amount: float  # pixels; greatest relative error of an exposure
    mended: bool
    relight: float  # dB: pictures under held-out lights, as displayed
    albedo: float  # dB, linear
    rough: float  # mean error
    named: float  # share of the views that are off and were found to be; where none is, of all that were believed to be
    error: float  # greatest error of what was found at first look: pixels, or relative


def main() -> int:
    """Measure what is asked for, then draw all that has been measured."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=256, help="of the vase's maps; captures are solved at 512")
    parser.add_argument("--capture", type=Path, action="append", default=[])
    arguments = parser.parse_args()
    RESULTS.mkdir(parents=True, exist_ok=True)
    for subject in (lambda: painted_vase(arguments.size), *(lambda f=f: captured(f) for f in arguments.capture)):
        renderer = measure(subject())
    found = {p.stem: json.loads(p.read_text()) for p in sorted(RESULTS.glob("*.json"), key=lambda p: p.stem != "vase")}
    draw(found, PAGE.with_suffix(".png"))
    pages.fill(PAGE, {"made": pages.measured(renderer), "tables": tables(found)})
    return 0


# ---- subjects


def painted_vase(size: int) -> Subject:
    """The demo's, smaller."""
    made = make(OUT, demo.Plan(texels=size, cameras=3, lights=12, pixels=224, samples=16))
    open_blend(made.scene)
    scene = read_scene(None, demo.NAME, made.captures)
    held = (f"Camera {demo.HELD_OUT}", f"Light {demo.HELD_OUT}", made.relit)
    return Subject("vase", scene, *vase.truth(size), [held], size)


def captured(folder: Path) -> Subject:
    """A capture from disk."""
    open_blend(folder / "scene.blend")
    scene = read_scene(None, None, folder / "captures.json")
    truth = np.load(folder / "truth.npz")
    held = [(v["camera"], v["lights"][0], folder / v["image"])
            for v in json.loads((folder / "held_out.json").read_text())["views"]]
    return Subject(folder.name, scene, truth["base_color"], truth["roughness"], held, 512)


# ---- measuring


def measure(subject: Subject) -> str:
    """Every amount on both axes, as given and corrected; into a file.  Returns the graphics device."""
    rows: list[Row] = []
    where: Bool | None = None
    for axis, amounts in (("shift", SHIFTS), ("drift", DRIFTS)):
        for amount in amounts:
            scene, truth = spoiled(subject.scene, axis, amount)
            for mended, chosen in enumerate(MODES[axis]):
                settings = SolveSettings(**{
                    "size": subject.size, "model": "one-lobe", "indirect": "off", "registration": "given",
                    "exposures": "given", **chosen})
                solution: Solution = thread.run(lambda s=scene, t=settings: pipeline.solve(s, t))
                where = solution.maps.coverage & ~solution.maps.filled if where is None else where
                named, error = (looked(solution, axis, truth) if not mended else (np.nan, np.nan))
                rows.append(row := Row(axis, amount, bool(mended), *score(subject, solution, where), named, error))
                print(subject.name, row, flush=True)
    (RESULTS / f"{subject.name}.json").write_text(json.dumps([asdict(r) for r in rows], indent=1), encoding="utf-8")
    return solution.device["renderer"]


def spoiled(scene: SceneData, axis: str, amount: float) -> tuple[SceneData, np.ndarray]:
    """The scene with each camera off by ``amount`` pixels in a direction of its own, or exposures by up to ``amount``.

    And what registration should find: (V, 2) pixels, or (V,) logarithms of gain.
    """
    rng = np.random.default_rng(1)
    size = bpy.context.scene.render.resolution_x, bpy.context.scene.render.resolution_y
    if axis == "shift":
        names = sorted({view.camera.name for view in scene.views})
        turns = dict(zip(names, rng.uniform(0, 2 * np.pi, len(names)), strict=True))
        off = {n: (-amount * np.cos(t), -amount * np.sin(t)) for n, t in turns.items()}
        cameras = {v.camera.name: moved(v.camera, (-off[v.camera.name][0], -off[v.camera.name][1]), size)
                   for v in scene.views}
        views = tuple(replace(v, camera=cameras[v.camera.name]) for v in scene.views)
        return replace(scene, views=views), np.array([off[v.camera.name] for v in scene.views])
    drift = rng.uniform(-1, 1, len(scene.views))
    logs = np.log1p(drift * amount / np.abs(drift).max())
    logs -= logs.mean()  # what all have in common is brightness of the paint
    views = tuple(replace(v, gain=v.gain * float(np.exp(-g))) for v, g in zip(scene.views, logs, strict=True))
    return replace(scene, views=views), logs


def looked(solution: Solution, axis: str, truth: np.ndarray) -> tuple[float, float]:
    """Of the first look: share of views named, and the greatest error of what was found."""
    assert solution.checks is not None
    found = solution.checks.registration
    if axis == "shift":
        error = max(float(np.hypot(*np.subtract(m.shift, t))) for m, t in zip(found, truth, strict=True))
        return float(np.mean([m.shifted for m in found])), error
    off = np.abs(truth) > 0.01
    asked = off if off.any() else ~off
    named = np.mean([m.drifted for m, o in zip(found, asked, strict=True) if o])
    return float(named), max(abs(float(np.log(m.gain)) - t) for m, t in zip(found, truth, strict=True))


def score(subject: Subject, solution: Solution, where: Bool) -> tuple[float, float, float]:
    """Relighting and base colour in dB, and the mean error of roughness over the texels ``where``."""
    maps, n = solution.maps, where.shape[0]
    errors = map_errors(at_size(maps.base_color, n), at_size(maps.roughness, n)[..., 0], at_size(subject.base, n),
                        at_size(subject.rough, n)[..., 0], where)
    material.write_maps(bpy.data.objects[subject.scene.mesh.name], solution)
    relit = [relight(*held) for held in subject.held]
    return float(np.mean(relit)), errors.albedo_psnr, errors.rough_mae


def relight(camera: str, light: str, picture: Path) -> float:
    """PSNR of the open scene's render against a picture, both as displayed with the brightest half per cent at 1."""
    lights = [o for o in bpy.data.objects if o.type == "LIGHT"]
    hidden = [o.hide_render for o in lights]
    for lamp in lights:
        lamp.hide_render = lamp.name != light
    scene = bpy.context.scene
    scene.camera, scene.render.filepath = bpy.data.objects[camera], str(OUT / "relit.exr")
    bpy.ops.render.render(write_still=True)
    for lamp, was in zip(lights, hidden, strict=True):
        lamp.hide_render = was
    want, have = demo.read_render(picture), demo.read_render(OUT / "relit.exr")
    inside = want[..., 3] > 0.999
    level = np.percentile(want[inside][:, :3], 99.5)
    shown = [np.clip(image[inside][:, :3] / level, 0, 1) ** (1 / 2.2) for image in (want, have)]
    return psnr(float(np.mean((shown[0] - shown[1]) ** 2)))


# ---- the page


def lines(results: dict[str, Any]) -> Iterator[tuple[str, str, bool, list[dict[str, Any]]]]:
    """Subject, axis, corrected, rows."""
    for name, rows in results.items():
        for axis in MODES:
            for mended in (False, True):
                yield name, axis, mended, [r for r in rows if r["axis"] == axis and r["mended"] == mended]


def draw(results: dict[str, Any], out: Path) -> None:
    """Relighting and roughness against each axis."""
    figure, axes = plt.subplots(2, 2, figsize=(10, 6.4), sharey="row", sharex="col")
    column = {"shift": 0, "drift": 1}
    colour = dict(zip(results, COLOURS, strict=False))
    for name, axis, mended, rows in lines(results):
        x = [r["amount"] * (100 if axis == "drift" else 1) for r in rows]
        style = {"color": colour[name], "linewidth": 2, "marker": "o", "markersize": 5,
                 "linestyle": "-" if mended else (0, (4, 2)), "markerfacecolor": colour[name] if mended else "white",
                 "label": f"{name}, {'corrected' if mended else 'as given'}"}
        axes[0, column[axis]].plot(x, [r["relight"] for r in rows], **style)
        axes[1, column[axis]].plot(x, [r["rough"] for r in rows], **style)
    axes[0, 0].set(ylabel="relighting, dB", title="Cameras off")
    axes[0, 1].set(title="Exposures off")
    axes[1, 0].set(ylabel="roughness error (mean)", xlabel="error of each camera, pixels")
    axes[1, 1].set(xlabel="greatest error of a view's exposure, %")
    for panel in axes.flat:
        panel.grid(color="#dddddd", linewidth=0.6)
        panel.spines[["top", "right"]].set_visible(False)
    axes[1, 0].set_ylim(bottom=0)
    axes[1, 0].set_xticks(SHIFTS, [f"{shift:g}" for shift in SHIFTS])
    axes[1, 1].set_xticks([100 * drift for drift in DRIFTS])
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=len(results), frameon=False, fontsize=9.5)
    figure.tight_layout(rect=(0, 0.09, 1, 1))
    figure.savefig(out, dpi=90, facecolor="white", pil_kwargs={"optimize": True})
    plt.close(figure)


def tables(results: dict[str, Any]) -> str:
    """One of each capture, under its name."""
    text = []
    for name, rows in results.items():
        text.append(f"\n## {name}\n\n| | relighting, dB: as given | corrected | base colour, dB: as given | corrected "
                    "| roughness error: as given | corrected | views named | error of what was found |\n"
                    "|---|---|---|---|---|---|---|---|---|\n")
        for axis, amount in dict.fromkeys((r["axis"], r["amount"]) for r in rows):
            given, right = (next(r for r in rows if (r["axis"], r["amount"], r["mended"]) == (axis, amount, m))
                            for m in (False, True))
            what = f"{amount:g} pixels" if axis == "shift" else f"{percent(amount)} of exposure"
            error = f"{given['error']:.3f} pixels" if axis == "shift" else f"{percent(given['error'], 1)}"
            text.append(f"| {what} | {given['relight']:.1f} | {right['relight']:.1f} | {given['albedo']:.1f} "
                        f"| {right['albedo']:.1f} | {given['rough']:.4f} | {right['rough']:.4f} | "
                        f"{percent(given['named'])} "
                        f"| {error} |\n")
    return "".join(text)


if __name__ == "__main__":
    sys.exit(main())
