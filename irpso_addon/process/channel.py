"""Messages between Blender and its worker process: pickles over a pipe, arrays beside them without copies.

Either side has its own name for this package (``bl_ext.user_default.irpso.irpso_addon`` in Blender): classes are
found by their place in it.
"""

from __future__ import annotations

import importlib
import io
import pickle
import struct
import threading
from typing import IO, Any

_HEAD = struct.Struct("<QQ")  # bytes of the pickle, number of buffers
_SIZE = struct.Struct("<Q")
LIBRARY = "irpso_addon"
ROOT_PACKAGE = (__package__ or f"{LIBRARY}.process").rpartition(".")[0]  # this package, by the name it has here


class Closed(Exception):
    """The other side has gone."""


class Sender:
    """Writes whole messages, from any thread."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self._lock = threading.Lock()

    def send(self, message: object) -> None:
        """Write one message.  Raises Closed."""
        buffers: list[pickle.PickleBuffer] = []
        body = pickle.dumps(message, protocol=5, buffer_callback=buffers.append)
        raws = [buffer.raw() for buffer in buffers]
        try:
            with self._lock:
                self._stream.write(_HEAD.pack(len(body), len(raws)))
                for raw in raws:
                    self._stream.write(_SIZE.pack(raw.nbytes))
                self._stream.write(body)
                for raw in raws:
                    self._stream.write(raw)
                self._stream.flush()
        except (OSError, ValueError):  # a broken pipe, or one that this side has closed
            raise Closed from None


class Receiver:
    """Reads whole messages, on one thread."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream

    def receive(self) -> Any:
        """The next message; arrays in it may be written to.  Raises Closed."""
        body, count = _HEAD.unpack(self._exactly(_HEAD.size))
        sizes = [_SIZE.unpack(self._exactly(_SIZE.size))[0] for _ in range(count)]
        text = self._exactly(body)
        return _Unpickler(io.BytesIO(text), buffers=[self._exactly(size) for size in sizes]).load()

    def _exactly(self, size: int) -> bytearray:
        data = bytearray(size)
        view, done = memoryview(data), 0
        while done < size:
            try:
                got = self._stream.readinto(view[done:])  # type: ignore[attr-defined]  # IO's stub lacks it
            except (OSError, ValueError):
                got = 0
            if not got:
                raise Closed
            done += got
        return data


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        return getattr(named(module), name) if LIBRARY in module.split(".") else super().find_class(module, name)


def named(module: str) -> Any:
    """The module of this package that either side calls ``...irpso_addon.a.b``, or just ``a.b``."""
    parts = module.split(".")
    tail = parts[parts.index(LIBRARY) + 1:] if LIBRARY in parts else parts
    return importlib.import_module(".".join([ROOT_PACKAGE, *tail]))
