"""The check before a solve, on a shoot that Cycles photographed: all well, and one fault at a time."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import OpenImageIO as oiio
import pytest

from irpso_addon.blender import files
from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.core.checks.mended_cameras import moved
from irpso_addon.core.checks.shoot_check import ShootCheck
from irpso_addon.core.data import SceneData, View
from irpso_addon.gpu.device import thread
from irpso_addon.solve import check_shoot
from tests.support import photo_shoot
from tests.support.picture_files import save

PLAN = photo_shoot.Plan(views=8, pixels=240)
UNIT = photo_shoot.UNIT
FLASH = ["--flash-right", 1000 * UNIT * photo_shoot.OFFSET[0], "--flash-above", 1000 * UNIT * photo_shoot.OFFSET[1],
         "--flash-size", 1000 * UNIT * photo_shoot.FLASH_SIZE, "--flash-power", UNIT**2 * photo_shoot.FLASH_POWER]


@pytest.fixture(scope="module")
def shoot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The .blend that `irpso import` makes of it."""
    from irpso_addon.__main__ import main

    folder = tmp_path_factory.mktemp("shoot")
    photo_shoot.make(folder, PLAN)
    out = folder / "shoot.blend"
    assert main(list(map(str, ["import", folder / "transforms.json", "--images", folder / "pictures", "--scale", UNIT,
                               *FLASH, "--out", out]))) == 0
    return out


@pytest.fixture(scope="module")
def data(shoot: Path) -> SceneData:
    files.open_blend(shoot)
    return read_scene(None, None, None)


def checked(data: SceneData) -> ShootCheck:
    found: ShootCheck = thread.run(lambda: check_shoot.check(data))
    return found


def changed(data: SceneData, change: Callable[[View], View]) -> SceneData:
    return replace(data, views=tuple(map(change, data.views)))


def as_pictures(data: SceneData, folder: Path, brighter: float) -> SceneData:
    """With 16-bit files, white 1, without alpha: the radiance so many times as bright."""

    def saved(view: View) -> View:
        pixels = np.asarray(oiio.ImageBuf(str(view.image)).get_pixels(oiio.FLOAT))[..., :3] * brighter
        path = folder / f"{view.image.stem}.tif"
        spec = oiio.ImageSpec(*pixels.shape[1::-1], 3, "uint16")
        output = oiio.ImageOutput.create(str(path))
        assert output.open(str(path), spec) and output.write_image(np.ascontiguousarray(np.clip(pixels, 0, 1)))
        output.close()
        return replace(view, image=path, colorspace="Linear Rec.709", exposure=float(np.log2(brighter)))

    return changed(data, saved)


@pytest.fixture(scope="module")
def right(data: SceneData) -> ShootCheck:
    return checked(data)


def test_a_right_shoot_has_no_fault(right: ShootCheck) -> None:
    """Outlines to 0.3 pixels (antialiased at 16 samples: 0.02), the flash to 3 % of its distance."""
    assert right.findings == ()
    assert len(right.views) == right.total == 8 and right.outside == ()
    assert max(view.pixels for view in right.views) < 0.3
    assert max(view.outline for view in right.views) < 0.5
    (flash,) = right.lamps
    assert flash.on_camera and flash.name == "Flash" and flash.views == 8 and flash.off < 0.03
    assert flash.distance == pytest.approx(0.464, abs=0.01)  # metres: 4.6 units, and the offset of 0.6
    assert np.median([view.highlight[1] for view in right.views if view.highlight]) < 4  # degrees
    assert all(view.lit > 0.9 and 0.1 < view.albedo < 0.35 and view.brightness is None for view in right.views)


def test_what_the_figures_of_base_colour_mean(right: ShootCheck, shoot: Path) -> None:
    """The median over the true map is between those of the views: 5 % for gloss and for parts that are not seen."""
    true = np.asarray(oiio.ImageBuf(str(shoot.parent / "truth" / "mesh_basecolor.exr")).get_pixels(oiio.FLOAT))
    middle = float(np.median(true[..., :3].mean(-1)))
    albedo = [view.albedo for view in right.views]
    assert 0.95 * min(albedo) < middle < 1.05 * max(albedo)


