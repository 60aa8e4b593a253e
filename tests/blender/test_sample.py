"""The sample scene: ready to be solved, made by a second Blender, whole or not at all."""

from __future__ import annotations

import os
import time
from pathlib import Path

import bpy
import numpy as np
import pytest

from irpso_addon.blender.sample import demo, sample, sample_child
from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.core.errors import BadInput
from irpso_addon.core.job import Progress
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.samples import vase
from irpso_addon.gpu.device import thread
from irpso_addon.solve import pipeline


def test_the_scene_is_ready_and_solves(extension, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(sample_child, "PLAN", demo.Plan(texels=128, lights=8, pixels=128, samples=2))
    steps = list(sample_child.build(tmp_path / "scene"))
    assert steps and all(isinstance(step, Progress) for step in steps)
    moved = tmp_path / "elsewhere"
    (tmp_path / "scene").rename(moved)  # its pictures go with it
    bpy.ops.wm.open_mainfile(filepath=str(moved / sample_child.SCENE), load_ui=False)
    scene, obj = bpy.context.scene, bpy.context.active_object
    assert obj.name == "Vase" and bpy.context.selected_objects == [obj]
    assert [i.name for i in bpy.data.images if "truth" in i.name] == [] and "truth" not in bpy.data.materials
    assert len(scene.irpso.views) == len(steps) == len(list((moved / "refs").iterdir()))
    data = read_scene(None, None, None)
    chosen = {name: getattr(scene.irpso, name) for name in ("size", "indirect", "registration")}
    settings = SolveSettings(model="one-lobe", **chosen)
    maps = thread.run(lambda: pipeline.solve(data, settings)).maps
    base, rough = vase.truth(settings.size)
    sure = maps.confidence > 0.5
    assert sure.mean() > 0.1
    assert np.median(np.abs(maps.roughness - rough)[sure]) < 0.03
    assert np.median(np.abs(maps.base_color - base)[sure]) < 0.03


def wait(making: sample.Making, until) -> None:
    end = time.monotonic() + 60
    while not until():
        assert time.monotonic() < end and making.child.status is None, making.child.last_line()
        time.sleep(0.05)


def test_stopped_it_leaves_nothing(tmp_path) -> None:
    making = sample.Making(tmp_path / "target")
    folder, process = Path(making.folder.name), making.child._process
    wait(making, lambda: making.poll().stage == "render")
    assert 0 <= making.poll().fraction < 1 and not making.done()
    making.end()
    assert process.returncode is not None and not folder.exists() and os.listdir(tmp_path) == []


def test_what_fails_says_why_in_a_line(tmp_path) -> None:
    """The user's folder is a file."""
    (tmp_path / "file").write_text("")
    making = sample.Making(tmp_path / "file" / "target")
    while making.child.status is None:
        time.sleep(0.05)
    with pytest.raises(BadInput, match=r"^sample scene: cannot be made \(.*Not a directory.*\)$"):
        making.done()
    making.end()
    assert os.listdir(tmp_path) == ["file"]
