"""Cameras against Blender's own view frame and Cycles' Position pass; lights against what Cycles renders of them."""

from __future__ import annotations

import json
import math

import bmesh
import bpy
import numpy as np
import OpenImageIO
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Matrix, Vector

from irpso_addon.blender import properties
from irpso_addon.core.errors import BadInput

CAMERAS = {
    "plain": {},
    "portrait": {"size": (24, 36)},
    "fit width": {"size": (24, 36), "sensor_fit": "HORIZONTAL"},
    "fit height": {"sensor_fit": "VERTICAL", "sensor_height": 15},
    "shift": {"shift_x": 0.2, "shift_y": -0.1},
    "shift in a portrait": {"size": (24, 36), "shift_x": 0.2, "shift_y": -0.1},
    "pixel aspect": {"pixels": (2, 1), "shift_x": 0.1, "shift_y": 0.1},
    "tall pixels": {"pixels": (1, 1.5), "sensor_fit": "VERTICAL"},
    "percentage": {"percentage": 50, "lens": 85},
    "ortho": {"type": "ORTHO", "ortho_scale": 3},
    "ortho portrait, shift": {"type": "ORTHO", "ortho_scale": 3, "size": (24, 36), "shift_x": 0.2, "pixels": (1, 2)},
    "scaled": {"scale": (2, 3, 0.5)},
}


def set_camera(stage, size=(36, 24), pixels=(1, 1), percentage=100, scale=(1, 1, 1), **data):
    render = stage.scene.render
    render.resolution_x, render.resolution_y = size
    render.resolution_percentage = percentage
    render.pixel_aspect_x, render.pixel_aspect_y = pixels
    for name, value in data.items():
        setattr(stage.camera.data, name, value)
    stage.camera.matrix_world = (
        Matrix.Translation((0.3, -2.5, 3)) @ Matrix.Rotation(0.7, 4, "X") @ Matrix.Rotation(0.2, 4, "Z")
        @ Matrix.Diagonal((*scale, 1)))


def project(camera, points):
    """(n, 2) in 0..1, bottom left first, and (n,) distance along the view axis."""
    eye = np.c_[points, np.ones(len(points))] @ camera.world_to_camera.T
    clip = eye @ camera.projection.T
    return clip[:, :2] / clip[:, 3:] / 2 + 0.5, -eye[:, 2]


@pytest.mark.parametrize("case", CAMERAS)
def test_projection_is_blenders(stage, case):
    set_camera(stage, **CAMERAS[case])
    camera = stage.read().views[0].camera
    points = np.random.default_rng(1).uniform(-1, 1, (50, 3))
    found, depth = project(camera, points)
    truth = np.array([world_to_camera_view(stage.scene, stage.camera, Vector(p)) for p in points])
    np.testing.assert_allclose(found, truth[:, :2], atol=2e-6)
    np.testing.assert_allclose(depth, truth[:, 2], atol=1e-6)
    assert camera.orthographic == ("ortho" in case)
    width, height = CAMERAS[case].get("size", (36, 24))
    assert camera.aspect == width / height
    world = stage.camera.matrix_world
    np.testing.assert_allclose(camera.position, world.translation, atol=1e-6)
    np.testing.assert_allclose(camera.forward, -world.col[2].to_3d().normalized(), atol=1e-6)
    rotation = camera.world_to_camera[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)


@pytest.mark.parametrize("case", ["shift in a portrait", "pixel aspect", "ortho portrait, shift", "scaled"])
def test_projection_is_cycles(stage, case):
    """Positions that Cycles sees through pixel centres fall on pixel centres."""
    set_camera(stage, **CAMERAS[case])
    stage.subject.scale = (20, 20, 1)
    stage.scene.view_layers[0].use_pass_position = True
    seen = render(stage, "Position")
    h, w = seen.shape[:2]
    y, x = np.mgrid[0:h, 0:w]
    found, _ = project(stage.read().views[0].camera, seen.reshape(-1, 3))
    centres = np.stack([(x.ravel() + 0.5) / w, 1 - (y.ravel() + 0.5) / h], 1)
    assert (abs(found - centres) * (w, h)).max() < 0.01  # pixels


