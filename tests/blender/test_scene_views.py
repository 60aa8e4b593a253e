"""Which object, which views, which settings; and that reading leaves the file as it was.

No ``from __future__ import annotations`` here: Blender takes properties from the annotations of a class.
"""

import json

import bpy
import numpy as np
import OpenImageIO
import pytest

from irpso_addon.blender.scene.scene import read_scene
from irpso_addon.core.errors import BadInput
from irpso_addon.core.images.reference_image import read_reference


def write_captures(stage, *views):
    stage.captures.write_text(json.dumps({"views": list(views)}), encoding="utf-8")


def bad(stage, **more):
    with pytest.raises(BadInput) as caught:
        stage.read(**more)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def add_light(stage, name, **settings):
    light = bpy.data.objects.new(name, bpy.data.lights.new(name, "SUN"))
    stage.scene.collection.objects.link(light)
    for key, value in settings.items():
        setattr(light, key, value)
    return light


# --- the object


def test_object_by_name_active_or_only(stage):
    assert stage.read(name="Subject").mesh.name == "Subject"
    bpy.context.view_layer.objects.active = None
    assert stage.read(name=None).mesh.name == "Subject"  # the only one
    bpy.ops.mesh.primitive_cube_add()
    bpy.context.object.name = "Box"
    assert stage.read(name=None).mesh.name == "Box"  # the active one
    bpy.context.view_layer.objects.active = stage.camera
    assert "'Subject', 'Box'" in bad(stage, name=None) or "'Box', 'Subject'" in bad(stage, name=None)
    bpy.data.objects["Box"].hide_render = True
    assert stage.read(name=None).mesh.name == "Subject"


def test_wrong_objects(stage):
    assert bad(stage, name="Nobody").startswith("object 'Nobody': is not in scene 'Scene'; it has 'Subject'")
    assert bad(stage, name="Cam") == "object 'Cam': is a camera, not a mesh; choose a mesh"
    bpy.data.objects.remove(stage.subject)
    assert "has no mesh" in bad(stage, name=None)


def test_a_scene_never_saved(empty):
    bpy.ops.mesh.primitive_plane_add()
    with pytest.raises(BadInput, match="never saved"):
        read_scene(None, None, None)


# --- views from captures.json


def test_captures(stage):
    add_light(stage, "Sun", hide_render=True)  # named: it counts, though it is off now
    view = {"image": "refs/a.exr", "camera": "Cam", "lights": ["Key", "Sun"], "exposure": 2, "mask": "m.png",
            "colorspace": "ACEScg", "ambient": "dark.exr", "flat": "refs/flat.exr", "vignetting": 3.5,
            "response": 0.9, "shoulder": 4, "ambient_radiance": [0.1, 0.2, 0], "black_level": [0.01, 0, -0.02],
            "tint": [1.1, 1, 0.9]}
    write_captures(stage, view, view | {"image": "refs/b.exr"})
    stage.scene.cycles.film_exposure = 0.5
    read = stage.read()
    assert read.name == "stage" and len(read.views) == 2 and read.views[0].camera is read.views[1].camera
    found = read.views[0]
    assert found.image == stage.folder / "refs/a.exr" and found.mask == stage.folder / "m.png"
    assert [light.name for light in found.lights] == ["Key", "Sun"]
    assert (found.exposure, found.gain, found.colorspace, found.vignetting) == (2, 0.5, "ACEScg", 3.5)
    assert (found.response, found.shoulder, found.ambient_radiance) == (0.9, 4, (0.1, 0.2, 0))
    assert (found.black_level, found.tint) == ((0.01, 0, -0.02), (1.1, 1, 0.9))
    assert (found.ambient, found.flat) == (stage.folder / "dark.exr", stage.folder / "refs/flat.exr")
    stage.scene.render.engine = "BLENDER_WORKBENCH"
    assert stage.read().views[0].gain == 1


@pytest.mark.parametrize(("view", "words"), [
    ({"camera": "Nobody"}, "view 1: camera 'Nobody' does not exist in the scene; there are: 'Cam'"),
    ({"camera": "Key"}, "view 1: camera 'Key' is a light"),
    ({"lights": ["Key", "Moon"]}, "view 1: light 'Moon' does not exist in the scene; there are: 'Key'"),
    ({"lights": ["Cam"]}, "view 1: light 'Cam' is a camera"),
    ({"lights": []}, 'view 1: has no light and the world is black'),
])
def test_captures_name_what_does_not_exist(stage, view, words):
    fine = {"image": "a.exr", "camera": "Cam", "lights": ["Key"]}
    write_captures(stage, fine, fine | view)
    message = bad(stage)
    assert message.startswith(f"{stage.captures}: ") and words in message


