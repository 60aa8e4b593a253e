"""Pages of figures: their prose stands in docs alone, and a run writes what it measured between the prose's marks.

A mark is a pair of lines, ``<!-- name: begin -->`` and ``<!-- name: end -->``.
tests/studies/test_pages.py holds the form.
"""

from __future__ import annotations

import csv
import datetime
import os
import platform
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
CODE = ("irpso_addon", "operators", "studies", "tests", "tools")


def fill(page: Path, parts: Mapping[str, str], out: Path | None = None) -> None:
    """Put each part between the marks of its name; into ``out``, else into the page itself.

    Raises ValueError where the page has no such marks.
    """
    text = page.read_text(encoding="utf-8")
    for name, part in parts.items():
        begin, end = f"<!-- {name}: begin -->\n", f"<!-- {name}: end -->"
        before, _, rest = text.partition(begin)
        _, found, after = rest.partition(end)
        if not found:
            raise ValueError(f"{page}: no marks of '{name}'")
        text = f"{before}{begin}{part.strip()}\n{end}{after}"
    (out or page).write_text(text, encoding="utf-8")


def measured(renderer: str = "", *programs: str) -> str:
    """The line that each page has: date, commit and machine of this run, and its programs with their versions."""
    software = ", ".join((*programs, f"numpy {np.__version__}", f"Python {platform.python_version()}"))
    return made(today(), commit(), processors(), renderer, software)


def made(date: str, at: str, cpu: str, renderer: str, software: str) -> str:
    """The same of any run."""
    return f"Measured {date[:10]} at commit {at} on {', '.join(filter(None, (cpu, renderer)))}; {software}."


def today() -> str:
    """As ISO 8601 has it, in UTC."""
    return f"{datetime.datetime.now(datetime.UTC):%Y-%m-%d}"


def commit() -> str:
    """Of the code; a change that is not committed is named, and the test of pages then fails."""
    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()

    try:
        changed = git("status", "--porcelain", "--untracked-files=no", "--", *CODE)
        return git("rev-parse", "--short=7", "HEAD") + " with uncommitted changes" * bool(changed)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def processors() -> str:
    """Their number and name."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return f"{os.cpu_count()} x {names[0] if names else platform.processor() or 'unknown processor'}"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """As Markdown."""
    return "\n".join(f"| {' | '.join(line)} |" for line in (head, ["---"] * len(head), *rows))


def write_csv(path: Path, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A full table beside a page."""
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([head, *rows])
