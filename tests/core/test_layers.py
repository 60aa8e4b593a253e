"""The arrows between the rooms: core <- gpu <- pipeline <- {cli, blender} <- operators.

Read from the import statements themselves, also those inside functions.
"""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LIBRARY = ROOT / "irpso_addon"

# What each room may import from irpso_addon, itself included.
ALLOWED = {
    "core": {"core"},
    "gpu": {"core", "gpu"},
    "pipeline": {"core", "gpu"},
    "examine": {"core", "gpu", "pipeline"},
    "preview": {"core", "gpu", "pipeline", "worker"},
    "large": {"core", "gpu", "pipeline"},
    "farm": {"core", "pipeline", "large"},
    "channel": set(),
    "worker": {"core", "gpu", "channel"},  # it finds its jobs by their names
    "remote": {"core", "channel"},
    "blender": {"core", "channel", "gpu", "pipeline", "examine", "remote", "blender"},
    "cli": {"core", "gpu", "pipeline", "examine", "remote", "large", "farm", "blender", "cli"},
    "__main__": {"core", "gpu", "pipeline", "blender", "cli"},
}
# One arrow back: Blender's start hands the command line's main() to Blender, which calls it much later.
EXCEPTIONS = {("blender/registration.py", "irpso_addon.__main__.main")}
FREE_OF_BLENDER = {"core", "gpu", "pipeline", "large", "farm", "examine", "preview", "channel", "worker", "remote",
                   "cli", "__main__"}


def files(room: str) -> list[Path]:
    path = LIBRARY / room
    return sorted(path.rglob("*.py")) if path.is_dir() else [path.with_suffix(".py")]


def rooms() -> list[str]:
    return [room for room in ALLOWED if (LIBRARY / room).is_dir() or (LIBRARY / f"{room}.py").is_file()]


def imports(path: Path) -> list[str]:
    """Absolute names of everything a file imports; relative ones resolved against its package."""
    package = list(path.relative_to(ROOT).parent.parts)
    found = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            stem = [*base, *(node.module.split(".") if node.module else [])]
            assert base or not node.level, f"{path}:{node.lineno} reaches above the extension"
            found += [".".join([*stem, alias.name]) for alias in node.names]
    return found


@pytest.mark.parametrize("room", rooms())
def test_room_imports_only_towards_core(room: str) -> None:
    for path in files(room):
        for name in imports(path):
            known = (path.relative_to(LIBRARY).as_posix(), name) in EXCEPTIONS
            if name.startswith("irpso_addon.") and not known:
                assert name.split(".")[1] in ALLOWED[room], f"{path.relative_to(ROOT)} imports {name}"


@pytest.mark.parametrize("room", sorted(FREE_OF_BLENDER & set(rooms())))
def test_no_blender(room: str) -> None:
    for path in files(room):
        used = {name.split(".")[0] for name in imports(path)}
        assert not used & {"bpy", "bpy_extras", "mathutils", "gpu", "bmesh"}, path.relative_to(ROOT)


@pytest.mark.parametrize("path", sorted(LIBRARY.rglob("*.py")), ids=lambda p: str(p.relative_to(LIBRARY)))
def test_library_never_names_itself(path: Path) -> None:
    """In Blender the package is bl_ext.<repository>.irpso.irpso_addon, so only relative imports resolve."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and not node.level:
            assert (node.module or "").split(".")[0] != "irpso_addon", f"line {node.lineno}"
        if isinstance(node, ast.ImportFrom) and node.level:
            assert node.level <= len(path.relative_to(ROOT).parent.parts), f"line {node.lineno} reaches above"
        if isinstance(node, ast.Import):
            assert all(alias.name.split(".")[0] != "irpso_addon" for alias in node.names), f"line {node.lineno}"


def test_plain_rooms_load_without_blender() -> None:
    """core, gpu and pipeline import where there is no bpy at all: a farm node, a GPU server."""
    names = [
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for room in ("core", "gpu", "pipeline")
        if room in rooms()
        for path in files(room)
        if path.name != "__init__.py"
    ]
    code = f"import sys, importlib; sys.modules['bpy'] = None\nfor n in {names!r}: importlib.import_module(n)"
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
