"""Indirect light: what the second Blender renders, and maps recovered from pictures that hold it.

A ball above a floor.  References and the independent renders are Cycles' own, of other passes and other settings.
"""

from __future__ import annotations

import hashlib
import json
import math
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import bpy
import numpy as np
import pytest

from irpso_addon.blender import files
from irpso_addon.blender.jobs import indirect
from irpso_addon.blender.sample import demo
from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.core.checks.bounced_light import BouncedSample
from irpso_addon.core.data import Bounced, Coat, Maps, RadianceImage, SceneData, Solution, View
from irpso_addon.core.errors import BadInput, Cancelled
from irpso_addon.core.images.reference_image import read_reference
from irpso_addon.core.job import Progress
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device import thread
from irpso_addon.solve import pipeline
from tests.support import skies
from tests.support.texels import finish

BASE, ROUGH, PIXELS = (0.7, 0.35, 0.15), 0.4, 96
RIGHT = {"lamps": "given", "exposures": "given", "registration": "given"}
PLAIN = {**RIGHT, "model": "one-lobe"}


def build(base, rough, level, metallic=0.0, coat=None, diffuse=0.0) -> bpy.types.Scene:
    """Ball, floor, two cameras, three lamps; the ball has the given material."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=24, radius=0.8)
    ball = bpy.context.object
    ball.name = "Ball"
    bpy.ops.object.shade_smooth()
    bpy.ops.mesh.primitive_plane_add(size=6, location=(0, 0, -0.8))
    floor = bpy.context.object
    floor.name = "Floor"
    paint(ball, "Paint", base, rough, level, metallic)
    inputs = ball.data.materials[0].node_tree.nodes["Principled BSDF"].inputs
    inputs["Diffuse Roughness"].default_value = diffuse
    if coat is not None:
        inputs["Coat Weight"].default_value, inputs["Coat Roughness"].default_value = coat.weight, coat.roughness
    paint(floor, "Floor", (0.6, 0.6, 0.5), 1.0, 0.0)
    for i, x in enumerate((-1.2, 1.2)):
        add(f"Camera {i}", bpy.data.cameras.new("Camera"), (x, -4.0, 0.9)).data.lens = 75
    for i, place in enumerate(((-2.8, -0.6, 1.5), (0.5, -2.5, 2.5), (2.8, -0.4, 1.0))):
        lamp = bpy.data.lights.new("Lamp", "POINT")
        lamp.energy, lamp.shadow_soft_size = 200.0, 0.0
        add(f"Lamp {i}", lamp, place)
    demo._set_up_render(scene)
    scene.render.resolution_x = scene.render.resolution_y = PIXELS
    scene.cycles.samples, scene.cycles.max_bounces = 32, 4
    bpy.context.view_layer.objects.active = ball
    return scene


def add(name, data, place) -> bpy.types.Object:
    return demo._add(name, data, demo.Vector(place))


def paint(obj, name, base, rough, level, metallic=0.0) -> None:
    if not obj.data.materials:
        obj.data.materials.append(demo._material(name))
    inputs = obj.data.materials[0].node_tree.nodes["Principled BSDF"].inputs
    inputs["Base Color"].default_value, inputs["Roughness"].default_value = (*base, 1), rough
    inputs["Specular IOR Level"].default_value, inputs["Metallic"].default_value = level, metallic


def references(folder: Path) -> None:
    """A picture of each camera under each lamp; then the file, its ball unpainted."""
    (folder / "refs").mkdir(parents=True)
    views = []
    for camera in ("Camera 0", "Camera 1"):
        for lamp in ("Lamp 0", "Lamp 1", "Lamp 2"):
            image = f"refs/{camera}, {lamp}.exr"
            demo._render(folder / image, bpy.data.objects[camera], bpy.data.objects[lamp])
            views.append({"image": image, "camera": camera, "lights": [lamp]})
    (folder / "captures.json").write_text(json.dumps({"views": views}))
    paint(bpy.data.objects["Ball"], "Paint", (0.8, 0.8, 0.8), 0.5, 0.5)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))


def solution_of(base, rough, model, metallic=0.0, coat=None, mapped=False, diffuse=0.0) -> Solution:
    """Constant maps; ``mapped``: Metallic is one of them, as beside paint."""
    shape, none = (8, 8), np.zeros((8, 8), np.float32)
    maps = Maps(base_color=np.broadcast_to(np.array(base, np.float32), (*shape, 3)), roughness=none + np.float32(rough),
                confidence=none, error=none, filled=none > 0, coverage=none > 0, roughness_sigma=none, base_sigma=none,
                metallic=none + np.float32(metallic) if mapped else None)
    value = 0.1 if mapped else metallic
    return Solution(maps=maps, model={"Paint": model}, why={}, texels={}, seconds={}, residual=0.0, views_used=(),
                    views_skipped=(), warnings=(), device={}, metallic={"Paint": value} if value else {},
                    coats={"Paint": coat} if coat else {}, paint={"Paint": 0.0} if mapped else {},
                    diffuse_roughness={"Paint": diffuse} if diffuse else {})


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.fixture(scope="module")
def bounced(tmp_path_factory) -> Path:
    """The capture with 4 bounces."""
    folder = tmp_path_factory.mktemp("bounced")
    build(BASE, ROUGH, 0.5)
    references(folder)
    return folder


@pytest.fixture
def scene(bounced: Path, monkeypatch) -> SceneData:
    """It, open."""
    monkeypatch.setattr(indirect, "SIDE", 48)
    files.open_blend(bounced / "scene.blend")
    return read_scene(None, "Ball", bounced / "captures.json")


@pytest.mark.parametrize(("base", "model", "level", "metallic", "coat", "mapped", "diffuse"), [
    (0.5, "lambert", 0.0, 0.0, None, False, 0.0), (0.0, "one-lobe", 0.5, 0.0, None, False, 0.0),
    (0.5, "one-lobe-metallic", 0.5, 1.0, None, False, 0.0), (0.5, "one-lobe-metallic", 0.5, 1.0, None, True, 0.0),
    (0.5, "one-lobe-metallic", 0.5, 1.0, Coat(1.0, 0.3), False, 0.0), (0.5, "lambert", 0.0, 0.0, None, False, 1.0)])
def test_passes_are_total_minus_direct(
    tmp_path, monkeypatch, base, model, level, metallic, coat, mapped, diffuse,
) -> None:
    """White paint without highlight: rho / pi times the irradiance; black paint with one, and metal: the glossy light.

    The irradiance has what a rough diffuse makes of it.

    Beside them the same paint by Cycles with 4 bounces minus without any.  Means over the ball: noise is averaged.
    """
    monkeypatch.setattr(indirect, "SIDE", PIXELS)
    monkeypatch.setattr(indirect, "SAMPLES", 64)
    scene = build((base,) * 3, ROUGH, level, metallic, coat, diffuse)
    scene.render.resolution_x = scene.render.resolution_y = 48
    scene.cycles.samples = 64
    light = {}
    for bounces in (0, 4):
        scene.cycles.max_bounces = bounces
        demo._render(tmp_path / f"{bounces}.exr", bpy.data.objects["Camera 0"], bpy.data.objects["Lamp 0"])
        light[bounces] = demo.read_render(tmp_path / f"{bounces}.exr")[..., :3]
    scene.cycles.film_exposure = 2.0  # is of the references, not of light
    captures = tmp_path / "captures.json"
    captures.write_text('{"views": [{"image": "4.exr", "camera": "Camera 0", "lights": ["Lamp 0"]}]}')
    file = tmp_path / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    found = finish(indirect.IndirectRenderer.of_open_file(file)(
        read_scene(None, "Ball", captures), solution_of((base,) * 3, ROUGH, model, metallic, coat, mapped, diffuse)))
    assert list(found) == [0]
    matt = model == "lambert"
    drawn = base / math.pi * found[0].irradiance if matt else found[0].glossy
    ball = np.hypot(*np.mgrid[-1:1:48j, -1:1:48j]) < 0.3  # around the picture's middle
    want = (light[4] - light[0])[ball].mean(0)
    assert (want > 0.002 * light[0][ball].mean()).all()
    np.testing.assert_allclose(drawn[ball].mean(0), want, rtol=0.05 if matt else 0.12)


@pytest.mark.one_python
def test_albedo_is_recovered_where_direct_light_alone_fails(scene: SceneData, bounced: Path) -> None:
    before = digest(bounced / "scene.blend")
    bouncer = indirect.IndirectRenderer.of_open_file(bounced / "scene.blend")
    errors, rough = {}, {}
    for mode in ("off", "auto"):
        settings = SolveSettings(size=64, indirect=mode, **(RIGHT if mode == "off" else {}))
        solution = thread.run(lambda settings=settings: pipeline.solve(scene, settings, bounce=bouncer))
        solved = solution.maps.coverage & ~solution.maps.filled
        solved[32:] = False  # the ball's lower half, which sees the floor
        errors[mode] = np.median(np.abs(solution.maps.base_color[solved] / BASE - 1), axis=0).max()
        sure = solution.maps.confidence > 0.25  # one half at most, where a material has one roughness
        rough[mode] = np.median(np.abs(solution.maps.roughness[sure] - ROUGH))
        assert any("bounced" in warning for warning in solution.warnings) == (mode == "off")
    assert errors["off"] > 0.3, errors
    assert errors["auto"] < 0.05, errors
    assert rough["auto"] < 0.02, rough
    assert digest(bounced / "scene.blend") == before
    assert bpy.data.filepath == str(bounced / "scene.blend") and not bpy.data.images.get("Ball_basecolor")


def under_sky(folder: Path, floor: bool, turns: bool = False) -> SceneData:
    """The ball, with or without its floor, under a sky with a window, from six sides.

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
    scene.world, scene.cycles.samples = sky, 96
    scene.render.resolution_x = scene.render.resolution_y = 64
    views = []
    for n in range(6):
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
    assert errors["off"] > 0.4, errors  # 0.64; under turns 0.47
    assert errors["auto"] < 0.05, errors  # 0.031; 0.025


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
    monkeypatch.setattr(indirect, "SAMPLES", 256)
    data = under_sky(tmp_path, True)
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


