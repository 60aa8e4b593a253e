"""Picture files that OpenImageIO writes, and views of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from irpso_addon.core.data import Camera, View
from irpso_addon.core.errors import BadInput
from irpso_addon.core.images.reference_image import read_reference


def camera(aspect: float) -> Camera:
    return Camera("Cam", np.eye(4), np.eye(4), np.zeros(3), np.array([0.0, 0, -1]), False, aspect)


def view(path: Path, aspect: float = 1.5, **more) -> View:
    return View(path, camera(aspect), (), **more)


def save(path: Path, pixels: np.ndarray, form: str = "float", names: str = "RGBA", **attributes) -> Path:
    """Writes (h, w, c), row 0 at the top."""
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], form)
    spec.channelnames = tuple(names)[:pixels.shape[2]]
    for key, value in attributes.items():
        if hasattr(spec, key):
            setattr(spec, key, value)
        else:
            spec.attribute(key.replace("__", ":"), value)
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), spec), file.geterror()
    assert file.write_image(np.ascontiguousarray(pixels)) and file.close(), file.geterror()
    return path


def error_of(v: View, **more) -> str:
    """The line by which a view is refused: its file, what is wrong, what to do."""
    with pytest.raises(BadInput) as caught:
        read_reference(v, **more)
    message = str(caught.value)
    assert "\n" not in message and message.startswith(str(v.mask or v.image)), message
    assert len(message.partition(": ")[2].split("; ")) == 2, message  # what is wrong; what to do
    return message
