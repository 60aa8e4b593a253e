"""What import-linter (pyproject.toml) cannot say of the imports.

In Blender the package is bl_ext.<repository>.irpso.irpso_addon, so only relative imports resolve there.
"""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LIBRARY = sorted((ROOT / "irpso_addon").rglob("*.py"))
OPERATORS = sorted((ROOT / "operators").rglob("*.py"))
IMPORTS_TEST = re.compile(r"^\s*(?:from|import)\s.*\btest_\w+.*", re.MULTILINE)
IMPORTS_STUDY = re.compile(r"^\s*(?:from|import)\s+studies\b.*", re.MULTILINE)
PLAIN = ("core", "gpu", "process", "solve", "compare")


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def dotted(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


def imports(path: Path) -> Iterator[tuple[int, int, str]]:
    """Line, leading dots and full name of each thing a file imports, also inside functions.

    Relative names are resolved against the repository's root, which stands for the extension.
    """
    package = path.relative_to(ROOT).parent.parts
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, 0, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: max(len(package) - node.level + 1, 0)] if node.level else ()
            stem = [*base, *([node.module] if node.module else [])]
            yield from ((node.lineno, node.level, ".".join([*stem, alias.name])) for alias in node.names)


@pytest.mark.parametrize("path", [*LIBRARY, *OPERATORS], ids=name_of)
def test_own_modules_are_imported_relatively(path: Path) -> None:
    for line, dots, name in imports(path):
        assert dots or name.split(".")[0] not in ("irpso_addon", "operators"), f"line {line}: {name}"


@pytest.mark.parametrize("path", [*LIBRARY, *OPERATORS], ids=name_of)
def test_relative_imports_stay_inside(path: Path) -> None:
    """The library inside irpso_addon, the operators inside the extension."""
    parts = path.relative_to(ROOT).parts
    most = len(parts) - (parts[0] == "irpso_addon")
    for line, dots, name in imports(path):
        assert dots <= most, f"line {line} reaches above: {name}"


@pytest.mark.parametrize("path", OPERATORS, ids=name_of)
def test_operators_import_rooms_and_helpers_alone(path: Path) -> None:
    """operators/__init__.py alone lists the operators; none runs the command line."""
    if path == ROOT / "operators" / "__init__.py":
        return
    for line, dots, name in imports(path):
        if dots:
            assert name.startswith(("irpso_addon.", "operators.helpers.")), f"line {line}: {name}"
            assert name.split(".")[1] not in ("cli", "__main__"), f"line {line}: {name}"


def test_nobody_imports_a_test_and_only_their_tests_import_studies() -> None:
    """What is shared lies in tests/support; code in strings, which tests run as programs, counts too."""
    files = [path for top in ("tests", "studies", "tools") for path in (ROOT / top).rglob("*.py")]
    assert len(files) > 150
    own = ROOT / "tests"
    plain = [path for path in files if own in path.parents and own / "studies" not in path.parents]
    tests = {name_of(path): found for path in files if (found := IMPORTS_TEST.findall(path.read_text("utf-8")))}
    studies = {name_of(path): found for path in plain if (found := IMPORTS_STUDY.findall(path.read_text("utf-8")))}
    assert (tests, studies) == ({}, {})


def test_plain_rooms_load_without_blender() -> None:
    """A farm node, a GPU server: there is no bpy at all."""
    names = [dotted(path) for path in LIBRARY
             if path.relative_to(ROOT).parts[1] in PLAIN and path.name != "__init__.py"]
    assert len(names) > 50
    code = ("import sys, importlib\nfor n in ('bpy', 'bpy_extras', 'mathutils', 'bmesh'): sys.modules[n] = None\n"
            f"for n in {names!r}: importlib.import_module(n)")
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