def test_direct_light_is_left_alone(scenes: Path) -> None:
    """Shadows are dark: nothing is rendered, and every map is the same, bit for bit."""
    files.open_blend(scenes / "good" / "scene.blend")
    data = read_scene(None, "Ball", scenes / "good" / "captures.json")

    def bounce(scene: SceneData, solution: Solution) -> Iterator[object]:
        raise AssertionError("rendered indirect light of a capture without it")
        yield

    settings = [SolveSettings(size=32, indirect=mode, **PLAIN) for mode in ("off", "auto")]
    found = [thread.run(lambda it=it: pipeline.solve(data, it, bounce=bounce)) for it in settings]
    for name in ("base_color", "roughness", "confidence", "error"):
        np.testing.assert_array_equal(getattr(found[0].maps, name), getattr(found[1].maps, name))
    assert not any("bounced" in warning for solution in found for warning in solution.warnings)


def test_a_black_level_is_not_rendered(tmp_path: Path, monkeypatch) -> None:
    """A ball alone, on which no light can bounce, in pictures that show some light everywhere: a few small renders.

    Nor is light taken out that makes the maps explain the pictures worse, once that is seen.
    """
    monkeypatch.setattr(indirect, "TEST_SIDE", 48)
    build(BASE, ROUGH, 0.5)
    bpy.data.objects.remove(bpy.data.objects["Floor"])
    references(tmp_path)
    files.open_blend(tmp_path / "scene.blend")
    data = read_scene(None, "Ball", tmp_path / "captures.json")
    bouncer = indirect.IndirectRenderer.of_open_file(tmp_path / "scene.blend")

    def lifted(view: View) -> RadianceImage:
        image = read_reference(view)
        return replace(image, rgb=image.rgb + np.float32(0.05 * np.quantile(image.rgb, 0.95)))

    class Test:
        """Of the renders, the few alone."""

        sample = bouncer.sample

        def __call__(self, scene: SceneData, solution: Solution) -> Iterator[object]:
            raise AssertionError("rendered indirect light where there is none")
            yield

    settings = SolveSettings(size=32, **PLAIN)
    solution = thread.run(lambda: pipeline.solve(data, settings, lifted, Test()))
    assert solution.checks.not_bounced.startswith("no surface in the scene")
    assert sum(solution.checks.not_bounced in warning for warning in solution.warnings) == 1
    assert solution.checks.unlit_share > 0.02 and "indirect" not in solution.seconds
    wrong = Wrong()
    worse = thread.run(lambda: pipeline.solve(data, settings, lifted, wrong))
    assert wrong.calls == 1 and "did not improve the fit" in worse.checks.not_bounced
    np.testing.assert_array_equal(worse.maps.base_color, solution.maps.base_color)