def test_no_capture_file(stage):
    assert "none.json" in bad(stage, captures=stage.folder / "none.json")


# --- views from the scene's own list


@pytest.fixture
def view_list():
    """The list as the add-on's properties define it, here with nothing else of the add-on."""

    class TestLight(bpy.types.PropertyGroup):
        light: bpy.props.PointerProperty(type=bpy.types.Object)

    class TestView(bpy.types.PropertyGroup):
        image: bpy.props.StringProperty()
        camera: bpy.props.PointerProperty(type=bpy.types.Object)
        lights: bpy.props.CollectionProperty(type=TestLight)
        exposure: bpy.props.FloatProperty()
        mask: bpy.props.StringProperty()
        ambient: bpy.props.StringProperty()
        vignetting: bpy.props.FloatProperty()
        response: bpy.props.FloatProperty(default=1.0)
        shoulder: bpy.props.FloatProperty(default=1.0)
        ambient_radiance: bpy.props.FloatVectorProperty(size=3)
        black_level: bpy.props.FloatVectorProperty(size=3)
        tint: bpy.props.FloatVectorProperty(size=3, default=(1.0, 1.0, 1.0))
        turn: bpy.props.FloatProperty()
        flat: bpy.props.StringProperty()
        enabled: bpy.props.BoolProperty(default=True)
        colorspace: bpy.props.StringProperty()

    class TestScene(bpy.types.PropertyGroup):
        views: bpy.props.CollectionProperty(type=TestView)

    classes = [TestLight, TestView, TestScene]
    for cls in classes:
        bpy.utils.register_class(cls)
    bpy.types.Scene.irpso = bpy.props.PointerProperty(type=TestScene)
    yield
    del bpy.types.Scene.irpso
    for cls in reversed(classes):
        bpy.utils.unregister_class(cls)


def test_the_scenes_own_list(stage, view_list):
    add_light(stage, "Sun")
    add_light(stage, "Off", hide_render=True)
    entry = stage.scene.irpso.views.add()
    entry.image, entry.camera, entry.exposure, entry.mask = "//refs/a.exr", stage.camera, 1.0, "//m.png"
    chosen = stage.scene.irpso.views.add()
    chosen.image, chosen.camera = "//b.exr", stage.camera
    chosen.lights.add().light = stage.key
    chosen.colorspace, chosen.ambient, chosen.flat = "ACEScg", "//dark.exr", "//flat.exr"
    chosen.vignetting, chosen.response, chosen.ambient_radiance = 2.5, 0.5, (0.25, 0.5, 0.0)
    chosen.shoulder = 6.0
    chosen.black_level, chosen.tint = (0.125, 0.0, -0.25), (1.25, 1.0, 0.75)
    off = stage.scene.irpso.views.add()
    off.image, off.enabled = "//c.exr", False
    read = stage.read(captures=None)
    first, second = read.views
    assert first.image == stage.folder / "refs/a.exr" and first.mask == stage.folder / "m.png" and first.exposure == 1
    assert [light.name for light in first.lights] == ["Key", "Sun"] and second.mask is None
    assert [light.name for light in second.lights] == ["Key"]
    assert first.colorspace is None and second.colorspace == "ACEScg" and first.ambient is first.flat is None
    assert (second.ambient, second.flat) == (stage.folder / "dark.exr", stage.folder / "flat.exr")
    assert (first.vignetting, second.vignetting) == (0, 2.5)
    assert (first.response, second.response, first.shoulder, second.shoulder) == (1, 0.5, 1, 6)
    assert (first.ambient_radiance, second.ambient_radiance) == ((0, 0, 0), (0.25, 0.5, 0))
    assert (first.black_level, second.black_level) == ((0, 0, 0), (0.125, 0, -0.25))
    assert (first.tint, second.tint) == ((1, 1, 1), (1.25, 1, 0.75))
    assert read.skipped == (("//c.exr", "switched off"),)
    chosen.lights.add()
    assert "view 1" in bad(stage, captures=None) and "empty light" in bad(stage, captures=None)
    entry.camera = None
    assert "view 0" in bad(stage, captures=None) and "no camera" in bad(stage, captures=None)
    entry.image = ""
    assert "no image" in bad(stage, captures=None)
    for item in stage.scene.irpso.views:
        item.enabled = False
    assert "no view" in bad(stage, captures=None)


