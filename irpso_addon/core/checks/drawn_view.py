"""One view beside what is drawn of the mesh through its camera, before anything is solved."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..data import F32, SOLID, Bool, RadianceImage, View
from ..images.shot_settings import NOTHING_SAID, ShotSettings


@dataclass(frozen=True)
class DrawnView:
    """The picture, reduced, and at its pixels the mesh; row 0 at the bottom."""

    view: View
    image: RadianceImage
    position: F32  # (h, w, 3) world, metres; of what is covered, as are the following
    normal: F32  # (h, w, 3) world, unit, normal map included; 0 where not covered
    covered: Bool  # (h, w) the object is what the pixel's centre sees
    share: F32  # (h, w) 0..1 of the pixel's square that the object covers
    lit: tuple[F32, ...]  # (h, w) 0..1 of each of the view's lights that arrives, for a point in its middle
    reduction: float = 1.0  # pixels of the file along a side of one of these
    white: bool = True  # whether the file's values end at a white of 1
    shot: ShotSettings = NOTHING_SAID

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the reduced picture."""
        height, width = self.covered.shape
        return width, height

    @cached_property
    def shown(self) -> Bool:
        """(h, w) the object is drawn there, and the picture does not deny it."""
        return self.covered & (self.image.coverage > SOLID)

    @cached_property
    def brightness(self) -> F32:
        """(h, w) radiance, the mean of the channels; clipped pixels are as bright as the brightest that are not."""
        mean = self.image.rgb.mean(axis=2)
        known = mean[self.image.valid]
        return np.where(self.image.valid, mean, known.max() if len(known) else np.float32(0)).astype(np.float32)
