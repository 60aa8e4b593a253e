"""Maps to image files: the names and the order that other programs rely on.

``<object>_basecolor``, ``_roughness``, ``_confidence``, ``_error``, ``_filled``, ``_roughness_sigma``,
``_basecolor_sigma``, ``_specular`` where it was solved for, and ``_normal`` where normals were refined; row 0 of the
file is the top (``core/images/image_writer.py`` flips).  EXR holds linear 32-bit floats; PNG and TIFF hold 16 bits,
cut off at 1, and the base colour (that map alone) is sRGB-encoded there.  ``_metallic`` is there where a material is
part metal and part paint; else Metallic is a value of the material, in the report.  Either every file of a set
appears, or none.
"""

from __future__ import annotations

import hashlib
import re
import unicodedata
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..data import F32, Maps
from ..errors import BadInput
from ..images.image_writer import write_image
from ..storage.output_transaction import OutputTransaction

KINDS = ("exr", "png", "tiff")
LAYERS = ("basecolor", "roughness", "confidence", "error", "filled", "roughness_sigma", "basecolor_sigma", "specular",
          "metallic", "normal")
STEM_BYTES = 200  # file systems allow 255 bytes a name; the longest suffix is "_basecolor_sigma.tiff"
FORBIDDEN = frozenset('/\\:*?"<>|')  # in a file name on some system that artists share files with
DEVICES = re.compile(r"(CON|PRN|AUX|NUL|(COM|LPT)[0-9¹²³])\s*(\.|$)", re.IGNORECASE)  # of Windows


def safe_stem(name: str) -> str:
    """A file stem from an object's name: one path component on every system, non-ASCII letters kept.

    One that begins like a device of Windows, as CON.001 does, gets a "_" before it.
    Names that are too long are cut at a letter and end in a hash of the whole, so that two objects
    whose names begin alike do not overwrite each other.
    """
    stem = "".join("_" if c in FORBIDDEN or not c.isprintable() else c for c in name)
    stem = stem.lstrip(". ").rstrip(". ") or "object"
    if DEVICES.match(stem):
        stem = f"_{stem}"
    if len(stem.encode()) > STEM_BYTES:
        digest = "_" + hashlib.sha256(name.encode(errors="replace")).hexdigest()[:8]
        stem = stem.encode()[: STEM_BYTES - len(digest)].decode(errors="ignore") + digest
    return stem


def share_files(one: str, other: str) -> bool:
    """Whether two objects of these names would overwrite each other's files on some system.

    Windows and macOS take upper and lower case for the same, and macOS a letter with its accent for the two apart.
    """
    folded, other_folded = (unicodedata.normalize("NFD", unicodedata.normalize("NFD", safe_stem(name)).casefold())
                            for name in (one, other))
    return folded == other_folded


def write_maps(maps: Maps, stem: str, out: Path, kind: str) -> list[Path]:
    """Writes the files of ``maps`` into the folder ``out`` (made if missing) and returns their paths.

    ``stem`` is the object's name, ``kind`` one of `KINDS`.  Raises BadInput when ``out`` cannot be
    written; nothing is left behind then and older files keep their contents.
    """
    check_kind(kind)
    with OutputTransaction(Path(out)) as staging:
        names = _write_all(maps, stem, staging.folder, kind)
        staging.publish()
        return [staging.out / name for name in names]


def layers(maps: Maps) -> dict[str, F32]:
    """The maps by the ends of their files' names: (n, n) or (n, n, 3) each.

    "roughness" is grey, or, where some material has two lobes, (roughness1, roughness2, weight of lobe 1).
    """
    found = {
        "basecolor": maps.base_color, "roughness": maps.roughness if maps.lobes is None else maps.lobes,
        "confidence": maps.confidence, "error": maps.error, "filled": maps.filled.astype(np.float32),
        "roughness_sigma": maps.roughness_sigma, "basecolor_sigma": maps.base_sigma,
    }
    more = {"specular": maps.specular, "metallic": maps.metallic, "normal": maps.normal}
    return found | {layer: array for layer, array in more.items() if array is not None}


def earlier_maps(out: Path, stem: str, written: Sequence[Path]) -> list[str]:
    """Names of maps of the same object that an earlier solve has left in the folder, beside those just ``written``."""
    name = re.compile(rf"{re.escape(safe_stem(stem))}_({'|'.join(LAYERS)})(\.\d{{4}})?\.({'|'.join(KINDS)})")
    return sorted(path.name for path in out.iterdir() if name.fullmatch(path.name) and path not in written)


def check_kind(kind: str) -> None:
    """Raises BadInput for a format that is not one of `KINDS`."""
    if kind not in KINDS:
        raise BadInput(f"format '{kind}': not known; use one of {', '.join(KINDS)}")


def file_name(stem: str, layer: str, kind: str, udim: int | None = None) -> str:
    """Of a map's file, given the object's name."""
    return f"{safe_stem(stem)}_{layer}{'' if udim is None else f'.{udim}'}.{kind}"


def as_stored(layer: str, values: F32) -> F32:
    """A layer with the channels that its file has: (h, w, channels).

    "roughness" has three also where they are equal: who reads it need not ask.
    """
    if values.ndim == 3:
        return values
    return np.repeat(values[..., None], 3 if layer == "roughness" else 1, axis=2)


def _write_all(maps: Maps, stem: str, folder: Path, kind: str) -> list[str]:
    """One file per map in ``folder``; their names."""
    names = []
    for layer, array in layers(maps).items():
        names.append(file_name(stem, layer, kind))
        write_image(folder / names[-1], as_stored(layer, array), kind=kind, color=layer == "basecolor")
    return names
