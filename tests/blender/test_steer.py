"""Solving a part: which faces, groups and images mean, against the mesh itself; the whole job by operators."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest

from irpso_addon.blender.jobs import solve_region
from irpso_addon.core.errors import BadInput

SIZE = 64


@pytest.fixture
def cube(empty):
    """A cube of six faces with UVs, subdivided once without smoothing by a modifier, and mirrored by its scale."""
    bpy.ops.mesh.primitive_cube_add(size=2)
    cube = bpy.context.object
    cube.scale.x = -1.5
    modifier = cube.modifiers.new("Subdivision", "SUBSURF")
    modifier.subdivision_type, modifier.levels = "SIMPLE", 1
    bpy.context.view_layer.update()
    return cube


def corners(obj):
    """World positions (T, 3, 3) in the order that the region's weights are to have."""
    from irpso_addon.blender.scene.scene_mesh import read_mesh

    return read_mesh(obj, bpy.context.evaluated_depsgraph_get(), {}, lambda _: None).positions


def test_selected_faces_are_those_of_the_evaluated_mesh(cube):
    for polygon in cube.data.polygons:
        polygon.select = polygon.normal.z > 0.5
    region = solve_region.faces_region(cube, bpy.context.evaluated_depsgraph_get())
    top = corners(cube)[..., 2] > 0.999
    np.testing.assert_array_equal(region.corners, np.repeat(top.all(1, keepdims=True), 3, 1))
    assert region.corners.sum() == 3 * 8  # a face has become four, of two triangles each
    cube.data.polygons.foreach_set("select", np.zeros(6, bool))
    cube.data.update()
    bpy.context.view_layer.update()
    with pytest.raises(BadInput, match=r"Cube.*no face is selected.*Edit Mode"):
        solve_region.faces_region(cube, bpy.context.evaluated_depsgraph_get())


def test_a_vertex_group_is_weighed_at_the_corners(cube):
    group = cube.vertex_groups.new(name="Soft")
    for vertex in cube.data.vertices:
        group.add([vertex.index], 0.5 + 0.5 * vertex.co.x, "REPLACE")  # 0 on the left, 1 on the right
    bpy.context.view_layer.update()
    region = solve_region.group_region(cube, bpy.context.evaluated_depsgraph_get(), "Soft")
    np.testing.assert_allclose(region.corners, 0.5 - 0.5 * corners(cube)[..., 0] / 1.5, atol=1e-6)  # mirrored
    for name, words in (("Hard", r"no vertex group 'Hard' \(it has 'Soft'\)"), ("", "no vertex group is chosen")):
        with pytest.raises(BadInput, match=words):
            solve_region.group_region(cube, bpy.context.evaluated_depsgraph_get(), name)


@pytest.mark.parametrize("is_float", [False, True])
def test_an_image_is_white_by_its_colour_and_alpha(empty, is_float):
    image = bpy.data.images.new("Region", 4, 2, alpha=True, float_buffer=is_float)
    pixels = np.zeros((2, 4, 4), np.float32)
    pixels[0, 1], pixels[1, 2], pixels[1, 3] = (1, 1, 1, 1), (1, 1, 0, 1), (1, 1, 1, 0)
    image.pixels.foreach_set(pixels.ravel())
    region = solve_region.image_region(image)
    np.testing.assert_array_equal(region.image > 0.5, [[False, True, False, False], [False, False, True, False]])
    image.pixels.foreach_set(np.zeros(32, np.float32))
    with pytest.raises(BadInput, match=r"Region.*has no white"):
        solve_region.image_region(image)
    with pytest.raises(BadInput, match="no image is chosen"):
        solve_region.image_region(None)


def test_an_image_file_is_white_as_the_image_is_that_blender_loads(empty, tmp_path):
    made = bpy.data.images.new("Region", 4, 2, alpha=True)
    pixels = np.zeros((2, 4, 4), np.float32)
    pixels[0, 1], pixels[1, 2], pixels[1, 0] = (1, 1, 1, 1), (0.2, 0.8, 0.9, 1), (1, 1, 1, 0.2)
    made.pixels.foreach_set(pixels.ravel())
    made.filepath_raw, made.file_format = str(tmp_path / "part.png"), "PNG"
    made.save()
    region, same = (solve_region.file_region(tmp_path / "part.png"),
                    solve_region.image_region(bpy.data.images.load(str(tmp_path / "part.png"))))
    np.testing.assert_allclose(region.image, same.image, atol=1e-6)
    np.testing.assert_array_equal(region.image > 0.5, [[False, True, False, False], [False, False, True, False]])
    (tmp_path / "none.png").write_bytes(b"no image")
    with pytest.raises(BadInput, match=r"none\.png: cannot be read as an image"):
        solve_region.file_region(tmp_path / "none.png")


# ---- by operators


