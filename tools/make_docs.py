"""Write the pages that are made from the code: docs/parameters.md, docs/reference.md, and a table of docs/export.md.

    python tools/make_docs.py            writes them
    python tools/make_docs.py --check    exit 1 when one is not what the code says

docs/parameters.md is the table in irpso_addon/core/params.py, with the commands whose parsers have the flag.
docs/reference.md is what Blender itself knows of the panels, operators, properties and preferences once the checkout is
registered as an extension.  The table of docs/export.md is irpso_addon/core/maps/targets.py.
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import Field, fields
from pathlib import Path
from typing import Any

import bpy

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from irpso_addon.cli import options  # noqa: E402  # the checkout is no installed package
from irpso_addon.core.maps import targets  # noqa: E402
from irpso_addon.core.params import (  # noqa: E402
    DeviceSettings,
    ExportSettings,
    ShootSettings,
    SolveSettings,
    choice_name,
)

EXTENSION = "irpso_docs"  # the checkout's name as an extension
HIDDEN = {"HIDDEN"}
TARGETS_START, TARGETS_END = "<!-- made by `make docs` from irpso_addon/core/maps/targets.py -->\n", "\n<!-- end -->"
TARGETS_HEAD = ("target", "file", "channels", "bits", "colour space", "when")
EDITORS = {"VIEW_3D": "3D Viewport", "IMAGE_EDITOR": "Image Editor"}
TABS = {"data": "Properties, Object Data"}  # of panels in the Properties editor, by their context

PARAMETERS = """\
# Parameters

Made by `make docs` from `irpso_addon/core/params.py` and `irpso_addon/cli/options.py`; do not edit. Each row is one
property of the panel (`scene.irpso`), one key of `report.json` by the same name, and one flag of the commands that the
row names.

"""
DEVICE = """
## The graphics device

Each row is one preference of the add-on, and one flag of the commands that the row names.

"""
EXPORT = """
## Export

The row is one property of the panel (`scene.irpso`), and one flag of the command that it names. [Export](export.md)
lists each target's files.

"""
SHOOT = """
## Import of a shoot

Each row is one property of the panel *Shoot* (`scene.irpso.shoot`), and one flag of the command that it names.
[From photographs to maps](shoots.md) describes their use.

"""
PARAMETER_HEAD = "| name | flag | of `irpso` | default | range or choices | what it does |\n|---|---|---|---|---|---|\n"

REFERENCE = """\
# Panels, operators, preferences

Made by `make docs` from what Blender knows of the add-on; do not edit. The words are those of the tooltips. How the
panels are used: [the guide](guide.md).

