"""What a running solve shows of itself: the maps so far, and pictures of the views beside what the maps predict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .data import F32, Bool, ViewPicture
from .resampling import nearest

F16 = NDArray[np.float16]
ROLES = ("base_color", "roughness", "confidence", "error")  # of maps, as blender/material/material.py names them


@dataclass(frozen=True)
class Live:
    """One look at a running solve."""

    maps: Mapping[str, F32]  # some of ROLES -> (n, n, 3) linear or (n, n); row 0 bottom; NaN: nothing known yet
    coverage: Bool | None = None  # (n, n) True: inside a UV island
    pictures: tuple[ViewPicture, ...] = ()
    seconds: float = 0.0  # since the job began
    error: float = float("nan")  # see `difference`
    model: Mapping[str, str] = field(default_factory=dict)  # material slot name -> model so far


def difference(pictures: tuple[ViewPicture, ...]) -> float:
    """Relative difference of pictures and prediction: sum of absolute errors over the sum of what was seen."""
    off = seen = 0.0
    for picture in pictures:
        reference, predicted = picture.reference.astype(np.float64), picture.predicted.astype(np.float64)
        known = np.isfinite(reference) & np.isfinite(predicted)
        off += picture.scale * float(np.abs(reference - predicted)[known].sum())
        seen += picture.scale * float(reference[known].sum())
    return off / seen if seen > 0 else float("nan")


class Canvas:
    """The maps of a running solve at their final size: coarse looks first, finer ones over them."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.maps: dict[str, F32] = {}  # NaN only where no look said anything
        self.coverage: Bool | None = None
        self._ranks: dict[str, NDArray[np.uint16]] = {}  # of the look that each texel has its value from
        self._finest = 0  # of coverage

    def finest(self, role: str) -> Bool:
        """(size, size) True where a map has its value from a look at full size that was no draft."""
        ranks = self._ranks.get(role)
        return np.zeros((self.size, self.size), bool) if ranks is None else ranks >= 2 * self.size

    def add(self, live: Live, preview: bool = False) -> dict[str, F32]:
        """Take over what a look knows where nothing finer is known; returns what is shown now.

        ``preview``: a draft, worth less than a real look of the same size.
        """
        for role, values in live.maps.items():
            rank = 2 * values.shape[0] - preview
            grown = nearest(values, self.size)
            if role not in self.maps:
                self.maps[role] = np.full_like(grown, np.nan)
                self._ranks[role] = np.zeros((self.size, self.size), np.uint16)
            known = np.isfinite(grown if grown.ndim == 2 else grown[..., 0]) & (self._ranks[role] <= rank)
            where = known if grown.ndim == 2 else known[..., None]
            self.maps[role] = np.where(where, grown, self.maps[role])  # a new array: whoever shows it tells it by that
            self._ranks[role][known] = rank
        if live.coverage is not None and live.coverage.shape[0] >= self._finest:
            self._finest = live.coverage.shape[0]
            self.coverage = nearest(live.coverage, self.size)
        return self.maps