# --- views from background images


def add_background(stage, path, name="Photo"):
    image = bpy.data.images.new(name, 3, 2)
    image.filepath_raw, image.file_format = str(path), "PNG"
    image.save()
    image = bpy.data.images.load(str(path))
    background = stage.camera.data.background_images.new()
    background.image = image
    return image


@pytest.mark.parametrize("name", ["Subject", "Cam", "Key", "every light"])
def test_names_that_a_linked_object_has_too(stage, view_list, name):
    """The scene has two objects of one name; by the name alone the linked one would be read."""
    alike = "Key" if name == "every light" else name
    library = stage.folder / "library.blend"
    bpy.data.libraries.write(str(library), {bpy.data.objects[alike]})
    view = stage.scene.irpso.views.add()
    view.image, view.camera = "//a.exr", stage.camera
    if name != "every light":
        view.lights.add().light = stage.key
    stage.read(captures=None)
    with bpy.data.libraries.load(str(library), link=True) as (_, into):
        into.objects = [alike]
    stage.scene.collection.objects.link(into.objects[0])
    assert f"'{alike}': is the name of two objects in the scene" in bad(stage, captures=None)
    local = next(obj for obj in stage.scene.objects if obj.name == alike and obj.library is None)
    local.name = "Mine"
    stage.read(name="Mine" if name == "Subject" else "Subject", captures=None)


def test_background_images(stage):
    add_light(stage, "Sun")
    image = add_background(stage, stage.folder / "photo.png")
    image.filepath = "//photo.png"
    image.colorspace_settings.name = "Linear Rec.2020"
    [view] = stage.read(captures=None).views
    assert view.image == stage.folder / "photo.png" and view.colorspace == "Linear Rec.2020"
    assert [light.name for light in view.lights] == ["Key", "Sun"] and view.camera.name == "Cam"
    image.pack()
    assert "unpack it" in bad(stage, captures=None)


def test_nothing_to_read_from(stage):
    assert "has no view" in bad(stage, captures=None)
    add_background(stage, stage.folder / "photo.png")
    stage.key.hide_render = True
    assert "has no light that renders" in bad(stage, captures=None)
    bpy.data.objects.remove(stage.camera)
    assert "has no camera" in bad(stage, captures=None)


# --- settings


