"""What the second Blender does (see sample.py): make the sample scene, put it where it is kept."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import bpy

from ...core.job import Progress
from ...core.samples import vase
from ...core.storage.atomic_io import FolderLock
from .. import properties
from ..second_blender import as_child, tell
from . import demo

SCENE = "IRPSO Sample.blend"
PLAN = demo.Plan(lights=12, pixels=224, samples=2)


def main(name: str) -> None:
    """Makes the scene in the folder ``name``, then moves it whole to where the file ``target`` there says."""
    as_child(lambda: _make(Path(name)))


def _make(folder: Path) -> None:
    properties.register()
    target, made = Path((folder / "target").read_text(encoding="utf-8")), folder / "scene"
    tempfile.TemporaryFile(dir=target.parent).close()  # whether it can be written, before the work
    for step in build(made):
        tell(folder, step)
    beside = target.with_name(f"{target.name}-new")  # the user's folder may lie on another disk
    with FolderLock(target.parent):
        shutil.rmtree(beside, ignore_errors=True)  # of one that was killed here
        shutil.move(made, beside)
        shutil.rmtree(target, ignore_errors=True)  # without a scene in it
        os.replace(beside, target)


def build(out: Path) -> Iterator[Progress]:
    """The vase, its pictures and the list of views, saved as ``out``/IRPSO Sample.blend."""
    base, rough = vase.truth(PLAN.texels)
    references = yield from demo.painted(out, PLAN, base, rough)
    demo.unpaint()
    scene = bpy.context.scene
    for reference in references:
        view = scene.irpso.views.add()
        view.image, view.camera = f"//{reference.image}", reference.camera
        view.lights.add().light = reference.light
    scene.irpso.size, scene.irpso.model = PLAN.texels, "one-lobe"
    scene.irpso.indirect, scene.irpso.registration = "off", "given"  # as they were rendered
    for kind, name in (("CAMERA", "Cameras"), ("LIGHT", "Lights")):
        _collect([obj for obj in scene.objects if obj.type == kind], name)
    for obj in scene.objects:
        obj.select_set(obj.name == demo.NAME)
    bpy.context.view_layer.objects.active = bpy.data.objects[demo.NAME]
    demo.save(out / SCENE)


def _collect(objects: list[bpy.types.Object], name: str) -> None:
    """Moves them into a collection of their own."""
    collection = bpy.data.collections.new(name)
    bpy.context.scene.collection.children.link(collection)
    for obj in objects:
        bpy.context.scene.collection.objects.unlink(obj)
        collection.objects.link(obj)
