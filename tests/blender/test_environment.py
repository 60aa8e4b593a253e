"""Worlds as light: read as Cycles maps them, and as bright as it renders them."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest

bpy = pytest.importorskip("bpy")

from irpso_addon.blender.scene.scene_world import is_black, read_environment  # noqa: E402
from irpso_addon.core.errors import BadInput  # noqa: E402
from irpso_addon.core.images.clipped_lights import BrightestPixels  # noqa: E402
from irpso_addon.core.images.environment_image import read_environment_image, seen_from  # noqa: E402
from irpso_addon.core.shading.environment import texel_directions  # noqa: E402
from tests.support import skies  # noqa: E402

HEIGHT = 64


def _hdr(path: Path, picture: np.ndarray) -> None:
    """``picture``: row 0 at the bottom."""
    buffer = OpenImageIO.ImageBuf(OpenImageIO.ImageSpec(picture.shape[1], picture.shape[0], 3, OpenImageIO.FLOAT))
    buffer.set_pixels(OpenImageIO.ROI(), np.ascontiguousarray(picture[::-1], np.float32))
    assert buffer.write(str(path))


def _world(path: Path | None, *, strength: float = 1.0, rotation=None, projection: str = "EQUIRECTANGULAR"):
    world = bpy.data.worlds.new("Room")
    if world.node_tree is None:
        world.use_nodes = True
    bpy.context.scene.world = world
    tree = world.node_tree
    tree.nodes.clear()
    background, output = tree.nodes.new("ShaderNodeBackground"), tree.nodes.new("ShaderNodeOutputWorld")
    background.inputs["Strength"].default_value = strength
    tree.links.new(background.outputs[0], output.inputs["Surface"])
    if path is not None:
        picture = tree.nodes.new("ShaderNodeTexEnvironment")
        picture.image, picture.projection = bpy.data.images.load(str(path)), projection
        tree.links.new(picture.outputs["Color"], background.inputs["Color"])
        if rotation is not None:
            mapping, place = tree.nodes.new("ShaderNodeMapping"), tree.nodes.new("ShaderNodeTexCoord")
            mapping.inputs["Rotation"].default_value = rotation
            tree.links.new(place.outputs["Generated"], mapping.inputs["Vector"])
            tree.links.new(mapping.outputs["Vector"], picture.inputs["Vector"])
    return world


def _rendered(directions: np.ndarray) -> np.ndarray:
    """(N, 3) what Cycles shows of the world in some directions: a camera of four pixels looks at each."""
    from mathutils import Vector

    from tests.blender import cycles_rig as rig

    scene, data = bpy.context.scene, bpy.data.cameras.new("Eye")
    eye = bpy.data.objects.new("Eye", data)
    scene.collection.objects.link(eye)
    scene.camera, data.angle = eye, math.radians(0.5)
    scene.world.cycles.sampling_method = "NONE"  # it lights nothing here, and its map takes two seconds a picture
    found = []
    for d in directions:
        eye.rotation_euler = Vector(d).to_track_quat("-Z", "Y").to_euler()
        found.append(rig.render()["rgb"].mean((0, 1)))
    return np.array(found)


def _sees_what_cycles_shows(world, directions: np.ndarray) -> None:
    found = read_environment(world, 0.0, pytest.fail)
    whole = seen_from(found.radiance, found.rotation, 256)
    v = ((0.5 + np.arcsin(directions[:, 2]) / np.pi) * 256).astype(int)
    u = ((0.5 - np.arctan2(directions[:, 1], directions[:, 0]) / (2 * np.pi)) * 512).astype(int)
    assert np.allclose(whole[v, u], _rendered(directions), rtol=0.03, atol=0.004)


def _some(count: int = 5) -> np.ndarray:
    d = np.random.default_rng(2).normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


@pytest.fixture
def picture(tmp_path):
    from tests.blender import cycles_rig as rig

    rig.scene(2, samples=4)
    _hdr(tmp_path / "sky.exr", skies.radiance(skies.unit_directions(HEIGHT), sun=3.0, width=0.5))
    return tmp_path / "sky.exr"


@pytest.mark.parametrize("rotation", [None, (0.3, -0.8, 1.9)])
def test_an_equirectangular_picture_is_turned_as_cycles_turns_it(picture, rotation):
    _sees_what_cycles_shows(_world(picture, strength=1.7, rotation=rotation), _some())


def test_a_mirror_ball_is_unfolded_as_cycles_unfolds_it(picture):
    d = _some(15)
    _sees_what_cycles_shows(_world(picture, projection="MIRROR_BALL"), d[d[:, 1] < 0.8][:5])


def test_what_the_camera_alone_sees_does_not_shine(picture):
    world = _world(picture)
    tree = world.node_tree
    background = next(n for n in tree.nodes if n.type == "BACKGROUND")
    mix, path, other = (tree.nodes.new(f"ShaderNode{n}") for n in ("MixShader", "LightPath", "Background"))
    other.inputs["Color"].default_value = (9, 0, 0, 1)
    tree.links.new(path.outputs["Is Camera Ray"], mix.inputs[0])
    tree.links.new(background.outputs[0], mix.inputs[1])
    tree.links.new(other.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    found = read_environment(world, 0.0, pytest.fail)
    assert found.radiance.max() < 5


def test_other_nodes_are_rendered_once(picture):
    world = _world(None)
    tree = world.node_tree
    gradient, place = tree.nodes.new("ShaderNodeTexGradient"), tree.nodes.new("ShaderNodeTexCoord")
    tree.links.new(place.outputs["Generated"], gradient.inputs["Vector"])
    tree.links.new(gradient.outputs["Color"], next(n for n in tree.nodes if n.type == "BACKGROUND").inputs["Color"])
    _sees_what_cycles_shows(world, _some())
    assert [w.name for w in bpy.data.worlds] == ["Room"]


def _corrected(world):
    """A Gamma node between picture and background: nodes that are rendered."""
    tree = world.node_tree
    gamma, background = tree.nodes.new("ShaderNodeGamma"), next(n for n in tree.nodes if n.type == "BACKGROUND")
    gamma.inputs["Gamma"].default_value = 1.2
    picture = next(n for n in tree.nodes if n.type == "TEX_ENVIRONMENT")
    tree.links.new(picture.outputs["Color"], gamma.inputs["Color"])
    tree.links.new(gamma.outputs["Color"], background.inputs["Color"])
    return picture


def test_rendered_nodes_have_their_picture_and_their_values_of_this_frame(picture, tmp_path):
    """The picture is given relative to the .blend, and the world turns from frame 1 on."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    world = _world(picture, rotation=(0, 0, 0))
    image = _corrected(world).image
    image.filepath = bpy.path.relpath(image.filepath)
    turn = next(n for n in world.node_tree.nodes if n.type == "MAPPING").inputs["Rotation"]
    turn.keyframe_insert("default_value", frame=1)
    turn.default_value = (0, 0, 2)
    turn.keyframe_insert("default_value", frame=20)
    bpy.context.scene.frame_set(20)
    bpy.context.view_layer.update()
    _sees_what_cycles_shows(world, _some())
    assert image.filepath == "//sky.exr"


