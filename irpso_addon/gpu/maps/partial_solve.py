"""A solve of some of the texels: which, from where the search begins, and how the rest of the last result joins in."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...core.data import F32, I32, Bool, Maps, Region, SceneData, Solution
from ...core.errors import BadInput
from ...core.maps import region
from ...core.params import SolveSettings, choice_name
from ...core.resampling import nearest
from ..device.context import Device
from ..gbuffer.solve_mask import SolveMask
from ..gbuffer.triangles import Triangles
from ..solve.ladder_records import EarlierResult, LadderResult


@dataclass(frozen=True)
class PartialSolve(SolveMask):
    """What a solve changes, and what it keeps of the last result."""

    known: Bool  # (n, n) the last result has a value of its own, which stays where the new one has none
    last: Maps | None = None  # the last result at this size; None: there is none

    def share(self, solved: Bool) -> F32:
        """(n, n) of the new result in the end, where it was ``solved``; 1 too where there is nothing else."""
        return np.where(self.known, self.weight * solved, np.float32(1.0)).astype(np.float32)

    def join(self, new: F32, role: str, share: F32) -> F32:
        """A map of the new result mixed with the last one's."""
        if self.last is None:
            return new
        old = getattr(self.last, role)
        weight = share if new.ndim == 2 else share[..., None]
        return np.where(weight == 0, old, np.where(weight == 1, new, weight * new + (1 - weight) * old)).astype(
            np.float32)

    def join_ladder(self, new: LadderResult, start: Solution | None) -> LadderResult:
        """The new roughnesses and levels among the last ones."""
        if self.last is None or start is None:
            return new
        share = self.share(new.texels.solved)
        texels = replace(new.texels, roughness=self.join(new.texels.roughness, "roughness", share),
                         solved=new.texels.solved | self.known)
        joined = replace(new, texels=texels, model={**start.model, **new.model}, why={**start.why, **new.why},
                         levels={**start.levels, **new.levels}, predictions={**start.predictions, **new.predictions},
                         priors={**start.priors, **new.priors},
                         metallic={**{name: value for name, value in start.metallic.items() if name not in new.model},
                                   **new.metallic},
                         coats={**{name: coat for name, coat in start.coats.items() if name not in new.model},
                                **new.coats},
                         diffuse_roughness={**{name: value for name, value in start.diffuse_roughness.items()
                                               if name not in new.model}, **new.diffuse_roughness})
        if new.painted or start.paint:
            none = np.zeros(share.shape, bool)
            joined.paint = np.where(share > 0.5, none if new.paint is None else new.paint,
                                    none if self.last.metallic is None else self.last.metallic == 0)
            joined.painted = new.painted | {name for name in start.paint if name in joined.metallic}
        if new.lobes is not None or self.last.lobes is not None:
            weight = share[..., None]
            joined.lobes = weight * _lobes(new.texels.roughness, new.lobes) + (1 - weight) * _lobes(
                self.last.roughness, self.last.lobes)
        if new.level is not None or self.last.specular is not None:
            half = np.full_like(share, 0.5)
            joined.level = share * (half if new.level is None else new.level) + (1 - share) * (
                half if self.last.specular is None else self.last.specular)
        return joined

    def join_base(self, base: F32) -> F32:
        """(n, n, 4): the new base colour, and how far it is known, among the last one's."""
        if self.last is None:
            return base
        share = np.where(self.known, self.weight * np.clip(base[..., 3], 0, 1), np.float32(1.0))
        return np.concatenate([self.join(base[..., :3], "base_color", share),
                               np.maximum(base[..., 3:], self.known[..., None])], -1).astype(np.float32)

    def join_maps(self, maps: Maps, share: F32) -> Maps:
        """Confidence, error and standard errors among the last ones."""
        joined: dict[str, Any] = {role: self.join(getattr(maps, role), role, share)
                                  for role in ("confidence", "error", "roughness_sigma", "base_sigma")}
        return replace(maps, **joined)


def _lobes(roughness: F32, lobes: F32 | None) -> F32:
    return np.stack([roughness, roughness, np.ones_like(roughness)], -1) if lobes is None else lobes


