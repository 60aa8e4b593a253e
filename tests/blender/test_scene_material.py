"""Normal maps that materials use, against Cycles' own Normal pass; and what is not modelled is named."""

from __future__ import annotations

import bmesh
import bpy
import numpy as np
import OpenImageIO
import pytest

from irpso_addon.core.errors import BadInput


def principled(stage):
    return next(n for n in stage.subject.data.materials[0].node_tree.nodes if n.type == "BSDF_PRINCIPLED")


def add_normal_map(stage, uv_map="", size=8, is_data=True, seed=3):
    """Random tangent normals, sampled Closest; returns Normal Map node, Image Texture node."""
    rng = np.random.default_rng(seed)
    pixels = np.ones((size, size, 4), np.float32)
    pixels[..., :3] = rng.uniform((0.3, 0.3, 0.8), (0.7, 0.7, 1), (size, size, 3))
    image = bpy.data.images.new("Bumps", size, size, is_data=is_data)
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    material = stage.subject.data.materials[0]
    material.cycles.use_bump_map_correction = False
    tree = material.node_tree
    texture, node = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeNormalMap")
    texture.image, texture.interpolation, node.uv_map = image, "Closest", uv_map
    tree.links.new(texture.outputs["Color"], node.inputs["Color"])
    tree.links.new(node.outputs["Normal"], principled(stage).inputs["Normal"])
    return node, texture


def smooth_ngons(stage):
    """A tube of n-gon caps, quads and a weird UV layout, smooth-shaded."""
    bm = bmesh.new()
    bmesh.ops.create_cone(bm, cap_ends=True, segments=7, radius1=0.9, radius2=0.5, depth=0.8)
    layer = bm.loops.layers.uv.new("UVMap")
    for face in bm.faces:
        for loop in face.loops:
            co = loop.vert.co
            loop[layer].uv = (0.5 + 0.3 * co.x + 0.1 * co.z + 0.05 * co.y, 0.5 + 0.4 * co.y - 0.2 * co.z * co.x)
    bm.to_mesh(stage.subject.data)
    bm.free()
    stage.subject.data.shade_smooth()


def shading_normal(mesh, at, weights):
    """World normal at barycentric ``weights`` (n, 3) of triangles ``at``: as the G-buffer combines it."""
    def mix(values):
        return (values[at] * weights[..., None]).sum(1)

    uv, normal, tangent = mix(mesh.uvs), mix(mesh.object_normals), mix(mesh.tangents)
    sign = np.sign(tangent[:, 3:])
    found = mesh.normal_maps[0]
    size = len(found.pixels)
    texel = np.floor(uv * size).astype(int) % size
    c = found.pixels[texel[:, 1], texel[:, 0]] * 2 - 1
    c[:, :2] *= found.strength
    c[:, 2] = 1 + (c[:, 2] - 1) * np.clip(found.strength, 0, 1)
    if found.unit_normal:
        normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    combined = c[:, :1] * tangent[:, :3] + c[:, 1:2] * sign * np.cross(normal, tangent[:, :3]) + c[:, 2:] * normal
    world = combined @ mesh.normal_matrix.T
    return world / np.linalg.norm(world, axis=1, keepdims=True), uv * size % 1


def cast(mesh, origins, direction):
    """First hit of parallel rays: triangle and barycentric weights; -1 where none (Moeller, Trumbore 1997)."""
    a = mesh.positions[:, 0]
    e1, e2 = mesh.positions[:, 1] - a, mesh.positions[:, 2] - a
    best, at, weights = np.full(len(origins), np.inf), np.full(len(origins), -1), np.zeros((len(origins), 3))
    p = np.cross(direction, e2)
    inverse = 1 / np.where(abs((e1 * p).sum(1)) < 1e-12, np.inf, (e1 * p).sum(1))
    for i, origin in enumerate(origins):
        s = origin - a
        u = (s * p).sum(1) * inverse
        q = np.cross(s, e1)
        v, t = (q @ direction) * inverse, (e2 * q).sum(1) * inverse
        t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)
        k = int(np.argmin(t))
        if t[k] < best[i]:
            at[i], weights[i] = k, (1 - u[k] - v[k], u[k], v[k])
            best[i] = t[k]
    return at, weights


@pytest.mark.parametrize(("scale", "uv_map"), [
    ((1, 1, 1), ""), ((1.3, 0.8, 1), ""), ((-1, 1.2, 1), ""), ((1, 1, 1), "Second")])