"""


# ---- docs/parameters.md


def parameters() -> str:
    """The whole page."""
    commands = settings_of_commands()
    tables = ((PARAMETERS, SolveSettings), (DEVICE, DeviceSettings), (EXPORT, ExportSettings), (SHOOT, ShootSettings))
    return "".join(words + PARAMETER_HEAD + "".join(parameter_row(field, commands) for field in fields(table))
                   for words, table in tables)


def settings_of_commands() -> dict[str, dict[str, Any]]:
    """For each command the settings that its parser has flags for, with their defaults."""
    (commands,) = (action for action in options.parser()._actions if isinstance(action, argparse._SubParsersAction))
    # A required flag is no setting: the number of a UDIM square that `tile` and `merge` ask for.
    return {name: {action.dest: action.default for action in command._actions if not action.required}
            for name, command in commands.choices.items()}


def parameter_row(field: Field[Any], commands: dict[str, dict[str, Any]]) -> str:
    """One line of the table."""
    meta = field.metadata
    unit = f" {meta['unit']}" if meta["unit"] else ""
    limits, what = "", meta["doc"]
    if meta["choices"]:
        limits = ", ".join(f"`{key}`" for key, _ in meta["choices"])
        what += ". " + ". ".join(f"`{key}` (*{choice_name(key)}*): {doc}" for key, doc in meta["choices"])
    elif meta["low"] is not None:
        limits = f"{meta['low']} to {meta['high']}{unit}"
    defaults = {name: known[field.name] for name, known in commands.items() if field.name in known}
    mark = "`" if meta["choices"] else ""
    default = f"{mark}{field.default}{mark}{unit}" + "".join(
        f"; `{name}`: {mark}{value}{mark}{unit}" for name, value in defaults.items() if value != field.default)
    having = ", ".join(f"`{name}`" for name in defaults)
    return f"| {meta['label']} | `--{field.name.replace('_', '-')}` | {having} | {default} | {limits} | {what} |\n"


# ---- docs/reference.md


def reference() -> str:
    """The whole page: the checkout is registered for as long as it takes."""
    package = extension()
    package.register()
    try:
        return REFERENCE + "\n".join([panels(), operators(), scene(), preferences()])
    finally:
        package.unregister()


def extension() -> Any:
    """The checkout as Blender loads an extension."""
    spec = importlib.util.spec_from_file_location(
        EXTENSION, ROOT / "__init__.py", submodule_search_locations=[str(ROOT)])
    assert spec is not None and spec.loader is not None
    package = importlib.util.module_from_spec(spec)
    sys.modules[EXTENSION] = package
    spec.loader.exec_module(package)
    return package


def ours(kind: type) -> list[Any]:
    """The add-on's registered classes of a kind, by name."""
    found, left = [], [kind]
    while left:
        cls = left.pop()
        left += cls.__subclasses__()
        if cls.__module__.split(".")[0] == EXTENSION and getattr(cls, "is_registered", False):
            found.append(cls)
    return sorted(set(found), key=lambda cls: cls.__name__)


def panels() -> str:
    """Where each panel is, and what it is for; sub-panels below their own."""
    order = sys.modules[f"{EXTENSION}.irpso_addon.blender.ui.panels"].CLASSES
    found = [cls for cls in order if issubclass(cls, bpy.types.Panel)]
    names = {cls.__name__: cls.bl_label for cls in found}
    rows = []
    for cls in found:
        parent = names.get(getattr(cls, "bl_parent_id", ""), "")
        tab = getattr(cls, "bl_category", "")
        elsewhere = TABS.get(getattr(cls, "bl_context", ""), "menu")
        where = f"{EDITORS[cls.bl_space_type]}, sidebar, tab {tab}" if tab else elsewhere
        label = cls.bl_label or "the active view"
        name = f"{parent} > {label}" if parent else label
        rows.append((name or cls.__name__, where, sentence(cls.__doc__)))
    return table("Panels", ("panel", "where", "what for"), rows)


def operators() -> str:
    """Each operator with what may be chosen in its redo panel, file browser or by a script."""
    text = ("## Operators\n\nF3 finds an operator by the name below, unless it is useful only as the button of a "
            "panel. In Python an operator is `bpy.ops.` and the name in code, such as `bpy.ops.irpso.solve`.\n")
    for cls in sorted(ours(bpy.types.Operator), key=lambda cls: cls.bl_idname):
        rna = getattr(bpy.ops.irpso, cls.bl_idname.removeprefix("irpso.")).get_rna_type()
        text += f"\n### {rna.name}\n\n`{cls.bl_idname}`. {sentence(rna.description)}\n"
        rows = list(property_rows(rna, HIDDEN))
        text += "\n" + rows_of(PROPERTY_HEAD, rows) if rows else ""
    return text


def scene() -> str:
    """What the .blend stores."""
    known = {field.name for table in (SolveSettings, ExportSettings, ShootSettings) for field in fields(table)}
    text = ("## Properties\n\nStored in the .blend. Those of [a solve, an export and an import](parameters.md) have a "
            "page of their own.\n")
    for cls in ours(bpy.types.PropertyGroup):
        rows = [row for row in property_rows(cls.bl_rna, set()) if row[1].strip("`") not in known]
        if rows:
            title = sentence(cls.__doc__).split(". ")[0].rstrip(".").replace("``", "`")
            text += f"\n### {title}\n\nType `{cls.__name__}`.\n\n" + rows_of(PROPERTY_HEAD, rows)
    return text