def partial_solve_of(device: Device, scene: SceneData, size: int, position: F32, slots: I32) -> PartialSolve:
    """What is to be solved.  Raises BadInput when no texel is in the region.

    ``position``: (n, n, 3) metres.  ``slots``: (n, n) material slot of each covered texel, -1 elsewhere.
    """
    covered = slots >= 0
    if scene.region is None:
        return PartialSolve(covered.astype(np.float32), True, np.zeros_like(covered))
    inside = covered & _inside(device, scene, scene.region, size)
    if not inside.any():
        raise BadInput(f"{scene.mesh.name}: the region to solve covers no texel at {size} x {size}; "
                       "choose a larger region, or increase Size")
    if scene.start is None:
        return PartialSolve(inside.astype(np.float32), False, np.zeros_like(covered))
    last = region.resized(scene.start.maps, size)
    within = np.isin(slots, np.unique(slots[inside]))  # where one material ends there is a seam already
    return PartialSolve(region.fade(position, within, inside), False, covered & ~last.filled, last)


def _inside(device: Device, scene: SceneData, chosen: Region, size: int) -> Bool:
    if chosen.corners is None:
        assert chosen.image is not None
        return region.of_image(chosen.image, size)
    corners = np.concatenate([scene.mesh.uvs, chosen.corners[..., None]], axis=2).astype(np.float32)
    program = device.programs.get("gbuffer/region.vert", "gbuffer/region.frag")
    triangles = Triangles(scene.mesh.positions, 0, len(corners), scene.mesh.uvs)
    with device.scope():
        texture = device.texture(size, size, 1)
        array = device.vertex_array(program, [(device.buffer(corners), "3f", "in_corner")])
        with device.target([texture], clear=True) as target:
            triangles.draw(device, ("gbuffer/region.frag", size), array, target, None)
        return device.read(texture)[..., 0] > 0.5


def earlier_result_of(
    part: PartialSolve, scene: SceneData, settings: SolveSettings, slots: I32,
) -> EarlierResult | None:
    """What the ladder takes over from the last result.

    Materials of which a part stays as it is keep their model.  ``slots``: (n, n) of each covered texel, -1 elsewhere.
    Raises BadInput where another model is asked for.
    """
    start, names = scene.start, scene.mesh.slot_names
    if start is None:
        return None
    of = {name: np.isin(slots, [i for i, other in enumerate(names) if other == name]) for name in start.model}
    unsolved = part.known & (part.weight < 1)
    shared = [name for name, mask in of.items() if unsolved[mask].any() and part.solved[mask].any()]
    for name in shared:
        _check_model(name, start, settings)
    again = settings.start == "last"
    taken = list(start.model) if again else shared
    return EarlierResult(
        model={name: start.model[name] for name in taken} if settings.model == "auto" else {},
        levels={name: level for name, level in start.levels.items() if name in taken}, fixed=frozenset(shared),
        level=None if part.last is None else part.last.specular,
        lobes=_seeds(region.resized(start.maps, settings.size)) if again else None,
        priors={name: prior for name, prior in start.priors.items() if name in taken},
        metallic={name: value for name, value in start.metallic.items() if name in taken},
        coats={name: coat for name, coat in start.coats.items() if name in taken and settings.model == "auto"},
        diffuse_roughness={name: value for name, value in start.diffuse_roughness.items()
                           if name in taken and settings.model == "auto"},
        predictions={name: found for name, found in start.predictions.items() if name in taken},
        painted=frozenset(start.paint).intersection(taken),
        paint=None if start.maps.metallic is None else nearest(start.maps.metallic, settings.size) == 0)


def _check_model(name: str, start: Solution, settings: SolveSettings) -> None:
    """A material has one model: raises BadInput where a part of it would get another."""
    model = start.model[name]
    wanted = "one-lobe" if settings.model == "auto" and settings.method == "paper" else settings.model
    if wanted not in ("auto", model):
        raise BadInput(f"material '{name}': its other region was solved as {choice_name(model)}, not "
                       f"{choice_name(wanted)}; choose that model, "
                       "or solve the whole object")
    if name in start.coats and settings.model != "auto":
        raise BadInput(f"material '{name}': its other region has a coat, for which only model Auto solves; choose "
                       "that model, or solve the whole object")
    if name in start.diffuse_roughness and settings.model != "auto":
        raise BadInput(f"material '{name}': its other region has a Diffuse Roughness, for which only model Auto "
                       "solves; choose that model, or solve the whole object")
    if name in start.paint and settings.model != "auto":
        raise BadInput(f"material '{name}': its other region is metal and paint, for which only model Auto solves; "
                       "choose that model, or solve the whole object")
    if model == "two-lobe" and start.ndf != settings.ndf:
        raise BadInput(f"material '{name}': its other region was solved with Highlight Shape "
                       f"{choice_name(start.ndf)}; choose that, or solve the whole object")


def _seeds(maps: Maps) -> F32:
    """(n, n, 4): roughness1, roughness2, weight; whether known."""
    return np.concatenate([_lobes(maps.roughness, maps.lobes), ~maps.filled[..., None]], -1).astype(np.float32)
