"""Each page under Measured opens with its verdict and chart, and names machine, commit, date and command."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
import yaml

from studies import charts

DOCS = Path(__file__).resolve().parents[2] / "docs"
NAV = yaml.safe_load((DOCS.parent / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]
PAGES = [page for part in NAV for entry in part.get("Measured", ()) for page in entry.values()]
COMMIT = r"([0-9a-f]{7,40})(?: \(joined into ([0-9a-f]{7,40})\))?"  # the second is what the history has of the first
MADE = re.compile(rf"Measured \d{{4}}-\d\d-\d\d at commit {COMMIT}\s+on\s+\d+\s+(?:x\s+[A-Z]|CPU\s+cores)")
FIGURES = ("brdf.md", "farms.md", "large.md", "paper.md", "shooting.md", "troubleshooting.md", "../README.md")
COMMAND = re.compile(r"python -m (studies|tools)\.\w+|python (studies|tools)/[\w/]+\.py")
DIRTY = re.compile(r"-dirty|uncommitted|commit unknown")
LONGEST = 48  # rows of a table; a longer one stands in a file beside the page


def test_there_are_pages():
    assert len(PAGES) > 10


@pytest.mark.parametrize("page", PAGES)
def test_a_page_of_figures(page):
    text = (DOCS / page).read_text(encoding="utf-8")
    assert text.split("\n\n")[1].startswith("**Verdict.** "), "the verdict is not first"
    assert MADE.search(text), "no line 'Measured DATE at commit COMMIT on MACHINE'"
    assert COMMAND.search(text), "no command"
    assert not DIRTY.search(text), "measured with code that no commit has"


@pytest.mark.parametrize("page", FIGURES)
def test_figures_elsewhere(page):
    text = (DOCS / page).read_text(encoding="utf-8")
    assert MADE.search(text) and not DIRTY.search(text)


@pytest.mark.parametrize("page", [*PAGES, *FIGURES])
def test_the_commit_of_figures_is_in_the_history(page):
    """Whoever doubts a figure can look at the code that made it."""
    if git("rev-parse", "--is-shallow-repository") != "false":
        pytest.skip("no clone with a whole history")
    text = (DOCS / page).read_text(encoding="utf-8")
    named = {joined or commit for commit, joined in re.findall(rf"at commit {COMMIT}", text)}
    assert named, "no commit"
    assert {commit for commit in named if git("cat-file", "-t", commit) != "commit"} == set()


def git(*words: str) -> str:
    """What git prints in this checkout; nothing where it fails or is not there."""
    try:
        return subprocess.run(["git", *words], cwd=DOCS, capture_output=True, text=True, check=False).stdout.strip()
    except OSError:
        return ""


@pytest.mark.parametrize("page", PAGES)
def test_the_chart_comes_before_the_tables(page):
    text = (DOCS / page).read_text(encoding="utf-8")
    pictures = [match.start() for match in re.finditer(r"^!\[", text, re.M)]
    if pictures:
        others = [match.start() for match in re.finditer(r"^(## |\|)", text, re.M)]
        assert pictures[0] < min(others), "a table or a heading comes before the chart"


@pytest.mark.parametrize("page", charts.CHARTS)
def test_a_chart_is_of_its_table(page):
    """Otherwise: python -m studies.charts."""
    assert charts.stamp(page).encode() in (DOCS / f"{page}.png").read_bytes()


@pytest.mark.parametrize("page", PAGES)
def test_no_table_is_long(page):
    text = (DOCS / page).read_text(encoding="utf-8")
    longest = max((block.count("\n|") for block in re.findall(r"(?:^\|.*\n)+", text, re.M)), default=0)
    assert longest <= LONGEST, "a long table belongs into a file beside the page"
