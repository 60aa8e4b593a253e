"""The chart, and spheres relit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from irpso_addon.core.data import F64, Bool
from irpso_addon.core.shading import tables

from . import fit, rig
from .judge import BRIGHT, EXPOSED, LUMINANCE, encode
from .recover import Principled, Recovered
from .run import AUTO, KINDS, LEVEL, LOSS_MODELS, PUBLISHED, SPHERE, Material

# Okabe and Ito's palette, told apart by the colour-blind.
COLOURS = ("#D55E00", "#E69F00", "#CC79A7", "#009E73", "#0072B2", "#000000", "#56B4E9")
LOSS_COLOURS = dict(zip(fit.LOSSES, ("#D55E00", "#0072B2", "#56B4E9", "#009E73", "#CC79A7"), strict=True))
PIXELS = 112  # of a sphere
SHOWN = 12
LAMPS = (0, 3)  # of the held-out ones, lit together
Reflectance = Callable[[F64, F64], F64]


def best_published(material: Material) -> float:
    """Display error of the best published fit."""
    return min(material.display(name) for name in material.published)


def chart(materials: Sequence[Material], out: Path) -> None:
    """Fit quality, and roughness, by loss."""
    figure = Figure(figsize=(13, 4.6), layout="constrained")
    FigureCanvasAgg(figure)  # no window, whatever the machine
    left, middle, right = figure.subplots(1, 3)
    _quality(left, materials)
    _losses(middle, materials)
    _roughness(right, materials)
    for axis in (left, middle, right):
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(alpha=0.25)
    figure.savefig(out, dpi=100, pil_kwargs={"optimize": True})


def _quality(axis: Axes, materials: Sequence[Material]) -> None:
    for kind, colour in zip(KINDS, COLOURS, strict=True):
        of = [m for m in materials if m.kind == kind]
        axis.scatter([best_published(m) for m in of], [m.display(AUTO) for m in of], s=18, color=colour, label=kind)
    ends = (0.008, 1.0)
    axis.plot(ends, ends, color="#777777", linewidth=1)
    axis.set(xscale="log", yscale="log", xlim=ends, ylim=ends, xlabel="best published fit: display error",
             ylabel=f"{AUTO}, maps: display error", title="Relighting: below the line the product is nearer")
    for side in (axis.xaxis, axis.yaxis):
        side.set_major_formatter("{x:g}")
    axis.legend(fontsize=8, loc="upper left")


def _losses(axis: Axes, materials: Sequence[Material]) -> None:
    """Medians with quartiles of the display error, by loss and model."""
    rows: list[tuple[str, str, list[float]]] = []
    for model in LOSS_MODELS:
        rows += [(f"{model}, {loss}", LOSS_COLOURS[loss], [m.display(f"{model}: {loss}") for m in materials])
                 for loss in fit.LOSSES]
    rows += [(name, "#777777", [m.display(name) for m in materials if name in m.published]) for name in PUBLISHED]
    for y, (_, colour, values) in enumerate(rows):
        low, mid, high = np.percentile(values, (25, 50, 75))
        axis.plot([low, high], [y, y], color=colour, linewidth=3, alpha=0.5)
        axis.plot([mid], [y], "o", color=colour)
    axis.set_yticks(range(len(rows)), [name for name, _, _ in rows], fontsize=8)
    axis.invert_yaxis()
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_formatter("")
    axis.set_xticks([0.02, 0.03, 0.05, 0.1, 0.2, 0.3])
    axis.set(xlabel="display error: median and quartiles", title="One value, by the loss it was fitted by")


def _roughness(axis: Axes, materials: Sequence[Material]) -> None:
    order = sorted(materials, key=lambda m: float(m.fitted[f"{LEVEL}: relative"].shared[0]))
    for loss in fit.LOSSES:
        axis.plot([m.fitted[f"{LEVEL}: {loss}"].shared[0] for m in order], ".", color=LOSS_COLOURS[loss], label=loss)
    axis.plot([m.uniform[f"sphere, no noise: {LEVEL}"].roughness for m in order], "x", color="#000000", markersize=4,
              label="maps of the rung")
    axis.plot([m.published["Low E2"].roughness if "Low E2" in m.published else np.nan for m in order], "+",
              color="#777777", markersize=5, label="Low E2, sqrt(m)")
    axis.set(xlabel="material, by roughness", ylabel="roughness", title="Roughness, by the loss", ylim=(0, 1.02))
    axis.legend(fontsize=8, loc="upper left")


def spheres(materials: Sequence[Material], out: Path) -> None:
    """Truth, maps, one value and the best published fit of a dozen, from where ``auto`` does best to worst."""
    order = sorted(materials, key=lambda m: m.display(AUTO) / best_published(m))
    chosen = [order[i] for i in np.unique(np.linspace(0, len(order) - 1, SHOWN).round().astype(int))]
    figure = Figure(figsize=(11.2, 1.62 * -(-len(chosen) // 2)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(-(-len(chosen) // 2), 2, squeeze=False)
    for axis in axes.ravel():
        axis.axis("off")
    for axis, material in zip(axes.T.ravel(), chosen, strict=False):
        strip, labels = _strip(material)
        axis.imshow(strip)
        for i, label in enumerate(labels):
            axis.text((i + 0.5) * PIXELS, PIXELS + 2, label, ha="center", va="top", fontsize=7)
        axis.set_title(material.name, fontsize=8, pad=2)
    figure.savefig(out, dpi=90, pil_kwargs={"quality": 88})


def _strip(material: Material) -> tuple[F64, list[str]]:
    """Pictures side by side, all exposed as the truth, and their labels."""
    source = min(material.published, key=material.display)
    assert material.maps is not None
    shown: list[tuple[str, Reflectance | Recovered]] = [
        ("measured", material.truth), (f"{AUTO} {material.display(AUTO):.3f}", material.maps),
        (f"one value {material.display(AUTO + ', one value'):.3f}", material.maps.uniform()),
        (f"{source} {material.display(source):.3f}", material.published[source])]
    pictures = [_render(reflectance) for _, reflectance in shown]
    on = _seen(rig.HELD_OUT_CAMERA)[1]
    luminance = pictures[0] @ LUMINANCE
    exposure = EXPOSED / max(float(np.percentile(luminance[luminance > 0], BRIGHT)), 1e-12)
    strip = np.concatenate([np.where(on[..., None], encode(exposure * p), 1.0) for p in pictures], axis=1)
    return strip, [label for label, _ in shown]


def _render(of: Reflectance | Recovered) -> F64:
    """Radiance (PIXELS, PIXELS, 3) from the held-out camera."""
    normal, hit = _seen(rig.HELD_OUT_CAMERA)
    surface = rig.Surface("pixels", normal, normal, hit)
    lamps = rig.lamps(rig.HELD_OUT_LAMPS, turn=1.3)[list(LAMPS)]
    maps = _looked_up(of, normal[hit]) if isinstance(of, Recovered) else None
    radiance = np.zeros((PIXELS, PIXELS, 3))
    for view in rig.views(surface, rig.HELD_OUT_CAMERA[None], lamps):
        f = (maps or of)(view.L[hit], view.V[hit])  # type: ignore[operator]
        radiance[hit] += f * view.irradiance[hit][:, None]
    return radiance


def _seen(camera: F64) -> tuple[F64, Bool]:
    """Normal (PIXELS, PIXELS, 3) of the unit sphere in a camera's picture, row 0 at the top, and where it is."""
    distance = np.linalg.norm(camera)
    z = camera / distance
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    at = ((np.arange(PIXELS) + 0.5) / PIXELS * 2 - 1) * 1.03 / np.sqrt(distance**2 - 1)
    u, v = np.meshgrid(at, -at)
    ray = u[..., None] * x + v[..., None] * np.cross(z, x) - z
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    along = ray @ camera
    root = along**2 - (distance**2 - 1)
    normal = camera + (-along - np.sqrt(np.maximum(root, 0)))[..., None] * ray
    return np.where((root > 0)[..., None], normal, z), root > 0