def test_an_inverted_mask(data: SceneData, tmp_path: Path) -> None:
    """Only the view that has it is named; the others stay right."""
    alpha = np.asarray(oiio.ImageBuf(str(data.views[0].image)).get_pixels(oiio.FLOAT))[..., 3:]
    save(tmp_path / "mask.png", np.ascontiguousarray(255 * (alpha < 0.5), np.uint8), "uint8", "Y")
    views = (replace(data.views[0], mask=tmp_path / "mask.png"), *data.views[1:])
    (finding,) = checked(replace(data, views=views)).findings
    assert finding.problem == f"'{data.views[0].image.name}': its mask or alpha hides the object"


@pytest.mark.one_python
def test_cameras_that_are_off(data: SceneData) -> None:
    """By 3 pixels to the right and 1 down in all views: told to 0.2 pixels, with one line, not the lamp's too."""

    def off(view: View) -> View:
        lens = view.camera.lens
        assert lens is not None
        return replace(view, camera=moved(view.camera, (-3.0, 1.0), (lens.width, lens.height)))

    found = checked(changed(data, off))
    for view in found.views:
        assert view.shift == pytest.approx((3.0, -1.0), abs=0.2)
    (finding,) = found.findings
    assert "the picture does not line up with the mesh" in finding.problem and "8 of 8 views" in finding.evidence
    assert "all by about (+3.0, -1.0)" in finding.evidence and "principal point" in finding.remedy


@pytest.mark.one_python
def test_one_camera_that_is_off(data: SceneData) -> None:
    camera = data.views[2].camera
    assert camera.lens is not None
    views = list(data.views)
    views[2] = replace(views[2], camera=moved(camera, (2.5, 2.0), (camera.lens.width, camera.lens.height)))
    (finding,) = checked(replace(data, views=tuple(views))).findings
    assert finding.problem == "'IMG_0002.exr': the picture does not line up with the mesh"
    assert "alike" not in finding.evidence


@pytest.mark.one_python
def test_a_camera_that_is_far_off(data: SceneData) -> None:
    """By a third of its picture, further than is looked for: nothing is said of outlines there."""
    camera = data.views[2].camera
    assert camera.lens is not None
    views = list(data.views)
    views[2] = replace(views[2], camera=moved(camera, (80.0, 0.0), (camera.lens.width, camera.lens.height)))
    far = checked(replace(data, views=tuple(views))).views[2]
    assert far.shift is None and far.outline is None


@pytest.mark.one_python
@pytest.mark.parametrize("by", [(0.2, 0.0), (0.0, -0.2)])
def test_a_flash_that_stands_elsewhere(data: SceneData, by: tuple[float, float]) -> None:
    """By a fifth of its distance to the right, or down: told to 4 % of the distance, in one line with millimetres."""
    distance = 0.464

    def displaced(view: View) -> View:
        (light,) = view.lights
        matrix = light.matrix.copy()
        matrix[:3, 3] += distance * np.array(by) @ view.camera.world_to_camera[:2, :3]
        return replace(view, lights=(replace(light, matrix=matrix),))

    found = checked(changed(data, displaced))
    (flash,) = found.lamps
    assert flash.place == pytest.approx((-by[0], -by[1]), abs=0.04)
    (finding,) = found.findings
    assert finding.problem == "light 'Flash': does not match the highlights"
    assert ("mm to the left" if by[0] else "mm up") in finding.remedy


@pytest.mark.one_python
def test_pictures_that_are_overexposed(data: SceneData, tmp_path: Path) -> None:
    """Four times as bright as what hardly clips: more than a tenth is lost, and nothing else is said."""
    found = checked(as_pictures(data, tmp_path, 16.0))
    (finding,) = found.findings
    assert finding.problem.endswith("clipped") and "and 5 more" in finding.problem and "less exposure" in finding.remedy
    assert min(view.clipped for view in found.views) > 0.1


