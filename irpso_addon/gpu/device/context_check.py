"""Tells whether the device still draws what it is asked to draw, and holds what it is given.

After a reset of the driver a context without OpenGL's robustness extensions (Blender machines have them rarely) says
nothing: calls do nothing, and reading back gives zeros, or whatever lay there.
"""

from __future__ import annotations

import moderngl
import numpy as np

from .programs import Programs

PATTERN = np.array([3.0, 1.0, 4.0, 15.0], np.float32)


class ContextCheck:
    """A texel that was written once, and is drawn with a new number whenever somebody asks."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx, self._programs = ctx, Programs(ctx)  # of its own: never given back
        self._program = self._programs.get("include/screen.vert", "device/context_check.frag")
        self._kept = ctx.texture((1, 1), 4, PATTERN.tobytes(), dtype="f4")
        self._drawn = ctx.texture((1, 1), 4, dtype="f4")
        self._target = ctx.framebuffer([self._drawn])
        self._array = ctx.vertex_array(self._program, [])
        self._number = 0

    def passes(self) -> bool:
        """Whether it lives.  Leaves its own framebuffer bound, blending and depth test off."""
        self._number += 1
        try:
            self._ctx.disable(moderngl.BLEND | moderngl.DEPTH_TEST)
            self._kept.use(0)
            self._programs.set(self._program, {"u_kept": 0, "u_number": float(self._number)})
            self._target.use()
            self._array.render(moderngl.TRIANGLES, vertices=3)
            heard = np.frombuffer(self._drawn.read(), np.float32)
        except moderngl.Error:
            return False
        return bool((heard == PATTERN * np.float32(self._number)).all())
