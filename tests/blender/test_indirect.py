"""Indirect light: what the second Blender renders, and maps recovered from pictures that hold it.

A ball above a floor.  References and the independent renders are Cycles' own, of other passes and other settings.
Under a world: test_indirect_worlds.py.
"""

from __future__ import annotations

import hashlib
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
from irpso_addon.core.data import Bounced, Coat, RadianceImage, SceneData, Solution, View
from irpso_addon.core.errors import BadInput, Cancelled
from irpso_addon.core.images.reference_image import read_reference
from irpso_addon.core.job import Progress
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device import thread
from irpso_addon.solve import pipeline, tiled_solve
from tests.blender.ball_on_floor import BASE, PIXELS, PLAIN, RIGHT, ROUGH, build, references, solution_of
from tests.support.texels import finish


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
    (0.5, "lambert", 0.0, 0.0, None, False, 0.0),
    pytest.param(0.0, "one-lobe", 0.5, 0.0, None, False, 0.0, marks=pytest.mark.one_python),
    pytest.param(0.5, "one-lobe-metallic", 0.5, 1.0, None, False, 0.0, marks=pytest.mark.one_python),
    (0.5, "one-lobe-metallic", 0.5, 1.0, None, True, 0.0),
    (0.5, "one-lobe-metallic", 0.5, 1.0, Coat(1.0, 0.3), False, 0.0),
    pytest.param(0.5, "lambert", 0.0, 0.0, None, False, 1.0, marks=pytest.mark.one_python)])
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
        settings = SolveSettings(size=32, indirect=mode, **(RIGHT if mode == "off" else {}))
        solution = thread.run(lambda settings=settings: pipeline.solve(scene, settings, bounce=bouncer))
        solved = solution.maps.coverage & ~solution.maps.filled
        solved[16:] = False  # the ball's lower half, which sees the floor
        errors[mode] = np.median(np.abs(solution.maps.base_color[solved] / BASE - 1), axis=0).max()
        sure = solution.maps.confidence > 0.25  # one half at most, where a material has one roughness
        rough[mode] = np.median(np.abs(solution.maps.roughness[sure] - ROUGH))
        assert any("bounced" in warning for warning in solution.warnings) == (mode == "off")
    assert errors["off"] > 0.3, errors
    assert errors["auto"] < 0.05, errors
    assert rough["auto"] < 0.02, rough
    assert digest(bounced / "scene.blend") == before
    assert bpy.data.filepath == str(bounced / "scene.blend") and not bpy.data.images.get("Ball_basecolor")


@pytest.mark.one_python
def test_albedo_is_recovered_from_maps_of_two_udims(bounced: Path, tmp_path: Path, monkeypatch) -> None:
    """The left half of the ball's UVs in one square, the right half in the next, and another paint in each."""
    monkeypatch.setattr(indirect, "SIDE", 48)
    files.open_blend(bounced / "scene.blend")
    uvs = bpy.data.objects["Ball"].data.uv_layers.active.uv
    at = np.empty((len(uvs), 2), np.float32)
    uvs.foreach_get("vector", at.ravel())
    at[:, 0] *= 2
    uvs.foreach_set("vector", at.ravel())
    file = tmp_path / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    data = read_scene(None, "Ball", bounced / "captures.json")
    errors = {}
    for mode in ("off", "auto"):
        out = tmp_path / mode
        thread.run(lambda mode=mode, out=out: tiled_solve.solve_to(
            data, SolveSettings(size=64, udim="all", indirect=mode, **PLAIN), out, "exr",
            indirect.IndirectRenderer.of_open_file(file)))
        found = []
        for udim in (1001, 1002):
            base, filled = (demo.read_render(out / f"Ball_{layer}.{udim}.exr") for layer in ("basecolor", "filled"))
            solved = filled[..., 0] < 0.5
            solved[32:] = False  # the ball's lower half, which sees the floor
            found.append(base[solved][:, :3] / BASE - 1)
        errors[mode] = np.median(np.abs(np.concatenate(found)), axis=0).max()
    assert errors["off"] > 0.3 and errors["auto"] < 0.07, errors  # 0.67, 0.048


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