@pytest.fixture
def scene(extension, scenes: Path, tmp_path: Path) -> bpy.types.Scene:
    """The good scene, its ball solved once."""
    shutil.copytree(scenes / "good", tmp_path / "good")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "good" / "scene.blend"), load_ui=False)
    bpy.context.view_layer.objects.active = bpy.data.objects["Ball"]
    settings = bpy.context.scene.irpso
    settings.size, settings.captures, settings.indirect = SIZE, "//captures.json", "off"
    settings.model, settings.lamps, settings.exposures, settings.registration = "one-lobe", "given", "given", "given"
    assert bpy.ops.irpso.solve() == {"FINISHED"}
    return bpy.context.scene


def pixels(name: str) -> np.ndarray:
    image = bpy.data.images[name]
    values = np.empty(image.size[0] * image.size[1] * 4, "f4")
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], 4)[..., :3]


def spoil(name: str, value: float) -> None:
    """Every pixel of one of the object's maps, so that what is kept can be told from what is new."""
    values = np.full(SIZE * SIZE * 4, value, np.float32)
    bpy.data.images[name].pixels.foreach_set(values)


def test_a_part_is_solved_and_the_rest_kept(scene):
    whole, known = pixels("Ball_roughness")[..., 0], pixels("Ball_confidence")[..., 0] > 0
    for module in [m for n, m in sys.modules.items() if n == "irpso_ext.irpso_addon.blender.jobs.session"]:
        module.session.forget()  # as after opening the saved file: the maps on the material are what is kept
    spoil("Ball_roughness", 0.9)
    ball = bpy.data.objects["Ball"]
    ball.data.polygons.foreach_set("select", [polygon.center.x > 0 for polygon in ball.data.polygons])
    scene.irpso.region = "FACES"
    assert bpy.ops.irpso.solve() == {"FINISHED"}
    now = pixels("Ball_roughness")[..., 0]
    bpy.ops.irpso.bake_gbuffer()
    x = pixels("Ball_position")[..., 0]
    assert np.quantile(np.abs(now - whole)[known & (x > 0.1)], 0.95) < 0.02
    np.testing.assert_allclose(now[known & (x < -0.4)], 0.9, atol=1e-6)  # two texels are 0.2 m
    seam = now[known & (x > -0.4) & (x < 0)]
    assert 0.1 < np.mean((seam > 0.5) & (seam < 0.85))  # it is soft


def test_starting_at_the_last_result_ends_where_it_was(scene):
    before = {name: pixels(f"Ball_{name}") for name in ("roughness", "basecolor")}
    scene.irpso.start = "last"
    assert bpy.ops.irpso.solve() == {"FINISHED"}
    sure = pixels("Ball_confidence")[..., 0] > 0.25  # one value for all: at most 0.5
    for name, values in before.items():
        off = np.abs(pixels(f"Ball_{name}") - values)[sure]
        assert np.median(off) < 1e-4 and np.quantile(off, 0.99) < 0.01


def test_a_material_that_was_copied_is_known_again(scene):
    """Another ball shows the same material: the solved one gets a copy of it, which is what its result is of."""
    ball = bpy.data.objects["Ball"]
    other = ball.copy()
    scene.collection.objects.link(other)
    other.hide_render = True  # it would stand in the way
    assert bpy.ops.irpso.solve() == {"FINISHED"}
    name = ball.material_slots[0].material.name
    assert name != "Paint" and ball.material_slots[0].material["irpso"] == "Paint"
    last = sys.modules["irpso_ext.irpso_addon.blender.jobs.solve_region"].last_result(ball)
    assert last.model == {name: "one-lobe"} and set(last.why) == {name}


def test_a_part_is_marked_in_its_own_mode(scene):
    ball = bpy.data.objects["Ball"]
    assert not bpy.ops.irpso.paint_part.poll()  # nothing to mark
    for region, mode in (("GROUP", "WEIGHT_PAINT"), ("IMAGE", "TEXTURE_PAINT"), ("FACES", "EDIT")):
        scene.irpso.region = region
        assert bpy.ops.irpso.paint_part() == {"FINISHED"} and ball.mode == mode
        assert bpy.ops.irpso.paint_part() == {"FINISHED"} and ball.mode == "OBJECT"
    assert scene.irpso.region_group == "Region" and [group.name for group in ball.vertex_groups] == ["Region"]
    assert tuple(scene.irpso.region_image.size) == (SIZE, SIZE)
    paint = scene.tool_settings.image_paint
    assert paint.canvas == scene.irpso.region_image
    unified = getattr(paint, "unified_paint_settings", None) or scene.tool_settings.unified_paint_settings
    assert tuple(unified.color) == (1, 1, 1)
    ball.vertex_groups["Region"].add([vertex.index for vertex in ball.data.vertices], 1.0, "REPLACE")
    scene.irpso.region = "GROUP"
    bpy.ops.irpso.paint_part()
    assert bpy.ops.irpso.solve() == {"FINISHED"}  # while it is being painted, too
    bpy.ops.object.mode_set(mode="OBJECT")


