"""What a bug report needs of what was done: one JSON object a line, in a file that does not grow without end.

    {"time": "2026-11-21T17:05:12.345Z", "level": "INFO", "event": "solved", "pid": 4711, "seconds": {...}, ...}

Quiet: nothing is printed unless asked for.  It holds versions, device, settings, figures, warnings and tracebacks; of
files their names alone, of pictures nothing.  Who runs the process says where the file is (`to_file`); a worker process
hands its lines to the one that started it (`to`).
"""

from __future__ import annotations

import json
import logging
import logging.handlers
import os
import re
import time
from collections import Counter
from collections.abc import Callable, Generator
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path, PurePath
from types import TracebackType
from typing import Any, TextIO, TypeVar

from .data import SceneData, Solution
from .errors import BadInput, Cancelled
from .job import Progress
from .params import Table

NAME = "irpso"
FILE = "irpso_log.jsonl"
MOST_BYTES, KEPT = 1_000_000, 2  # of a file, after which it is put aside; files put aside
MOST_LETTERS = 4000  # of a text
LIBRARY = Path(__file__).resolve().parents[2]
# In prose: a stretch without a blank up to a separator, and on to the last one before a colon, a quote or the line's
# end: names of folders may have blanks.  Rather too much than too little.
FOLDERS = re.compile(r"""(?<![^\s'"(<|])[^\s'"(<|]*[/\\](?:[^:'"\n<>|]*[/\\])?""")
Fields = dict[str, Any]
Result = TypeVar("Result")

logger = logging.getLogger(NAME)
logger.propagate = False
logger.setLevel(logging.INFO)
logger.addHandler(logging.NullHandler())


def info(event: str, **fields: Any) -> None:
    """Something was done."""
    logger.info(event, extra={"fields": fields})


def warning(event: str, **fields: Any) -> None:
    """Something that the user was warned of."""
    logger.warning(event, extra={"fields": fields})


def failure(event: str, error: BaseException) -> None:
    """Something ended early: by bad input (a line), or by a bug (with its traceback)."""
    fields: Fields = {"error": type(error).__name__, "message": str(error)}
    if not isinstance(error, BadInput):
        fields["trace"] = trace(error)
    logger.error(event, extra={"fields": fields})


def name_alone(argument: str) -> str:
    """An argument of a command, or what else is known to be a path, cut to what follows the last separator.

    Whatever the folders are called; "--flag=" stays.
    """
    return re.sub(r"(?s)^(--[\w-]+=)?.*[/\\]", r"\1", argument)


def without_folders(text: str) -> str:
    """Prose with every path, as far as a pattern can tell, cut to its last part."""
    return FOLDERS.sub("", text)[:MOST_LETTERS]


def trace(error: BaseException) -> list[str]:
    """Where it was raised, "module file:line function", outermost first, and what it came from; no source text."""
    lines: list[str] = []
    seen: set[int] = set()
    now: BaseException | None = error
    while now is not None and id(now) not in seen:
        seen.add(id(now))
        lines = [*_frames(now.__traceback__), f"{type(now).__name__}: {now}", *lines]
        now = now.__cause__ or (None if now.__suppress_context__ else now.__context__)
    return lines


def _frames(at: TracebackType | None) -> list[str]:
    found = []
    while at is not None:
        code = at.tb_frame.f_code
        file = Path(code.co_filename)
        where = file.relative_to(LIBRARY).as_posix() if file.is_relative_to(LIBRARY) else file.name
        found.append(f"{where.replace('/', ' ')}:{at.tb_lineno} {code.co_name}")
        at = at.tb_next
    return found


# ---- where it goes


class Lines(logging.Formatter):
    """A record as a line of JSON."""

    def format(self, record: logging.LogRecord) -> str:
        """Never fails: what JSON does not know becomes text."""
        stamp = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created)) + f".{int(record.msecs):03d}Z"
        content = {"time": stamp, "level": record.levelname, "event": record.getMessage(), "pid": os.getpid(),
                   **getattr(record, "fields", {})}
        return json.dumps(_plain(content), ensure_ascii=False)


