"""Write docs/parameters.md from the table in irpso_addon/core/params.py.

    python tools/make_docs.py            writes it
    python tools/make_docs.py --check    exit 1 when the file is not what the table says
"""

from __future__ import annotations

import sys
from dataclasses import fields
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from irpso_addon.core.params import DeviceSettings, SolveSettings  # noqa: E402  # the checkout is no installed package

PAGE = ROOT / "docs" / "parameters.md"
HEAD = """\
# Parameters

Made by `make docs` from `irpso_addon/core/params.py`; do not edit.  Each row is one flag of `irpso solve`, one
property of the panel (`scene.irpso`), and one key of `report.json`, by the same name.

| name | flag | default | range or choices | what it does |
|---|---|---|---|---|
"""


DEVICE = """
## The graphics device

Preferences of the add-on, and flags of `irpso solve`, `irpso compare` and `irpso doctor`.

| name | flag | default | range or choices | what it does |
|---|---|---|---|---|
"""


def page() -> str:
    """The whole page."""
    rows = ("".join(_row(field) for field in fields(table)) for table in (SolveSettings, DeviceSettings))
    return HEAD + DEVICE.join(rows)


def _row(field) -> str:  # type: ignore[no-untyped-def]
    meta = field.metadata
    unit = f" {meta['unit']}" if meta["unit"] else ""
    limits, what = "", meta["doc"]
    if meta["choices"]:
        limits = ", ".join(f"`{key}`" for key, _ in meta["choices"])
        what += ": " + "; ".join(f"`{key}`: {doc[0].lower()}{doc[1:]}" for key, doc in meta["choices"])
    elif meta["low"] is not None:
        limits = f"{meta['low']} to {meta['high']}{unit}"
    return f"| {meta['label']} | `--{field.name.replace('_', '-')}` | {field.default}{unit} | {limits} | {what} |\n"


if __name__ == "__main__":
    if "--check" in sys.argv[1:]:
        sys.exit(0 if PAGE.exists() and PAGE.read_text(encoding="utf-8") == page() else "docs/parameters.md is stale: "
                 "run 'make docs'")
    PAGE.write_text(page(), encoding="utf-8")