class Wrong:
    """Finds more light in some views than their lamps give."""

    calls = 0

    def sample(self, scene: SceneData, solution: Solution) -> Iterator[Progress]:
        yield Progress(0.0, "indirect")
        return BouncedSample(1.0, 1.0)

    def __call__(self, scene: SceneData, solution: Solution) -> Iterator[Progress]:
        self.calls += 1
        yield Progress(0.0, "indirect")
        return {n: Bounced(*(np.full((8, 8, 3), light, np.float32) for light in (20.0 * n, 0.0)))
                for n in range(len(scene.views))}


def test_the_sample_tells_what_all_pictures_do(scene: SceneData, bounced: Path) -> None:
    """Of the true maps: the share of the radiance that Cycles' own pictures with and without bounces hold."""
    bouncer = indirect.IndirectRenderer.of_open_file(bounced / "scene.blend")
    found = finish(bouncer.sample(scene, solution_of(BASE, ROUGH, "one-lobe")))
    assert 0.1 < found.share < 0.4 and 0.05 < found.unlit < 0.3


class Kept(subprocess.Popen):
    """Remembers what was started, and where."""

    made: ClassVar[list[Kept]] = []

    def __init__(self, *arguments, **options) -> None:
        super().__init__(*arguments, **options)
        self.folder = Path(options["cwd"])
        self.made.append(self)


