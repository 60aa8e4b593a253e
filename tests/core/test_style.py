"""What users read keeps the rules of docs/style.md that a program can check."""

from __future__ import annotations

import ast
import importlib.util
import re
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.one_python

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def style() -> Any:
    spec = importlib.util.spec_from_file_location("style_check", ROOT / "tools" / "style_check.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_messages_labels_and_tooltips(style: Any) -> None:
    assert list(style.code()) == []


def test_pages(style: Any) -> None:
    assert list(style.pages()) == []


@pytest.mark.parametrize(("source", "words"), [
    ('raise BadInput(f"{n}: want 16 to 8192")', "must be"),
    ('raise BadInput("a.txt: is no mesh file; choose another")', "is not a"),
    ('line = f"light: the report tells of {n} lamps"', "names"),
    ('line = f"{n} is off by 17.4% of it"', "17 %"),
    ('line = f"light: it is off by {share:.1%} of it"', "17 %"),
    ('x = BoolProperty(name="Known power", description="Real power")', "capital"),
    ('x = BoolProperty(name="Known Power", description="Real power.")', "full stop"),
    ('x = BoolProperty(name="Known Power", description="real power")', "begin with a capital"),
    ('x: int = parameter(1, "' + "Word " * 50 + '", label="Size")', "at most"),
    ('class IRPSO_OT_solve:\n    """Solve."""', "full stop"),
    ('class IRPSO_PT_solve:\n    bl_label = "Solve now"', "capital"),
])
def test_a_breach_in_code(style: Any, source: str, words: str) -> None:
    assert any(words in line for line in style.of_code(source, "a.py")), list(style.of_code(source, "a.py"))


def test_what_is_well_in_code(style: Any) -> None:
    source = """raise BadInput(f"{path}: is not a mesh file; there is no UV map")
x = f(name="Size", description="Width")"""
    assert list(style.of_code(source, "a.py")) == []


def test_a_breach_in_a_page(style: Any) -> None:
    page = "IRPSO begins anew.\n\n    anew in code\n\n`anew`\n\n```\nanew\n```\n5% of it\n"
    assert [line.split(": ")[0] for line in style.of_page(page, "a.md")] == ["a.md:1", "a.md:10"]


# ---- the table of warnings in docs/troubleshooting.md

WARNED = {  # where warnings are made: functions, or the records whose first argument they are
    "irpso_addon/core/checks/warnings.py": None,
    "irpso_addon/core/checks/camera_lines.py": {"corrected_cameras"},
    "irpso_addon/core/checks/calibration_lines.py": {"worlds_in_doubt"},
    "irpso_addon/core/checks/shoot_check.py": {"Finding"},
    "irpso_addon/solve/one_round.py": {"unfit", "no_metal", "_warnings"},
}


def clauses(source: str, names: set[str] | None) -> set[str]:
    """What each warning states first, with "..." for what is put in: from after the name to the first stop."""
    tree = ast.parse(source)
    roots: list[ast.AST] = [tree] if names is None else [
        node.args[0] if isinstance(node, ast.Call) else node for node in ast.walk(tree)
        if (isinstance(node, ast.Call) and getattr(node.func, "id", "") in names)
        or (isinstance(node, ast.FunctionDef) and node.name in names)]
    found = set()
    for node in (node for root in roots for node in ast.walk(root) if isinstance(node, ast.JoinedStr)):
        text = "".join(str(part.value) if isinstance(part, ast.Constant) else "..." for part in node.values)
        name, _, rest = text.partition(": ")
        clause = re.split(r"[;(,:]", rest)[0].strip()
        named = re.fullmatch(r"(all views|\.\.\.|\w+ '\.\.\.'|\w+ of '\.\.\.'|\.\.\. (of \.\.\. )?\w+)", name)
        if named and re.search(r"[a-z]", clause):
            found.add(clause)
    return found


def test_every_warning_is_in_the_table() -> None:
    made = set().union(*(clauses((ROOT / path).read_text(encoding="utf-8"), names) for path, names in WARNED.items()))
    page = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    section = page[page.index("## Warnings"):]
    rows = re.findall(r"^\| \*(.+?)\* \|", section[:section.index("\n## ", 3)], re.M)
    assert len(made) > 20 and sorted(made - {*rows}) == [] and sorted({*rows} - made) == []


# ---- the table of an import's lines in docs/shoots.md

IMPORTED = ("irpso_addon/core/shoot", "irpso_addon/blender/shoot/import_shoot.py",
            "irpso_addon/blender/shoot/mesh_place.py", "irpso_addon/blender/shoot/shoot_pictures.py",
            "irpso_addon/core/images/shot_settings.py")


def appended(source: str) -> set[str]:
    """The texts that go into a list `lines` or `warnings`, with "..." for what is put in."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "append" and (
                getattr(node.func.value, "attr", getattr(node.func.value, "id", "")) in ("lines", "warnings")):
            parts = node.args[0].values if isinstance(node.args[0], ast.JoinedStr) else node.args
            found.add("".join(str(part.value) if isinstance(part, ast.Constant) else "..." for part in parts))
    return {text for text in found if re.search(r"[a-z]{3,} [a-z]", text)}


def test_every_line_of_an_import_is_in_the_table() -> None:
    files = [file for path in IMPORTED for file in ([*(ROOT / path).glob("*.py")] or [ROOT / path])]
    made = set().union(*(appended(file.read_text(encoding="utf-8")) for file in files))
    page = (ROOT / "docs" / "shoots.md").read_text(encoding="utf-8")
    section = page[page.index("## What the lines mean"):page.index("These lines end an import")]
    rows = [quote for row in re.findall(r"^\| (\*.+?) \|", section, re.M) for quote in re.findall(r"\*(.+?)\*", row)]
    assert len(made) > 15
    assert [text for text in sorted(made) if not any(
        all(part.strip(" ;") in text for part in quote.split("...")) for quote in rows)] == []
