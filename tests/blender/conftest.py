"""What the Blender tests share: an empty file for each test, and the checkout loaded as the extension."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

bpy = pytest.importorskip("bpy")


@pytest.fixture
def irpso_here(capfd):
    """As ``irpso`` (tests/conftest.py), but in this process, as Blender runs it; a start of a program takes seconds.

    The device that the command line asks for is that command's alone.
    """
    from irpso_addon.__main__ import main
    from irpso_addon.gpu.device import thread

    def run(*arguments):
        capfd.readouterr()
        device = thread.settings()
        try:
            code = main(list(map(str, arguments)))
        finally:
            thread.configure(device)
        return subprocess.CompletedProcess(arguments, code, *capfd.readouterr())

    return run


@pytest.fixture
def empty(monkeypatch):
    """The current scene of an empty file, with nothing remembered of its objects."""
    monkeypatch.setattr("irpso_addon.blender.jobs.session.session.stored", None)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


@pytest.fixture(scope="module")
def extension():
    """The checkout as Blender loads an extension: one package, whose name is not ours to choose.

    Its modules are ``irpso_ext.irpso_addon...``: never mix them with ``irpso_addon...`` in one test.
    """
    spec = importlib.util.spec_from_file_location(
        "irpso_ext", ROOT / "__init__.py", submodule_search_locations=[str(ROOT)])
    package = importlib.util.module_from_spec(spec)
    sys.modules["irpso_ext"] = package
    spec.loader.exec_module(package)
    package.register()
    yield package
    package.unregister()


@pytest.fixture
def stage(empty, tmp_path):
    """A saved file: a plane 'Subject' of 2 m with UVs under camera 'Cam' (4 m above) and point light 'Key'."""
    import types

    bpy.ops.mesh.primitive_plane_add(size=2)
    subject = bpy.context.object
    subject.name = "Subject"
    subject.data.materials.append(bpy.data.materials.new("Paint"))
    if bpy.app.version < (5, 0, 0):
        subject.data.materials[0].use_nodes = True
    camera = bpy.data.objects.new("Cam", bpy.data.cameras.new("Cam"))
    key = bpy.data.objects.new("Key", bpy.data.lights.new("Key", "POINT"))
    camera.location, key.location = (0, 0, 4), (0, 0, 3)
    for obj in (camera, key):
        empty.collection.objects.link(obj)
    empty.camera = camera
    empty.render.engine, empty.render.resolution_x, empty.render.resolution_y = "CYCLES", 36, 24
    file = tmp_path / "stage.blend"
    captures = tmp_path / "captures.json"
    captures.write_text('{"views": [{"image": "a.exr", "camera": "Cam", "lights": ["Key"]}]}', encoding="utf-8")
    bpy.ops.wm.save_as_mainfile(filepath=str(file))

    def read(name="Subject", captures=captures):
        from irpso_addon.blender.scene.scene import read_scene
        return read_scene(None, name, captures)

    return types.SimpleNamespace(
        scene=empty, subject=subject, camera=camera, key=key, folder=tmp_path, captures=captures, read=read)


@pytest.fixture
def ball_scene(extension, scenes: Path, tmp_path: Path) -> bpy.types.Scene:
    """A private copy of the good scene, open, its ball active, its views in the list."""
    shutil.copytree(scenes / "good", tmp_path / "good")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "good" / "scene.blend"), load_ui=False)
    bpy.context.view_layer.objects.active = bpy.data.objects["Ball"]
    bpy.context.scene.irpso.captures = "//captures.json"
    bpy.ops.irpso.load_captures()
    return bpy.context.scene


@pytest.fixture
def module(extension):
    """``module("core.data")``: a module of the registered extension, not of the library beside it."""
    def find(name: str):
        return sys.modules[f"irpso_ext.irpso_addon.{name}"]
    return find