@pytest.mark.one_python
def test_pictures_without_alpha(data: SceneData, tmp_path: Path) -> None:
    """Edges alone tell where cameras look, to 0.5 pixels, and brightness is that of the file."""
    found = checked(as_pictures(data, tmp_path, 1.0))
    assert found.findings == ()
    assert max(view.pixels for view in found.views) < 0.5
    assert all(view.outline is None and 0.02 < view.brightness < 0.2 for view in found.views)
    dark = checked(as_pictures(data, tmp_path, 0.05))
    assert [finding.problem.endswith("too dark") for finding in dark.findings] == [True]


@pytest.mark.one_python
def test_power(data: SceneData) -> None:
    """Eight times too little, a hundred times too much: said, and by how much, to a factor of two."""
    for factor, problem, word in ((1 / 8, "too little power", "multiply"), (100, "too much power", "divide")):
        found = checked(changed(data, lambda view, f=factor: replace(
            view, lights=tuple(replace(light, power=light.power * f) for light in view.lights))))
        (finding,) = found.findings
        assert finding.problem.endswith(problem)
        said = float(re.search(rf"{word} the power by (?:about )?([\d.e+]+)", finding.remedy)[1])
        assert 0.5 < said / max(factor, 1 / factor) < 2


@pytest.mark.one_python
def test_a_mesh_that_turned(data: SceneData) -> None:
    """By 6 degrees about its axis: the handles' outline gives it away, which no shift explains."""
    turn = np.array([[np.cos(0.105), -np.sin(0.105), 0], [np.sin(0.105), np.cos(0.105), 0], [0, 0, 1]], np.float32)
    mesh = replace(data.mesh, positions=data.mesh.positions @ turn.T, normals=data.mesh.normals @ turn.T)
    problems = [finding.problem for finding in checked(replace(data, mesh=mesh)).findings]
    assert any("outline differs from the mesh's" in problem or "edges are not found" in problem for problem in problems)


@pytest.mark.one_python
def test_a_mesh_that_is_inside_out(data: SceneData) -> None:
    """One line, which says so, and none of edges and lamps."""
    mesh = replace(data.mesh, positions=data.mesh.positions[:, ::-1].copy(), normals=-data.mesh.normals[:, ::-1],
                   uvs=data.mesh.uvs[:, ::-1].copy())
    (finding,) = checked(replace(data, mesh=mesh)).findings
    assert finding.problem.endswith("its faces look inwards")


def test_command(shoot: Path, irpso_here, tmp_path: Path) -> None:
    """The table, the picture, nothing to warn of; refused: other files than PNG, missing folders."""
    out = tmp_path / "check.png"
    done = irpso_here("check", shoot, "--out", out)
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr and "no problem" in done.stdout
    assert len([line for line in done.stdout.splitlines() if line.startswith("IMG_") and ", " not in line]) == 8
    picture = oiio.ImageBuf(str(out))
    assert picture.spec().width == 4 * (480 + 12) + 12
    pixels = np.asarray(picture.get_pixels(oiio.FLOAT))[..., :3]
    drawn = np.abs(pixels - (0.0, 0.9, 1.0)).max(-1) < 0.01  # the edges' colour
    assert 2000 < drawn.sum() < 60_000
    for bad, words in ((tmp_path / "a.jpg", "must end in .png"), (tmp_path / "no" / "a.png", "folder not found")):
        refused = irpso_here("check", shoot, "--out", bad)
        assert refused.returncode == 3 and words in refused.stderr and not bad.exists()
    refused = irpso_here("check", tmp_path / "nowhere" / "a.blend")
    assert refused.returncode == 3 and "a.blend: cannot be opened (No such file" in refused.stderr


