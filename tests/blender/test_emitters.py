"""Meshes that glow: read from the file, as bright as Cycles renders them, and which views they shine in."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from irpso_addon.blender.jobs import indirect  # noqa: E402
from irpso_addon.blender.scene.scene import read_scene  # noqa: E402
from irpso_addon.blender.scene.scene_emitters import read_emitter  # noqa: E402
from irpso_addon.core.data import Maps, Solution  # noqa: E402
from irpso_addon.core.errors import BadInput  # noqa: E402
from irpso_addon.core.shading import emitters, environment  # noqa: E402
from tests.blender import cycles_rig as rig  # noqa: E402
from tests.support import glowing_scene  # noqa: E402
from tests.support.texels import finish  # noqa: E402


def _read(obj, warn=pytest.fail):
    bpy.context.view_layer.update()
    return read_emitter(obj, bpy.context.evaluated_depsgraph_get(), warn)


def _principled(obj, color, strength):
    node = rig.principled(obj, (0.5, 0.5, 0.5), 0.5)
    node.inputs["Emission Color"].default_value, node.inputs["Emission Strength"].default_value = (*color, 1), strength
    return node


# ---- as bright as Cycles renders them


@pytest.mark.one_python
@pytest.mark.parametrize("kind", ["panel", "back of a panel", "bulb", "tube"])
def test_irradiance_is_that_of_cycles(kind):
    """A white Lambertian plane under each; a panel also against the area lamp that replaces it."""
    rig.scene(16, 4096 if kind in {"bulb", "tube"} else 512)
    rig.principled(rig.plane(), (1, 1, 1), 0.5, specular=0.0)
    rig.camera((0, -1.6, 1.6), degrees=55)
    place = (0.5, -0.6, 1.4)
    if "panel" in kind:
        target = (0.1, 0.1, 0) if kind == "panel" else (0.9, -1.3, 2.8)
        made = glowing_scene.panel("Panel", place, 0.7, 4.0, target)
    elif kind == "bulb":
        made = glowing_scene.bulb("Bulb", place, 0.2, 8.0)
    else:
        made = glowing_scene.tube("Tube", place, 1.2, 0.05, 20.0)
    made.visible_camera = False
    light = _read(made)
    assert light.name == made.name and light.both_sides == ("panel" in kind)
    image = rig.render()
    truth, P = image["rgb"][..., 0] * np.pi, image["position"].reshape(-1, 3)
    found = emitters.patches([light], P.mean(0), float(np.linalg.norm(np.ptp(P, axis=0)) / 2))
    up = np.array([0.0, 0, 1])
    twin = np.array([environment.node_values(emitters.seen_from(found, p), up, up)[0][0] for p in P]).reshape(16, 16)
    lit = truth > 0.05 * truth.max()
    error = np.abs(twin / np.where(lit, truth, 1) - 1)[lit]
    assert abs(twin.sum() / truth.sum() - 1) < (0.01 if kind == "tube" else 0.003)  # the tube hides parts of itself
    assert error.mean() < 0.01  # most of it is noise
    if kind == "panel":
        bpy.data.objects.remove(made)
        rig.lamp("AREA", place, (0.1, 0.1, 0), shape="SQUARE", size=0.7, energy=4.0 * np.pi * 0.7**2)
        assert abs(rig.render()["rgb"].sum() / image["rgb"].sum() - 1) < 0.002


# ---- reading


def test_color_and_strength_of_either_node(stage):
    panel = glowing_scene.panel("Panel", (0, 0, 2), 0.5, 3.0, color=(1, 0.5, 0.25))
    assert np.allclose(_read(panel).radiance, (3, 1.5, 0.75))
    _principled(panel, (0.5, 1, 0.25), 2.0)
    found = _read(panel)
    assert np.allclose(found.radiance, (1, 2, 0.5))
    assert found.both_sides and np.allclose(found.triangles[..., 2], 2.0)


def test_material_slots_and_closed_shapes(stage):
    bpy.ops.mesh.primitive_cube_add(size=1, location=(0, 0, 3))
    cube = bpy.context.object
    glowing_scene.glow(cube, 2.0)
    assert len(_read(cube).triangles) == 12 and not _read(cube).both_sides
    cube.scale.x = -1  # mirrored: what Blender shows as outside stays so
    outward = _read(cube).triangles.astype(float)
    middle = outward.mean(1) - (0, 0, 3)
    assert ((np.cross(outward[:, 1] - outward[:, 0], outward[:, 2] - outward[:, 0]) * middle).sum(-1) > 0).all()
    cube.data.materials.append(bpy.data.materials.new("Paint"))
    for face in list(cube.data.polygons)[1:]:
        face.material_index = 1
    found = _read(cube)
    assert len(found.triangles) == 2 and not found.both_sides  # the rest of the cube hides its back


def test_what_the_camera_alone_sees_does_not_shine(stage):
    panel = glowing_scene.panel("Panel", (0, 0, 2), 0.5, 3.0)
    tree = panel.data.materials[0].node_tree
    mix, path, other = (tree.nodes.new(f"ShaderNode{n}") for n in ("MixShader", "LightPath", "Emission"))
    tree.links.new(path.outputs["Is Camera Ray"], mix.inputs[0])
    tree.links.new(next(n for n in tree.nodes if n.type == "EMISSION").outputs[0], mix.inputs[1])
    tree.links.new(other.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    strengths = [n.inputs["Strength"].default_value for n in tree.nodes if n.type == "EMISSION"]
    assert sorted(strengths) == [1.0, 3.0]
    assert np.allclose(_read(panel).radiance, 3.0)


def _picture(panel) -> None:
    """A gradient in red and a bright quarter in green, as a picture's color of a panel with UVs of its own."""
    pixels = np.zeros((32, 64, 4), np.float32)
    pixels[..., 0] = np.linspace(0.1, 1, 64)[None]
    pixels[16:, 32:, 1] = 2.0
    pixels[..., 2:] = 0.5, 1.0
    image = bpy.data.images.new("Soft Box", 64, 32, float_buffer=True)
    image.colorspace_settings.name = "Linear Rec.709"
    image.pixels.foreach_set(pixels.ravel())
    layer = panel.data.uv_layers.new(name="Turned")
    for loop, uv in zip(layer.data, ((1, 0), (1, 1), (0, 1), (0, 0)), strict=True):
        loop.uv = uv
    node = panel.data.materials[0].node_tree.nodes["Emission"]
    texture = node.id_data.nodes.new("ShaderNodeTexImage")
    texture.image = image
    node.id_data.links.new(texture.outputs["Color"], node.inputs["Color"])


