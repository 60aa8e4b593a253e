"""The part of a grid that holds something, as squares: draws over them touch nothing else.

A camera's pictures mostly show what is around the object, and a software rasteriser, or a GPU's memory, pays for every
pixel that a draw covers, even where the shader leaves at once.
"""

from __future__ import annotations

import moderngl
import numpy as np

from ..core.data import Bool

CELL = 8  # pixels


class Cells:
    """The squares of CELL x CELL pixels of one grid size that hold a covered pixel."""

    def __init__(self, ctx: moderngl.Context, covered: Bool) -> None:
        """``covered``: (h, w)."""
        height, width = covered.shape
        padded = np.pad(covered, ((0, -height % CELL), (0, -width % CELL)))
        held = padded.reshape(padded.shape[0] // CELL, CELL, -1, CELL).any((1, 3))
        y, x = np.nonzero(held)
        self.count = len(x)
        self.size = width, height
        self._ctx = ctx
        self._corners = ctx.buffer(np.stack([x, y], -1).astype(np.float32).tobytes()) if len(x) else None
        self._arrays: dict[int, moderngl.VertexArray] = {}

    def render(self, program: moderngl.Program) -> None:
        """Run a program made with include/cells.vert on every pixel of the squares."""
        if self._corners is None:
            return
        if program.glo not in self._arrays:
            self._arrays[program.glo] = self._ctx.vertex_array(program, [(self._corners, "2f/i", "in_cell")])
        self._arrays[program.glo].render(moderngl.TRIANGLE_STRIP, vertices=4, instances=self.count)

    @property
    def uniforms(self) -> dict[str, object]:
        """Of include/cells.vert."""
        return {"u_cell": (2.0 * CELL / self.size[0], 2.0 * CELL / self.size[1])}

    def release(self) -> None:
        """Free the buffer."""
        for array in self._arrays.values():
            array.release()
        if self._corners is not None:
            self._corners.release()
