"""The G-buffer against Cycles' bakes, and light visibility against the shadows that Cycles renders."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector

from irpso_addon.blender.material import material
from irpso_addon.blender.scene.scene_mesh import read_mesh, read_occluders
from irpso_addon.blender.scene.scene_objects import read_camera
from irpso_addon.core.data import Maps, SceneData, Solution
from irpso_addon.core.job import Progress
from irpso_addon.core.normals.tangent_map import encoded
from irpso_addon.core.samples import vase
from irpso_addon.core.shading import lights
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.gbuffer.gbuffer import MeshBuffer, Occluders, draw_pixel_grid
from irpso_addon.gpu.observe.visibility import LightVisibility
from irpso_addon.solve import one_round
from tests.blender import cycles_rig as rig

TEXELS = 192
PLACE = Matrix.Translation((0.4, -0.2, 0.3)) @ Matrix.Rotation(0.6, 4, Vector((1, 2, 0.5)))
SCALE = (1.0, 1.3, 0.8)


def read_all(subject) -> SceneData:
    """The subject as a solve gets it, without views."""
    from irpso_addon.blender.scene.scene_material import read_normal_maps

    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    mesh = read_mesh(subject, depsgraph, read_normal_maps(subject, quiet), quiet)
    return SceneData("test", mesh, read_occluders(subject, depsgraph, quiet)[0], ())


def quiet(text: str) -> None:
    """Warnings are not what these tests are about."""


# ---- the UV square


def potato() -> object:
    """A smooth ball out of shape, with custom normals, turned and unevenly scaled; its UVs do not overlap."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=20, ring_count=11, radius=0.7)
    made = bpy.context.object
    mesh = made.data
    for vertex in mesh.vertices:
        x, y, z = vertex.co
        vertex.co *= 1 + 0.2 * np.sin(3 * x + 1) * np.cos(4 * y) + 0.1 * z
    bpy.ops.object.shade_smooth()
    mesh.update()
    mesh.normals_split_custom_set_from_vertices(
        [(v.normal + 0.25 * v.co.cross((0.3, 0.2, 1))).normalized() for v in mesh.vertices])
    for uv in mesh.uv_layers.active.uv:  # a margin around the island
        uv.vector = 0.04 + 0.92 * uv.vector[0], 0.04 + 0.92 * uv.vector[1]
    made.matrix_world = PLACE @ Matrix.Diagonal((*SCALE, 1))
    mesh.materials.append(bpy.data.materials.new("Paint"))
    if bpy.app.version < (5, 0, 0):
        mesh.materials[0].use_nodes = True
    return made