def test_normals_are_those_of_cycles(stage, scale, uv_map):
    smooth_ngons(stage)
    stage.subject.data.normals_split_custom_set_from_vertices(
        [(v.co + 0.3 * v.co.cross((0, 0, 1))).normalized() for v in stage.subject.data.vertices])
    if uv_map:
        second = stage.subject.data.uv_layers.new(name=uv_map)
        for item in second.uv:  # tangents of another map, turned by a quarter
            item.vector = (item.vector[1], 1 - item.vector[0])
    node, _ = add_normal_map(stage, uv_map)
    node.inputs["Strength"].default_value = 0.8
    stage.subject.scale = scale
    scene = stage.scene
    scene.cycles.samples, scene.cycles.pixel_filter_type, scene.cycles.filter_width = 1, "BOX", 0.01
    scene.cycles.use_denoising = False
    scene.view_layers[0].use_pass_normal = True
    stage.camera.data.type, stage.camera.data.ortho_scale = "ORTHO", 2
    if bpy.app.version >= (5, 0, 0):
        scene.render.image_settings.media_type = "MULTI_LAYER_IMAGE"
    scene.render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    scene.render.filepath = str(stage.folder / "pass.exr")
    bpy.ops.render.render(write_still=True)
    truth = read_channels(stage.folder / "pass.exr", "Normal")
    mesh = stage.read().mesh
    h, w = truth.shape[:2]
    y, x = np.mgrid[0:h, 0:w]
    origins = np.stack([(x + 0.5) / w * 2 - 1, 1 * (h / w) - (y + 0.5) / h * 2 * h / w, np.full(x.shape, 4.0)], -1)
    at, weights = cast(mesh, origins.reshape(-1, 3), np.array([0.0, 0, -1]))
    truth = truth.reshape(-1, 3)[at >= 0]
    found, inside = shading_normal(mesh, at[at >= 0], weights[at >= 0])
    sure = (abs(inside - 0.5) < 0.45).all(1)  # a texel's border is anybody's
    degrees = np.degrees(np.arccos(np.clip((found * truth).sum(1), -1, 1)))[sure]
    assert len(degrees) > 150
    # Cycles 5 keeps corner normals in fewer bits.
    assert np.median(degrees) < 0.06 and np.quantile(degrees, 0.98) < 0.2, np.sort(degrees)[-20:]


def read_channels(path, name):
    """The three channels of the pass ``name``, row 0 at the top."""
    file = OpenImageIO.ImageInput.open(str(path))
    part = 0
    while file.seek_subimage(part, 0):
        names = file.spec().channelnames
        index = [i for i, n in enumerate(names) if f"{name}." in f"{file.spec().get_string_attribute('name')}.{n}"]
        index = sorted(index, key=lambda i: names[i])
        if len(index) >= 3:
            return np.asarray(file.read_image(part, 0, 0, len(names), OpenImageIO.FLOAT))[..., index[:3]]
        part += 1
    raise AssertionError(f"no pass {name}")


def test_pixels_as_the_shader_gets_them(stage):
    node, texture = add_normal_map(stage)
    node.inputs["Strength"].default_value = 0.7
    read = stage.read()
    stored = np.empty(8 * 8 * 4, np.float32)
    texture.image.pixels.foreach_get(stored)
    np.testing.assert_array_equal(read.mesh.normal_maps[0].pixels, stored.reshape(8, 8, 4)[..., :3])
    assert read.mesh.normal_maps[0].strength == pytest.approx(0.7) and not read.warnings
    assert read.mesh.tangents.shape == (2, 3, 4) and read.mesh.object_normals.shape == (2, 3, 3)
    texture.image.colorspace_settings.name = "sRGB"  # by mistake; Cycles decodes it then, and so does this
    read = stage.read()
    assert read.mesh.normal_maps[0].pixels.max() <= 1 and any("'sRGB'" in w for w in read.warnings)
    v = stored.reshape(8, 8, 4)[..., :3]
    np.testing.assert_allclose(read.mesh.normal_maps[0].pixels, ((v + 0.055) / 1.055) ** 2.4, rtol=1e-4)


def test_no_map_no_tangents(stage):
    mesh = stage.read().mesh
    assert mesh.tangents is None and mesh.object_normals is None and not mesh.normal_maps


def set_object_space(stage, node, texture):
    node.space = "OBJECT"


def insert_bump(stage, node, texture):
    tree = stage.subject.data.materials[0].node_tree
    bump = tree.nodes.new("ShaderNodeBump")
    tree.links.new(bump.outputs["Normal"], principled(stage).inputs["Normal"])


