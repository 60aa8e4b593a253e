"""OpenImageIO on files that anybody may have made: the header, the layer to read, its pixels.  Row 0 is the top here.

It runs in a process of its own (decoder_pool.py), so what it tells is plain: numbers, words, arrays as they are stored.
"""

from __future__ import annotations

import re
import stat
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from .icc_profile import space_of_profile
from .shot_settings import apex, iso_number, positive
from .tiff_tags import png_exif

MAX_SIDE = 20_000  # pixels: at most 400 megapixels
MAX_TILE = 1 << 24  # pixels of a row of tiles: what a file may make a reader hold
BAND = 1 << 19  # pixels read at a time: 8 MB as RGBA float
CHUNK, LONG_CHUNK = 32, 256  # rows that an EXR file compresses together, at most: DWAB, else
MAX_PARTS = 1000
UNCALIBRATED = 65535  # EXIF's ColorSpace
MARK = "IRPSO map"  # description of the files that image_writer.py writes
KINDS = {"bmp", "cineon", "dpx", "hdr", "jpeg", "jpeg2000", "openexr", "png", "pnm", "sgi", "targa", "tiff", "webp"}
SUFFIXES = {".exr", ".hdr", ".png", ".tif", ".tiff", ".jpg", ".jpeg", ".webp", ".tga", ".bmp", ".dpx", ".cin", ".jp2"}
JPEG = {".jpg", ".jpeg"}
TIFF = {".tif", ".tiff"}
# The last word of a layer's name that holds the finished picture, best first.
_PICTURE = ("", "combined", "composite", "beauty", "rgba", "rgb", "color", "image")

Stored = NDArray[Any]  # of one of these types
FORMS = {"uint8": np.uint8, "uint16": np.uint16, "half": np.float16, "float": np.float32}

# What libjpeg says of bytes between a JPEG's segments, as some cameras leave them there.  Tables, APPn, and comments
# stand before the pixels; where bytes were skipped before another marker, pixels may be missing.
HARMLESS = re.compile(r"JPEG error: Corrupt JPEG data: \d+ extraneous bytes before marker 0x(db|e.|fe) .*")


@dataclass(frozen=True)
class StoredPicture:
    """Where a file holds the picture, as `header` told it."""

    part: int  # OpenImageIO's subimage; of a RAW file 1 if it is read in full
    channels: tuple[int, ...]
    form: str  # a key of FORMS
    size: tuple[int, int]  # width and height of the stored window


def header(path: Path) -> dict[str, Any]:
    """The fields of image_file.ImageFile but ``path``, checked before anything is allocated.  Raises BadInput."""
    try:
        with closing(_open(path)) as file:
            parts: list[Any] = []
            while len(parts) < MAX_PARTS and file.seek_subimage(len(parts), 0):
                parts.append(file.spec())
            part, channels, warnings = _choose(path, parts)
            if file.format_name() == "png" and parts[part].getattribute("Orientation") is None:
                for name, value in png_exif(path).items():
                    parts[part].attribute(name, min(max(int(value), 0), 9) if name == "Orientation" else float(value))
            return _fields(path, parts[part], part, channels, warnings)
    except UnicodeDecodeError:
        raise BadInput(f"{path}: is damaged (names in its header are not text); render or copy it again") from None


def bands(
    path: Path, picture: StoredPicture, first: int, last: int, at_once: int = BAND,
) -> Iterator[Stored]:
    """Rows ``first`` to ``last`` (exclusive) of the stored window, in order: (rows, its width, channels).

    At most about ``at_once`` pixels each, or a row of tiles.  Raises BadInput when the file ends early or is damaged.
    """
    with closing(_open(path)) as file:
        try:
            spec = file.spec() if file.seek_subimage(picture.part, 0) else None
            if spec is None or (spec.width, spec.height) != picture.size or stored_form(spec) != picture.form or (
                    max(picture.channels) >= spec.nchannels):
                raise BadInput(f"{path}: changed while it was read; try again")
            rows = _rows_at_once(spec, at_once)
            for top in range(first - first % rows, last, rows):
                bottom = min(top + rows, spec.height)
                block = _block(file, spec, picture.channels, top, bottom)
                problem = file.geterror()
                if block is None or not all(HARMLESS.fullmatch(line) for line in problem.splitlines()):
                    raise BadInput(f"{path}: is damaged or cut short{_brief(problem)}; render or copy it again")
                yield np.ascontiguousarray(block[max(first - top, 0):last - top])
        except UnicodeDecodeError:  # names in the header that are no text
            raise BadInput(f"{path}: is damaged or cut short; render or copy it again") from None


