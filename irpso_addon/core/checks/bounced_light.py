"""Whether light that bounces between a scene's surfaces matters: told by a few small pictures of it.

Light where no lamp's light arrives need not have bounced: a camera's black level and light that the scene does not hold
look the same there.  On an object that stands alone and has no hollows no light can bounce at all.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..data import F32, Bool
from ..phrases import percent

LEAST_SHARE = 0.005  # of the lamps' light on the object, from which on indirect light is taken out
# Up to LITTLE of the lamps' light it is left where the shadows hold several times as much of other light, which spoils
# the maps more: where it makes less than EXPLAINED of what is there.  Measured: 0.06 to 0.15 on photographs with a
# black level, 1.2 to 1.9 on renders without one (the first maps are too bright).
LITTLE, EXPLAINED = 0.03, 0.25
UNLIT = 1e-3  # of the lit median: what is darker has no light of its lamps
FEWEST = 50  # pixels that tell of shadows


@dataclass(frozen=True)
class LightPicture:
    """Radiance that the maps show in a view, mean of the channels, rendered."""

    direct: F32  # (h, w) from the view's lamps alone
    indirect: F32  # (h, w) by way of other surfaces, from the world and from what glows
    shown: Bool  # (h, w) pixels that show the object


@dataclass(frozen=True)
class BouncedSample:
    """What some views hold of indirect light."""

    share: float  # of the lamps' light on the object; NaN: nothing tells
    unlit: float  # radiance where no lamp's light arrives, as a share of the lit pixels' median; NaN: nothing tells


def sampled(pictures: Iterable[LightPicture]) -> BouncedSample:
    """Of some pictures together."""
    direct = indirect = 0.0
    dark = [np.zeros(0, np.float32)]
    for picture in pictures:
        lamps, rest = (np.asarray(values[picture.shown], np.float64) for values in (picture.direct, picture.indirect))
        direct, indirect = direct + float(lamps.sum()), indirect + float(rest.sum())
        lit = lamps[lamps > UNLIT * lamps.max(initial=0.0)]
        level = float(np.median(lit)) if len(lit) else 0.0
        if level > 0:
            dark.append(np.minimum(rest[lamps <= UNLIT * level] / level, 1.0))  # bright sparks cut
    shadows = np.concatenate(dark)
    return BouncedSample(indirect / direct if direct > 0 else np.nan,
                         float(shadows.mean()) if len(shadows) >= FEWEST else np.nan)


def why_not(found: BouncedSample, unlit_share: float) -> str:
    """Why it is not worth the time to render all views' indirect light; empty where it is, or where nothing tells.

    ``unlit_share``: as ``BouncedSample.unlit``, of the references.
    """
    if found.share < LEAST_SHARE:
        return f"no surface in the scene sends much light to another ({percent(found.share, 1)} of the lamps' light)"
    if found.share < LITTLE and found.unlit < EXPLAINED * unlit_share:
        return f"bounced light makes shadows in this scene only {percent(found.unlit, 1)} as bright as lit areas"
    return ""
