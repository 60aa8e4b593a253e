"""What the guide's pictures show of the interface, read from the code: docs/images/guide/made.json keeps it.

`tests/gui/screenshots.py` writes the file beside the pictures; `tests/core/test_guide_pictures.py` compares.  Only
names, defaults, buttons and icons of panels that a picture shows count: texts of messages, tooltips and all that the
panels do may change without new pictures.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

from irpso_addon.core.params import SolveSettings, choice_name

ROOT = Path(__file__).resolve().parents[2]
BLENDER = ROOT / "irpso_addon" / "blender"
MADE = ROOT / "docs" / "images" / "guide" / "made.json"
PANELS = {  # and their parts that no picture shows: menus, folded panels
    "ui/panel_capture.py": {"IRPSO_MT_views", "IRPSO_PT_view", "_draw_lights", "_draw_file", "_draw_heads"},
    "ui/panel_solve.py": {"IRPSO_PT_advanced", "_draw_shared", "draw_unseen"},
    "ui/panel_result.py": set(),
    "ui/panel_views.py": {"IRPSO_PT_open", "_chart", "_table", "IRPSO_MT_pictures", "_ResultMenu",
                          "IRPSO_MT_result_a", "IRPSO_MT_result_b"},
    "jobs/solve_speed.py": {"_draw_bounced"},
    "jobs/solve_region.py": set(),
    "preferences.py": {"draw_offer"},
}
DRAWN = {"label", "prop", "prop_enum", "operator", "operator_menu_enum", "menu", "progress"}  # of a layout
OWN = {"_choices": "prop", "_figure": "label"}  # the panels' own ways to do so
UNSEEN = {"irpso.look_back", "irpso.write_maps", "region_group", "region_image", "irpso.paint_part"}
TABLES = ("### IRPSO's settings of a scene", "### One reference image", "### What the viewer shows",
          "## Preferences")  # of docs/reference.md, which the code makes
ROW = re.compile(r"^\| (?P<label>[^|]+?) \| `(?P<name>\w+)` \| (?P<default>[^|]*?) \| (?P<choices>[^|]*?) \|")
SPECIAL = "; for "  # in the text of settings that only some models and methods have


def shown() -> dict[str, list[str]]:
    """Of each pictured file what it draws, then properties with their defaults, and the figures of Checks."""
    found = {name: sorted(set(_drawn(BLENDER / name, without))) for name, without in PANELS.items()}
    names = {line.split()[1] for lines in found.values() for line in lines if line.startswith("prop")}
    operators = {line.split()[1] for lines in found.values() for line in lines if line.startswith("operator")}
    found["properties"] = sorted(_properties(names))
    found["operators"] = sorted(_operators(operators))
    found["solve"] = [f"{f.metadata['label']}: {choice_name(f.default) if f.metadata['choices'] else f.default}"
                      for f in fields(SolveSettings) if not f.metadata["advanced"] and SPECIAL not in f.metadata["doc"]]
    choices = (BLENDER / "viewer" / "view_properties.py").read_text()
    found["choices"] = [f"{name}: {label}" for name, label in re.findall(r'\("(\w+)", "([^"]+)",', choices)]
    checks = ROOT / "irpso_addon" / "core" / "checks" / "check_figures.py"
    found["checks"] = re.findall(r'(?:CheckFigure|_share)\(\s*"([^"]+)"', checks.read_text())
    return found


def changed(before: dict[str, list[str]]) -> list[str]:
    """A line for each thing that the pictures show and the code no longer has, or the other way round."""
    now = shown()
    lines = []
    for place in sorted(before.keys() | now.keys()):
        then, here = set(before.get(place, [])), set(now.get(place, []))
        lines += [f"{place}: the pictures show '{line}'" for line in sorted(then - here)]
        lines += [f"{place}: the pictures lack '{line}'" for line in sorted(here - then)]
    return lines


def _drawn(path: Path, without: set[str]) -> Iterator[str]:
    """Lines such as "label Text ICON" and "prop name": constants alone, f-strings without what is filled in."""
    for node in _parts(ast.parse(path.read_text()), without):
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant):
            if any(isinstance(target, ast.Name) and target.id == "bl_label" for target in node.targets):
                yield f"panel {node.value.value}"
        elif isinstance(node, ast.Call) and (kind := _kind(node.func)):
            words = [_text(arg) for arg in node.args]
            words += [_text(word.value) for word in node.keywords if word.arg in ("text", "icon")]
            words = [word for word in words if word]
            if words and words[0] not in UNSEEN:
                yield " ".join([kind, *words])


def _kind(called: ast.expr) -> str:
    """What a call draws; "" where it draws nothing."""
    if isinstance(called, ast.Attribute):
        return called.attr if called.attr in DRAWN else ""
    return OWN.get(called.id, "") if isinstance(called, ast.Name) else ""


def _parts(node: ast.AST, without: set[str]) -> Iterator[ast.AST]:
    for child in ast.iter_child_nodes(node):
        if getattr(child, "name", None) not in without:
            yield child
            yield from _parts(child, without)


def _text(node: ast.expr) -> str:
    """A constant string; of an f-string or a choice between two, those in it."""
    if isinstance(node, ast.Constant):
        return node.value.strip() if isinstance(node.value, str) else ""
    parts = node.values if isinstance(node, ast.JoinedStr) else (
        [node.body, node.orelse] if isinstance(node, ast.IfExp) else [])
    return " ".join(text for part in parts if (text := _text(part)))


def _sections() -> dict[str, str]:
    """docs/reference.md by its headings."""
    page = (ROOT / "docs" / "reference.md").read_text()
    parts = re.split(r"^(#{2,3} .*)$", page, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def _properties(names: set[str]) -> Iterator[str]:
    for heading, text in _sections().items():
        for line in text.splitlines() if heading.startswith(TABLES) else ():
            if (row := ROW.match(line)) and row["name"] in names:
                choices = " ".join(re.findall(r"`(\w+)`", row["choices"]))
                yield f"{row['name']}: {row['label']}, {row['default'] or 'empty'}, {choices}".rstrip(", ")


def _operators(names: set[str]) -> Iterator[str]:
    for heading, text in _sections().items():
        if (told := re.match(r"\s*`(irpso\.\w+)`", text)) and told[1] in names:
            yield f"{told[1]}: {heading.lstrip('# ')}"