@pytest.mark.usefixtures("extension")
def test_operator_and_steps(shoot: Path, module) -> None:
    """What is missing, the check, its picture and what the panel says then."""
    steps = sys.modules["irpso_ext.irpso_addon.blender.shoot.steps"]
    bpy.ops.wm.open_mainfile(filepath=str(shoot))
    mesh = bpy.data.objects["mesh"]
    bpy.context.view_layer.objects.active = mesh

    def missing() -> dict[str, str | None]:
        module("blender.scene.readiness").recent(bpy.context, renew=True)
        return {step.text.split(":")[0]: step.mend and step.mend[0]
                for step in steps.steps(bpy.context) if not step.done}

    def texts() -> set[str]:
        module("blender.scene.readiness").recent(bpy.context, renew=True)
        return {step.text for step in steps.steps(bpy.context)}

    assert missing() == {"Check": "irpso.check_shoot"}
    assert bpy.ops.irpso.check_shoot() == {"FINISHED"}
    assert missing() == {}
    image = bpy.data.images["IRPSO Check"]
    assert image.is_runtime_data and image.size[0] == 4 * (480 + 12) + 12
    assert bpy.ops.irpso.check_shoot() == {"FINISHED"}  # again: the same image
    assert [i.name for i in bpy.data.images if i.name.startswith("IRPSO Check")] == ["IRPSO Check"]
    scene = bpy.context.scene
    assert {"Light: a flash on the camera", "Cameras: 8 views"} < texts()
    scene.irpso.shoot.scale = 3.0  # after the import it changes nothing
    assert any(text.startswith("Scale: as imported") for text in texts())
    scene.collection.objects.link(bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN")))
    assert "Light: a flash on the camera" in texts()  # no view has it
    scene.collection.objects.link(bpy.data.objects.new("Cube", mesh.data))
    assert "Mesh: 'mesh'; 'Cube' is in the scene too: delete what did not stand there" in texts()
    bpy.data.objects["Cube"].hide_render = True
    assert "Mesh: 'mesh'" in texts() and f"File: {shoot.name}" in texts()
    scene.irpso.views[7].enabled = False
    assert missing() == {"Check": "irpso.check_shoot"} and "Check: the views have changed since" in texts()
    scene.irpso.views[7].enabled = True
    assert missing() == {}
    mesh.data.uv_layers.remove(mesh.data.uv_layers[0])
    assert missing()["Mesh"] == "irpso.unwrap"
    assert bpy.ops.irpso.unwrap() == {"FINISHED"} and "Mesh" not in missing()


@pytest.mark.usefixtures("extension")
def test_steps_of_an_empty_file(empty) -> None:
    """One after the other becomes the first that is not done; the import is offered when it has what it needs."""
    steps = sys.modules["irpso_ext.irpso_addon.blender.shoot.steps"]
    readiness = sys.modules["irpso_ext.irpso_addon.blender.scene.readiness"]
    shoot = bpy.context.scene.irpso.shoot

    def first() -> tuple[str, str | None]:
        readiness.recent(bpy.context, renew=True)
        step = next(step for step in steps.steps(bpy.context)[1:] if not step.done)
        return step.text, step.mend and step.mend[0]

    found = steps.steps(bpy.context)
    assert [step.done for step in found] == [False, False, False, False, False, True, False, False]
    assert found[0].mend == ("wm.save_mainfile", "Save")  # without which nothing can be checked
    assert first() == ("Cameras: choose the project above, or add views under Capture", None)
    shoot.project = "//transforms.json"
    assert first() == ("Pictures: choose their folder above", None)
    shoot.images = "//pictures/"
    assert first()[0].startswith("Scale: the project's own")  # the flash's offset depends on it
    shoot.scale = 0.1
    assert first() == ("Import: not done yet", "irpso.import_shoot")
    assert [step.text for step in steps.steps(bpy.context)[1:5]] == [
        "Cameras: from transforms.json", "Pictures: from pictures", "Mesh: the only one beside the project",
        "Light: a flash 0 mm right of the lens and 0 mm above it"]


@pytest.mark.one_python
def test_cameras_that_look_elsewhere(data: SceneData) -> None:
    """One, or all of them: no figures, no traceback, a line that names them."""

    def away(view: View) -> View:
        back = np.diag([-1.0, 1.0, -1.0, 1.0]) @ view.camera.world_to_camera
        return replace(view, camera=replace(view.camera, world_to_camera=back, forward=-view.camera.forward))

    one = checked(replace(data, views=(away(data.views[0]), *data.views[1:])))
    assert one.outside == ("IMG_0000.exr",) and not one.views[0].drawn and one.views[0].shift is None
    assert [finding.problem for finding in one.findings] == ["'IMG_0000.exr': does not show 'mesh'"]
    found = checked(changed(data, away))
    assert len(found.outside) == 8 and "8 of 8 cameras" in found.findings[0].evidence and len(found.findings) == 1