def render(stage, name, samples=1):
    """(h, w, 3) of one pass, row 0 at the top."""
    settings, cycles = stage.scene.render.image_settings, stage.scene.cycles
    if bpy.app.version >= (5, 0, 0):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
    cycles.samples, cycles.use_denoising, cycles.use_adaptive_sampling = samples, False, False
    cycles.pixel_filter_type, cycles.filter_width, cycles.max_bounces = "BOX", 0.01, 0
    cycles.light_sampling_threshold = cycles.sample_clamp_direct = 0
    path = stage.folder / "pass.exr"
    stage.scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    file, part = OpenImageIO.ImageInput.open(str(path)), 0
    while file.seek_subimage(part, 0):
        spec = file.spec()
        full = [c if c.count(".") > 1 else f"{spec.get_string_attribute('name')}.{c}" for c in spec.channelnames]
        index = [i for c in "RGBXYZ" for i, n in enumerate(full) if n.endswith(f"{name}.{c}")]
        if index:
            return np.asarray(file.read_image(part, 0, 0, spec.nchannels, OpenImageIO.FLOAT))[..., index]
        part += 1
    raise AssertionError(f"no pass {name}")


def test_cameras_that_cannot_be_used(stage):
    stage.camera.data.type = "PANO"
    with pytest.raises(BadInput, match=r"^camera 'Cam': is neither perspective nor orthographic"):
        stage.read()
    stage.camera.data.type = "PERSP"
    stage.camera.scale = (0, 0, 0)
    with pytest.raises(BadInput, match=r"^camera 'Cam': its scale is 0"):
        stage.read()
    stage.camera.scale = (1, 1, 1)
    stage.camera.data.dof.use_dof = True
    assert any("'Cam': depth of field" in w for w in stage.read().warnings)


def on_axis(light, distance):
    """(3,) irradiance at ``distance`` straight under a lamp that points down, facing it."""
    if light.kind == "SUN":
        return light.power
    if light.kind == "AREA":
        # Power over area pi is the radiance; the form factor of a small rectangle with its second-order term
        scale = np.linalg.norm(light.matrix[:3, :2], axis=0)
        a, b = np.array(light.size) * scale / distance
        area = a * b * (math.pi / 4 if light.shape in {"DISK", "ELLIPSE"} else 1)
        spread = light.spread / 2
        focus = 1 if spread > 1.57 else math.tan(spread) / (math.tan(spread) - spread)
        return light.power / math.pi / distance**2 * focus * (1 - area / math.pi)
    falloff = distance**2 + (light.radius**2 if light.soft_falloff else 0)
    return light.power / (4 * math.pi) / falloff


LIGHTS = {
    "point": {}, "point, exposed": {"exposure": 1.5}, "point, coloured": {"color": (1, 0.5, 0.25)},
    "point, warm": {"use_temperature": True, "temperature": 2700, "color": (0.9, 1, 0.5)},
    "point, soft": {"shadow_soft_size": 0.8}, "point, sphere": {"shadow_soft_size": 0.8, "use_soft_falloff": False},
    "point, not normalised": {"shadow_soft_size": 0.3, "normalize": False},
    "point, no radius, not normalised": {"normalize": False},
    "sun": {"kind": "SUN", "energy": 3}, "sun, wide": {"kind": "SUN", "energy": 3, "angle": 0.5},
    "sun, not normalised": {"kind": "SUN", "energy": 3, "angle": 0.5, "normalize": False},
    "spot": {"kind": "SPOT", "spot_size": 1.2, "spot_blend": 0.3},
    "spot, not normalised": {"kind": "SPOT", "shadow_soft_size": 0.1, "normalize": False},
    "area": {"kind": "AREA", "size": 0.2}, "area, disk": {"kind": "AREA", "shape": "DISK", "size": 0.3},
    "area, rectangle": {"kind": "AREA", "shape": "RECTANGLE", "size": 0.3, "size_y": 0.1},
    "area, not normalised": {"kind": "AREA", "shape": "RECTANGLE", "size": 0.3, "size_y": 0.1, "normalize": False},
    "area, ellipse, scaled, not normalised": {
        "kind": "AREA", "shape": "ELLIPSE", "size": 0.3, "size_y": 0.1, "normalize": False, "scale": (2, 0.5, 1)},
    "area, narrow": {"kind": "AREA", "size": 0.01, "spread": 1.0},
}


