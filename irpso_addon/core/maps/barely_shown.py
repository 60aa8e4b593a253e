"""Base colours of texels that pictures barely show, within what is known of their material."""

from __future__ import annotations

import numpy as np

from ..data import F32, I32, Bool

ENOUGH = 100  # texels that say which colours a material has
RARE = 0.5  # per cent of them at either end: some of these are wrong themselves


def within_material(base: F32, sure: Bool, barely: Bool, slots: I32) -> F32:
    """(h, w, 4) base colour, and how far it is known, of which what is ``barely`` shown has colours of its material.

    ``base``: linear RGB, and 0 to 1.  ``sure``: (h, w) texels that say which colours these are.  ``slots``: (h, w)
    material of each texel, -1 where there is none.

    The light that a world sends into a nook is wrong by a large factor where the mesh is a little wrong there.  Each
    texel of the nook is hardly known, but all together are when holes are filled.
    """
    result = base.copy()
    for slot in np.unique(slots[slots >= 0]):
        own = slots == slot
        known = base[own & sure, :3]
        if len(known) >= ENOUGH:
            least, most = np.percentile(known, [RARE, 100 - RARE], axis=0).astype(np.float32)
            result[own & barely, :3] = np.clip(base[own & barely, :3], least, most)
    return result