def _rows_at_once(spec: Any, pixels: int) -> int:
    """Whole tiles, or whole chunks of compression."""
    long = spec.get_string_attribute("compression").startswith("dwab")
    height = int(spec.tile_height) or (LONG_CHUNK if long else CHUNK)
    return height * max(1, pixels // (int(spec.width) * height))


def _block(file: Any, spec: Any, channels: Sequence[int], top: int, bottom: int) -> Stored | None:
    """Rows of the stored window; None: they cannot be read."""
    import OpenImageIO

    form = {"uint8": OpenImageIO.UINT8, "uint16": OpenImageIO.UINT16, "half": OpenImageIO.HALF}.get(
        stored_form(spec), OpenImageIO.FLOAT)
    rows, width = bottom - top, spec.width
    out: Stored = np.empty((rows, width, len(channels)), FORMS[stored_form(spec)])
    for low, high in _runs(channels):  # a file may have a thousand channels
        if spec.tile_width:
            block = file.read_tiles(spec.x, spec.x + width, spec.y + top, spec.y + bottom, 0, 1, low, high, form)
        else:
            block = file.read_scanlines(spec.y + top, spec.y + bottom, 0, low, high, form)
        if block is None:
            return None
        block = np.asarray(block).reshape(rows, width, high - low)
        for i, channel in enumerate(channels):
            if low <= channel < high:
                out[..., i] = block[..., channel - low]
    return out


def _runs(channels: Sequence[int]) -> list[tuple[int, int]]:
    """The channels as few ranges."""
    runs: list[tuple[int, int]] = []
    for channel in sorted(set(channels)):
        if runs and runs[-1][1] == channel:
            runs[-1] = runs[-1][0], channel + 1
        else:
            runs.append((channel, channel + 1))
    return runs


def stored_form(spec: Any) -> str:
    """Which of FORMS holds what is stored without loss (as far as floats do)."""
    name = str(spec.format)
    return name if name in FORMS else "float"


def _fields(path: Path, spec: Any, part: int, channels: tuple[int, ...], warnings: tuple[str, ...]) -> dict[str, Any]:
    width, height = spec.full_width or spec.width, spec.full_height or spec.height
    if max(width, height, spec.width, spec.height) > MAX_SIDE:
        raise BadInput(f"{path}: is {width} x {height} pixels; scale it to at most {MAX_SIDE} on a side")
    if min(width, height, spec.width, spec.height) < 1 or spec.depth > 1:
        raise BadInput(f"{path}: is not a flat image; save it as an ordinary picture")
    # A row of tiles is read at once.
    if spec.tile_width and max(spec.tile_width, spec.width) * spec.tile_height > MAX_TILE:
        raise BadInput(f"{path}: is stored in tiles of {spec.tile_width} x {spec.tile_height} pixels; "
                       "save it in rows or small tiles")
    form, orientation = spec.format, spec.get_int_attribute("Orientation", 1)
    orientation = orientation if 1 <= orientation <= 8 else 1  # as viewers take what is none
    turned = (height, width) if orientation >= 5 else (width, height)
    return {
        "part": part, "channels": channels, "width": turned[0], "height": turned[1], "orientation": orientation,
        "window": (spec.x - spec.full_x, spec.y - spec.full_y, spec.width, spec.height),
        "form": stored_form(spec),
        "bits": spec.get_int_attribute("oiio:BitsPerSample", form.size() * 8),
        "integer": str(form) not in {"half", "float", "double"},
        "premultiplied": not spec.get_int_attribute("oiio:UnassociatedAlpha", 0),
        "colorspace": spec.get_string_attribute("colorInteropID") or _profile(spec) or None,
        "warnings": warnings, "shot": _shot(spec), "own": _words(spec, "ImageDescription") == MARK, "camera": None,
    }


def _shot(spec: Any) -> dict[str, Any]:
    """The fields of ShotSettings, of EXIF."""
    def values(*names: str) -> list[Any]:
        found = [spec.getattribute(name) for name in names]
        return [value[0] if isinstance(value, tuple) and value else value for value in found]  # ISO may be a list

    def first(found: list[float | None]) -> float | None:
        return next((value for value in found if value is not None), None)

    shutter, aperture = values("Exif:ShutterSpeedValue", "Exif:ApertureValue")
    return {
        "time": first([positive(value) for value in values("ExposureTime", "Exif:ExposureTime")]) or apex(shutter, -1),
        "f_number": first([positive(value) for value in values("FNumber", "Exif:FNumber")]) or apex(aperture, 0.5),
        "iso": first([iso_number(value) for value in values(
            "Exif:PhotographicSensitivity", "Exif:ISOSpeedRatings", "Exif:StandardOutputSensitivity",
            "Exif:RecommendedExposureIndex", "Exif:ISOSpeed")])}


def _profile(spec: Any) -> str:
    """The colour space of the ICC profile, else the profile's own name, else what EXIF says without one; or nothing.

    Cameras that are set to Adobe RGB write no profile, but "uncalibrated" and a gamma of 2.2 (DCF 2.0, JEITA CP-3461B).
    """
    profile = spec.getattribute("ICCProfile")
    if profile is None:
        gamma = spec.get_float_attribute("Exif:Gamma", 0.0)
        adobe = spec.get_int_attribute("Exif:ColorSpace", 1) == UNCALIBRATED and abs(gamma - 2.2) < 0.05
        return "Gamma 2.2 Encoded AdobeRGB" if adobe else ""
    try:
        found = space_of_profile(np.asarray(profile, np.uint8).tobytes())
    except (ValueError, OverflowError):  # EXR files hold attributes of any name and type
        found = None
    return found or _words(spec, "ICCProfile:profile_description")


def _words(spec: Any, name: str) -> str:
    """Text that a picture can do without: cameras do not all write UTF-8."""
    try:
        return _plain(spec.get_string_attribute(name).strip())
    except UnicodeDecodeError:
        return ""


def check_file(path: Path) -> None:
    """Raises BadInput where there is no ordinary file."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise BadInput(f"{path}: image not found; check the path") from None
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or "not a possible file name"
        raise BadInput(f"{path}: image not found ({why}); check the path") from None
    if not stat.S_ISREG(mode):  # pipes and devices may wait for ever, or never end
        raise BadInput(f"{path}: is {'a folder' if stat.S_ISDIR(mode) else 'not a file'}; check the path")


def _open(path: Path) -> Any:
    import OpenImageIO

    check_file(path)
    # Straight alpha as stored: multiplying integers by it would lose bits.
    config = OpenImageIO.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    file: Any
    try:
        file = OpenImageIO.ImageInput.open(str(path), config)
        problem = OpenImageIO.geterror()
    except UnicodeError:  # in the path, or in the words about what is wrong
        file, problem = None, ""
    if file is not None and file.format_name() not in KINDS:
        file, problem = None, f"of format '{file.format_name()}'"
    if file is None:
        raise BadInput(f"{path}: cannot be read as an image{_brief(problem)}; use EXR, HDR, PNG, TIFF, JPEG or RAW")
    return file


def _brief(problem: str) -> str:
    """The library's own words, one line of them, in brackets."""
    first = problem.strip().splitlines()[0].strip().rstrip(".").replace(";", ",") if problem and problem.strip() else ""
    return f" ({_plain(first)})" if first else ""


def _plain(words: str) -> str:
    """What a file says of itself, fit for a line of a message."""
    return "".join(c if c.isprintable() else "?" for c in words[:120])


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
        names = _plain(", ".join(dict.fromkeys(name or "?" for _, name, _ in layers)))
        raise BadInput(f"{path}: has no colour picture (layers: {names}); save the Combined pass")
    part, name, letters = colour[ranked[0][1]]
    warnings: tuple[str, ...] = ()
    if sum(rank == ranked[0][0] for rank, _ in ranked) > 1:
        warnings = (f"{path.name}: contains several pictures; '{_plain(name)}' is used",)
    order = "RGBA" if "A" in letters else "RGB"
    return part, tuple(letters[letter] for letter in order), warnings