def test_a_picture_shines_as_cycles_renders_it():
    """Of a mirror below the panel, and on white paper: which corner is bright, and how much of it arrives."""
    rig.scene(24, 512)
    rig.principled(rig.plane(), (1, 1, 1), 0.5, specular=0.0)
    rig.camera((0, -0.6, 1.2), degrees=60)
    panel = glowing_scene.panel("Panel", (0.1, 0.0, 0.4), 0.8, 3.0, (0.1, 0.0, 0.0))
    _picture(panel)
    panel.visible_camera = False
    light = _read(panel)
    assert len(light.triangles) >= 1 << 14
    area = np.linalg.norm(np.cross(light.triangles[:, 1] - light.triangles[:, 0],
                                   light.triangles[:, 2] - light.triangles[:, 0]), axis=1) / 2
    assert np.allclose(area @ light.radiance / area.sum(), 3 * np.array([0.55, 0.5, 0.5]), rtol=0.01)
    image = rig.render()
    P = image["position"].reshape(-1, 3)
    found = emitters.patches([light], P.mean(0), float(np.linalg.norm(np.ptp(P, axis=0)) / 2))
    up = np.array([0.0, 0, 1])
    twin = np.array([environment.node_values(emitters.seen_from(found, p), up, up)[0] for p in P]).reshape(24, 24, 3)
    truth = image["rgb"] * np.pi
    lit = truth > 0.1 * truth.max()
    assert np.abs(twin.sum((0, 1)) / truth.sum((0, 1)) - 1).max() < 0.005
    assert np.quantile(np.abs(twin / np.where(lit, truth, 1) - 1)[lit], 0.9) < 0.05  # noise
    assert np.ptp((truth[..., 1] / truth[..., 2])[lit.all(-1)]) > 1  # the quarter shows


