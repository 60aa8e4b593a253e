"""The numbers of a rig as one vector, and what is known of them before the pictures are looked at."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..data import F64
from .rig import Rig, RigChange
from .rig_sample import RigSample
from .shade import AroundInShade

PLACE, POWER, GAIN = 0.05, 0.1, 0.03  # what a shoot's figures are off by: of a lamp's distance; relative
VIGNETTING = 2.0  # power of the cosine
AMBIENT, RESPONSE = 0.2, 0.3  # of the lamps' typical irradiance; of the logarithm of the response's exponent
SHOULDER = 2.0  # of the logarithm
COSINE, TRANSMISSION, ROUGH = 0.3, 1.0, 1.0  # powers
LEVEL = 0.3  # of Specular IOR Level
CAUCHY = 2.4  # standard deviations at which an observation has lost half its weight
SHARED, DIFFUSE = 7, 3  # numbers of all views: vignetting, ambient light, response, shoulder; last, of the diffuse
MEAN = 1e-4  # of powers, and of gains: brightness as a whole belongs to the base colours
LEAST_USUAL = 1e-3  # of a lamp's distance, relative power
# Lamps whose powers are as far off as exposures are, which are believed in beside the shoot's.  A power is hardly told
# from exposures: what a few of them typically are off by often comes out as nothing.
BELIEVED = 4.0
LEAST_LAMPS = 4  # that are free: fewer say little of what is typical


@dataclass(frozen=True)
class Free:
    """Which numbers are looked for."""

    lamps: bool  # places and powers
    exposures: bool
    vignetting: bool = False
    levels: bool = False  # the Specular IOR Level of each material
    ambient: bool = False
    response: bool = False
    shoulder: bool = False  # of the response
    cosine: bool = False  # a power of the cosine: the usual way in which a diffuse is not Lambert's
    diffuse: bool = False  # all that it may have beside Lambert's
    tilts: bool = False  # of the texels' normals, in detail: each texel's own, as its base colour

    @property
    def scene(self) -> bool:
        """Whether any of the scene's numbers are."""
        return self.ambient or self.lamps or self.exposures or self.vignetting or self.response

    @property
    def only_ambient(self) -> bool:
        """Of the scene's numbers."""
        return self.ambient and not replace(self, ambient=False).scene


def tell_typical(rig: Rig, free: Free) -> bool:
    """Whether lamps are enough to tell how far off they typically are."""
    return free.lamps and sum(not group.kept for group in rig.groups) >= LEAST_LAMPS


class RigNumbers:
    """Offsets, powers, gains, SHARED, and levels of the materials; slices say where in the vector each kind is."""

    def __init__(self, sample: RigSample, free: Free, learns: bool) -> None:
        """``learns``: whether `learn` is asked how far off lamps typically are."""
        self.groups, self.views, self.learns = len(sample.rig.groups), len(sample.rig.views), learns
        self.group = sample.rig.number()
        self.kept = np.array([group.kept for group in sample.rig.groups], bool)
        self.slots = [int(slot) for slot in np.unique(sample.slot)] if free.levels else []
        self.places = slice(0, 3 * self.groups)
        self.powers = slice(self.places.stop, 4 * self.groups)
        self.gains = slice(self.powers.stop, self.powers.stop + self.views)
        self.shared = slice(self.gains.stop, self.gains.stop + SHARED)
        self.ambient, self.diffuse = self.shared.start + 1, slice(self.shared.stop - DIFFUSE, self.shared.stop)
        self.levels = slice(self.shared.stop, self.shared.stop + len(self.slots))
        self.count = self.levels.stop
        places = np.repeat(~self.kept[:, None], 3, 1)
        if sample.metals:  # a flash that is farther back makes dark places brighter, as light that bounces does
            places[[group.carried for group in sample.rig.groups], 2] = False
        lamps = np.concatenate([places.ravel(), ~self.kept]) & free.lamps
        # A rough surface shines back to the light: a flash that cameras carry elsewhere shows nearly the same.
        rough = free.diffuse and not any(group.carried for group in sample.rig.groups)
        self.free = np.flatnonzero(np.concatenate(
            [lamps, np.full(self.views, free.exposures), [free.vignetting, free.ambient, free.response, free.shoulder],
             [free.cosine or free.diffuse, free.diffuse, rough], np.ones(len(self.slots), bool)]))
        self.place = np.full(self.count, -1)  # of each number, among the free ones; -1: it is not
        self.place[self.free] = np.arange(len(self.free))
        self.prior = np.concatenate([np.full(3 * self.groups, PLACE), np.full(self.groups, POWER),
                                     np.full(self.views, GAIN),
                                     [VIGNETTING, AMBIENT, RESPONSE, SHOULDER, COSINE, TRANSMISSION, ROUGH],
                                     np.full(len(self.slots), LEVEL)])
        self.expected = np.zeros(self.count)  # the prior's middle
        self.start = np.zeros(self.count)  # whose means are kept
        self.means = np.zeros((self.count,) * 2)
        self.believed = BELIEVED if free.exposures else 0.0
        for own in (self.powers, self.gains):
            self.means[own, own] = 1 / (MEAN * (own.stop - own.start)) ** 2

    def packed(self, change: RigChange) -> F64:
        """The change as one vector."""
        return np.concatenate([change.offset.ravel(), change.log_power, change.log_gain,
                               [change.vignetting, change.ambient, change.log_response, change.log_shoulder],
                               [change.cosine, change.transmission, change.rough], np.zeros(len(self.slots))])

    def unpacked(self, free: F64) -> RigChange:
        """Of values of the free numbers; the others are as given."""
        values = np.zeros(self.count)
        values[self.free] = free
        return RigChange(values[self.places].reshape(-1, 3), values[self.powers], values[self.gains],
                         *values[self.shared].tolist())

    def expect(self, around: AroundInShade | None) -> None:
        """Light from all around is about what the shade shows."""
        if around is not None:
            self.expected[self.ambient], self.prior[self.ambient] = around.value, around.error

    def spread(self, change: RigChange) -> F64:
        """Standard deviations of the prior; of a gain that is far off, as an automatic flash makes it, a wider one."""
        spread = self.prior.copy()
        spread[self.gains] = np.maximum(spread[self.gains], np.abs(change.log_gain) / CAUCHY)
        return spread

    def learn(self, free: F64, variance: F64) -> bool:
        """By how much lamps typically are off (empirical Bayes: one round of expectation maximisation).

        Whether that is something else than before.  ``free``, ``variance``: values of the free numbers, and how far
        those may be off.
        """
        before = self.prior.copy()
        for kind, most, believed in ((self.places, PLACE, 0.0), (self.powers, POWER, self.believed)):
            own = (self.free >= kind.start) & (self.free < kind.stop)
            squares = float(np.sum(free[own] ** 2 + variance[own])) + believed * GAIN**2
            usual = np.sqrt(squares / (np.count_nonzero(own) + believed))
            self.prior[self.free[own]] = min(max(usual, LEAST_USUAL), most)
        return not np.array_equal(before, self.prior)

    def slopes_of_brightness(self, sample: RigSample) -> F64:
        """(V, N) of the logarithm of each view's brightness by each number: its exposure and its lamps' powers."""
        slopes = np.zeros((self.views, self.count))
        for v, view in enumerate(sample.rig.views):
            slopes[v, self.gains.start + v] = 1.0
            for light in view.lights:
                slopes[v, self.powers.start + self.group[light.name]] += 1 / len(view.lights)
        return slopes
