"""All materials under all methods: errors and numbers, for the page."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from irpso_addon.core.data import F32, F64, MaterialPrediction
from irpso_addon.core.evaluation.folds import WHITE
from irpso_addon.gpu.device.context import Device

from . import fit, merl, rig
from .judge import Judge, Judgement
from .recover import Principled, Recovered, recover

SPHERE, COW = 32, 48  # width of the maps
NOISE = 0.01
PUBLISHED = tuple(merl.FITS)
AUTO = "auto"  # the default, which the page compares with what is published
LEVEL = "one-lobe-specular"  # the rung whose numbers are also fitted jointly, by every loss
METALLIC = "one-lobe-metallic"
LOSS_MODELS = (LEVEL, "cook-torrance")


@dataclass(frozen=True)
class Solve:
    """One way to ask the product."""

    name: str
    model: str
    loss: str = "squares"
    everywhere: bool = False  # also on the cow, and with noise


SOLVES = (
    Solve("lambert", "lambert", everywhere=True), Solve("one-lobe", "one-lobe", everywhere=True),
    Solve(LEVEL, LEVEL, everywhere=True), Solve(METALLIC, METALLIC, everywhere=True), Solve("two-lobe", "two-lobe"),
    Solve(AUTO, AUTO, "auto", everywhere=True), Solve("robust", LEVEL, "robust"),
)


@dataclass(frozen=True)
class Scene:
    """An object with what is observed of it and what is held out."""

    name: str
    noise: float
    seen: rig.Geometry
    held_out: list[rig.View]

    @property
    def title(self) -> str:
        """As the page names it."""
        return f"{self.name}, {f'{100 * self.noise:g} % noise' if self.noise else 'no noise'}"


@dataclass
class Material:
    """What is known of one material in the end."""

    name: str
    kind: str
    truth: merl.Network
    published: dict[str, merl.CookTorrance]
    errors: dict[str, Judgement] = field(default_factory=dict)  # by "scene: method"
    uniform: dict[str, Principled] = field(default_factory=dict)  # by "scene: solve"
    fitted: dict[str, fit.Fitted] = field(default_factory=dict)  # by "model: loss"
    predictions: dict[str, MaterialPrediction] = field(default_factory=dict)  # by scene, where ``auto`` could make one
    largest: dict[str, float] = field(default_factory=dict)  # by scene, see ``largest_share``
    maps: Recovered | None = None  # of AUTO on the sphere without noise

    def display(self, method: str) -> float:
        """Display error on the sphere without noise."""
        return self.errors[f"sphere, no noise: {method}"].display


def scenes(cow: Path | None) -> list[Scene]:
    """Sphere and cow, without and with noise."""
    surfaces = [rig.sphere(SPHERE), *([rig.cow(cow, COW)] if cow else [])]
    made = []
    for surface in surfaces:
        seen = rig.geometry(rig.views(surface, rig.CAMERAS, rig.lamps(rig.LAMPS)))
        cameras = np.array([rig.CAMERAS[0], rig.HELD_OUT_CAMERA])
        held_out = rig.views(surface, cameras, rig.lamps(rig.HELD_OUT_LAMPS, turn=1.3))
        made += [Scene(surface.name, noise, seen, held_out) for noise in (0.0, NOISE)]
    return made


def run(device: Device, folder: Path, cow: Path | None, only: Callable[[str], bool]) -> Iterator[Material]:
    """One material after the other."""
    published, places = merl.fits(folder), scenes(cow)
    for network in merl.networks(folder):
        if not only(network.name):
            continue
        fits = {source: table[network.name] for source, table in published.items() if network.name in table}
        material = Material(network.name, kind_of(network.name), network, fits)
        for scene in places:
            _solve(device, material, scene)
        _fit(material, places[0])
        yield material


def largest_share(scene: Scene, rgb: F32) -> float:
    """How much of the sum of squared radiances one observation makes up.  rgb: (h, w, K, 3), 1/sr."""
    squares = ((rgb * scene.seen.irradiance[..., None]) ** 2).sum(-1)[scene.seen.quality > 0]
    return float(squares.max() / squares.sum())


def _judge(material: Material, scene: Scene, rgb: F32) -> Judge:
    """``rgb``: (h, w, K, 3) what is observed, by which prediction finds the radiance that is white."""
    seen = scene.seen.quality > 0
    white = np.percentile((rgb * scene.seen.irradiance[..., None])[seen], WHITE)
    told = seen.sum(-1) >= 3
    return Judge(scene.held_out, lambda v, m: material.truth(v.L[m], v.V[m]), told, float(white))


def _everywhere(reflectance: Callable[[F64, F64], F64]) -> Callable[[rig.View, np.ndarray], F64]:
    return lambda v, m: reflectance(v.L[m], v.V[m])


def _by_texel(maps: Principled) -> Callable[[rig.View, np.ndarray], F64]:
    return lambda v, m: maps.at(m)(v.L[m], v.V[m])


def _solve(device: Device, material: Material, scene: Scene) -> None:
    rgb = rig.observe(scene.seen.views, material.truth, scene.noise)
    judge = _judge(material, scene, rgb)
    material.largest[scene.title] = largest_share(scene, rgb)
    first = scene.name == "sphere" and not scene.noise
    for name, reflectance in material.published.items():
        material.errors[f"{scene.title}: {name}"] = judge(_everywhere(reflectance))
    for solve in SOLVES:
        if not (first or solve.everywhere):
            continue
        found = recover(device, scene.seen, rgb, solve.model, loss=solve.loss)
        key, one = f"{scene.title}: {solve.name}", found.uniform()
        material.errors[key] = judge(_by_texel(found.maps))
        material.errors[f"{key}, one value"] = judge(_everywhere(one))
        material.uniform[key] = one
        if found.prediction is not None:
            material.predictions[scene.title] = found.prediction
        if first and solve.name == AUTO:
            material.maps = found


def _fit(material: Material, scene: Scene) -> None:
    """One value by every loss."""
    rgb = rig.observe(scene.seen.views, material.truth, scene.noise)
    judge = _judge(material, scene, rgb)
    of = fit.samples(scene.seen.views, rgb, scene.seen.quality)
    for model in LOSS_MODELS:
        scale = 0.0
        for loss in fit.LOSSES:
            found = fit.fit(model, of, loss, scale)
            if loss == "relative":
                scale = fit.scale_of(found, of)
            material.fitted[f"{model}: {loss}"] = found
            material.errors[f"{scene.title}: {model}: {loss}"] = judge(_everywhere(found))
    found = material.fitted["metallic"] = fit.fit("metallic", of, "relative")
    material.errors[f"{scene.title}: metallic"] = judge(_everywhere(found))


KINDS = {
    "metal": ("alum-bronze", "aluminium", "black-oxidized-steel", "brass", "chrome", "grease-covered-steel", "nickel",
              "ss440", "steel", "tungsten-carbide", "two-layer", "hematite"),
    "metallic paint": ("metallic-paint", "color-changing-paint", "gold-paint", "silver-paint", "pearl-paint"),
    "fabric": ("fabric", "felt"),
    "wood": ("cherry", "maple", "fruitwood", "pine", "natural-209", "oak", "walnut"),
    "paint": ("paint", "latex"),
    "stone, glass": ("alumina-oxide", "aventurnine", "obsidian", "jasper", "marble", "silicon-nitrade"),
    "plastic, rubber": ("",),
}


def kind_of(name: str) -> str:
    """The first kind of which a word is in the name."""
    return next(kind for kind, words in KINDS.items() if any(word in name for word in words))
