"""How wrong pixels make what a material as a whole says: they are wider than its highlights are sharp.

All lamps and cameras share such an error, so that values without one of them do not show it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .sampled_texels import SampledTexels

LEAST = 50  # texels that say a value
MOST = 2.0  # differences of two halves that the error is at most: both may be blurred about alike


def pixel_bias(texels: SampledTexels, value: Callable[[SampledTexels], float]) -> float:
    """Standard error that pixels add to a ``value`` of ``texels``; 0 where these are few.

    Texels whose lobes pixels blur more say another value than those whose lobes they blur less.  Of an error in
    proportion to the blur, which is a variance, this difference tells the whole.
    """
    seen = texels.usable()
    some = seen.any(1)
    if some.sum() < 2 * LEAST:
        return 0.0
    blur = np.where(seen, texels.lobes[..., 1].max(-1, initial=0.0), 0.0).sum(1) / np.maximum(seen.sum(1), 1)
    middle = np.median(blur[some])
    more, less = some & (blur > middle), some & (blur <= middle)
    if min(int(more.sum()), int(less.sum())) < LEAST:
        return 0.0
    apart = value(texels.part(more)) - value(texels.part(less))
    high, low = float(blur[more].mean()), float(blur[less].mean())
    return abs(apart) * min((high + low) / 2 / max(high - low, 1e-30), MOST)
