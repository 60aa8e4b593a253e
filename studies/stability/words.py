"""The words of docs/stability/README.md stand in words.md; figures in them are looked up: {refined.failures@10}."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def parts() -> dict[str, str]:
    """words.md by its headings; before the first: "head"."""
    head, *rest = Path(__file__).with_suffix(".md").read_text(encoding="utf-8").split("\n## ")
    return {"head": head + "\n", **{key: words.strip() for key, words in (part.split("\n", 1) for part in rest)}}


_FIGURE = re.compile(r"\{(\w+)\.(\w+)@([^}]+)\}")


def filled(words: str, points: Mapping[str, Any]) -> str:
    """With the figures of an axis; one that was not measured is a dash."""
    return wrapped(_FIGURE.sub(lambda m: _figure(points, *m.groups()), words))


def wrapped(text: str) -> str:
    """Paragraphs in lines of 120; a number stays with its %."""
    return "\n\n".join(part if part.startswith("#") else _lines(part) for part in text.split("\n\n"))


def _lines(paragraph: str) -> str:
    kept = paragraph.replace(" %", "\0%")
    return textwrap.fill(kept, 120, break_long_words=False, break_on_hyphens=False).replace("\0", " ")


def _figure(points: Mapping[str, Any], method: str, what: str, label: str) -> str:
    value = points.get(label, {}).get(method, {}).get(what)
    if value is None:
        return "-"
    if what not in ("failures", "gross", "unsure", "predicted"):
        return f"{value:.3f}"
    return f"{100 * value:.2g} %" if value < 0.1 else f"{100 * value:.0f} %"
