"""One view beside what the maps say that it should show: what checks and registration are made from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..data import F32, Bool, View


@dataclass(frozen=True)
class PixelWindow:
    """The part of a camera's pixels that is looked at, (h, w); row 0 at the bottom.  Its views share it."""

    corner: tuple[int, int]  # x, y of its first pixel in the camera's image
    image: tuple[int, int]  # width and height of that image
    covered: Bool  # (h, w) what the pixel's centre sees is the object, and a face that the maps hold
    position: F32  # (h, w, 3) world, metres; of what is covered, as are the following
    normal: F32  # (h, w, 3) world, unit, normal map included
    uv: F32  # (h, w, 2)
    slot: F32  # (h, w) material slot
    cos_v: F32  # (h, w)
    share: F32 | None = None  # (h, w) 0..1 of the pixel's square that the object covers; None: as ``covered``

    @property
    def drawn(self) -> F32:
        """(h, w) 0..1: the object as its outline should be in a picture."""
        return self.covered.astype(np.float32) if self.share is None else self.share


@dataclass(frozen=True)
class CheckedView:
    """One view: what its pixels show, and what the maps say that they should."""

    view: View
    window: PixelWindow
    observed: F32  # (h, w, 3) radiance / irradiance, 1/sr; 0 where quality is 0, below 0 in a channel without light
    predicted: F32  # (h, w, 3) the same by the maps; 0 where not covered
    specular: F32  # (h, w, 3) the lobes' part of it
    quality: F32  # (h, w) cos_v^2 for a well lit pixel, thousandths at an edge, 0: tells nothing
    edge: Bool  # (h, w) at an edge of shadow, at a silhouette or the terminator; or quality is 0
    unlit: Bool  # (h, w) covered, seen well enough and not at a light: what shines there has bounced
    radiance: F32  # (h, w, 3) of the reference, W/(m^2 sr); NaN where it has none (clipped, masked)
    irradiance: F32  # (h, w, 3) of the view's lights, W/m^2; 0 where quality is 0
    sin2h: F32  # (h, w) sin^2 of the angle between normal and half vector, the least over the view's lights
    coverage: F32  # (h, w) 0..1 of the reference: alpha times mask
    clipped: float  # share of the object's pixels that the reference has clipped

    @property
    def good(self) -> Bool:
        """(h, w) pixels to judge by."""
        return (self.quality > 0) & ~self.edge