def link_strength(stage, node, texture):
    tree = stage.subject.data.materials[0].node_tree
    tree.links.new(tree.nodes.new("ShaderNodeValue").outputs[0], node.inputs["Strength"])


def scale_texture(stage, node, texture):
    tree = stage.subject.data.materials[0].node_tree
    tree.links.new(tree.nodes.new("ShaderNodeMapping").outputs[0], texture.inputs["Vector"])


def flip_green(stage, node, texture):
    tree = stage.subject.data.materials[0].node_tree
    invert = tree.nodes.new("ShaderNodeInvert")
    tree.links.new(texture.outputs[0], invert.inputs["Color"])
    tree.links.new(invert.outputs[0], node.inputs["Color"])


def no_image(stage, node, texture):
    texture.image = None


def clip_texture(stage, node, texture):
    texture.extension = "CLIP"


@pytest.mark.parametrize("change", [
    set_object_space, insert_bump, link_strength, scale_texture, flip_green, no_image, clip_texture])
def test_unsupported_normal_maps_are_named(stage, change):
    change(stage, *add_normal_map(stage))
    read = stage.read()
    assert not read.mesh.normal_maps and read.mesh.tangents is None
    assert any("'Paint'" in w and "normals are left out" in w for w in read.warnings), read.warnings


def test_reroutes_and_uv_map_nodes_are_followed(stage):
    node, texture = add_normal_map(stage, uv_map="UVMap")
    tree = stage.subject.data.materials[0].node_tree
    reroute, uv = tree.nodes.new("NodeReroute"), tree.nodes.new("ShaderNodeUVMap")
    uv.uv_map = "UVMap"
    tree.links.new(uv.outputs[0], texture.inputs["Vector"])
    tree.links.new(texture.outputs["Color"], reroute.inputs[0])
    tree.links.new(reroute.outputs[0], node.inputs["Color"])
    read = stage.read()
    assert read.mesh.normal_maps and not read.warnings


def test_a_normal_map_whose_file_is_gone(stage):
    _, texture = add_normal_map(stage)
    texture.image = bpy.data.images.new("Gone", 4, 4)
    texture.image.source, texture.image.filepath = "FILE", "//gone.png"
    with pytest.raises(BadInput, match=r"image 'Gone'.*'Paint'"):
        stage.read()


def test_bump_map_correction_is_named(stage):
    add_normal_map(stage)
    stage.subject.data.materials[0].cycles.use_bump_map_correction = True
    read = stage.read()
    assert read.mesh.normal_maps and any("Bump Map Correction" in w for w in read.warnings)


@pytest.mark.parametrize(("name", "value"), [
    ("Metallic", 0.5), ("IOR", 1.33), ("Specular IOR Level", 0.2), ("Coat Weight", 1), ("Sheen Weight", 0.1),
    ("Subsurface Weight", 0.3), ("Transmission Weight", 1), ("Anisotropic", 0.4), ("Alpha", 0.5),
    ("Emission Strength", 2), ("Diffuse Roughness", 0.5),
])
def test_principled_inputs_that_are_not_modelled(stage, name, value):
    assert not stage.read().warnings
    socket = principled(stage).inputs[name]
    socket.default_value = value
    [warning] = stage.read().warnings
    assert f"'Paint': {name} is {value:.3g}" in warning
    tree = stage.subject.data.materials[0].node_tree
    tree.links.new(tree.nodes.new("ShaderNodeValue").outputs[0], socket)
    [warning] = stage.read().warnings
    assert f"'Paint': {name} is linked" in warning


def test_displacement_is_named(stage):
    tree = stage.subject.data.materials[0].node_tree
    output = tree.get_output_node("CYCLES")
    tree.links.new(tree.nodes.new("ShaderNodeDisplacement").outputs[0], output.inputs["Displacement"])
    assert any("'Paint': Displacement" in w for w in stage.read().warnings)


def test_tint_and_distribution(stage):
    principled(stage).inputs["Specular Tint"].default_value = (1, 0.5, 0.5, 1)
    principled(stage).distribution = "GGX"
    text = " ".join(stage.read().warnings)
    assert "Specular Tint" in text and "GGX" in text


def test_no_principled_and_no_material(stage):
    tree = stage.subject.data.materials[0].node_tree
    diffuse = tree.nodes.new("ShaderNodeBsdfDiffuse")
    tree.links.new(diffuse.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    assert any("not a Principled" in w for w in stage.read().warnings)
    stage.subject.data.materials.clear()
    read = stage.read()
    assert read.mesh.slot_names == ("",) and any("no material" in w for w in read.warnings)
