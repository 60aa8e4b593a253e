"""The part of a grid that holds something, as squares: draws over them touch nothing else.

A camera's pictures mostly show what is around the object, and a software rasteriser, or a GPU's memory, pays for every
pixel that a draw covers, even where the shader leaves at once.
"""

from __future__ import annotations

import moderngl
import numpy as np

from .context import Device, Inputs

CELL = 8  # pixels: width of a square


class OccupiedCells:
    """The squares of CELL x CELL pixels of a texture that hold a pixel whose alpha is not 0."""

    def __init__(self, device: Device, texture: moderngl.Texture) -> None:
        self.size = texture.size
        with device.scope():
            squares = device.texture(-(-texture.width // CELL), -(-texture.height // CELL), 1)
            with device.target([squares]) as target:
                device.draw("device/occupied.frag", target, Inputs({"u_map": texture}, defines={"CELL": str(CELL)}))
            y, x = np.nonzero(device.read(squares)[..., 0])
        self.count = len(x)
        self._device = device
        self.corners = device.buffer(np.stack([x, y], -1).astype(np.float32)) if len(x) else None
        self._arrays: dict[int, moderngl.VertexArray] = {}

    def render(self, program: moderngl.Program, first: int, count: int) -> None:
        """Run a program made with include/occupied_cells.vert on every pixel of some of the squares."""
        if self.corners is None:
            return
        array = self._arrays.get(program.glo)
        if array is None or isinstance(array.mglo, moderngl.InvalidObject):  # freed with the scope of an earlier draw
            array = self._device.vertex_array(program, [(self.corners, "2f/i", "in_cell")])
            self._arrays[program.glo] = array
        # OpenGL 3.3 has no first instance
        place = program["in_cell"]
        assert isinstance(place, moderngl.Attribute)
        array.bind(place.location, "f", self.corners, "2f", offset=8 * first, stride=8, divisor=1)
        array.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=count)

    @property
    def pixels_each(self) -> int:
        """Pixels of a square."""
        return CELL**2

    @property
    def uniforms(self) -> dict[str, object]:
        """Of include/occupied_cells.vert."""
        return {"u_cell": (2.0 * CELL / self.size[0], 2.0 * CELL / self.size[1])}

    def release(self) -> None:
        """Free the buffer."""
        for array in self._arrays.values():
            array.release()
        if self.corners is not None:
            self.corners.release()