def test_a_picture_without_its_uv_map_is_named(stage):
    panel = glowing_scene.panel("Panel", (0, 0, 2), 0.5, 3.0)
    _picture(panel)
    said: list[str] = []
    assert _read(panel) is not None
    tree = panel.data.materials[0].node_tree
    chosen = tree.nodes.new("ShaderNodeUVMap")
    chosen.uv_map = "Gone"
    tree.links.new(chosen.outputs["UV"], next(n for n in tree.nodes if n.type == "TEX_IMAGE").inputs["Vector"])
    assert _read(panel, said.append) is None
    tree.nodes.remove(chosen)
    panel.data.uv_layers.remove(panel.data.uv_layers[0])
    panel.data.update()
    assert _read(panel, said.append) is None
    assert said == [f"object 'Panel': glows by an image and lacks its UV map{which}, so it counts as indirect light; "
                    "unwrap it, or choose a UV map that it has" for which in (" 'Gone'", "")]


@pytest.mark.parametrize("what", ["texture", "blackbody", "coat", "group"])
def test_what_is_not_modelled_is_named_in_one_line(stage, what):
    panel = glowing_scene.panel("Panel", (0, 0, 2), 0.5, 3.0)
    node = panel.data.materials[0].node_tree.nodes["Emission"]
    tree = node.id_data
    if what == "coat":
        _principled(panel, (1, 1, 1), 2.0).inputs["Coat Weight"].default_value = 0.5
    elif what == "group":
        inner = bpy.data.node_groups.new("Inner", "ShaderNodeTree")
        inner.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
        inner.nodes.new("ShaderNodeEmission")
        group = tree.nodes.new("ShaderNodeGroup")
        group.node_tree = inner
        tree.links.new(group.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    else:
        kind = "ShaderNodeTexChecker" if what == "texture" else "ShaderNodeBlackbody"
        tree.links.new(tree.nodes.new(kind).outputs[0], node.inputs["Color"])
    read = stage.read()
    assert read.views[0].environment is None
    (line,) = [warning for warning in read.warnings if "Panel" in warning]
    assert line.startswith("object 'Panel': glows by nodes") and "counts as indirect light" in line
    assert "; " in line and "\n" not in line


def test_numbers_that_no_light_has(stage):
    panel = glowing_scene.panel("Panel", (0, 0, 2), 0.5, float("inf"))
    with pytest.raises(BadInput, match="object 'Panel': its emission is negative, not finite or too large"):
        _read(panel)


# ---- which views they shine in


def _captures(stage, *lights) -> None:
    stage.captures.write_text(json.dumps({"views": [
        {"image": f"{n}.exr", "camera": "Cam", "lights": list(names)} for n, names in enumerate(lights)]}))


def _shining(stage, **more) -> list[tuple[str, ...]]:
    return [view.light_names for view in stage.read(**more).views]


def test_one_that_no_view_names_shines_in_all(stage):
    glowing_scene.panel("Panel", (0, 0, 3), 0.5, 3.0)
    glowing_scene.panel("Neon", (1, 0, 3), 0.1, 3.0)
    _captures(stage, ["Key"], [])
    assert _shining(stage) == [("Key", "Panel", "Neon"), ("Panel", "Neon")]
    _captures(stage, ["Key"], ["Panel"], ["Key", "Panel"])
    assert _shining(stage) == [("Key", "Neon"), ("Panel", "Neon"), ("Key", "Panel", "Neon")]
    views = stage.read().views
    assert views[1].environment is views[2].environment  # and is drawn once
    bpy.data.objects["Neon"].hide_render = True
    assert _shining(stage) == [("Key",), ("Panel",), ("Key", "Panel")]
    _captures(stage, ["Neon"])  # named: it counts, though it is off now
    assert _shining(stage) == [("Neon", "Panel")]


def test_what_is_solved_shines_on_nothing(stage):
    _principled(bpy.data.objects["Subject"], (1, 1, 1), 1.0)
    _captures(stage, ["Key"])
    assert _shining(stage) == [("Key",)]


def test_one_too_faint_to_count_is_left_out(stage):
    """Key sends 10 W / (4 pi 9 m^2) = 0.088 W/m^2 to the plane's middle, the diode L 1e-4 m^2 / (5.08 - 1.41 m)^2."""
    bpy.data.objects["Key"].data.energy = 10.0
    diode = glowing_scene.panel("Diode", (0, 0, 5), 0.01, 8.0)
    _captures(stage, ["Key"], [])
    assert _shining(stage) == [("Key",), ("Diode",)]  # below 0.1 % of the lamp; alone it is all the light
    diode.data.materials[0].node_tree.nodes["Emission"].inputs["Strength"].default_value = 16.0
    assert _shining(stage) == [("Key", "Diode"), ("Diode",)]


def test_one_hidden_from_the_rays_that_light_surfaces(stage):
    panel = glowing_scene.panel("Panel", (0, 0, 3), 0.5, 3.0)
    _captures(stage, ["Key"])
    panel.visible_diffuse = False
    assert [w for w in stage.read().warnings if "hidden from diffuse or glossy rays" in w]
    panel.visible_glossy = False
    assert _shining(stage) == [("Key",)]


def test_a_mesh_that_does_not_glow_is_no_light(stage):
    glowing_scene.panel("Panel", (0, 0, 3), 0.5, 3.0)
    bpy.ops.mesh.primitive_cube_add(location=(5, 5, 0))
    _captures(stage, ["Cube"])
    with pytest.raises(BadInput, match="light 'Cube' is a mesh; there are: 'Key', 'Panel'"):
        stage.read()


def test_a_grey_world_is_no_light_beside_them(stage):
    world = bpy.data.worlds.new("Grey")
    bpy.context.scene.world = world
    _captures(stage, [])
    assert stage.read().views[0].environment.name == "Grey"
    glowing_scene.panel("Panel", (0, 0, 3), 0.5, 3.0)
    found = stage.read().views[0].environment
    assert found.name == "" and [e.name for e in found.emitters] == ["Panel"] and not found.radiance.any()


# ---- indirect light, and maps from Cycles' pictures


def _set_up(folder: Path, pixels: int, bounces: int):
    """A ball above a floor between two panels and a bulb, three cameras; saved."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=0.8)
    ball = bpy.context.object
    ball.name = "Ball"
    bpy.ops.object.shade_smooth()
    rig.principled(ball, (0.7, 0.35, 0.15), 0.4)
    bpy.ops.mesh.primitive_plane_add(size=6, location=(0, 0, -0.81))
    rig.principled(bpy.context.object, (0.6, 0.6, 0.5), 1.0, 0.0)
    glowing_scene.panel("Left", (-2.2, -1.6, 1.4), 0.8, 12.0)
    glowing_scene.panel("Right", (2.2, -1.2, 1.0), 0.6, 16.0)
    glowing_scene.bulb("Bulb", (0.2, -1.9, 2.2), 0.12, 60.0)
    bpy.context.view_layer.objects.active = ball
    scene = bpy.context.scene
    for n, place in enumerate(((-1.4, -3.8, 0.9), (1.4, -3.8, 0.7), (0.0, -3.4, 2.2))):
        data = bpy.data.cameras.new("Camera")
        data.lens = 65
        rig.add(f"Camera {n}", data, place)
    scene.render.engine, scene.render.resolution_x, scene.render.resolution_y = "CYCLES", pixels, pixels
    scene.cycles.device, scene.cycles.max_bounces = "CPU", bounces
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.cycles.sample_clamp_indirect = scene.cycles.light_sampling_threshold = 0
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    return scene


PANELS = ("Left", "Right", "Bulb")


def _render(scene, path: Path, camera: str, on: str, samples: int) -> None:
    """With one of PANELS on and the others dark, which stay where they are."""
    strengths = {name: bpy.data.objects[name].data.materials[0].node_tree.nodes["Emission"].inputs["Strength"]
                 for name in PANELS}
    before = {name: socket.default_value for name, socket in strengths.items()}
    for name, socket in strengths.items():
        socket.default_value = before[name] if name == on else 0.0
    scene.camera, scene.cycles.samples, scene.render.filepath = bpy.data.objects[camera], samples, str(path)
    bpy.ops.render.render(write_still=True)
    for name, socket in strengths.items():
        socket.default_value = before[name]


def _pixels(path: Path) -> np.ndarray:
    import OpenImageIO

    return OpenImageIO.ImageBuf(str(path)).get_pixels(OpenImageIO.FLOAT)[::-1, :, :3].astype(np.float64)


def test_what_bounces_is_rendered_without_the_emitters_own_light(tmp_path, monkeypatch):
    """rho / pi times the indirect irradiance is what 4 bounces add to none, of Cycles' own renders."""
    monkeypatch.setattr(indirect, "SIDE", 48)
    monkeypatch.setattr(indirect, "SAMPLES", 256)
    scene = _set_up(tmp_path, 48, 4)
    rig.principled(bpy.data.objects["Ball"], (0.5, 0.5, 0.5), 0.4, 0.0)
    _render(scene, tmp_path / "all.exr", "Camera 0", "Left", 512)
    scene.cycles.max_bounces = 0
    _render(scene, tmp_path / "direct.exr", "Camera 0", "Left", 512)
    scene.cycles.max_bounces = 4
    captures = tmp_path / "captures.json"
    captures.write_text(json.dumps({"views": [
        {"image": "all.exr", "camera": "Camera 0", "lights": [name]} for name in PANELS]}))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    data = read_scene(None, "Ball", captures)
    assert [view.light_names for view in data.views] == [("Left",), ("Right",), ("Bulb",)]
    none = np.zeros((8, 8), np.float32)
    maps = Maps(base_color=np.full((8, 8, 3), 0.5, np.float32), roughness=none + np.float32(0.4), confidence=none,
                error=none, filled=none > 0, coverage=none > 0, roughness_sigma=none, base_sigma=none)
    solution = Solution.of_maps(maps, {bpy.data.objects["Ball"].data.materials[0].name: "lambert"})
    found = finish(indirect.IndirectRenderer.of_open_file(tmp_path / "scene.blend")(
        replace(data, views=data.views[:1]), solution))[0]
    direct, whole = _pixels(tmp_path / "direct.exr"), _pixels(tmp_path / "all.exr")
    ball = np.hypot(*np.mgrid[-1:1:48j, -1:1:48j]) < 0.3
    want = (whole - direct)[ball].mean(0)
    assert (want > 0.01 * direct[ball].mean()).all()
    np.testing.assert_allclose((0.5 / np.pi * found.irradiance)[ball].mean(0), want, rtol=0.1)


@pytest.mark.one_python
def test_maps_come_back_by_the_command_line(tmp_path, irpso_here):
    """Three cameras, each emitter alone, none of them a lamp; base colour 0.7, 0.35, 0.15 and roughness 0.4."""
    scene = _set_up(tmp_path, 96, 0)
    views = []
    for n in range(3):
        for name in PANELS:
            _render(scene, tmp_path / f"{n} {name}.exr", f"Camera {n}", name, 24)
            views.append({"image": f"{n} {name}.exr", "camera": f"Camera {n}", "lights": [name]})
    (tmp_path / "captures.json").write_text(json.dumps({"views": views}))
    rig.principled(bpy.data.objects["Ball"], (0.8, 0.8, 0.8), 0.5)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    done = irpso_here("solve", tmp_path / "scene.blend", "--captures", tmp_path / "captures.json", "--object", "Ball",
                      "--size", 32, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    report = json.loads(next((tmp_path / "out").glob("*report.json")).read_text())
    assert any("Left" in view["lights"] for view in report["checks"]["views"]), report["checks"]["views"][0]
    base, rough = (_pixels(tmp_path / "out" / f"Ball_{role}.exr") for role in ("basecolor", "roughness"))
    conf = _pixels(tmp_path / "out" / "Ball_confidence.exr")[..., 0]
    sure = conf > 0.25  # one value for all: at most 0.5
    assert sure.mean() > 0.05
    assert np.median(np.abs(base[sure] - (0.7, 0.35, 0.15))) < 0.015
    assert np.median(np.abs(rough[sure][:, 0] - 0.4)) < 0.03
    refused = irpso_here("solve", tmp_path / "scene.blend", "--captures", tmp_path / "captures.json", "--object",
                         "Ball", "--device", "numpy", "--size", 16, "--out", tmp_path / "numpy")
    assert refused.returncode != 0
    assert "device numpy: works with lamps only, but object 'Left' shines on the views" in refused.stderr
