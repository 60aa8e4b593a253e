"""Records of core to files and back: one .npz of its arrays and a JSON text.  Nothing in it can be run.

The same thing gives the same bytes, on any machine.  numpy opens the file by itself: ``numpy.load(path)``.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import stat
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path, PurePath
from typing import Any, BinaryIO

import numpy as np

from ..change_records import (
    AmbientChange,
    BlackLevelChange,
    Calibration,
    CameraChange,
    ExposureChange,
    LampChange,
    PredictionError,
    RefinedNormals,
    ResponseChange,
    SizeChange,
    VignettingChange,
    WorldChange,
)
from ..check_records import Checks, LightResidual, MaterialCheck, Misfit, Residual, Slope, ViewCheck
from ..data import (
    Bounced,
    Camera,
    Coat,
    Emitter,
    Environment,
    JointPrior,
    Light,
    Maps,
    MaterialPrediction,
    MeshArrays,
    NormalMap,
    Region,
    SceneData,
    Solution,
    View,
    ViewPicture,
)
from ..errors import BadInput
from ..lens import Lens
from ..params import SolveSettings
from ..storage.atomic_io import replacing
from ..versions import version
from .tiled_plan import Noise, Plan, Typical

FORMAT = 29  # of the files; another one is refused
THING = "thing.json"
MOST = 1 << 28  # bytes of a packed record
# The records that a file may hold.  Their names and their fields' names are the file's format: raise FORMAT with them.
RECORDS: dict[str, type[Any]] = {kind.__name__: kind for kind in (
    NormalMap, MeshArrays, Camera, Lens, Light, Emitter, Environment, View, Region, SceneData, Bounced, Maps, Solution,
    ViewPicture, Coat, JointPrior, PredictionError, MaterialPrediction, LampChange, SizeChange, CameraChange,
    ExposureChange, VignettingChange, AmbientChange, ResponseChange, BlackLevelChange, WorldChange, Calibration,
    RefinedNormals, SolveSettings, Residual, Slope, LightResidual, Misfit, ViewCheck, MaterialCheck, Checks, Noise,
    Typical, Plan)}
_KINDS = "biuf"  # of arrays: truth values, integers, floats
_TIME = (1980, 1, 1, 0, 0, 0)  # the earliest that a zip can tell: else other bytes each time


def save(path: Path, record: Any) -> None:
    """Write ``thing``: `RECORDS`, tuples, lists, dicts, None, str, numbers, paths, numpy arrays, nested.

    Whole or not at all.  Raises BadInput where it cannot be written, TypeError for what is none of these.
    """
    path = Path(path)
    encoded = _encode(record)
    try:
        with replacing(path) as part, part.open("wb") as file:
            _write(file, *encoded)
    except OSError as error:
        raise BadInput(f"{path}: cannot be written ({error.strerror}); check the folder and the free space") from None


def load(path: Path) -> Any:
    """What `save` wrote there, after its checksums were compared.  Raises BadInput."""
    path = Path(path)
    try:
        size = _size(path)
        with path.open("rb") as file:
            return _read(file, size)
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror or 'is damaged'}); check the path") from None
    except OtherFormatError:
        raise BadInput(f"{path}: was written by another version of irpso; remove it and run again") from None
    except BadInput:
        raise
    except Exception:  # whatever a damaged or forged file makes the readers of zip, JSON and arrays say
        raise BadInput(f"{path}: is damaged or of another version of irpso; remove it and run again") from None


def packed(record: Any) -> bytes:
    """What `save` writes, compressed."""
    file = io.BytesIO()
    _write(file, *_encode(record))
    return zlib.compress(file.getvalue(), 1)  # a window waits for it


def unpacked(content: bytes) -> Any:
    """What `packed` made, of at most MOST bytes when unpacked.  Raises ValueError."""
    try:
        unpacker = zlib.decompressobj()
        plain = unpacker.decompress(content, MOST)
        if not unpacker.eof:
            raise ValueError
        return _read(io.BytesIO(plain), len(plain))
    except Exception:  # as in `load`
        raise ValueError("was not written by this version of irpso") from None


class OtherFormatError(ValueError):
    """A file that another version wrote."""


def _write(to: BinaryIO, text: bytes, arrays: Mapping[str, Any]) -> None:
    with zipfile.ZipFile(to, "w", zipfile.ZIP_STORED) as file:
        file.writestr(_member(THING, len(text)), text)
        for name, array in arrays.items():
            with file.open(_member(f"{name}.npy", array.nbytes + 1024), "w") as member:
                np.lib.format.write_array(member, array, allow_pickle=False)


def _read(content: BinaryIO, size: int) -> Any:
    """Raises all sorts for what `_write` has not written; ``size``: of the content."""
    with zipfile.ZipFile(content) as file:
        members = {info.filename: info for info in file.infolist()}
        # Stored as they are and together no larger than the file: nothing that unpacks to more than the disk holds.
        if (len(members) != len(file.infolist()) or sum(m.file_size for m in members.values()) > size
                or any(m.compress_type != zipfile.ZIP_STORED for m in members.values())):
            raise ValueError
        arrays = {name[:-4]: _array(file.read(info)) for name, info in members.items() if name != THING}
        text = json.loads(file.read(THING))
    if text["format"] != FORMAT:
        raise OtherFormatError
    return _decode(text["thing"], arrays)


def fingerprint(*records: Any, files: Iterable[Path] = ()) -> str:
    """A name for exactly these things, these files' contents and this version of irpso: 64 hexadecimal digits.

    Raises BadInput for a file that cannot be read.
    """
    found = hashlib.sha256(f"{version()} {FORMAT}\n".encode())
    for record in records:
        text, arrays = _encode(record)
        found.update(hashlib.sha256(text).digest())
        for array in arrays.values():
            found.update(f"{array.dtype.str} {array.shape}".encode())
            found.update(hashlib.sha256(array).digest())
    for path in files:
        try:
            _size(Path(path))
            with Path(path).open("rb") as file:
                found.update(hashlib.file_digest(file, "sha256").digest())
        except OSError as error:
            raise BadInput(f"{path}: cannot be read ({error.strerror}); check the path") from None
    return found.hexdigest()


def _size(path: Path) -> int:
    """Of a file, in bytes.  Raises BadInput for what is none: reading a pipe would wait."""
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise BadInput(f"{path}: is not a file; check the path")
    return status.st_size


def _member(name: str, size: int) -> zipfile.ZipInfo:
    """A zip member's header that is the same on every system and day."""
    info = zipfile.ZipInfo(name, _TIME)
    info.create_system, info.external_attr, info.file_size = 3, 0o644 << 16, size
    return info


