"""Colours of lamps, and white balances of pictures, that the scene has wrong (colour_fit.py).

A tint that all lamps share, or all pictures, cannot be found: it belongs to the base colours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..change_records import PredictionError
from ..data import F64, Bool, Light
from ..evaluation.folds import Folds
from ..job import Progress, Steps
from .colour_fit import LEAST, ColourContest, ColourFit, Tinted
from .contest import SURE
from .rig import Rig, RigChange, with_factors
from .rig_fit import RigFound, typical
from .rig_sample import COLOURS, RigSample
from .standard_errors import COMMON, parts_of

LEAST_TINT = 0.02  # what is worth changing: photographs under calibrated lamps show up to 0.018


@dataclass(frozen=True)
class _Found:
    """Tints of lamps, or of views."""

    of: Tinted
    log_tint: F64  # (G, 3), whose mean over the channels is 0
    error: F64  # (G,) standard error of each one's
    given: PredictionError  # of left-out views, as the scene is given
    changed: PredictionError

    @property
    def errors(self) -> F64:
        """(G, 3) those of each channel."""
        return np.asarray(self.error[:, None] * np.ones(COLOURS))

    @property
    def off(self) -> bool:
        """Whether one is off beyond doubt."""
        return bool(_off(self.log_tint, self.error).any())


@dataclass(frozen=True)
class Tints:
    """What lamps' powers, and what pictures show of radiance, are to be multiplied by in each channel."""

    lamps: _Found | None
    views: _Found | None

    @property
    def given(self) -> PredictionError:
        """Of left-out views, as the scene is given."""
        return self._found[0].given

    @property
    def changed(self) -> PredictionError:
        """Of left-out views, after the change."""
        return self._found[-1].changed

    @property
    def _found(self) -> list[_Found]:
        return [found for found in (self.lamps, self.views) if found is not None]

    def corrected(self, sample: RigSample) -> RigSample:
        """A sample as if its lamps and pictures had these colours."""
        for found in self._found:
            sample = found.of.corrected(sample, found.log_tint)
        return sample

    def beside(self, change: RigChange, error: RigChange) -> tuple[RigChange, RigChange]:
        """A change of the corrected rig as one of the given rig, and its standard errors."""
        if self.lamps is not None:
            change, error = replace(change, log_tint=self.lamps.log_tint), replace(error, log_tint=self.lamps.errors)
        if self.views is not None:
            change = replace(change, log_balance=self.views.log_tint)
            error = replace(error, log_balance=self.views.errors)
        return change, error


def under_tints(sample: RigSample, change: RigChange) -> RigSample:
    """A sample as if its lamps and pictures had a change's colours."""
    if change.log_tint is not None:
        sample = _under_lamps(sample, change.log_tint)
    return sample if change.log_balance is None else _under_views(sample, change.log_balance)


def tints_of(
    sample: RigSample, folds: Folds, first: RigFound, lamps: bool, views: bool, larger: Callable[[bool], RigSample],
) -> Steps[Tints | None]:
    """The colours of lamps and pictures that are off beyond doubt, if left-out views are predicted better with them.

    Lamps' before pictures', because they are fewer.  Pictures that each have their own colour give each lamp the mean
    of its pictures': lamps keep theirs only if these means differ by more than the pictures explain.  ``lamps``,
    ``views``: what may be changed.  ``first``: the materials of the sample.  ``larger``: a sample of more texels, which
    says by how much.
    """
    of_lamps = None
    if lamps:
        of_lamps = yield from _found(sample, folds, first, _lamps(sample.rig), larger, "lamps' colours")
    only_lamps = None if of_lamps is None else Tints(of_lamps, None)
    if not views:
        return only_lamps
    of_views = yield from _of_views(sample, folds, first, larger, only_lamps)
    if of_views is None:
        return only_lamps
    if of_lamps is not None and not _beyond(sample, of_lamps, of_views).off:
        of_lamps, alone = None, (yield from _of_views(sample, folds, first, larger, None))
        of_views = alone or of_views
    return Tints(of_lamps, of_views)


def _of_views(
    sample: RigSample, folds: Folds, first: RigFound, larger: Callable[[bool], RigSample], before: Tints | None,
) -> Steps[_Found | None]:
    """Colours of pictures.  ``before``: what is right by then."""
    if before is not None:
        seen = before.corrected
        return (yield from _found(seen(sample), folds, first, _views(sample.rig),
                                  lambda ambient: seen(larger(ambient)), "white balance"))
    return (yield from _found(sample, folds, first, _views(sample.rig), larger, "white balance"))


def _beyond(sample: RigSample, lamps: _Found, views: _Found) -> _Found:
    """Lamps' colours, with standard errors that hold how far means of so many pictures' colours scatter."""
    lit = np.zeros(len(lamps.log_tint))
    for place in np.unique(sample.view):
        numbers, share = lamps.of.share(sample, int(place))
        np.add.at(lit, numbers, share.sum(0) / max(float(share.sum()), LEAST))
    left = max(len(views.log_tint) - len(lit), 1)
    scatter = np.sqrt((views.log_tint**2).sum() / (left * COLOURS))
    return replace(lamps, error=np.hypot(lamps.error, scatter / np.sqrt(np.maximum(lit, LEAST))))


