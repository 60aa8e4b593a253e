"""Image files as OpenImageIO sees them: the header, the layer to read, its rows.  Row 0 is the top here."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .data import F32
from .errors import BadInput

MAX_SIDE = 20_000  # pixels: at most 400 megapixels
# The last word of a layer's name that holds the finished picture, best first.
_PICTURE = ("", "combined", "composite", "beauty", "rgba", "rgb", "color", "image")


@dataclass(frozen=True)
class ImageFile:
    """An opened image: which channels of which part are the picture.  Pixels are not read yet."""

    path: Path
    part: int  # OpenImageIO's subimage
    channels: tuple[int, ...]  # R, G, B and, where there is one, A (a grey image repeats its channel)
    width: int  # of the display window: the whole frame
    height: int
    window: tuple[int, int, int, int]  # x, y, width, height of the stored pixels in that frame
    bits: int  # per channel
    integer: bool
    premultiplied: bool
    colorspace: str | None  # as the file itself names it
    warnings: tuple[str, ...] = ()

    def read(self, top: int, bottom: int) -> F32:
        """Rows ``top`` to ``bottom`` (exclusive), (rows, width, 3 or 4); 0 outside the stored window.

        Raises BadInput when the file ends early or is damaged.
        """
        x, y, width, height = self.window
        first, last = max(top, y), min(bottom, y + height)
        left, right = max(0, x), min(self.width, x + width)
        out = np.zeros((bottom - top, self.width, len(self.channels)), np.float32)
        if first >= last or left >= right:
            return out
        block = self._block(first - y, last - y)[:, left - x:right - x]
        out[first - top:last - top, left:right] = block
        return out

    def _block(self, first: int, last: int) -> F32:
        """Rows of the stored window, (rows, its width, channels)."""
        import OpenImageIO

        low, high = min(self.channels), max(self.channels) + 1
        file = _open(self.path)
        try:
            file.seek_subimage(self.part, 0)
            if file.spec().tile_width:
                block = file.read_image(self.part, 0, low, high, OpenImageIO.FLOAT)
                block = None if block is None else block[first:last]
            else:
                top = file.spec().y
                block = file.read_scanlines(top + first, top + last, 0, low, high, OpenImageIO.FLOAT)
            problem = file.geterror()
        except UnicodeDecodeError:  # names in the header that are no text
            block, problem = None, ""
        finally:
            file.close()
        if block is None or problem:
            raise BadInput(f"{self.path}: is damaged or cut short{_brief(problem)}; render or copy it again")
        block = np.asarray(block, np.float32).reshape(last - first, self.window[2], high - low)
        return np.asarray(block[..., [c - low for c in self.channels]])


def open_image(path: Path) -> ImageFile:
    """The header of ``path``, checked for size before anything is allocated.  Raises BadInput."""
    file = _open(path)
    try:
        parts: list[Any] = []
        while file.seek_subimage(len(parts), 0) and len(parts) < 1000:
            parts.append(file.spec())
        part, channels, warnings = _choose(path, parts)
        return _image_file(path, parts[part], part, channels, warnings)
    except UnicodeDecodeError:
        raise BadInput(f"{path}: is damaged (names in its header are no text); render or copy it again") from None
    finally:
        file.close()


def _image_file(path: Path, spec: Any, part: int, channels: tuple[int, ...], warnings: tuple[str, ...]) -> ImageFile:
    width, height = spec.full_width or spec.width, spec.full_height or spec.height
    if max(width, height, spec.width, spec.height) > MAX_SIDE:
        raise BadInput(f"{path}: is {width} x {height} pixels; scale it to at most {MAX_SIDE} on a side")
    if min(width, height) < 1 or spec.depth > 1:
        raise BadInput(f"{path}: is not a flat image; save it as an ordinary picture")
    if spec.get_int_attribute("Orientation", 1) != 1:
        raise BadInput(f"{path}: is stored rotated; save it upright, without an orientation tag")
    form = spec.format
    return ImageFile(
        path=path, part=part, channels=channels, width=width, height=height,
        window=(spec.x - spec.full_x, spec.y - spec.full_y, spec.width, spec.height),
        bits=spec.get_int_attribute("oiio:BitsPerSample", form.size() * 8),
        integer=str(form) not in {"half", "float", "double"},
        premultiplied=not spec.get_int_attribute("oiio:UnassociatedAlpha", 0),
        colorspace=spec.get_string_attribute("colorInteropID") or None, warnings=warnings,
    )


def _open(path: Path) -> Any:
    import OpenImageIO

    if not path.is_file():
        raise BadInput(f"{path}: {'is a folder' if path.is_dir() else 'there is no such image'}; check the path")
    # Straight alpha as stored: multiplying integers by it would lose bits.
    config = OpenImageIO.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    try:
        file = OpenImageIO.ImageInput.open(str(path), config)
        problem = OpenImageIO.geterror()
    except UnicodeError:  # in the path, or in the words about what is wrong
        file, problem = None, ""
    if file is None:
        raise BadInput(f"{path}: cannot be read as an image{_brief(problem)}; want EXR, HDR, PNG or TIFF")
    return file


def _brief(problem: str) -> str:
    """The library's own words, one line of them, in brackets."""
    first = problem.strip().splitlines()[0].strip().rstrip(".").replace(";", ",") if problem and problem.strip() else ""
    return f" ({first[:120]})" if first else ""


def _choose(path: Path, parts: list[Any]) -> tuple[int, tuple[int, ...], tuple[str, ...]]:
    """Part and channels of the finished picture among the layers of all ``parts``; warnings."""
    layers: list[tuple[int, str, dict[str, int]]] = []  # part, layer's name, channel letter -> index
    for part, spec in enumerate(parts):
        groups: dict[str, dict[str, int]] = {}
        for index, channel in enumerate(spec.channelnames):
            prefix, _, letter = channel.rpartition(".")
            groups.setdefault(prefix, {})[letter.upper()] = index
        name = spec.get_string_attribute("oiio:subimagename") or spec.get_string_attribute("name")
        for prefix, letters in groups.items():
            layers.append((part, prefix or (name if len(parts) > 1 else ""), letters))
    colour = [layer for layer in layers if {"R", "G", "B"} <= layer[2].keys()]
    if not colour:  # a grey picture: one channel, whatever its name, or luminance and alpha
        grey = [(p, n, {"R": i, "G": i, "B": i} | {k: v for k, v in c.items() if k == "A"})
                for p, n, c in layers if len(c.keys() - {"A"}) == 1 for k, i in c.items() if k != "A"]
        colour = grey if len(layers) == 1 else []
    ranked = sorted((_PICTURE.index(word), at) for at, (_, name, _) in enumerate(colour)
                    if (word := name.rpartition(".")[2].lower()) in _PICTURE)
    if not ranked and len(colour) == 1:
        ranked = [(0, 0)]
    if not ranked:
        names = ", ".join(dict.fromkeys(name or "?" for _, name, _ in layers))[:120]
        raise BadInput(f"{path}: holds no colour picture (layers: {names}); save the Combined pass")
    part, name, letters = colour[ranked[0][1]]
    warnings: tuple[str, ...] = ()
    if sum(rank == ranked[0][0] for rank, _ in ranked) > 1:
        warnings = (f"{path.name}: several pictures inside; '{name}' is used",)
    order = "RGBA" if "A" in letters else "RGB"
    return part, tuple(letters[letter] for letter in order), warnings