def preferences() -> str:
    """The add-on's preferences."""
    rows = [row for cls in ours(bpy.types.AddonPreferences) for row in property_rows(cls.bl_rna, set())]
    return table("Preferences", PROPERTY_HEAD, rows)


PROPERTY_HEAD = ("name", "in Python", "default", "range or choices", "what it is")


def property_rows(rna: bpy.types.Struct, hidden: set[str]) -> Iterator[tuple[str, ...]]:
    """One row for each property of our own; those of Blender's base classes have no module to tell them by."""
    base = {prop.identifier for prop in rna.base.properties} if rna.base else set()
    for prop in rna.properties:
        if prop.identifier in base | {"rna_type", "name"} or (hidden and prop.is_hidden):
            continue
        yield prop.name, f"`{prop.identifier}`", default(prop), limits(prop), sentence(prop.description)


def default(prop: bpy.types.Property) -> str:
    """As the panel shows it, without the noise of 32-bit floats."""
    if prop.type in ("POINTER", "COLLECTION"):
        return ""
    if prop.type == "ENUM":
        chosen = sorted(prop.default_flag) if prop.is_enum_flag else [prop.default]
        return ", ".join(f"`{key}`" for key in chosen if key)
    if prop.type in ("FLOAT", "INT") and prop.is_array:
        return ", ".join(f"{value:.6g}" for value in prop.default_array)
    if prop.type == "FLOAT":
        return number(prop, prop.default)
    if prop.type == "BOOLEAN":
        return "on" if prop.default else "off"
    return f"`{prop.default}`" if prop.type == "STRING" and prop.default else str(prop.default)


def limits(prop: bpy.types.Property) -> str:
    """Choices with their meaning, a range, or what an item is."""
    if prop.type == "ENUM":
        return "; ".join(f"`{item.identifier}`: {item.description or item.name}" for item in prop.enum_items_static)
    if prop.type in ("POINTER", "COLLECTION"):
        kind = prop.fixed_type.identifier
        return f"list of `{kind}`" if prop.type == "COLLECTION" else f"`{kind}`"
    if prop.type in ("FLOAT", "INT"):
        low, high = (number(prop, end) for end in (prop.soft_min, prop.soft_max))  # as sliders go; more can be typed
        return f"{low} to {high}" if prop.soft_max < 1e9 else f"{low} or more" if prop.soft_min > -1e9 else ""
    return "on or off" if prop.type == "BOOLEAN" else "path" if prop.subtype in ("FILE_PATH", "DIR_PATH") else "text"


def number(prop: bpy.types.Property, value: float) -> str:
    """As the panel shows it: angles in degrees."""
    return f"{math.degrees(value):.4g}°" if prop.subtype == "ANGLE" else f"{value:.6g}"


# ---- docs/export.md


def export() -> str:
    """The page as it is, its table of the export's files made anew."""
    page = (ROOT / "docs" / "export.md").read_text(encoding="utf-8")
    before, rest = page.split(TARGETS_START)
    _, after = rest.split(TARGETS_END)
    return f"{before}{TARGETS_START}\n{rows_of(TARGETS_HEAD, targets.table())}{TARGETS_END}{after}"


# ---- tables


def sentence(words: str | None) -> str:
    """On one line, with a full stop, safe in a table."""
    text = " ".join((words or "").split()).replace("|", "\\|")
    return text if not text or text.endswith(".") else f"{text}."


def table(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A section with a table."""
    return f"## {title}\n\n" + rows_of(head, rows)


def rows_of(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


PAGES: dict[str, Callable[[], str]] = {
    "parameters.md": parameters, "reference.md": reference, "export.md": export}


def main() -> int:
    """Write, or look whether writing would change anything."""
    stale = []
    for name, make in PAGES.items():
        path, text = ROOT / "docs" / name, make()
        if path.exists() and path.read_text(encoding="utf-8") == text:
            continue
        stale.append(f"docs/{name}")
        if "--check" not in sys.argv[1:]:
            path.write_text(text, encoding="utf-8")
    if stale and "--check" in sys.argv[1:]:
        print(f"{', '.join(stale)}: stale; run 'make docs'", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