@pytest.mark.parametrize("case", LIGHTS)
def test_power_is_what_cycles_shines(stage, case):
    """A white Lambertian pixel straight under the lamp."""
    options = dict(LIGHTS[case])
    lamp = bpy.data.lights.new("L", options.pop("kind", "POINT"))
    lamp.energy, stage.key.scale = 50.0, options.pop("scale", (1, 1, 1))
    if lamp.type in {"POINT", "SPOT"}:
        lamp.shadow_soft_size = 0
    for name, value in options.items():
        setattr(lamp, name, value)
    stage.key.data = lamp
    tree = stage.subject.data.materials[0].node_tree
    diffuse = tree.nodes.new("ShaderNodeBsdfDiffuse")
    diffuse.inputs["Color"].default_value = (1, 1, 1, 1)
    tree.links.new(diffuse.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    set_camera(stage, size=(4, 4), type="ORTHO", ortho_scale=0.004)
    stage.camera.matrix_world = Matrix.Translation((0, 0, 5))
    soft = {"AREA": "size", "SUN": "angle"}.get(lamp.type, "shadow_soft_size")
    exact = getattr(lamp, soft) == 0
    radiance = render(stage, "Combined", 4 if exact else 400).mean((0, 1))
    light = stage.read().views[0].lights[0]
    np.testing.assert_allclose(radiance * math.pi, on_axis(light, 3.0), rtol=1e-5 if exact else 5e-3)
    assert light.kind == lamp.type and light.name == "Key"


def test_emission_nodes(stage):
    lamp = stage.key.data
    if bpy.app.version < (5, 0, 0):
        lamp.use_nodes = True
    plain = stage.read().views[0].lights[0].power
    emission = next(n for n in lamp.node_tree.nodes if n.type == "EMISSION")
    emission.inputs["Strength"].default_value = 0.5
    emission.inputs["Color"].default_value = (1, 0.5, 0.25, 1)
    read = stage.read()
    np.testing.assert_allclose(read.views[0].lights[0].power, plain * (0.5, 0.25, 0.125))
    assert not read.warnings
    tree = lamp.node_tree
    tree.links.new(tree.nodes.new("ShaderNodeLightFalloff").outputs[0], emission.inputs["Strength"])
    assert any("'Key': nodes" in w for w in stage.read().warnings)
    tree.links.new(tree.nodes.new("ShaderNodeTexIES").outputs[0], emission.inputs["Strength"])
    assert any("'Key': an IES profile" in w for w in stage.read().warnings)


def test_emission_behind_a_reroute_or_muted(stage):
    """As Cycles renders them: a reroute changes nothing, a muted link is none, a muted node is named."""
    if bpy.app.version < (5, 0, 0):
        stage.key.data.use_nodes = True
    tree = stage.key.data.node_tree
    emission, output = next(n for n in tree.nodes if n.type == "EMISSION"), tree.get_output_node("CYCLES")
    emission.inputs["Strength"].default_value = 3.0
    plain = stage.read().views[0].lights[0].power
    reroute = tree.nodes.new("NodeReroute")
    tree.links.new(emission.outputs[0], reroute.inputs[0])
    link = tree.links.new(reroute.outputs[0], output.inputs["Surface"])
    found = stage.read()
    assert np.array_equal(found.views[0].lights[0].power, plain) and not [w for w in found.warnings if "Key" in w]
    emission.mute = True
    assert any("'Key': nodes in it" in w for w in stage.read().warnings)
    emission.mute, link.is_muted = False, True
    assert not stage.read().views[0].lights[0].power.any()


def test_a_light_of_negative_power_is_refused(stage):
    stage.key.data.energy = -1.0
    with pytest.raises(BadInput, match="'Key': its power or colour is negative"):
        stage.read()


def test_light_linking_and_ray_visibility_are_named(stage):
    stage.key.light_linking.receiver_collection = bpy.data.collections.new("Only these")
    stage.key.visible_glossy = False
    text = " ".join(stage.read().warnings)
    assert "'Key': light linking" in text and "'Key': is hidden from" in text


@pytest.mark.parametrize("hidden", ["", "lamp", "instancer"])
def test_lamps_of_a_collection_instance_are_named(stage, hidden):
    """Cycles renders them, and the view of every light that renders does not have them."""
    rig = bpy.data.collections.new("Rig")
    lamp = bpy.data.objects.new("Rim", bpy.data.lights.new("Rim", "AREA"))
    rig.objects.link(lamp)
    instancer = bpy.data.objects.new("Left", None)
    instancer.instance_type, instancer.instance_collection = "COLLECTION", rig
    stage.scene.collection.objects.link(instancer)
    lamp.hide_render, instancer.hide_render = hidden == "lamp", hidden == "instancer"
    named = [line for line in stage.read().warnings if line.startswith("light 'Rim': shines as an instance of 'Left'")]
    assert len(named) == (not hidden)


def test_what_of_a_world_is_not_modelled_is_named(stage):
    world = bpy.data.worlds.new("Room")
    if world.node_tree is None:
        world.use_nodes = True
    stage.scene.world, tree, layer = world, world.node_tree, stage.scene.view_layers[0]
    background = next(node for node in tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (0.5, 0.5, 0.5, 1)
    stage.captures.write_text(stage.captures.read_text().replace('["Key"]', "[]"))
    found = stage.read()
    assert found.views[0].environment is not None and not [w for w in found.warnings if "Room" in w]
    world.cycles_visibility.glossy = False
    if hasattr(world.cycles, "use_shadows"):  # Blender 5
        world.cycles.use_shadows = False
    layer.use_sky = False
    volume = tree.nodes.new("ShaderNodeVolumeAbsorption")
    tree.links.new(volume.outputs[0], tree.get_output_node("CYCLES").inputs["Volume"])
    named = [line for line in stage.read().warnings if "Room" in line]
    for what in ("has a volume", "hidden from diffuse or glossy", "switches world 'Room' off"):
        assert sum(what in line for line in named) == 1, named
    assert any("casts no shadows" in line for line in named) == (bpy.app.version >= (5, 0, 0))
    lit = stage.captures.read_text()
    stage.captures.write_text(lit.replace("[]", '["Key"]'))  # beside which a grey world is no light
    assert [line for line in stage.read().warnings if "Room" in line] == [line for line in named if "volume" in line]
    stage.captures.write_text(lit)
    world.cycles_visibility.diffuse = False
    with pytest.raises(BadInput, match="the world is black"):
        stage.read()
    world.cycles_visibility.diffuse, layer.use_sky = True, True
    layer.world_override = bpy.data.worlds.new("Other")
    assert any("overrides it" in line for line in stage.read().warnings)


def _keyed(block, path, *values):
    """Keyframes of a property, at frames 1, 11 and so on."""
    for n, value in enumerate(values):
        setattr(block, path, value)
        block.keyframe_insert(path, frame=1 + 10 * n)


def test_what_differs_from_frame_to_frame_is_named(stage):
    """A turntable is often one animated camera, object or world; all views are read at the present frame."""
    world = bpy.data.worlds.new("Room")
    if world.node_tree is None:
        world.use_nodes = True
    background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value, stage.scene.world = (0.5, 0.5, 0.5, 1), world
    some = [{"image": f"{name}.exr", "camera": "Cam", "lights": ["Key"] * (name != "a")} for name in "abc"]

    def named(*views) -> list[str]:
        stage.captures.write_text(json.dumps({"views": views}))
        return [line for line in stage.read().warnings if "all views are read at frame 11" in line]

    _keyed(stage.subject, "location", (0, 0, 0), (0, 0, 0))  # keyframes of one place
    stage.scene.frame_set(11)
    assert not named(*some)
    turning = bpy.data.objects.new("Turning", None)
    stage.scene.collection.objects.link(turning)
    _keyed(turning, "rotation_euler", (0, 0, 0), (0, 0, 1))
    stage.camera.parent = turning
    stage.key.driver_add("location", 0).driver.expression = "0.1 * frame"
    _keyed(stage.subject, "rotation_euler", (0, 0, 0), (0, 0, 1))
    strength = background.inputs["Strength"]
    for frame, value in ((1, 1.0), (11, 2.0)):
        strength.default_value = value
        strength.keyframe_insert("default_value", frame=frame)
    stage.scene.frame_set(11)
    found = named(*some)
    assert [line.split(":")[0] for line in found] == [
        "object 'Subject'", "camera 'Cam'", "light 'Key'", "world 'Room'"]
    assert not named(some[0])  # one picture is of one frame


def test_fields(stage):
    lamp = bpy.data.lights.new("L", "SPOT")
    lamp.spot_size, lamp.spot_blend, lamp.shadow_soft_size, lamp.use_shadow = 0.9, 0.4, 0.25, False
    lamp.use_soft_falloff = False
    stage.key.data = lamp
    turn = Matrix.Rotation(0.4, 4, "X") @ Matrix.Diagonal((2, 1, 1, 1))
    stage.key.matrix_world = Matrix.Translation((1, 2, 3)) @ turn
    light = stage.read().views[0].lights[0]
    assert (light.spot_angle, light.spot_blend, light.radius) == pytest.approx((0.9, 0.4, 0.25))
    assert not light.cast_shadow and not light.soft_falloff
    np.testing.assert_allclose(light.matrix, stage.key.matrix_world, atol=1e-6)


def test_a_lamp_that_was_measured(extension, stage):
    assert not stage.read().views[0].lights[0].kept
    stage.key.irpso_keep = True
    assert stage.read().views[0].lights[0].kept


def test_a_light_disabled_in_the_viewport_keeps_its_place(stage):
    parent = bpy.data.objects.new("Rig", None)
    stage.scene.collection.objects.link(parent)
    parent.location, stage.key.parent = (1, 0, 0), parent
    wanted = Matrix.Translation((1, 0, 3))
    stage.key.hide_viewport = stage.camera.hide_viewport = True
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=bpy.data.filepath)
    view = stage.read().views[0]
    np.testing.assert_allclose(view.lights[0].matrix, wanted, atol=1e-6)
    np.testing.assert_allclose(view.camera.position, (0, 0, 4), atol=1e-6)


def test_lamps_that_views_name_and_the_viewport_hides_keep_their_place(stage):
    """A property that names an object pulls it into Blender's evaluation, but not into its transforms."""
    properties.register()
    try:
        stage.camera.location, stage.key.parent, stage.key.location = (1, 2, 5), stage.camera, (0.5, 0, 0)
        stage.key.hide_viewport = stage.key.hide_render = True
        view = stage.scene.irpso.views.add()
        view.image, view.camera = "//a.exr", stage.camera
        view.lights.add().light = stage.key
        bpy.ops.wm.save_mainfile()
        bpy.ops.wm.open_mainfile(filepath=bpy.data.filepath)
        light = stage.read(captures=None).views[0].lights[0]
        np.testing.assert_allclose(light.matrix, Matrix.Translation((1.5, 2, 5)), atol=1e-6)
    finally:
        properties.unregister()


def by_constraint(stage):
    target = bpy.data.objects.new("Target", None)
    stage.scene.collection.objects.link(target)
    target.location = (1, 2, 3)
    for obj in (stage.key, stage.camera, stage.subject):
        obj.constraints.new("COPY_LOCATION").target = target


def by_keyframes(stage):
    for obj in (stage.key, stage.camera, stage.subject):
        for frame, place in ((1, (0, 0, 3)), (10, (1, 2, 3))):
            obj.location = place
            obj.keyframe_insert("location", frame=frame)
    stage.scene.frame_set(1)


def by_a_parents_constraint(stage):
    by_constraint(stage)
    for obj in (stage.key, stage.camera, stage.subject):
        parent = bpy.data.objects.new(f"{obj.name}'s", None)
        stage.scene.collection.objects.link(parent)
        parent.constraints.new("COPY_LOCATION").target = bpy.data.objects["Target"]
        parent.hide_viewport, obj.parent = True, parent
        obj.constraints.clear()


@pytest.mark.parametrize("placed", [by_constraint, by_keyframes, by_a_parents_constraint])
@pytest.mark.parametrize("name", ["key", "camera", "subject"])
def test_what_blender_has_not_placed_is_refused(stage, placed, name):
    """Beside the object's own location these decide, and of what is disabled Blender evaluates none of them."""
    placed(stage)
    obj = getattr(stage, name)
    obj.hide_viewport = True
    stage.scene.frame_set(10)
    with pytest.raises(BadInput, match=rf"^\w+ '{obj.name}('s)?': is disabled .* so its .* enable it$"):
        stage.read()
    obj.hide_viewport = False
    for parent in bpy.data.objects:
        parent.hide_viewport = False
    read = stage.read()
    places = {"key": read.views[0].lights[0].matrix[:3, 3], "camera": read.views[0].camera.position,
              "subject": read.mesh.positions.reshape(-1, 3).mean(0)}
    np.testing.assert_allclose(places[name], np.array(obj.evaluated_get(
        bpy.context.evaluated_depsgraph_get()).matrix_world.translation), atol=1e-6)


def test_a_lamp_on_a_bone_in_an_excluded_collection_is_refused(stage):
    rig = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    stage.scene.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    bone = rig.data.edit_bones.new("Arm")
    bone.head, bone.tail = (1, 1, 1), (1, 1, 2)
    bpy.ops.object.mode_set(mode="OBJECT")
    stage.key.parent, stage.key.parent_type, stage.key.parent_bone = rig, "BONE", "Arm"
    lamps = bpy.data.collections.new("Lamps")
    stage.scene.collection.children.link(lamps)
    lamps.objects.link(stage.key)
    stage.scene.collection.objects.unlink(stage.key)
    stage.read()
    bpy.context.view_layer.layer_collection.children["Lamps"].exclude = True
    with pytest.raises(BadInput, match="light 'Key': is disabled in viewports or excluded, so the bones"):
        stage.read()


@pytest.mark.parametrize("shaped", ["modifier", "shape key"])
def test_a_subject_whose_shape_blender_has_not_evaluated_is_refused(stage, shaped):
    if shaped == "modifier":
        stage.subject.modifiers.new("Sub", "SUBSURF")
    else:
        stage.subject.shape_key_add(name="Basis")
        stage.subject.shape_key_add(name="Moved").value = 1.0
    stage.read()
    stage.subject.hide_viewport = True
    with pytest.raises(BadInput, match=r"'Subject': is disabled .* its modifiers and shape keys are ignored"):
        stage.read()


def test_a_flat_light(stage):
    stage.key.scale = (1, 1, 0)
    with pytest.raises(BadInput, match=r"^light 'Key': its scale is 0"):
        stage.read()


@pytest.mark.parametrize(("shape", "smooth", "said"), [
    ("ball", False, True), ("ball", True, False), ("small ball", False, False), ("box", False, False)])
def test_a_scan_that_is_shaded_flat_is_named(stage, shape, smooth, said) -> None:
    """A box of many faces has six planes, and few facets may be meant."""
    obj = bpy.data.objects["Subject"]
    made = bmesh.new()
    if shape == "box":
        bmesh.ops.create_cube(made)
        bmesh.ops.subdivide_edges(made, edges=made.edges, cuts=40, use_grid_fill=True)
    else:
        bmesh.ops.create_icosphere(made, subdivisions=4 if shape == "small ball" else 6, radius=1)
    made.loops.layers.uv.new("UVMap")
    for face in made.faces:
        face.smooth = smooth
        for loop in face.loops:
            loop[made.loops.layers.uv.active].uv = loop.vert.co.xy
    made.to_mesh(obj.data)
    lines = stage.read().warnings
    assert any(f"'{obj.name}': is shaded flat, so its " in line for line in lines) == said


@pytest.mark.parametrize(("noise", "subdivisions", "said"), [(0.1, 6, True), (0.0, 6, False), (0.1, 4, False)])
def test_a_scan_whose_corners_are_off_is_named(stage, noise, subdivisions, said) -> None:
    """By a part of an edge; of few faces, bumps may be meant."""
    obj = bpy.data.objects["Subject"]
    made = bmesh.new()
    bmesh.ops.create_icosphere(made, subdivisions=subdivisions, radius=1)
    made.loops.layers.uv.new("UVMap")
    rng, edge = np.random.default_rng(0), np.sqrt(4 * np.pi / len(made.faces))
    for vert in made.verts:
        vert.co += type(vert.co)(rng.normal(0, noise * edge, 3))
    for face in made.faces:
        face.smooth = True
        for loop in face.loops:
            loop[made.loops.layers.uv.active].uv = loop.vert.co.xy
    made.to_mesh(obj.data)
    named, remedy = "object 'Subject': the noise of its corners turns its normals by ", "Normals (panel Shoot)"
    lines = [line for line in stage.read().warnings if "noise of its corners" in line]
    assert len(lines) == said and all(line.startswith(named) and line.endswith(remedy) for line in lines)