@pytest.mark.parametrize(("kind", "width", "samples"), [
    ("BOX", 1.0, 400), ("BOX", 0.01, 400), ("GAUSSIAN", 1.5, 400), ("BLACKMAN_HARRIS", 1.5, 400),
    ("BLACKMAN_HARRIS", 0.8, 400), ("BLACKMAN_HARRIS", 1.5, 1),
])
def test_pixel_filter_is_as_wide_as_that_of_cycles(stage, kind, width, samples):
    """The standard deviation of a thin line's picture, the line moved under the pixels by eighths."""
    cycles, render = stage.scene.cycles, stage.scene.render
    cycles.pixel_filter_type, cycles.filter_width, cycles.samples = kind, width, samples
    cycles.use_denoising = cycles.use_adaptive_sampling = False
    want = stage.read().pixel_filter
    tree = stage.subject.data.materials[0].node_tree
    emission = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(emission.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    stage.subject.scale = (0.0625, 100, 1)  # an eighth of a pixel wide
    camera = stage.camera.data
    camera.type, camera.ortho_scale, camera.sensor_fit = "ORTHO", 7, "HORIZONTAL"
    render.resolution_x, render.resolution_y = 7, 64
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    profile = np.zeros(7 * 8)
    for i in range(8):
        stage.subject.location.x = (i + 0.5) / 8 - 0.5
        render.filepath = str(stage.folder / "line.exr")
        bpy.ops.render.render(write_still=True)
        file = OpenImageIO.ImageInput.open(render.filepath)
        profile[7 - i::8] = np.asarray(file.read_image("float"))[..., 0].mean(0)
    x = (np.arange(56) - 27.5) / 8
    centre = (profile * x).sum() / profile.sum()
    variance = (profile * (x - centre) ** 2).sum() / profile.sum()
    line = 0.125**2 / 12
    assert np.sqrt(12 * max(variance - line, 0)) == pytest.approx(want, rel=0.03, abs=0.1 if samples == 1 else 0)


def test_pixel_filter_of_other_engines(stage):
    stage.scene.render.engine = "BLENDER_WORKBENCH"
    assert stage.read().pixel_filter == 1


def test_beside_lamps_a_world_with_a_picture_or_nodes_alone_is_light(stage):
    """Every new file has a world of one colour."""
    def environment():
        found = stage.read()
        assert not found.warnings
        return found.views[0].environment

    world = bpy.data.worlds.new("Sky")
    stage.scene.world = world
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    background = next(n for n in world.node_tree.nodes if n.type == "BACKGROUND")
    assert environment() is None
    world.node_tree.links.new(world.node_tree.nodes.new("ShaderNodeTexSky").outputs[0], background.inputs["Color"])
    assert environment().radiance.max() > 0
    background.inputs["Strength"].default_value = 0
    assert environment() is None


def test_views_without_lamps_are_lit_by_the_world(stage):
    stage.scene.world = bpy.data.worlds.new("Sky")
    write_captures(stage, {"image": "a.exr", "camera": "Cam", "lights": []},
                   {"image": "b.exr", "camera": "Cam", "lights": [], "turn": 90},
                   {"image": "c.exr", "camera": "Cam", "lights": [], "world": "Sky"})
    first, second, third = stage.read().views
    assert first.lights == () and first.environment is third.environment is not None  # of one colour
    assert second.environment is not first.environment
    write_captures(stage, {"image": "a.exr", "camera": "Cam", "lights": [], "world": "Moon"})
    assert "world 'Moon' does not exist" in bad(stage)


def test_images_that_may_have_a_view_transform_are_named(stage):
    stage.scene.view_settings.view_transform = "AgX"
    assert not stage.read().warnings  # EXR
    view = {"image": "a.png", "camera": "Cam", "lights": ["Key"]}
    write_captures(stage, view)
    assert any("AgX" in w for w in stage.read().warnings)
    write_captures(stage, view | {"colorspace": "Linear Rec.709"})
    assert not stage.read().warnings


@pytest.mark.skipif(bpy.app.version < (5, 0, 0), reason="one working space only")
def test_other_working_spaces(stage):
    bpy.ops.wm.set_working_color_space(working_space="ACEScg")
    assert "working colour space is ACEScg" in bad(stage)


# --- nothing changes


def counts():
    return {name: len(getattr(bpy.data, name)) for name in dir(bpy.data)
            if isinstance(getattr(bpy.data, name), bpy.types.bpy_prop_collection)}


@pytest.mark.parametrize("mode", ["OBJECT", "EDIT"])
def test_reading_changes_nothing(stage, mode):
    bpy.ops.mesh.primitive_monkey_add()
    monkey = bpy.context.object
    monkey.modifiers.new("Sub", "SUBSURF")
    tree_of = bpy.data.materials.new("Skin")
    monkey.data.materials.append(tree_of)
    if bpy.app.version < (5, 0, 0):
        tree_of.use_nodes = True
    tree = tree_of.node_tree
    image = bpy.data.images.new("Normals", 4, 4, is_data=True)
    image.pack()
    texture, node = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeNormalMap")
    texture.image = image
    tree.links.new(texture.outputs[0], node.inputs["Color"])
    tree.links.new(node.outputs[0], next(n for n in tree.nodes if n.type == "BSDF_PRINCIPLED").inputs["Normal"])
    add_light(stage, "Sun")
    bpy.ops.wm.save_mainfile()
    bpy.ops.object.mode_set(mode=mode)
    bpy.ops.wm.save_mainfile()
    before, selected = counts(), [o.name for o in bpy.context.selected_objects]
    vertices = len(monkey.data.vertices), len(monkey.data.attributes)
    dirty = bpy.data.is_dirty
    read = stage.read(name=monkey.name)
    assert read.mesh.tangents is not None
    assert counts() == before and bpy.data.is_dirty == dirty
    assert monkey.mode == mode and bpy.context.object == monkey
    assert [o.name for o in bpy.context.selected_objects] == selected
    assert (len(monkey.data.vertices), len(monkey.data.attributes)) == vertices
    again = stage.read(name=monkey.name)
    for field in ("positions", "normals", "uvs", "tangents"):
        np.testing.assert_array_equal(getattr(read.mesh, field), getattr(again.mesh, field))


# --- files that Blender itself writes


@pytest.mark.parametrize("form", ["OPEN_EXR", "OPEN_EXR_MULTILAYER", "PNG", "TIFF", "HDR"])
def test_files_that_blender_writes(stage, form):
    """The same render in each format: a lit plane over a transparent film."""
    scene = stage.scene
    stage.key.data.energy = 60
    scene.render.film_transparent = True
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = 1, False, False
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 0.01
    scene.view_settings.view_transform = "Standard"
    scene.view_layers[0].use_pass_z = scene.view_layers[0].use_pass_normal = True
    stage.camera.data.type, stage.camera.data.ortho_scale = "ORTHO", 4

    def render(form):
        settings = scene.render.image_settings
        if bpy.app.version >= (5, 0, 0):
            settings.media_type = "MULTI_LAYER_IMAGE" if form.endswith("MULTILAYER") else "IMAGE"
        settings.file_format = form
        settings.color_mode = "RGB" if form == "HDR" else "RGBA"
        if form != "HDR":
            settings.color_depth = "16" if form in {"PNG", "TIFF"} else "32"
        path = stage.folder / f"{form}.{ {'PNG': 'png', 'TIFF': 'tif', 'HDR': 'hdr'}.get(form, 'exr') }"
        scene.render.filepath = str(path)
        bpy.ops.render.render(write_still=True)
        write_captures(stage, {"image": path.name, "camera": "Cam", "lights": ["Key"]})
        return read_reference(stage.read().views[0])

    truth = render("OPEN_EXR")
    exact = OpenImageIO.ImageBuf(str(stage.folder / "OPEN_EXR.exr")).get_pixels(OpenImageIO.FLOAT)[::-1]
    np.testing.assert_array_equal(truth.coverage, exact[..., 3])
    seen = truth.coverage == 1
    assert 100 < seen.sum() < 800
    np.testing.assert_array_equal(truth.rgb[seen], exact[..., :3][seen])
    found = render(form)
    tolerance = {"OPEN_EXR": 0, "OPEN_EXR_MULTILAYER": 0, "HDR": 8e-3}.get(form, 3e-4)
    np.testing.assert_allclose(found.rgb[seen], truth.rgb[seen], rtol=tolerance)
    if form != "HDR":
        np.testing.assert_allclose(found.coverage, truth.coverage, atol=1e-4)
    assert ["without a colour space" in line for line in found.warnings] == [True] * (form == "TIFF")


def test_colour_spaces_are_blenders(stage):
    """Blender converts a float image to linear Rec.709 when it loads it: the same file through both."""
    from irpso_addon.core.images.colour import SPACES

    pixels = np.random.default_rng(5).uniform(0.05, 0.9, (2, 3, 3)).astype(np.float32)
    path = stage.folder / "a.exr"
    spec = OpenImageIO.ImageSpec(3, 2, 3, "float")
    file = OpenImageIO.ImageOutput.create(str(path))
    assert file.open(str(path), spec) and file.write_image(pixels) and file.close()
    names = bpy.types.ColorManagedInputColorspaceSettings.bl_rna.properties["name"].enum_items
    blenders = {item.identifier for item in names}
    compared = 0
    for space in SPACES:
        if space not in blenders:
            continue
        image = bpy.data.images.load(str(path))
        image.colorspace_settings.name = space
        values = np.empty(2 * 3 * 4, np.float32)
        image.pixels.foreach_get(values)
        write_captures(stage, {"image": "a.exr", "camera": "Cam", "lights": ["Key"], "colorspace": space})
        found = read_reference(stage.read().views[0]).rgb
        truth = values.reshape(2, 3, 4)[..., :3]  # also what lies outside Rec.709, below 0
        np.testing.assert_allclose(found, truth, atol=2e-3, err_msg=space)
        bpy.data.images.remove(image)
        compared += 1
    assert compared >= 8


def test_the_object_that_is_solved_is_not_its_views_light(stage):
    """A panel may be active because its light was just set."""
    principled = stage.subject.data.materials[0].node_tree.nodes["Principled BSDF"]
    principled.inputs["Emission Strength"].default_value = 5
    principled.inputs["Emission Color"].default_value = (1, 1, 1, 1)
    view = {"image": "a.exr", "camera": "Cam"}
    write_captures(stage, {**view, "lights": ["Key", "Subject"]})
    assert "'Subject': is to be solved, but views name it as their light" in bad(stage)
    assert "'Subject': is to be solved" in bad(stage, name=None)  # it is the active object
    write_captures(stage, {**view, "lights": ["Key"]})  # a glowing part of it is no fault
    assert [light.name for light in stage.read().views[0].lights] == ["Key"]