def bake(subject, source, scale: float) -> np.ndarray:
    """A vector socket at every texel, (n, n, 3), row 0 the bottom; NaN where Cycles baked nothing.

    Baked as emission of scale * vector + 0.5 at one sample: the texel's centre, and as raw floats.
    """
    tree = subject.data.materials[0].node_tree
    shift, emission, target = (tree.nodes.new(kind) for kind in (
        "ShaderNodeVectorMath", "ShaderNodeEmission", "ShaderNodeTexImage"))
    shift.operation = "MULTIPLY_ADD"
    shift.inputs[1].default_value, shift.inputs[2].default_value = (scale,) * 3, (0.5,) * 3
    tree.links.new(source, shift.inputs[0])
    tree.links.new(shift.outputs[0], emission.inputs["Color"])
    output = tree.get_output_node("CYCLES")
    surface = output.inputs["Surface"].links[0].from_socket
    tree.links.new(emission.outputs[0], output.inputs["Surface"])
    image = bpy.data.images.new("baked", TEXELS, TEXELS, float_buffer=True, is_data=True)
    target.image = image
    tree.nodes.active = target
    bpy.context.view_layer.objects.active = subject
    subject.select_set(True)
    settings = bpy.context.scene.render.bake
    settings.margin, settings.use_clear = 0, True
    bpy.ops.object.bake(type="EMIT")
    pixels = np.empty(TEXELS * TEXELS * 4, np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(TEXELS, TEXELS, 4)[..., :3].astype(float)
    tree.links.new(surface, output.inputs["Surface"])
    for node in (shift, emission, target):
        tree.nodes.remove(node)
    bpy.data.images.remove(image)
    return np.where((pixels != 0).any(-1, keepdims=True), (pixels - 0.5) / scale, np.nan)


def inner(mask: np.ndarray, reach: int = 1) -> np.ndarray:
    """The mask less its rim."""
    padded = np.pad(mask, reach)
    n = 2 * reach + 1
    return np.all([padded[y:y + mask.shape[0], x:x + mask.shape[1]] for y in range(n) for x in range(n)], axis=0)


def angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Degrees between unit vectors."""
    return np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2, 0, 1)))


def gbuffer(subject) -> one_round.GBuffer:
    scene = read_all(subject)
    return thread.run(lambda: one_round.bake_gbuffer(scene, TEXELS))


def test_positions_and_smooth_normals_are_those_that_cycles_bakes():
    """Positions to a hundredth of a texel, normals to 0.01 degrees; 0.02 degrees at 99 %."""
    rig.scene(16)
    subject = potato()
    geometry = subject.data.materials[0].node_tree.nodes.new("ShaderNodeNewGeometry")
    position, normal = (bake(subject, geometry.outputs[name], scale) for name, scale in
                        (("Position", 0.1), ("Normal", 0.4)))
    got = gbuffer(subject)
    baked = np.isfinite(position[..., 0])
    assert 0.5 < baked.mean() < 0.95
    differ = got.coverage != baked
    assert not (differ & (inner(baked) | inner(~baked))).any()  # only along the island's rim
    assert differ.sum() < 0.1 * (baked & ~inner(baked)).sum()
    inside = inner(baked & got.coverage)
    step = np.linalg.norm(np.diff(position, axis=1), axis=-1)[:, :-1][inside[:, 1:-1]]
    texel = np.median(step)
    off = np.linalg.norm(got.position - position, axis=-1)[inside] / texel
    assert off.max() < 0.01
    degrees = angle(got.normal, normal)[inside]
    assert np.median(degrees) < 0.01
    assert np.quantile(degrees, 0.99) < 0.02


def test_mapped_normals_are_those_that_cycles_bakes():
    """A smooth tangent-space map, strength 0.7: 0.02 degrees in the median, 0.05 at 99 %."""
    rig.scene(16)
    subject = potato()
    tree = subject.data.materials[0].node_tree
    size = 64
    u, v = np.meshgrid(*2 * [(np.arange(size) + 0.5) / size])
    n = np.stack([0.5 * np.sin(10 * np.pi * u), 0.4 * np.cos(6 * np.pi * v), np.ones_like(u)], -1)
    pixels = np.ones((size, size, 4), np.float32)
    pixels[..., :3] = n / np.linalg.norm(n, axis=-1, keepdims=True) * 0.5 + 0.5
    image = bpy.data.images.new("bumps", size, size, float_buffer=True, is_data=True)
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    texture, mapped = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeNormalMap")
    texture.image = image
    mapped.inputs["Strength"].default_value = 0.7
    tree.links.new(texture.outputs["Color"], mapped.inputs["Color"])
    principled = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    tree.links.new(mapped.outputs["Normal"], principled.inputs["Normal"])
    normal = bake(subject, mapped.outputs["Normal"], 0.4)
    smooth = bake(subject, tree.nodes.new("ShaderNodeNewGeometry").outputs["Normal"], 0.4)
    got = gbuffer(subject)
    inside = inner(np.isfinite(normal[..., 0]) & got.coverage)
    degrees = angle(got.normal, normal)[inside]
    assert np.median(angle(smooth, normal)[inside]) > 5  # the map does something
    assert np.median(degrees) < 0.02
    assert np.quantile(degrees, 0.99) < 0.05


@pytest.mark.parametrize("mirrored", [False, True])
def test_cycles_shows_the_normals_that_a_result_has(mirrored):
    """From world normals to a tangent map, onto the material, and back: 0.05 degrees in the median, 0.3 at 99 %."""
    rig.scene(16)
    subject = potato()
    if mirrored:
        subject.matrix_world = subject.matrix_world @ Matrix.Diagonal((1, -1, 1, 1))
    scene, got = read_all(subject), gbuffer(subject)
    v, u = (np.mgrid[:TEXELS, :TEXELS] + 0.5) / TEXELS
    wanted = got.normal + 0.15 * np.stack([np.sin(40 * u), np.cos(35 * v), np.sin(30 * (u - v))], -1)
    wanted = (wanted / np.linalg.norm(wanted, axis=-1, keepdims=True)).astype(np.float32)
    normal = encoded(scene.mesh, wanted, got.coverage)
    none = np.zeros((TEXELS, TEXELS), np.float32)
    maps = Maps(np.full((TEXELS, TEXELS, 3), 0.5, np.float32), none + 0.5, none, none, none > 0, got.coverage, none,
                none, normal=normal)
    material.write_maps(subject, Solution.of_maps(maps, {"Paint": "one-lobe"}))
    tree = subject.data.materials[0].node_tree
    principled = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    shown = bake(subject, principled.inputs["Normal"].links[0].from_socket, 0.4)
    inside = inner(np.isfinite(shown[..., 0]) & got.coverage)
    degrees = angle(shown, wanted)[inside]
    assert np.median(angle(got.normal, wanted)[inside]) > 5
    assert np.median(degrees) < 0.05
    assert np.quantile(degrees, 0.99) < 0.3


# ---- light through the cameras

PIXELS = 160


def white(obj) -> None:
    rig.principled(obj, (1, 1, 1), 1.0, specular=0.0)


def add_mesh(name: str, shape: vase.QuadMesh, smooth: bool = True):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(shape.vertices.tolist(), [], shape.quads.tolist())
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", shape.uvs.ravel())
    mesh.polygons.foreach_set("use_smooth", np.full(len(shape.quads), smooth))
    mesh.validate()
    made = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(made)
    return made


def lit_by_irpso(subject, light) -> tuple[np.ndarray, np.ndarray]:
    """(lit share, covered), each (h, w), row 0 the bottom."""
    scene = read_all(subject)
    camera = read_camera(bpy.context.scene.camera, bpy.context.scene, bpy.context.evaluated_depsgraph_get())

    def job():
        yield Progress(0.0, "test")
        device = thread.device()
        with device.scope():
            mesh, others = MeshBuffer(device, scene.mesh), Occluders(device, scene.occluders)
            grid = draw_pixel_grid(device, mesh, others, camera, (PIXELS, PIXELS), 0.0)
            visibility = LightVisibility(device, mesh, others)
            *_, (lit,) = visibility.lit_maps(light, [grid])
            kind = {"f2": np.float16, "f4": np.float32}[lit.dtype]
            share = np.frombuffer(lit.read(alignment=1), kind).reshape(PIXELS, PIXELS).astype(float)
            shown = device.read(grid.position)[..., 3] > 0.5
            return share, shown

    return thread.run(job)


LAMPS = {
    "point": ("POINT", (2.0, -2.2, 2.4), {}),
    "point from the side": ("POINT", (2.6, -0.1, 1.2), {}),
    "point close by": ("POINT", (0.75, -0.5, 1.0), {}),
    "sun": ("SUN", (-1.6, -1.8, 1.4), {"angle": 0.0}),
    "spot": ("SPOT", (-2.0, -2.4, 2.0), {"spot_size": 1.2}),
}


@dataclass(frozen=True)
class Compared:
    """Pixels where Cycles says light or no light, and what the shadow maps say."""

    told: np.ndarray  # the light strikes the smooth surface at less than 80 degrees
    away: np.ndarray  # of those, away from the edges of Cycles' shadows
    lit: np.ndarray
    share: np.ndarray  # ours, 0..1


def compare(subject, name: str) -> Compared:
    """The open scene under a lamp of LAMPS, rendered by Cycles and by us."""
    kind, place, settings = LAMPS[name]
    light = rig.as_light(rig.lamp(kind, place, **settings))
    image = rig.render()
    rgb, position, normal = (image[key][::-1] for key in ("rgb", "position", "normal"))
    share, shown = lit_by_irpso(subject, light)
    irradiance = lights.light_irradiance(light, position, normal) * light.power[0]
    toward = light.matrix[:3, 2] if kind == "SUN" else light.matrix[:3, 3] - position
    cosine = (normal * toward).sum(-1) / np.linalg.norm(np.broadcast_to(toward, position.shape), axis=-1)
    told = shown & (cosine > np.cos(np.radians(80))) & (irradiance > 1e-3 * irradiance[shown].max())
    true = rgb[..., 0] * np.pi / np.where(told, irradiance, 1)
    assert (np.minimum(np.abs(true), np.abs(true - 1))[told] < 0.02).mean() > 0.99  # Cycles says yes or no
    lit = true > 0.5
    reach = np.pad(np.where(told, lit, False), 1), np.pad(np.where(told, ~lit, False), 1)
    near = [np.any([p[y:y + PIXELS, x:x + PIXELS] for y in range(3) for x in range(3)], axis=0) for p in reach]
    return Compared(told, told & ~(near[0] & near[1]), lit, share)


@pytest.mark.parametrize("name", LAMPS)
def test_shadows_are_those_that_cycles_renders(name):
    """A vase of 20 000 faces beside a post: light or no light, 99.9 % of the pixels away from shadow's edges.

    Pixels are compared where the light strikes at less than 80 degrees; there Cycles' white surface is bright or
    black.  On the edges themselves a pixel's centre falls on one side or the other.
    """
    rig.scene(PIXELS)
    subject = add_mesh("Vase", vase.mesh())
    assert len(subject.data.polygons) > 3000
    bpy.ops.mesh.primitive_cube_add(size=1, location=(0.7, -0.9, 0.0), scale=(0.16, 0.16, 1.7))
    post = bpy.context.object
    for obj in (subject, post):
        white(obj)
    rig.camera((-0.6, -3.6, 0.9), degrees=32)
    got = compare(subject, name)
    agree = (got.share > 0.5) == got.lit
    assert got.away.sum() > 2000
    assert 0.02 < (~got.lit)[got.away].mean() < 0.8  # there is shadow
    assert agree[got.away].mean() > 0.999
    assert agree[got.told].mean() > 0.995


@pytest.mark.parametrize("name", ["point", "sun"])
@pytest.mark.parametrize(("shape", "least"), [("ball", 1.0), ("monkey", 0.98)])
def test_few_smooth_faces_are_lit_as_cycles_lights_them(shape, least, name):
    """Where a face turns from the light but its smooth normal does not, Cycles lights it; a ray from the face does not.

    The ball has 128 faces, the monkey 500 and its ears and eyes shadow one another.
    """
    rig.scene(PIXELS)
    if shape == "ball":
        bpy.ops.mesh.primitive_uv_sphere_add(segments=16, ring_count=8)
    else:
        bpy.ops.mesh.primitive_monkey_add()
    subject = bpy.context.object
    bpy.ops.object.shade_smooth()
    white(subject)
    rig.camera((-0.6, -4.6, 0.9), degrees=32)
    got = compare(subject, name)
    agree = (got.share > 0.5) == got.lit
    assert got.told.sum() > 3000
    assert agree[got.away].mean() >= least
    if shape == "ball":  # lit all over, edges or not
        assert agree[got.told].all()


def test_the_pixels_that_show_the_subject_are_those_of_cycles():
    """Behind the post and outside its outline nothing is shown; differing pixels lie on outlines."""
    rig.scene(PIXELS)
    subject = add_mesh("Vase", vase.mesh())
    bpy.ops.mesh.primitive_cube_add(size=1, location=(-0.4, -0.9, 0.0), scale=(0.16, 0.16, 1.7))
    post = bpy.context.object
    white(subject)
    rig.principled(post, (0.5, 0.5, 0.5), 1.0, specular=0.0)
    rig.camera((-0.6, -3.6, 0.9), degrees=32)
    light = rig.as_light(rig.lamp("POINT", (-0.6, -3.6, 0.9)))  # at the camera: no shadow in sight
    image = rig.render()
    rgb, position, normal = (image[key][::-1] for key in ("rgb", "position", "normal"))
    _, shown = lit_by_irpso(subject, light)
    irradiance = lights.light_irradiance(light, position, normal) * light.power[0]
    hit = np.linalg.norm(normal, axis=-1) > 0.5
    true = hit & (rgb[..., 0] * np.pi > 0.75 * irradiance)  # white, not grey
    differ = true != shown
    edge = (np.any([np.roll(true, s, a) for s in (-1, 1) for a in (0, 1)], axis=0)
            & ~np.all([np.roll(true, s, a) for s in (-1, 1) for a in (0, 1)], axis=0))
    assert true.sum() > 3000
    assert (hit & ~true).sum() > 500
    assert not (differ & ~edge).any()
    assert differ.sum() < 0.05 * edge.sum()
