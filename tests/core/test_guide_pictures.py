"""The guide's pictures show the present interface: they are as old as what made.json says that they show."""

from __future__ import annotations

import json

import pytest

from tests.support import pictured


def test_the_pictures_show_the_present_interface() -> None:
    made = json.loads(pictured.MADE.read_text())
    assert not (lines := pictured.changed(made["shows"])), "\n".join([*lines, "run make screenshots"])


def test_each_picture_is_of_the_same_run() -> None:
    """And each has a page that shows it."""
    folder, docs = pictured.MADE.parent, pictured.ROOT / "docs"
    pictures = sorted(path.name for path in folder.glob("*.jpg"))
    assert pictures == json.loads(pictured.MADE.read_text())["pictures"]
    pages = "".join(page.read_text() for page in docs.glob("*.md"))
    assert not [name for name in pictures if f"images/guide/{name}" not in pages]


@pytest.mark.parametrize("line", [
    "panel Solve", "operator irpso.solve Solve Objects Solve PLAY", "prop enabled", "label Not solved yet INFO"])
def test_what_a_panel_draws_is_found(line: str) -> None:
    assert line in [found for lines in pictured.shown().values() for found in lines]


def test_a_change_that_a_picture_shows_is_reported() -> None:
    """A label and a default that are other ones now."""
    before = {place: list(lines) for place, lines in pictured.shown().items()}
    assert pictured.changed(before) == []
    before["ui/panel_solve.py"].remove("panel Solve")
    before["properties"][before["properties"].index("out: Folder, `//irpso`")] = "out: Folder, `//maps`"
    assert pictured.changed(before) == [
        "properties: the pictures show 'out: Folder, `//maps`'",
        "properties: the pictures lack 'out: Folder, `//irpso`'",
        "ui/panel_solve.py: the pictures lack 'panel Solve'"]