def _in_group(world, output: str):
    """The world's shader from a group that mixes by an output of Light Path."""
    group = bpy.data.node_groups.new("Room", "ShaderNodeTree")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    names = ("ShaderNodeLightPath", "NodeReroute", "ShaderNodeMixShader", "NodeGroupOutput")
    path, between, mix, out = (group.nodes.new(name) for name in names)
    for socket, color in ((1, (0.2, 0.4, 0.6, 1)), (2, (9, 0, 0, 1))):
        background = group.nodes.new("ShaderNodeBackground")
        background.inputs["Color"].default_value = color
        group.links.new(background.outputs[0], mix.inputs[socket])
    group.links.new(path.outputs[output], between.inputs[0])
    group.links.new(between.outputs[0], mix.inputs[0])
    group.links.new(mix.outputs[0], out.inputs[0])
    node = world.node_tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    world.node_tree.links.new(node.outputs[0], world.node_tree.get_output_node("CYCLES").inputs["Surface"])


def test_light_paths_in_groups(picture):
    world = _world(None)
    _in_group(world, "Is Camera Ray")
    assert np.allclose(read_environment(world, 0.0, pytest.fail).radiance, (0.2, 0.4, 0.6), atol=1e-3)
    world = _world(None)
    _in_group(world, "Is Diffuse Ray")
    with pytest.raises(BadInput, match=r"'Room.*Light Path node uses 'Is Diffuse Ray'"):
        read_environment(world, 0.0, pytest.fail)