def _found(
    sample: RigSample, folds: Folds, first: RigFound, of: Tinted, larger: Callable[[bool], RigSample], what: str,
) -> Steps[_Found | None]:
    """What is off beyond doubt, if left-out views are predicted better with it."""
    if len(of.free) < 2 or not of.free.any():
        return None
    yield Progress(0.0, "calibrate", what)
    colours = ColourFit(sample, first, of)
    if not _off(*colours.fit()).any():
        return None
    contest = ColourContest(sample, first, folds, colours)
    if not contest.better():
        return None
    yield Progress(0.0, "calibrate", what)
    tints, error = _with_errors(larger(False), first, of)
    if not _off(tints, error).any():
        return None
    given, changed = contest.errors(tints)
    if changed.relative_rms > given.relative_rms and changed.lightness > given.lightness:
        return None  # highlights of a colour that the material lacks: right colours predict no better what views show
    return _Found(of, tints, error, given, changed)


def _with_errors(sample: RigSample, first: RigFound, of: Tinted) -> tuple[F64, F64]:
    """Tints, and standard errors that explain by how much fits to parts of the sample differ (standard_errors.py)."""
    tints, error = ColourFit(sample, first, of).fit()
    factor, free = 1.0, of.free
    for pair in parts_of(sample):
        if min(len(part.slot) for part in pair) == 0:
            continue
        (one, by), (other, also) = (ColourFit(part, first, of).fit() for part in pair)
        apart = (one - other)[free] / np.hypot(by, also)[free, None]
        factor = max(factor, COMMON * float(np.sqrt(np.mean(apart**2))))
    return tints, error * factor


def _off(tints: F64, error: F64) -> Bool:
    return np.asarray(np.abs(tints).max(1) > np.maximum(SURE * error, LEAST_TINT))


# ---- lamps


def _lamps(rig: Rig) -> Tinted:
    group = rig.number()

    def share(sample: RigSample, place: int) -> tuple[list[int], F64]:
        lights = sample.rig.views[place].lights
        lit = np.stack([_lit(sample, light).mean(-1) for light in lights], -1)
        lit /= np.maximum(lit.sum(-1, keepdims=True), LEAST)
        return [group[light.name] for light in lights], lit

    return Tinted(~np.array([each.kept for each in rig.groups], bool), share, _brighter_lamps, _under_lamps,
                  lambda tints: np.median(tints, axis=0))


def _lit(sample: RigSample, light: Light) -> F64:
    """(T, 3) irradiance by a lamp."""
    return np.asarray(sample.geometry.given[light.name][0][:, None] * light.power)


def _brighter_lamps(sample: RigSample, log_tint: F64) -> F64:
    """Irradiance under tinted lamps over that under the given ones."""
    texels, group = sample.texels, sample.rig.number()
    channels = texels.reflected.shape[-1]
    ratio = np.ones(texels.reflected.shape)
    for v, place in enumerate(sample.view):
        lights = sample.rig.views[place].lights
        given = [_lit(sample, light) for light in lights]
        after = sum((lit * np.exp(log_tint[group[light.name]]) for lit, light in zip(given, lights, strict=True)),
                    np.zeros(COLOURS))
        of = after / np.maximum(sum(given, np.zeros(COLOURS)), LEAST) if len(lights) > 1 else (
            np.exp(log_tint[group[lights[0].name]])[None])
        ratio[:, v] = of if channels > 1 else of[:, texels.channel[v], None]
    return ratio


def _under_lamps(sample: RigSample, log_tint: F64) -> RigSample:
    texels, rig = sample.texels, sample.rig
    ratio = _brighter_lamps(sample, log_tint)
    views = tuple(replace(view, lights=tuple(
        replace(light, power=light.power * np.exp(log_tint[rig.number()[light.name]])) for light in view.lights))
        for view in rig.views)
    return replace(sample, rig=replace(rig, views=views), texels=replace(
        texels, reflected=texels.reflected / ratio, irradiance=texels.irradiance * ratio))


# ---- pictures


def _views(rig: Rig) -> Tinted:
    return Tinted(np.ones(len(rig.views), bool), lambda sample, place: ([place], np.ones((len(sample.slot), 1))),
                  _brighter_views, _under_views, lambda tints: np.array([typical(tints[:, n]) for n in range(COLOURS)]))


def _brighter_views(sample: RigSample, log_tint: F64) -> F64:
    """(1, V, C) what tinted pictures show over what the given ones do."""
    texels, ratio = sample.texels, np.exp(log_tint)[sample.view]
    if texels.reflected.shape[-1] == COLOURS:
        return np.asarray(ratio[None])
    return np.asarray(ratio[np.arange(len(ratio)), texels.channel][None, :, None])


def _under_views(sample: RigSample, log_tint: F64) -> RigSample:
    rig, ratio = sample.rig, _brighter_views(sample, log_tint)
    views = tuple(replace(view, tint=with_factors(view.tint, np.exp(by)))
                  for view, by in zip(rig.views, log_tint, strict=True))
    return replace(sample, rig=replace(rig, views=views),
                   texels=replace(sample.texels, reflected=sample.texels.reflected / ratio),
                   shade=None if sample.shade is None else sample.shade / ratio)
