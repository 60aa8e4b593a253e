"""Indirect light under a world, which lights all that the cameras see.

A ball above a floor.  References and the independent renders are Cycles' own, of other passes and other settings.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from irpso_addon.blender.jobs import indirect
from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.core.data import SceneData, Solution
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device import thread
from irpso_addon.solve import pipeline
from tests.blender.ball_on_floor import BASE, PLAIN, ROUGH, add, build, paint, solution_of
from tests.support import skies
from tests.support.texels import finish


@pytest.fixture(scope="module", autouse=True)
def few_directions() -> Iterator[None]:
    """Light that bounces is judged here."""
    with pytest.MonkeyPatch.context() as patch:
        skies.sum_few_directions(patch)
        yield


def under_sky(folder: Path, floor: bool, turns: bool = False, count: int = 6) -> SceneData:
    """The ball, with or without its floor, under a sky with a window, from six sides, or the first of them.

    ``turns``: each view has the world under another turn, of which its picture is rendered.
    """
    build(BASE, ROUGH, 0.5)
    scene, sky = bpy.context.scene, bpy.data.worlds.new("Sky")
    for thing in [*scene.collection.all_objects]:
        if thing.type in {"LIGHT", "CAMERA"} or (thing.name == "Floor" and not floor):
            bpy.data.objects.remove(thing)
    pixels = np.ones((64, 128, 4), np.float32)
    pixels[..., :3] = skies.sky(64, window=12.0).radiance
    picture = bpy.data.images.new("Sky", 128, 64, float_buffer=True, is_data=True)
    picture.pixels.foreach_set(pixels.ravel())
    picture.pack()
    if bpy.app.version < (5, 0, 0):
        sky.use_nodes = True
    node = sky.node_tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = picture
    background = next(node for node in sky.node_tree.nodes if node.type == "BACKGROUND")
    sky.node_tree.links.new(node.outputs["Color"], background.inputs["Color"])
    place, mapping = (sky.node_tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexCoord", "Mapping"))
    sky.node_tree.links.new(place.outputs["Generated"], mapping.inputs["Vector"])
    sky.node_tree.links.new(mapping.outputs["Vector"], node.inputs["Vector"])
    scene.world, scene.cycles.samples = sky, 64 if floor else 16
    # The map for sampling that Cycles makes by itself is larger: a second for each turn, and slower to draw from.
    sky.cycles.sampling_method, sky.cycles.sample_map_resolution = "MANUAL", 512
    scene.render.resolution_x = scene.render.resolution_y = 64
    views = []
    for n in range(count):
        turn = n * math.pi / 3
        camera = add(f"Eye {n}", bpy.data.cameras.new("Eye"), (4 * math.sin(turn), -4 * math.cos(turn), 0.6))
        camera.data.lens = 75
        scene.camera, scene.render.filepath = camera, str(folder / f"{n}.exr")
        degrees = 100.0 * n if turns else 0.0
        mapping.inputs["Rotation"].default_value[2] = -math.radians(degrees)  # of what is looked up
        bpy.ops.render.render(write_still=True)
        views.append({"image": f"{n}.exr", "camera": camera.name, "lights": [], "world": "Sky", "turn": degrees})
    mapping.inputs["Rotation"].default_value[2] = 0.0
    (folder / "captures.json").write_text(json.dumps({"views": views}))
    paint(bpy.data.objects["Ball"], "Paint", (0.8, 0.8, 0.8), 0.5, 0.5)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
    return read_scene(None, "Ball", folder / "captures.json")


@pytest.mark.one_python
@pytest.mark.parametrize("turns", [False, True])
def test_light_that_a_floor_bounces_under_a_world_is_subtracted(tmp_path: Path, monkeypatch, turns: bool) -> None:
    """The world lights all that the cameras see, so that no shadow shows it; a few small renders do."""
    monkeypatch.setattr(indirect, "SIDE", 48)
    data = under_sky(tmp_path, True, turns)
    bouncer = indirect.IndirectRenderer.of_open_file(tmp_path / "scene.blend")
    errors = {}
    for mode in ("off", "auto"):
        solution = thread.run(lambda mode=mode: pipeline.solve(
            data, SolveSettings(size=32, indirect=mode, **PLAIN), bounce=bouncer))
        assert solution.checks is not None and math.isnan(solution.checks.unlit_share)
        solved = solution.maps.coverage & ~solution.maps.filled
        solved[16:] = False  # the ball's lower half, which sees the floor
        errors[mode] = np.median(np.abs(solution.maps.base_color[solved] / BASE - 1), axis=0).max()
    assert errors["off"] > 0.4, errors  # 0.58; under turns 0.45
    assert errors["auto"] < 0.05, errors  # 0.035; 0.031


@pytest.mark.one_python
def test_under_a_world_little_is_rendered_where_no_light_can_bounce(tmp_path: Path, monkeypatch) -> None:
    """A ball alone: a few small renders."""
    monkeypatch.setattr(indirect, "TEST_SIDE", 48)
    data = under_sky(tmp_path, False)
    bouncer = indirect.IndirectRenderer.of_open_file(tmp_path / "scene.blend")
    asked = []

    class Test:
        """Of the renders, the few alone."""

        direct_only = bouncer.direct_only

        def sample(self, scene: SceneData, solution: Solution) -> Iterator[object]:
            asked.append(scene)
            return (yield from bouncer.sample(scene, solution))

        def __call__(self, scene: SceneData, solution: Solution) -> Iterator[object]:
            raise AssertionError("rendered indirect light where there is none")
            yield

    settings = SolveSettings(size=32, **PLAIN)
    solution = thread.run(lambda: pipeline.solve(data, settings, bounce=Test()))
    assert solution.checks is not None and solution.checks.not_bounced.startswith("no surface in the scene")
    assert len(asked) == 1 and not any("bounced" in line for line in solution.warnings)
    bpy.context.scene.cycles.max_bounces = 0  # as in a file whose pictures have direct light alone
    bouncer = indirect.IndirectRenderer.of_open_file(tmp_path / "scene.blend")
    Test.direct_only = bouncer.direct_only
    thread.run(lambda: pipeline.solve(data, settings, bounce=Test()))
    assert len(asked) == 1


def test_a_world_that_a_view_turns_is_turned_where_it_is_rendered(tmp_path: Path, monkeypatch) -> None:
    """The bounced light is that of a file whose world is turned by its nodes; turned the other way it is not."""
    monkeypatch.setattr(indirect, "SIDE", 48)
    monkeypatch.setattr(indirect, "SAMPLES", 128)
    data = under_sky(tmp_path, True, count=1)
    file = tmp_path / "scene.blend"

    def light(degrees: float) -> np.ndarray:
        """(12, 12) irradiance, means of squares of 4 x 4 pixels."""
        view = replace(data.views[0], environment=replace(data.views[0].environment, turn=math.radians(degrees)))
        bouncer = indirect.IndirectRenderer.of_open_file(file)
        found = finish(bouncer(replace(data, views=(view,)), solution_of(BASE, ROUGH, "one-lobe")))
        return found[0].irradiance.mean(-1).reshape(12, 4, 12, 4).mean((1, 3))

    turned, other_way = light(120), light(-120)
    mapping = next(node for node in bpy.data.worlds["Sky"].node_tree.nodes if node.type == "MAPPING")
    mapping.inputs["Rotation"].default_value[2] = -math.radians(120)
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    by_nodes = light(0)
    off, off_other_way = (np.abs(found - by_nodes).sum() / by_nodes.sum() for found in (turned, other_way))
    assert off < 0.05 < 0.2 < off_other_way