def _looked_up(texels: Recovered, normal: F64) -> Principled:
    """The maps at (n, 3) normals; beyond the texels the one value."""
    one, maps = texels.uniform(), texels.maps
    polar = np.arccos(np.clip(normal[:, 2], -1, 1))
    radius = np.sin(polar / 2) / np.sin(rig.SPHERE_EDGE / 2)
    flat = np.maximum(np.hypot(normal[:, 0], normal[:, 1]), 1e-9)
    uv = (normal[:, :2] / flat[:, None] * radius[:, None] + 1) / 2
    on = radius < 1 - 2 / SPHERE
    at = (uv * SPHERE - 0.5) / (SPHERE - 1)  # 0..1 from the first texel's centre to the last's

    def look(grid: F64, else_: F64) -> F64:
        filled = np.where(texels.solved[..., None], grid, else_)
        return np.where(on[:, None], tables.bilinear(filled, at[:, 1], at[:, 0]), else_)

    roughness, roughness2, weight, level = (
        look(grid[..., None], else_[None])[:, 0] for grid, else_ in
        ((maps.roughness, one.roughness), (maps.roughness2, one.roughness2), (maps.weight, one.weight),
         (maps.level, one.level)))
    return Principled(maps.model, look(maps.base, one.base), roughness, roughness2, weight, level, maps.metallic,
                      maps.coat, maps.diffuse_roughness)
