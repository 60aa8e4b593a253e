"""The page's words, and tables as Markdown."""

from __future__ import annotations

import textwrap

from .run import NOISE

FIRST = "sphere, no noise"
SCENES = (FIRST, f"sphere, {100 * NOISE:g} % noise", "cow, no noise", f"cow, {100 * NOISE:g} % noise")


def wrapped(paragraph: str, indent: str = "") -> str:
    """Lines of at most 120 characters, whatever was filled in."""
    return textwrap.fill(" ".join(paragraph.split()), 120, subsequent_indent=indent, break_long_words=False,
                         break_on_hyphens=False)
