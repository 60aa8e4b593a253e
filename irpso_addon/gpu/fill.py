"""Holes filled and seams padded by push-pull (Gortler, Grzeszczuk, Szeliski, Cohen 1996)."""

from __future__ import annotations

import moderngl

from .context import Device


def fill(device: Device, source: moderngl.Texture) -> moderngl.Texture:
    """A new RGBA32F texture: ``source`` where its alpha is 1, else the nearest known values, smoothly.

    Texels whose alpha lies between are mixed accordingly.
    """
    levels = [source]
    while max(levels[-1].size) > 1:
        w, h = levels[-1].size
        levels.append(device.texture((w + 1) // 2, (h + 1) // 2))
        target = device.framebuffer([levels[-1]])
        device.draw("fill/down.frag", target, textures={"u_map": levels[-2]}, uniforms={})
        target.release()
    filled = levels.pop()
    while levels:
        own = levels.pop()
        result = device.texture(*own.size)
        target = device.framebuffer([result])
        device.draw("fill/up.frag", target, textures={"u_map": own, "u_parent": filled}, uniforms={})
        target.release()
        filled.release()
        if own is not source:
            own.release()
        filled = result
    return filled