def test_coordinates_that_a_camera_decides_are_refused_where_surfaces_see_them(picture):
    world = _world(picture)
    tree, node = world.node_tree, _corrected(world)
    place, path, mix, other = (tree.nodes.new(f"ShaderNode{n}") for n in ("TexCoord", "LightPath", "MixShader",
                                                                          "Background"))
    tree.links.new(place.outputs["Window"], other.inputs["Color"])
    tree.links.new(path.outputs["Is Camera Ray"], mix.inputs[0])
    tree.links.new(next(n for n in tree.nodes if n.type == "BACKGROUND").outputs[0], mix.inputs[1])
    tree.links.new(other.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    assert read_environment(world, 0.0, pytest.fail) is not None
    tree.links.new(place.outputs["Camera"], node.inputs["Vector"])
    with pytest.raises(BadInput, match=r"'Room.*Texture Coordinate node uses 'Camera'"):
        read_environment(world, 0.0, pytest.fail)


def test_rendered_nodes_without_their_picture(picture):
    world = _world(picture)
    _corrected(world)
    picture.unlink()
    with pytest.raises(BadInput, match=r"sky\.exr' does not exist"):
        read_environment(world, 0.0, pytest.fail)


def test_the_disc_of_a_sky_node_is_as_bright_as_cycles_renders_it(picture):
    """A white floor under a sun of half a degree, the whole of whose light comes from two pixels."""
    from tests.blender import cycles_rig as rig

    rig.scene(8, samples=1024)
    rig.principled(rig.plane(), (1, 1, 1), 0.5, specular=0.0)
    rig.camera((0, 0, 2))
    world = _world(None)
    tree = world.node_tree
    sky = tree.nodes.new("ShaderNodeTexSky")
    sky.sky_type = "NISHITA" if bpy.app.version < (5, 0, 0) else "SINGLE_SCATTERING"
    sky.sun_elevation, sky.sun_rotation = 0.5, 2.5
    background = next(n for n in tree.nodes if n.type == "BACKGROUND")
    background.inputs["Strength"].default_value = 0.1
    tree.links.new(sky.outputs["Color"], background.inputs["Color"])
    found = read_environment(world, 0.0, pytest.fail).radiance
    toward, solid = texel_directions(*found.shape[:2])
    irradiance = (found * (np.maximum(toward[..., 2], 0) * solid)[..., None]).sum((0, 1))
    assert np.allclose(irradiance, rig.render()["rgb"].mean((0, 1)) * np.pi, rtol=0.01)


def test_plain_colours_and_black(picture):
    world = _world(None, strength=2.0)
    socket = next(n for n in world.node_tree.nodes if n.type == "BACKGROUND").inputs["Color"]
    socket.default_value = (0.1, 0.2, 0.3, 1)
    assert np.allclose(read_environment(world, 0.0, pytest.fail).radiance, (0.2, 0.4, 0.6))
    assert not is_black(world)
    socket.default_value = (0, 0, 0, 1)
    assert is_black(world)
    assert read_environment(world, 0.0, pytest.fail) is None


def test_a_turn_takes_the_light_about_z(picture):
    world = _world(picture)
    d = _some()
    turned = read_environment(world, math.radians(40), pytest.fail)
    still = read_environment(world, 0.0, pytest.fail)
    c, s = math.cos(math.radians(40)), math.sin(math.radians(40))
    # What shone from d shines from d turned by 40 degrees against the clock.
    there = d @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
    assert np.allclose(there @ turned.rotation.T, d @ still.rotation.T)


def test_pictures_that_cannot_be_used_are_named_in_one_line(picture, tmp_path):
    world = _world(picture)
    picture.unlink()
    with pytest.raises(BadInput, match=r"sky\.exr"):
        read_environment(world, 0.0, pytest.fail)
    broken = skies.radiance(skies.unit_directions(16))
    broken[:8] = np.nan
    _hdr(tmp_path / "sky.exr", broken)
    with pytest.raises(BadInput, match="NaN or infinite"):
        read_environment(world, 0.0, pytest.fail)
    some = skies.radiance(skies.unit_directions(32))
    some[3, 4] = np.inf
    some[5, :20] = -1.0
    _hdr(tmp_path / "sky.exr", some)
    said: list[str] = []
    found = read_environment(world, 0.0, said.append)
    assert len(said) == 2 and np.isfinite(found.radiance).all() and found.radiance.min() >= 0
    _hdr(tmp_path / "sky.exr", np.ones((40, 41, 3)))
    said.clear()
    read_environment(world, 0.0, said.append)
    assert len(said) == 1 and "stretches" in said[0]
    _hdr(tmp_path / "sky.exr", np.ones((20, 9000, 3)))
    assert read_environment(world, 0.0, said.append).radiance.shape[1] <= 2048


def test_a_sun_that_is_cut_off_is_named(picture, tmp_path):
    """And not one that the picture holds in full."""
    bright = skies.radiance(skies.unit_directions(256), sun=300.0, width=0.06)
    world, said = _world(picture), list[str]()
    _hdr(tmp_path / "sky.exr", bright)
    read_environment(world, 0.0, said.append)
    assert not said
    _hdr(tmp_path / "sky.exr", np.minimum(bright, 20.0))
    assert read_environment(world, 0.0, said.append) is not None
    line = r"sky\.exr.*: \d+ pixels have its highest value, 20, so lights in it seem to be clipped"
    assert len(said) == 1 and re.match(line, said[0])
    image = next(n for n in world.node_tree.nodes if n.type == "TEX_ENVIRONMENT").image
    image.reload()
    image.pack()
    read_environment(world, 0.0, said.append)
    assert len(said) == 2 and re.search(line, said[1])


def test_real_pictures_are_named_only_where_they_are_cut_off():
    """Those that come with Blender, whole, and with their hundred brightest pixels cut off."""
    folder = Path(bpy.utils.resource_path("LOCAL")) / "datafiles" / "studiolights" / "world"
    named = []
    for path in folder.glob("*.exr"):
        assert not any("clipped" in line for line in read_environment_image(path, None)[1])
        picture = np.asarray(OpenImageIO.ImageBuf(str(path)).get_pixels(OpenImageIO.FLOAT))[..., :3].clip(0)
        cut = BrightestPixels()
        cut.add(np.minimum(picture, np.sort(picture.max(-1).ravel())[-101]))
        named.append(cut.clipped() > 0)
    assert len(named) == 8
    assert sum(named) >= 6  # skies without a sun lack little then


def test_a_texture_without_an_image_is_refused(picture):
    world = _world(picture)
    next(n for n in world.node_tree.nodes if n.type == "TEX_ENVIRONMENT").image = None
    with pytest.raises(BadInput, match="world 'Room': its Environment Texture has no image"):
        read_environment(world, 0.0, pytest.fail)


def test_colour_spaces_of_pictures(picture):
    """Those that Blender has and IRPSO does not know are refused; Blender's name for its own space is known."""
    world = _world(picture)
    image = next(n for n in world.node_tree.nodes if n.type == "TEX_ENVIRONMENT").image
    image.colorspace_settings.name = "Linear Rec.709"
    given = read_environment(world, 0.0, pytest.fail).radiance
    if bpy.app.version >= (5, 0, 0):
        image.colorspace_settings.name = "scene_linear"  # Working Space
        assert np.array_equal(read_environment(world, 0.0, pytest.fail).radiance, given)
    for name in ("Filmic Log", "AgX Log"):
        image.colorspace_settings.name = name
        with pytest.raises(BadInput, match=rf"sky\.exr: colour space '{name}' is not known"):
            read_environment(world, 0.0, pytest.fail)


def test_a_packed_picture_of_8_bits(picture, tmp_path):
    buffer = OpenImageIO.ImageBuf(OpenImageIO.ImageSpec(64, 32, 3, OpenImageIO.UINT8))
    OpenImageIO.ImageBufAlgo.fill(buffer, (0.5, 0.5, 0.5))
    assert buffer.write(str(tmp_path / "sky.png"))
    world = _world(tmp_path / "sky.png")
    image = next(n for n in world.node_tree.nodes if n.type == "TEX_ENVIRONMENT").image
    image.pack()
    said: list[str] = []
    assert read_environment(world, 0.0, said.append) is not None
    assert len(said) == 1 and said[0].startswith("sky.png: has 8 bits per channel")
    image.colorspace_settings.name = "Filmic Log"
    with pytest.raises(BadInput, match=r"'sky\.png' \(of the world\): colour space 'Filmic Log' is not known"):
        read_environment(world, 0.0, said.append)
