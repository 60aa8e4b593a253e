"""Maps, objects and materials made in the file that is open, and what their nodes say."""

from __future__ import annotations

import bpy
import numpy as np

from irpso_addon.core.data import Maps, Solution

SIZE = 16


def make_maps(size: int = SIZE, seed: int = 0) -> Maps:
    rng = np.random.default_rng(seed)
    return Maps(
        base_color=rng.uniform(0.02, 0.9, (size, size, 3)).astype("f4"),
        roughness=rng.uniform(0.1, 1.0, (size, size)).astype("f4"),
        confidence=rng.uniform(0, 1, (size, size)).astype("f4"),
        error=rng.uniform(0, 0.1, (size, size)).astype("f4"),
        filled=rng.uniform(size=(size, size)) > 0.5,
        coverage=np.ones((size, size), bool),
        roughness_sigma=rng.uniform(0, 0.1, (size, size)).astype("f4"),
        base_sigma=rng.uniform(0, 0.1, (size, size)).astype("f4"),
    )


def make_solution(model: dict[str, str], maps: Maps | None = None) -> Solution:
    return Solution(
        maps=maps or make_maps(), model=model, why={}, texels={"covered": 4, "observed": 4, "solved": 4, "filled": 0},
        seconds={}, residual=0.0, views_used=(), views_skipped=(), warnings=(), device={})


def make_plane(name: str = "Plane", materials: tuple[str, ...] = ("Skin",)) -> bpy.types.Object:
    """A square whose UVs fill the UV square, so that texel = pixel of a bake."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [], [(0, 1, 2, 3)])
    layer = mesh.uv_layers.new(name="UVMap")
    for corner, uv in zip(layer.data, [(0, 0), (1, 0), (1, 1), (0, 1)], strict=True):
        corner.uv = uv
    for material_name in materials:
        mesh.materials.append(bpy.data.materials.get(material_name) or make_material(material_name))
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def make_material(name: str) -> bpy.types.Material:
    """A new material with Blender's default nodes."""
    made = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0):  # later every material has nodes, and to say so is deprecated
        made.use_nodes = True
    return made


def principled_of(shader: bpy.types.Material) -> bpy.types.Node:
    return next(n for n in shader.node_tree.nodes if n.bl_idname == "ShaderNodeBsdfPrincipled")


def source(shader: bpy.types.Material, socket: str) -> bpy.types.Node:
    return principled_of(shader).inputs[socket].links[0].from_node


def tree_state(tree: bpy.types.NodeTree) -> dict[str, object]:
    """Every node with its settings and values, and every link, as plain data."""
    def plain(value):
        if hasattr(value, "__len__") and not isinstance(value, str):
            return tuple(value)
        return str(getattr(value, "name", value))

    state = {}
    for node in tree.nodes:
        skip = {"rna_type", "dimensions", "select", "inputs", "outputs", "internal_links", "color_mapping",
                "texture_mapping", "image_user", "height", "warning_propagation", "color_tag"}
        settings = {p.identifier: plain(getattr(node, p.identifier)) for p in node.bl_rna.properties
                    if p.identifier not in skip and p.type != "COLLECTION"}
        values = {s.identifier: plain(s.default_value) for s in node.inputs if hasattr(s, "default_value")}
        state[node.name] = (settings, values, [s.identifier for s in node.inputs if s.hide])
    state["links"] = sorted(
        (k.from_node.name, k.from_socket.identifier, k.to_node.name, k.to_socket.identifier) for k in tree.links)
    return state


def bake(obj: bpy.types.Object, shader: bpy.types.Material, socket: str, size: int = SIZE) -> np.ndarray:
    """What Cycles evaluates into a socket of the Principled, texel by texel: (size, size, 3).

    A bake looks 0.002 pixels beside the texel's centre, so neighbours would bleed in: Closest instead.
    """
    texture = source(shader, socket)
    assert (texture.interpolation, texture.extension, texture.projection) == ("Linear", "REPEAT", "FLAT")
    texture.interpolation = "Closest"
    tree = shader.node_tree
    emission, target = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeTexImage")
    output = tree.get_output_node("CYCLES")
    tree.links.new(principled_of(shader).inputs[socket].links[0].from_socket, emission.inputs["Color"])
    tree.links.new(emission.outputs["Emission"], output.inputs["Surface"])
    target.image = bpy.data.images.new("baked", size, size, float_buffer=True, is_data=True)
    tree.nodes.active = target
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples, scene.cycles.device = "CYCLES", 1, "CPU"
    bpy.context.view_layer.objects.active = obj
    obj.select_set(True)
    bpy.ops.object.bake(type="EMIT", margin=0)
    pixels = np.empty(size * size * 4, "f4")
    target.image.pixels.foreach_get(pixels)
    texture.interpolation = "Linear"
    return pixels.reshape(size, size, 4)[..., :3]
