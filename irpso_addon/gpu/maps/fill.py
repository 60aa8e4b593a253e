"""Holes filled and seams padded by push-pull (Gortler, Grzeszczuk, Szeliski, Cohen 1996)."""

from __future__ import annotations

import moderngl
import numpy as np

from ...core.data import F32
from ..device.context import Device, Inputs

Level = tuple[moderngl.Texture, moderngl.Framebuffer]


class Filler:
    """Fills textures of one size, again and again, without making new ones."""

    def __init__(self, device: Device, size: tuple[int, int], around: F32 | None = None) -> None:
        """``around``: (h, w, 3) of cells whose width is a power of two in texels: what is known of larger holes."""
        self.device = device
        last = (1, 1) if around is None else (around.shape[1], around.shape[0])
        sizes = [size]
        while sizes[-1] != last:
            sizes.append(((sizes[-1][0] + 1) // 2, (sizes[-1][1] + 1) // 2))
        self._around: moderngl.Texture | None = None
        if around is not None:
            rgba = np.concatenate([around, np.ones_like(around[..., :1])], axis=2)
            self._around = device.texture(*sizes.pop(), data=rgba)
        self._coarser = [self._level(s) for s in sizes[1:]]  # what is known, ever coarser
        self._filled = [self._level(s) for s in (sizes[:-1] if around is None else sizes)]  # the same without holes

    def fill(self, source: moderngl.Texture) -> moderngl.Texture:
        """RGBA32F: ``source`` where its alpha is 1, else the nearest known values, smoothly.

        Texels whose alpha lies between are mixed accordingly.  The texture belongs to the filler, which
        overwrites it the next time.
        """
        known = [source, *(texture for texture, _ in self._coarser)]
        for finer, (_, target) in zip(known, self._coarser, strict=False):
            self.device.draw("maps/fill_down.frag", target, Inputs({"u_map": finer}))
        filled = self._around or known.pop()
        for own, (texture, target) in zip(reversed(known), reversed(self._filled), strict=True):
            border = {"BORDER": "1"} if own is source else {}  # on coarser levels it would show as squares
            self.device.draw("maps/fill_up.frag", target, Inputs({"u_map": own, "u_parent": filled}, {}, border))
            filled = texture
        return filled

    def _level(self, size: tuple[int, int]) -> Level:
        texture = self.device.texture(*size)
        return texture, self.device.framebuffer([texture])


def fill(device: Device, source: moderngl.Texture, around: F32 | None = None) -> moderngl.Texture:
    """A new texture, as Filler.fill gives it; a single texel is itself."""
    with device.scope() as owned:
        filled = Filler(device, source.size, around).fill(source)
        owned.hand_over(filled)
        return filled