def _encode(record: Any) -> tuple[bytes, dict[str, Any]]:
    """The JSON text, and the arrays it names, each once."""
    arrays: dict[str, Any] = {}
    names: dict[int, tuple[str, Any]] = {}  # with the array itself, so that its id is not given to another

    def array(value: Any) -> str:
        if id(value) not in names:
            if value.dtype.kind not in _KINDS:
                raise TypeError(f"arrays of {value.dtype} are not kept")
            names[id(value)] = name, _ = f"a{len(arrays)}", value
            arrays[name] = np.asarray(value, value.dtype.newbyteorder("<"), order="C")
        return names[id(value)][0]

    def plain(value: Any) -> Any:
        match value:
            case np.ndarray():
                return {"array": array(value)}
            case np.generic():
                return {"scalar": array(np.asarray(value))}
            case None | bool() | int() | str():
                return value
            case float():
                return value if math.isfinite(value) else {"float": str(value)}
            case PurePath():
                return {"path": str(value)}
            case tuple():
                return {"tuple": [plain(item) for item in value]}
            case list():
                return [plain(item) for item in value]
            case Mapping():
                return {"dict": [[plain(key), plain(item)] for key, item in value.items()]}
        kind = RECORDS.get(type(value).__name__)
        if kind is not type(value):
            raise TypeError(f"{type(value)} is none of the records that files keep")
        names_of = [f.name for f in fields(kind)]
        return {"record": kind.__name__, "fields": {name: plain(getattr(value, name)) for name in names_of}}

    encoded = {"format": FORMAT, "thing": plain(record)}
    return json.dumps(encoded, separators=(",", ":"), allow_nan=False).encode(), arrays


def _decode(encoded: Any, arrays: dict[str, Any]) -> Any:
    """The thing again.  Raises all sorts for a text that `_encode` does not write."""
    if isinstance(encoded, list):
        return [_decode(item, arrays) for item in encoded]
    if not isinstance(encoded, dict):
        return encoded
    match encoded:
        case {"array": name}:
            return arrays[name]
        case {"scalar": name}:
            return arrays[name][()]
        case {"float": text}:
            return float(text)
        case {"path": str(text)} if "\0" not in text:
            return Path(text)
        case {"tuple": items}:
            return tuple(_decode(item, arrays) for item in items)
        case {"dict": pairs}:
            return {_decode(key, arrays): _decode(item, arrays) for key, item in pairs}
        case {"record": name, "fields": values}:
            return RECORDS[name](**{key: _decode(value, arrays) for key, value in values.items()})
    raise ValueError("not written by irpso")


def _array(content: bytes) -> Any:
    """An array as numpy writes it, whose header promises no more than there is."""
    file = io.BytesIO(content)
    if np.lib.format.read_magic(file) != (1, 0):
        raise ValueError
    shape, columns_first, dtype = np.lib.format.read_array_header_1_0(file)
    if columns_first or dtype.kind not in _KINDS or math.prod(shape) * dtype.itemsize != len(content) - file.tell():
        raise ValueError
    return np.frombuffer(bytearray(content), dtype, offset=file.tell()).reshape(shape)