def _plain(value: Any) -> Any:
    """As JSON has it, texts without folders."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return round(value, 6) if abs(value) < 1e300 else str(value)  # NaN and infinity too
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, PurePath):
        return name_alone(str(value))
    return without_folders(str(value))


class _File(logging.handlers.RotatingFileHandler):
    """A file of some size; never in anybody's way."""

    def doRollover(self) -> None:
        """Windows refuses while another process has the file open: then it grows on, as long as this one runs."""
        try:
            super().doRollover()
        except OSError:
            self.maxBytes = 0  # else it would be tried, and the files put aside moved, with every line
            self.stream = self._open()

    def handleError(self, record: logging.LogRecord) -> None:
        """A full disk must not end a solve."""

    def close(self) -> None:
        """Nor hinder Blender's end."""
        with suppress(OSError):
            super().close()


class _Hand(logging.Handler):
    """Hands a record on."""

    def __init__(self, take: Callable[[str, str, Fields], None]) -> None:
        super().__init__()
        self._take = take

    def emit(self, record: logging.LogRecord) -> None:
        """To whoever asked for it."""
        self._take(record.levelname, record.getMessage(), {"pid": os.getpid(), **getattr(record, "fields", {})})


def to_file(path: Path) -> None:
    """Write there from now on, beside where it goes already; not twice to one file."""
    if any(isinstance(h, _File) and Path(h.baseFilename) == path.absolute() for h in logger.handlers):
        return
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        _add(_File(path, maxBytes=MOST_BYTES, backupCount=KEPT, encoding="utf-8", delay=True,
                   errors="backslashreplace"))


def to_stream(stream: TextIO) -> None:
    """Write there too."""
    _add(logging.StreamHandler(stream))


def _add(handler: logging.Handler) -> None:
    handler.setFormatter(Lines())
    logger.addHandler(handler)


def to(take: Callable[[str, str, Fields], None]) -> None:
    """Hand each record (level, event, fields) to a function."""
    logger.addHandler(_Hand(take))


def again(level: str, event: str, fields: Fields) -> None:
    """A record that another process has made."""
    logger.log(logging.getLevelNamesMapping().get(level, logging.INFO), event, extra={"fields": fields})


def close() -> None:
    """Close the files; nothing is written from now on."""
    for handler in logger.handlers[:]:
        if not isinstance(handler, logging.NullHandler):
            logger.removeHandler(handler)
            handler.close()


# ---- what is told of a solve


def watched(
    scene: SceneData, settings: Table, device: Table, steps: Generator[Progress, None, Result],
) -> Generator[Progress, None, Result]:
    """A solve whose beginning and end are told."""
    views = scene.views
    info("solve", triangles=len(scene.mesh.positions), others=len(scene.occluders), views=len(views),
         materials=len(scene.mesh.slot_names), cameras=len({view.camera.name for view in views}),
         lights=dict(Counter(light.kind for view in views for light in view.lights)),
         part=scene.region is not None, settings=asdict(settings), device=asdict(device))
    started = time.perf_counter()
    try:
        result = yield from steps
    except (Cancelled, GeneratorExit):
        info("stopped", seconds=time.perf_counter() - started)
        raise
    except BaseException as error:
        failure("solve failed", error)
        raise
    if isinstance(result, Solution):
        _solved(result)
    return result


def _solved(solution: Solution) -> None:
    for text in solution.warnings:
        warning("warning", message=text)
    for view, why in solution.views_skipped:
        warning("view left out", message=f"{view}: {why}")
    info("solved", device=solution.device, seconds=solution.seconds, texels=solution.texels,
         models=list(solution.model.values()), residual=solution.residual, cancelled=solution.cancelled)