def test_what_is_stopped_keeps_the_last_result(scene, extension):
    """Looks at a part put their texels into it; the preview's coarse maps none."""
    live, data, session = (sys.modules[f"irpso_ext.irpso_addon.{name}"]
                           for name in ("blender.jobs.live_display", "core.data", "blender.jobs.session"))
    glimpse = sys.modules["irpso_ext.irpso_addon.core.live_maps"].Live
    settings = sys.modules["irpso_ext.irpso_addon.blender.properties"].settings(scene.irpso)
    start = session.session.solution_of(bpy.data.objects["Ball"])
    mesh = data.MeshArrays("Ball", *np.zeros((3, 0, 3, 3), "f4"), np.zeros(0, "i4"), ("Paint",))
    image = np.zeros((2, 2), np.float32)
    maps = live.LiveMaps(data.SceneData("good", mesh, np.zeros((0, 3, 3), "f4"), (), region=data.Region(image=image),
                                        start=start), settings)
    maps.take_preview(glimpse({"roughness": np.full((16, 16), 0.9, "f4")}, np.ones((16, 16), bool)))
    look = np.full((SIZE, SIZE), np.nan, np.float32)
    part = (slice(20, 30), slice(20, 30))
    look[part] = 0.7
    maps.take(glimpse({"roughness": look}, start.maps.coverage))
    stopped = maps.solution()
    want = start.maps.roughness.copy()
    want[part] = 0.7
    np.testing.assert_array_equal(stopped.maps.roughness, want)
    for role in ("base_color", "confidence", "filled", "coverage"):
        np.testing.assert_array_equal(getattr(stopped.maps, role), getattr(start.maps, role))
    assert stopped.cancelled and stopped.model == start.model
    assert np.all(stopped.maps.base_sigma[~stopped.maps.filled] == 0.5)  # no look tells how sure base colour is


def test_what_cannot_take_the_maps_is_refused_before_the_solve(scene):
    material = bpy.data.materials["Paint"]
    tree = material.node_tree
    principled = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    images = len(bpy.data.images)

    def refused(*words):
        with pytest.raises(RuntimeError) as caught:
            bpy.ops.irpso.solve()
        assert all(word in str(caught.value) for word in words), str(caught.value)
        assert len(bpy.data.images) == images

    principled.mute = True
    refused("material 'Paint'", "muted", "unmute it")
    principled.mute = False
    output = tree.get_output_node("CYCLES")
    group = bpy.data.node_groups.new("Their Shader", "ShaderNodeTree")
    inner = group.nodes.new("ShaderNodeBsdfPrincipled")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    group.links.new(inner.outputs[0], group.nodes.new("NodeGroupOutput").inputs[0])
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    link = tree.links.new(node.outputs[0], output.inputs["Surface"])
    refused("material 'Paint'", "inside node group 'Their Shader'", "ungroup")
    tree.links.remove(link)
    diffuse = tree.nodes.new("ShaderNodeBsdfDiffuse")
    tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
    refused("material 'Paint'", "no Principled BSDF feeds its output")
    # A muted node hands on what it is given.
    mix = tree.nodes.new("ShaderNodeMixShader")
    mix.mute = True
    tree.links.new(principled.outputs[0], mix.inputs[1])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    assert bpy.ops.irpso.solve() == {"FINISHED"}
    # A slot that no face uses needs no Principled BSDF.
    other = bpy.data.materials.new("Other")
    if other.node_tree is None:
        other.use_nodes = True
    other.node_tree.nodes.clear()
    bpy.data.objects["Ball"].data.materials.append(other)
    assert bpy.ops.irpso.solve() == {"FINISHED"}


def test_what_is_linked_from_a_library_is_refused(scene, tmp_path_factory):
    tmp_path = tmp_path_factory.mktemp("library")
    library = tmp_path / "library.blend"
    bpy.data.libraries.write(str(library), {bpy.data.materials["Paint"]})
    with bpy.data.libraries.load(str(library), link=True) as (_, linked):
        linked.materials = ["Paint"]
    bpy.data.objects["Ball"].data.materials[0] = linked.materials[0]
    with pytest.raises(RuntimeError, match="Paint: this material is linked from a library; make it local"):
        bpy.ops.irpso.solve()
    bpy.data.libraries.write(str(tmp_path / "ball.blend"), {bpy.data.objects["Ball"]})
    with bpy.data.libraries.load(str(tmp_path / "ball.blend"), link=True) as (_, linked):
        linked.objects = ["Ball"]
    why_not = sys.modules["irpso_ext.irpso_addon.blender.material.material_preflight"].why_not
    assert why_not(linked.objects[0]) == "Ball: this object is linked from a library; make it local first " \
        "(Object > Relations)"
