"""The lamps and views of a scene as numbers that can be found: places, powers, exposures.

A *rig group* holds the lamps that share their numbers: one lamp, or the copies of a flash that each camera carries.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..checks.light_checks import moved
from ..checks.mended_cameras import given_name
from ..data import F64, Camera, Light, View
from ..shading.lights import with_extent

# Of the distance: lamps that stand so alike beside their cameras are one flash.  So do they where a solve has turned
# cameras by a degree about their axes, and left the flashes.
SAME = 5e-3
SAME_POWER = 1e-6  # relative


@dataclass(frozen=True)
class RigGroup:
    """Lamps that share their numbers."""

    name: str  # of the first
    lights: tuple[str, ...]
    axes: tuple[F64, ...]  # of each lamp: (3, 3) world from the axes in which the group is moved
    reach: float  # metres to the object, of the first; of a SUN 1: it is turned, by radians
    cameras: tuple[str, ...] = ()  # of lamps that cameras carry: theirs
    sun: bool = False
    kept: bool = False  # what is given of one of them is sure

    @property
    def carried(self) -> bool:
        """Whether cameras carry them."""
        return bool(self.cameras)


@dataclass(frozen=True)
class RigChange:
    """What is to be changed of G groups and V views."""

    offset: F64  # (G, 3) in the groups' axes, of their reach
    log_power: F64  # (G,)
    log_gain: F64  # (V,) of radiance in the picture over the view's
    vignetting: float = 0.0  # to be added to every view's
    ambient: float = 0.0  # irradiance by light from all around, over the sample's typical irradiance by lamps
    log_response: float = 0.0  # of the power to which files hold radiance
    log_shoulder: float = 0.0  # of how many times flatter their curve is at white
    # What a diffuse that is not Lambert's may show instead: powers of the cosine to the lamp, of what a dielectric lets
    # in and out, and of what a rough surface shows.  Nothing is put right by them.
    cosine: float = 0.0
    transmission: float = 0.0
    rough: float = 0.0
    log_tint: F64 | None = None  # (G, 3) of powers in each channel, beside log_power (tints.py); None: as given
    # (V, 3) of what pictures show in each channel, beside log_gain (tints.py); None: as given
    log_balance: F64 | None = None
    black_level: F64 | None = None  # (3,) to be added to every view's (black_level.py); None: as given
    extent: float | None = None  # of all lamps, as `extent_of` has it (lamp_size.py); None: as given

    @classmethod
    def none(cls, groups: int, views: int) -> RigChange:
        """Everything as it is given."""
        return cls(np.zeros((groups, 3)), np.zeros(groups), np.zeros(views))

    @property
    def moves(self) -> bool:
        """Whether a lamp stands elsewhere."""
        return bool(self.offset.any())

    @property
    def bends(self) -> bool:
        """Whether radiance is no longer in proportion to what it was."""
        return bool(self.ambient or self.log_response or self.log_shoulder)


@dataclass(frozen=True)
class Rig:
    """The lamps of some views."""

    views: tuple[View, ...]
    groups: tuple[RigGroup, ...]

    @classmethod
    def of(cls, views: Sequence[View], middle: F64) -> Rig:
        """``middle``: (3,) of the object, metres."""
        lights: dict[str, Light] = {}
        cameras: dict[str, dict[str, Camera]] = {}
        for view in views:
            for light in view.lights:
                lights.setdefault(light.name, light)
                cameras.setdefault(light.name, {}).setdefault(given_name(view), view.camera)
        groups: list[RigGroup] = []
        flash = _flash(lights, cameras, middle)
        if flash is not None:
            groups.append(flash)
        taken = () if flash is None else flash.lights
        groups += [RigGroup(name, (name,), (np.eye(3),), _reach(light, middle), sun=light.kind == "SUN",
                             kept=light.kept)
                   for name, light in lights.items() if name not in taken]
        return cls(tuple(views), tuple(groups))

    @property
    def one_flash(self) -> bool:
        """Whether all light is that of a flash which cameras carry, and nobody measured it."""
        return len(self.groups) == 1 and self.groups[0].carried and not self.groups[0].kept

    def number(self) -> dict[str, int]:
        """Of each lamp's group."""
        return {name: n for n, group in enumerate(self.groups) for name in group.lights}

    def lights(self, change: RigChange) -> dict[str, Light]:
        """The lamps by name, after a change."""
        given: dict[str, Light] = {}
        for view in self.views:
            for light in view.lights:
                given.setdefault(light.name, light)
        result = {}
        powers = change.log_power[:, None] + (0.0 if change.log_tint is None else change.log_tint)
        for group, offset, power in zip(self.groups, change.offset, powers, strict=True):
            for name, axes in zip(group.lights, group.axes, strict=True):
                light = given[name] if change.extent is None else with_extent(given[name], change.extent)
                for axis, by in enumerate(axes @ offset * group.reach):
                    light = moved(light, axis, float(by)) if by else light
                result[name] = replace(light, power=light.power * np.exp(power)) if power.any() else light
        return result


def with_factors(given: tuple[float, float, float], by: Sequence[float] | F64) -> tuple[float, float, float]:
    """A colour, each channel times another one's."""
    red, green, blue = (value * float(factor) for value, factor in zip(given, by, strict=True))
    return red, green, blue


def with_more(given: tuple[float, float, float], by: Sequence[float] | F64) -> tuple[float, float, float]:
    """A colour and another one."""
    red, green, blue = (value + float(more) for value, more in zip(given, by, strict=True))
    return red, green, blue


def _reach(light: Light, middle: F64) -> float:
    return 1.0 if light.kind == "SUN" else max(float(np.linalg.norm(light.matrix[:3, 3] - middle)), 1e-6)


def _flash(lights: dict[str, Light], cameras: dict[str, dict[str, Camera]], middle: F64) -> RigGroup | None:
    """The lamps that stand beside their cameras alike, each lit for one camera; None: there are not two."""
    carried = [(name, next(iter(cameras[name].values()))) for name, light in lights.items()
               if len(cameras[name]) == 1 and light.kind != "SUN"]
    if len(carried) < 2 or len({camera.name for _, camera in carried}) < len(carried):
        return None
    places = np.array([(camera.world_to_camera @ lights[name].matrix[:, 3])[:3] for name, camera in carried])
    powers = np.array([lights[name].power for name, _ in carried])
    reach = _reach(lights[carried[0][0]], middle)
    if np.abs(places - places[0]).max() > SAME * reach or np.abs(powers - powers[0]).max() > SAME_POWER * powers.max():
        return None
    names = tuple(name for name, _ in carried)
    return RigGroup(names[0], names, tuple(camera.world_to_camera[:3, :3].T for _, camera in carried), reach,
                    tuple(next(iter(cameras[name])) for name in names),
                    kept=any(lights[name].kept for name in names))
