"""Holes filled and seams padded by push-pull (Gortler, Grzeszczuk, Szeliski, Cohen 1996)."""

from __future__ import annotations

import moderngl

from .context import Device

Level = tuple[moderngl.Texture, moderngl.Framebuffer]


class Filler:
    """Fills textures of one size, again and again, without making new ones."""

    def __init__(self, device: Device, size: tuple[int, int]) -> None:
        self.device = device
        sizes = [size]
        while max(sizes[-1]) > 1:
            sizes.append(((sizes[-1][0] + 1) // 2, (sizes[-1][1] + 1) // 2))
        self._coarser = [self._level(s) for s in sizes[1:]]  # what is known, ever coarser
        self._filled = [self._level(s) for s in sizes[:-1]]  # the same without holes

    def fill(self, source: moderngl.Texture) -> moderngl.Texture:
        """RGBA32F: ``source`` where its alpha is 1, else the nearest known values, smoothly.

        Texels whose alpha lies between are mixed accordingly.  The texture belongs to the filler, which
        overwrites it the next time.
        """
        known = [source, *(texture for texture, _ in self._coarser)]
        for finer, (_, target) in zip(known, self._coarser, strict=False):
            self.device.draw("fill/down.frag", target, textures={"u_map": finer}, uniforms={})
        filled = known.pop()
        for own, (texture, target) in zip(reversed(known), reversed(self._filled), strict=True):
            self.device.draw("fill/up.frag", target, textures={"u_map": own, "u_parent": filled}, uniforms={})
            filled = texture
        return filled

    def release(self, keep: moderngl.Texture | None = None) -> None:
        """Free the textures, but not ``keep``."""
        for texture, target in (*self._coarser, *self._filled):
            target.release()
            if texture is not keep:
                texture.release()

    def _level(self, size: tuple[int, int]) -> Level:
        texture = self.device.texture(*size)
        return texture, self.device.framebuffer([texture])


def fill(device: Device, source: moderngl.Texture) -> moderngl.Texture:
    """A new texture, as Filler.fill gives it; a single texel is itself."""
    filler = Filler(device, source.size)
    filled = filler.fill(source)
    filler.release(keep=filled)
    return filled
