"""Parts of the lines that users read: counted things, and the first names of a list."""

from __future__ import annotations

from collections.abc import Sequence

NAMED = 3  # names in a line


def counted(count: int, thing: str) -> str:
    """``1 view``, ``2 views``: for a word whose plural ends in s."""
    return f"{count} {thing}{'' if count == 1 else 's'}"


def some(names: Sequence[str], mark: str = "'") -> str:
    """The first names of a list, each between two of ``mark``, and how many more there are."""
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(f"{mark}{name}{mark}" for name in names[:NAMED]) + more


def percent(share: float, digits: int = 0, sign: bool = False) -> str:
    """``17.4 %`` of 0.174: with the space that the pages have."""
    return f"{100 * share:{'+' if sign else ''}.{digits}f} %"