def test_stopping_ends_the_child(scene: SceneData, bounced: Path, monkeypatch) -> None:
    monkeypatch.setattr(indirect, "SAMPLES", 1_000_000)
    monkeypatch.setattr(subprocess, "Popen", Kept)
    steps = indirect.IndirectRenderer.of_open_file(bounced / "scene.blend")(scene, solution_of(BASE, ROUGH, "one-lobe"))
    next(steps)
    child = Kept.made.pop()
    assert child.poll() is None and child.folder.is_dir()
    with pytest.raises(Cancelled):
        steps.throw(Cancelled())
    assert child.returncode is not None and not child.folder.exists()


def test_a_child_that_fails_costs_a_warning(scene: SceneData, tmp_path: Path) -> None:
    """One line that says why; the direct result stays."""
    bad = tmp_path / "bad.blend"
    bad.write_bytes(b"BLENDER is not what this is")
    bouncer = indirect.IndirectRenderer.of_open_file(bad)
    with pytest.raises(BadInput, match=r"bad\.blend: indirect light cannot be rendered") as caught:
        finish(bouncer(scene, solution_of(BASE, ROUGH, "one-lobe")))
    assert "\n" not in str(caught.value)
    solution = thread.run(lambda: pipeline.solve(scene, SolveSettings(size=16, indirect="on", **PLAIN), bounce=bouncer))
    assert str(caught.value) in solution.warnings and not solution.cancelled


def test_a_copy_holds_what_was_not_saved(scene: SceneData) -> None:
    """And goes when the job is done."""
    bpy.data.objects["Ball"]["mark"] = 1
    bouncer = indirect.IndirectRenderer.of_copy()
    path = bpy.data.filepath
    with bpy.data.libraries.load(str(bouncer.blend)) as (there, here):
        here.objects = ["Ball"] if "Ball" in there.objects else []
    assert here.objects[0]["mark"] == 1
    assert bpy.data.filepath == path and bouncer.blend != Path(path)

    def job() -> Iterator[int]:
        yield 1
        raise Cancelled

    with pytest.raises(Cancelled):
        finish(bouncer.around(job()))
    assert not bouncer.blend.exists()


def test_world_light_is_indirect_too(scene: SceneData, tmp_path: Path, bounced: Path) -> None:
    """A grey world of radiance 1 above an open floor: irradiance is below pi, most of it where the ball looks up."""
    world = bpy.data.worlds.new("Grey")
    world.color = (1, 1, 1)
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    tree = world.node_tree
    if tree is not None:
        next(node for node in tree.nodes if node.type == "BACKGROUND").inputs["Color"].default_value = (1, 1, 1, 1)
    bpy.context.scene.world = world
    bpy.context.scene.cycles.max_bounces = 1
    file = tmp_path / "world.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file), copy=True)
    found: Bounced = finish(indirect.IndirectRenderer.of_open_file(file)(
        replace(scene, views=scene.views[:1]), solution_of(BASE, ROUGH, "lambert")))[0]
    middle = slice(21, 27)
    column = found.irradiance[:, middle].mean((1, 2))
    on = np.flatnonzero(column > 0)
    top = column[on[-int(0.2 * len(on)):]].max()
    assert 2.0 < top < 1.6 * math.pi
