"""How a photograph was exposed, by its EXIF, and what that says of a set of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median_low

from ..phrases import some

MOST_ISO = 65535
MOST_APEX = 32  # of a time or an aperture
LEAST_DIFFERENCE = 1 / 6  # EV: half a step of a camera's wheels

WORDS = {"time": "time", "f_number": "aperture", "iso": "ISO"}
ASSUMED = {"f_number": 1.0, "iso": 100.0}


@dataclass(frozen=True)
class ShotSettings:
    """What EXIF (CIPA DC-008) says of a photograph; None where it does not."""

    time: float | None = None  # seconds
    f_number: float | None = None
    iso: float | None = None

    @property
    def exposure_value(self) -> float | None:
        """log2(time * ISO / 100 / f-number^2): a picture of 1 more is twice as bright.  None: something is missing.

        ISO 2720:1974's exposure value with the sign of the picture's brightness, and the sensitivity in it.
        """
        if self.time is None or self.f_number is None or self.iso is None:
            return None
        return math.log2(self.time) + math.log2(self.iso / 100) - 2 * math.log2(self.f_number)


NOTHING_SAID = ShotSettings()


def relative_exposures(shots: Mapping[str, ShotSettings | None]) -> tuple[dict[str, float], tuple[str, ...]]:
    """For each picture its exposure relative to the lower median, EV, as `View.exposure` counts; lines for the user.

    A picture whose settings are not known gets 0 and is named.  One line says that exposures differ, where they do by
    more than LEAST_DIFFERENCE.  Where no picture has an aperture, or an ISO, one is assumed.  ``shots``: by the
    pictures' names.
    """
    given = {name: shot for name, shot in shots.items() if shot is not None}
    assumed = _assumed(list(given.values()))
    known = {name: replace(shot, **assumed).exposure_value for name, shot in given.items()}
    values = {name: value for name, value in known.items() if value is not None}
    middle = median_low(values.values()) if values else 0.0
    found = {name: values[name] - middle if name in values else 0.0 for name in shots}
    lines = []
    off = [name for name, value in found.items() if abs(value) > LEAST_DIFFERENCE]
    if off:
        worst = max(off, key=lambda name: abs(found[name]))
        lines.append(f"{len(off)} of {len(shots)} pictures: EXIF states another exposure than for the rest "
                     f"({found[worst]:+.2f} EV in '{worst}'); IRPSO scales their brightness by it, which is wrong for "
                     "a flash shorter than the exposure time: correct Exposure then")
    if "f_number" in assumed:
        lines.append("EXIF has no aperture for any picture, as with a lens without contacts, so one is assumed for "
                     "all; correct the exposures by hand if you changed it")
    if "iso" in assumed:
        lines.append("EXIF has no ISO for any picture, so one is assumed for all; correct the exposures by hand if you "
                     "changed it")
    missing = [name for name in shots if name not in values]
    if missing and values:
        what = ", ".join(word for key, word in WORDS.items() if key not in assumed)
        what = " and ".join(what.rsplit(", ", 1))
        lines.append(f"{some(missing)}: EXIF has no {what}, so the exposure of the rest is used; enter it by hand if "
                     "it differs")
    elif missing:
        lines.append("EXIF has no time, aperture and ISO for any picture, so equal exposures are used; enter the "
                     "exposures by hand if they differ")
    return found, tuple(lines)


def _assumed(shots: Sequence[ShotSettings]) -> dict[str, float]:
    """Of aperture and ISO, those that no picture has: any number will do.  None of them where no picture has a time."""
    if not any(shot.time for shot in shots):
        return {}
    return {key: value for key, value in ASSUMED.items() if not any(getattr(shot, key) for shot in shots)}


def brighter_by(shot: ShotSettings, other: ShotSettings) -> float | None:
    """EV by which a picture is brighter than the ``other`` in equal light; None where EXIF does not say.

    Where neither has an aperture, as with a lens without contacts, or an ISO, it is the same one.
    """
    assumed = _assumed((shot, other))
    value, reference = (replace(each, **assumed).exposure_value for each in (shot, other))
    return None if value is None or reference is None else value - reference


def exposures_off(views: Sequence[tuple[ShotSettings, float]]) -> list[float]:
    """For each view, of EXIF and its ``View.exposure``: EV that EXIF states beside that, if the other views are right.

    The lower median over the others that `brighter_by` can compare with it; 0 where there is none.  Views are sorted
    once, because all pairs of a thousand views take seconds.
    """
    found = [0.0] * len(views)
    for ordered in _comparable(views):
        middle = (len(ordered) - 1) // 2  # the higher median of the others lies there, or one on, past the view itself
        for rank, (value, place) in enumerate(ordered):
            if len(ordered) > 1:
                found[place] = value - ordered[middle + (rank <= middle)][0]
    return found


def exposures_by_exif(views: Sequence[tuple[ShotSettings, float]]) -> list[float]:
    """``View.exposure`` of each view as EXIF states it beside the others; as given where EXIF cannot be compared.

    Of views that can be compared, those whose given exposure is the lower median keep it.
    """
    found = [exposure for _, exposure in views]
    for ordered in _comparable(views):
        middle = median_low([value for value, _ in ordered])
        for value, place in ordered:
            found[place] += value - middle
    return found


def not_compared(shots: Sequence[ShotSettings]) -> list[int]:
    """Places of those that EXIF does not compare with most others: of all but the largest set of `_comparable`."""
    sets = _comparable([(shot, 0.0) for shot in shots])
    largest = {place for _, place in max(sets, key=len, default=[])}
    return [place for place in range(len(shots)) if place not in largest]


def _comparable(views: Sequence[tuple[ShotSettings, float]]) -> list[list[tuple[float, int]]]:
    """For each set of views that `brighter_by` compares: EV of EXIF beside the view's exposure, and its place; sorted.

    All of a set have a time, and all or none of them have an aperture, and an ISO.
    """
    found: dict[tuple[bool, bool], list[tuple[float, int]]] = {}
    for place, (shot, exposure) in enumerate(views):
        value = replace(shot, **_assumed([shot])).exposure_value
        if value is not None:
            found.setdefault((shot.f_number is None, shot.iso is None), []).append((value - exposure, place))
    return [sorted(alike) for alike in found.values()]


def iso_number(value: object) -> float | None:
    """As `positive`; None also for 65535, which EXIF has for each ISO from there on, and which is none."""
    number = positive(value)
    return None if number == MOST_ISO else number


def apex(value: object, power: float) -> float | None:
    """2^(power * value) of EXIF's APEX values; None where there is none, which cameras also write as 0."""
    if isinstance(value, (int, float)) and not isinstance(value, bool) and 0 < abs(value) < MOST_APEX:
        return float(2.0 ** (power * value))
    return None


def positive(value: object) -> float | None:
    """A finite number above 0, else None: what files and cameras without a contact to the lens write is 0."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        number = float(value)
        return number if math.isfinite(number) and number > 0 else None
    return None
