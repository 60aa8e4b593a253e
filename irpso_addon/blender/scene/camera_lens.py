"""The lens of a photographed camera, kept on Blender's camera data; Blender's own settings are the nearest pinhole."""

from __future__ import annotations

from typing import Any

from ...core.errors import BadInput
from ...core.lens import Lens

NUMBERS = ("fx", "fy", "cx", "cy", "skew")


def read_lens(data: Any) -> Lens | None:
    """The lens that a camera's data block carries; None: Blender's own settings hold.  Raises BadInput."""
    stored = getattr(data, "irpso_lens", None)
    if stored is None or not stored.use:
        return None
    if stored.width < 1 or stored.height < 1 or not stored.fx > 0 or not stored.fy > 0:
        raise BadInput(f"camera data '{data.name}': its lens has no size or no focal length; switch it off, or import "
                       "the shoot again")
    return Lens(stored.width, stored.height, *(getattr(stored, name) for name in ("fx", "fy", "cx", "cy")),
                tuple(stored.radial), tuple(stored.tangential), stored.skew, stored.fisheye)


def write_lens(data: Any, lens: Lens) -> None:
    """Keeps a lens on a camera's data, and makes what the viewport shows nearly that."""
    stored = data.irpso_lens
    stored.use, stored.width, stored.height, stored.fisheye = True, lens.width, lens.height, lens.fisheye
    for name in NUMBERS:
        setattr(stored, name, getattr(lens, name))
    stored.radial, stored.tangential = lens.radial, lens.tangential
    data.sensor_fit, data.sensor_width = "HORIZONTAL", 36.0
    data.lens = 36.0 * lens.fx / lens.width
    data.shift_x = 0.5 - lens.cx / lens.width
    data.shift_y = (lens.cy - lens.height / 2) / lens.width
