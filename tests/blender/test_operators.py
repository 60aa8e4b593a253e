"""The whole job by operators, on a scene rendered by Cycles: views, solve, maps, export, undo."""

from __future__ import annotations

import os
import re
import shutil
import sys
from pathlib import Path

import bmesh
import bpy
import numpy as np
import pytest

from tests.blender.ball import BASE, ROUGH

SIZE = 64


@pytest.fixture
def scene(extension, scenes: Path, tmp_path: Path) -> bpy.types.Scene:
    """A private copy of the good scene, open, its ball active, small maps asked for."""
    shutil.copytree(scenes / "good", tmp_path / "good")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "good" / "scene.blend"), load_ui=False)
    bpy.context.view_layer.objects.active = bpy.data.objects["Ball"]
    bpy.context.scene.irpso.size = SIZE
    return bpy.context.scene


def pixels(name: str) -> np.ndarray:
    image = bpy.data.images[name]
    values = np.empty(image.size[0] * image.size[1] * 4, "f4")
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], 4)[..., :3]


def maps() -> list[str]:
    """Names of the images that IRPSO made."""
    return sorted(name for name in bpy.data.images.keys() if name != "Render Result")


def refused(operator, *words: str, **options) -> None:
    """The operator reports one line with these words and changes nothing."""
    images, nodes = len(bpy.data.images), len(bpy.data.materials["Paint"].node_tree.nodes)
    with pytest.raises(RuntimeError) as caught:
        operator(**options)
    lines = str(caught.value).strip().splitlines()
    assert len(lines) == 1, lines
    assert all(word in lines[0] for word in words), lines[0]
    assert (len(bpy.data.images), len(bpy.data.materials["Paint"].node_tree.nodes)) == (images, nodes)


def test_the_whole_job(scene, module, tmp_path: Path) -> None:
    scene.irpso.captures = "//captures.json"
    assert bpy.ops.irpso.load_captures() == {"FINISHED"}
    assert scene.irpso.captures == "" and len(scene.irpso.views) == 10
    view = scene.irpso.views[3]
    assert (view.image, view.camera.name) == ("//refs/Camera 0, Light 3.exr", "Camera 0")
    assert [item.light.name for item in view.lights] == ["Light 3"]

    assert not bpy.ops.irpso.write_maps.poll() and not bpy.ops.irpso.export_maps.poll()
    assert bpy.ops.irpso.solve() == {"FINISHED"}
    confident = pixels("Ball_confidence")[..., 0] > 0.25  # one value for all: at most 0.5
    assert confident.mean() > 0.1
    np.testing.assert_allclose(np.median(pixels("Ball_basecolor")[confident], axis=0), BASE, atol=0.02)
    assert abs(np.median(pixels("Ball_roughness")[confident]) - ROUGH) < 0.02
    principled = bpy.data.materials["Paint"].node_tree.nodes["Principled BSDF"]
    assert principled.inputs["Base Color"].links[0].from_node.image == bpy.data.images["Ball_basecolor"]

    # What is on the material is what is exported.
    scene.irpso.format, scene.irpso.out = "exr", "//maps"
    assert bpy.ops.irpso.export_maps() == {"FINISHED"}
    assert sorted(os.listdir(tmp_path / "good" / "maps")) == sorted(f"{name}.exr" for name in [*maps(), "Ball_filled"])
    saved = bpy.data.images.load(str(tmp_path / "good" / "maps" / "Ball_basecolor.exr"))
    np.testing.assert_array_equal(pixels(saved.name), pixels("Ball_basecolor"))
    bpy.data.images.remove(saved)
    assert bpy.ops.irpso.export_maps(directory=str(tmp_path / "other"), format="png") == {"FINISHED"}
    assert len(os.listdir(tmp_path / "other")) == 7

    # The capture file itself gives the same bytes as the list made from it.
    before = {name: pixels(name) for name in maps()}
    scene.irpso.views.clear()
    scene.irpso.captures = "//captures.json"
    assert bpy.ops.irpso.solve() == {"FINISHED"}
    for name, values in before.items():
        np.testing.assert_array_equal(pixels(name), values)
    assert len(maps()) == 6

    # Another file: the solution is forgotten.
    bpy.ops.wm.read_factory_settings(use_empty=False)
    bpy.context.view_layer.objects.active = next(o for o in bpy.data.objects if o.type == "MESH")
    assert not bpy.ops.irpso.write_maps.poll()
    assert module("blender.jobs.session").session.running is None


def test_the_tooltip_names_every_map_that_is_exported(module) -> None:
    flat, colour = np.zeros((2, 2), np.float32), np.zeros((2, 2, 3), np.float32)
    everything = module("core.data").Maps(
        base_color=colour, roughness=flat, confidence=flat, error=flat, filled=flat > 0, coverage=flat < 1,
        roughness_sigma=flat, base_sigma=flat, specular=flat, metallic=flat, normal=colour)
    named = sys.modules["irpso_ext.operators.export_maps"].MAPS
    assert list(named) == list(module("core.maps.export").layers(everything))
    tooltip = bpy.ops.irpso.export_maps.get_rna_type().description
    assert all(words in tooltip for words in named.values())


def test_solve_without_writing_then_write_undo_redo(scene) -> None:
    scene.irpso.captures = "//captures.json"
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.irpso.solve("EXEC_DEFAULT", True, write=False) == {"FINISHED"}
    assert len(maps()) == 0
    assert bpy.ops.irpso.write_maps("EXEC_DEFAULT", True) == {"FINISHED"}
    assert len(maps()) == 6
    values = pixels("Ball_roughness")
    bpy.ops.ed.undo()  # one step
    tree = bpy.data.materials["Paint"].node_tree
    assert len(maps()) == 0 and len(tree.nodes) == 2 and len(tree.links) == 1
    assert "irpso" not in bpy.data.objects["Ball"]
    assert bpy.ops.irpso.write_maps.poll()  # the solution outlives the undo
    bpy.ops.ed.redo()
    np.testing.assert_array_equal(pixels("Ball_roughness"), values)
    # Solved, then renamed: still the same object.
    bpy.data.objects["Ball"].name = "Pearl"
    assert bpy.ops.irpso.write_maps() == {"FINISHED"}
    assert maps()[0] == "Pearl_basecolor"


def test_save_the_maps_instead_of_packing(scene, tmp_path: Path) -> None:
    scene.irpso.captures = "//captures.json"
    bpy.ops.irpso.solve(write=False)
    assert bpy.ops.irpso.write_maps(packed=False) == {"FINISHED"}
    assert bpy.data.images["Ball_basecolor"].filepath == "//irpso/Ball_basecolor.exr"
    assert bpy.data.images["Ball_basecolor"].packed_file is None
    no_folder = str(tmp_path / "good" / "captures.json")
    refused(bpy.ops.irpso.export_maps, "captures.json", directory=no_folder)


def test_bake_gbuffer(scene, module) -> None:
    flat = np.full((SIZE, SIZE, 3), (0.5, 0.5, 1.0), np.float32)
    module("blender.material.material").put_image(bpy.data.objects["Ball"], "normal", flat)
    assert bpy.ops.irpso.bake_gbuffer() == {"FINISHED"}
    coverage = pixels("Ball_coverage")[..., 0] > 0.5
    assert coverage.mean() > 0.9  # a UV sphere fills the square but for its poles
    np.testing.assert_array_equal(pixels("Ball_normal"), flat)  # a solved normal map is another thing
    normal, position = pixels("Ball_world_normal")[coverage], pixels("Ball_position")[coverage]
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=1e-5)
    # A unit sphere at the origin; the chords of 24 x 48 facets lie up to 1 % below it.
    np.testing.assert_allclose(normal, position, atol=0.02)


@pytest.mark.parametrize("overridden", [False, True])
def test_baked_images_that_the_file_does_not_keep(scene, capfd, tmp_path: Path, overridden: bool) -> None:
    ball = bpy.data.objects["Ball"]
    bpy.data.libraries.write(str(tmp_path / "library.blend"), {ball})
    bpy.data.objects.remove(ball)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, into):
        into.objects = ["Ball"]
    obj = into.objects[0].override_create() if overridden else into.objects[0]
    scene.collection.objects.link(obj)
    bpy.context.view_layer.objects.active = obj
    if not overridden:
        refused(bpy.ops.irpso.bake_gbuffer, "Ball", "linked from a library", "local")
        return
    assert bpy.ops.irpso.bake_gbuffer() == {"FINISHED"}
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=bpy.data.filepath, load_ui=False)
    kept = bpy.data.images["Ball_position"].users > 0  # Blender drops it at the next saving where it has none
    assert kept == ("Ball: is a library override, which does not keep its images" not in capfd.readouterr().out)

def test_views_by_hand(scene) -> None:
    camera = bpy.data.objects["Camera 0"]
    camera.data.background_images.new().image = bpy.data.images.load(
        str(Path(bpy.data.filepath).parent / "refs" / "Camera 0, Light 1.exr"))
    assert bpy.ops.irpso.add_views() == {"FINISHED"}
    assert [(v.camera.name, Path(v.image).name) for v in scene.irpso.views] == [
        ("Camera 0", "Camera 0, Light 1.exr"), ("Camera 1", "")]
    assert bpy.ops.irpso.add_views() == {"CANCELLED"}  # they are there already
    assert len(scene.irpso.views) == 2
    for obj in scene.objects:
        obj.select_set(obj.name in ("Light 1", "Light 2", "Ball"))
    scene.irpso.active_view = 0
    assert bpy.ops.irpso.set_view_lights() == {"FINISHED"}
    assert [item.light.name for item in scene.irpso.views[0].lights] == ["Light 1", "Light 2"]
    bpy.ops.object.select_all(action="DESELECT")
    assert bpy.ops.irpso.set_view_lights() == {"FINISHED"}
    assert len(scene.irpso.views[0].lights) == 0
    refused(bpy.ops.irpso.solve, "view 1", "no image")
    scene.irpso.active_view = 1
    assert bpy.ops.irpso.remove_view() == {"FINISHED"}
    assert [v.camera.name for v in scene.irpso.views] == ["Camera 0"] and scene.irpso.active_view == 0
    assert bpy.ops.irpso.remove_view(all=True) == {"FINISHED"}
    assert not bpy.ops.irpso.remove_view.poll() and not bpy.ops.irpso.set_view_lights.poll()


def test_bad_input_is_one_line_and_changes_nothing(scene) -> None:
    bpy.context.view_layer.objects.active = bpy.data.objects["Ball"]
    refused(bpy.ops.irpso.solve, "no view")
    scene.irpso.captures = "//nosuch.json"
    refused(bpy.ops.irpso.solve, "nosuch.json")
    refused(bpy.ops.irpso.load_captures, "nosuch.json")
    scene.irpso.captures = "//captures.json"
    bpy.data.objects["Light 2"].name = "Lamp"
    refused(bpy.ops.irpso.solve, "Light 2")
    refused(bpy.ops.irpso.load_captures, "Light 2")
    assert len(scene.irpso.views) == 0
    bpy.data.objects["Lamp"].name = "Light 2"
    (Path(bpy.data.filepath).parent / "refs" / "Camera 1, Light 4.exr").write_bytes(b"no image")
    refused(bpy.ops.irpso.solve, "Camera 1, Light 4.exr")


def test_materials_of_all_objects_are_checked_before_the_first_is_solved(scene, module) -> None:
    scene.irpso.captures, scene.irpso.model = "//captures.json", "lambert"
    ball, second = bpy.data.objects["Ball"], bpy.data.objects["Ball"].copy()
    second.data = ball.data.copy()
    scene.collection.objects.link(second)
    ball.select_set(True)
    second.select_set(True)
    glow = second.data.materials[0] = bpy.data.materials.new("Glow")
    if bpy.app.version < (5, 0):
        glow.use_nodes = True
    emission = glow.node_tree.nodes.new("ShaderNodeEmission")
    glow.node_tree.links.new(emission.outputs[0], glow.node_tree.get_output_node("ALL").inputs["Surface"])
    refused(bpy.ops.irpso.solve, "Glow", "Principled")
    assert module("blender.jobs.session").session.results_of(ball) == []
    second.data.materials.clear()  # without faces it takes no map
    second.data.materials.append(bpy.data.materials["Paint"].copy())
    second.data.materials.append(glow)
    assert bpy.ops.irpso.solve() == {"FINISHED"}
    assert all(module("blender.jobs.session").session.results_of(obj) for obj in (ball, second))


def test_what_is_not_possible_says_why(scene) -> None:
    for active in (None, "Camera 0", "Ball"):
        bpy.context.view_layer.objects.active = bpy.data.objects.get(active) if active else None
        if active == "Ball":
            bpy.ops.object.mode_set(mode="EDIT")
        assert not bpy.ops.irpso.solve.poll() and not bpy.ops.irpso.bake_gbuffer.poll()
    bpy.ops.object.mode_set(mode="OBJECT")
    assert bpy.ops.irpso.solve.poll()


def test_without_a_window_there_is_no_editor_to_show_views_in(scene) -> None:
    assert bpy.app.background and bpy.context.window is not None and not bpy.ops.irpso.show_views.poll()


def test_a_uv_map_is_made_where_blender_can_make_it(scene, tmp_path: Path) -> None:
    ball = bpy.data.objects["Ball"]
    ball.data.uv_layers.remove(ball.data.uv_layers[0])
    ball.hide_set(True)
    assert not bpy.ops.irpso.unwrap.poll()  # Blender enters Edit Mode of nothing that is hidden, without a word
    ball.hide_set(False)
    bpy.data.libraries.write(str(tmp_path / "library.blend"), {ball})
    assert bpy.ops.irpso.unwrap() == {"FINISHED"} and len(ball.data.uv_layers) == 1
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, into):
        into.objects = ["Ball"]
    scene.collection.objects.link(into.objects[0])
    bpy.context.view_layer.objects.active = into.objects[0]
    assert not bpy.ops.irpso.unwrap.poll()
    bpy.context.view_layer.objects.active = ball
    assert bpy.ops.irpso.unwrap.poll()
    ball.data.clear_geometry()
    assert not bpy.ops.irpso.unwrap.poll()


def test_noise_is_taken_out_of_the_normals_of_a_scan_in_the_scene(scene, module) -> None:
    """Flat or smooth: its vertices and faces stay.  Not where modifiers or shape keys make normals of their own."""
    ball = bpy.data.objects["Ball"]
    bpy.context.view_layer.objects.active = ball
    made = bmesh.new()
    bmesh.ops.create_icosphere(made, subdivisions=6, radius=1)
    rng, edge = np.random.default_rng(0), np.sqrt(4 * np.pi / len(made.faces))
    for vert in made.verts:
        vert.co += type(vert.co)(rng.normal(0, edge / 10, 3))
    made.to_mesh(ball.data)

    def off() -> tuple[float, np.ndarray]:
        """Degrees by which corners' normals are off from the sphere's, in the median; places of the vertices."""
        corners, places = np.empty((len(ball.data.loops), 3), "f4"), np.empty((len(ball.data.vertices), 3), "f4")
        vertices = np.empty(len(ball.data.loops), "i4")
        ball.data.corner_normals.foreach_get("vector", corners.ravel())
        ball.data.vertices.foreach_get("co", places.ravel())
        ball.data.loops.foreach_get("vertex_index", vertices)
        exact = places / np.linalg.norm(places, axis=1, keepdims=True)
        cosine = (corners * exact[vertices]).sum(1)
        return float(np.degrees(np.median(np.arccos(cosine.clip(-1, 1))))), places

    ball.modifiers.new("Bumps", "DISPLACE")
    assert not bpy.ops.irpso.denoise_normals.poll()
    ball.modifiers.clear()
    ball.shape_key_add()
    assert not bpy.ops.irpso.denoise_normals.poll()
    ball.shape_key_clear()
    flat, before = off()
    ball.data.shade_smooth()
    smooth = off()[0]
    ball.data.shade_flat()
    assert bpy.ops.irpso.denoise_normals() == {"FINISHED"}
    found, after = off()
    assert found < 0.6 * smooth < 0.6 * flat and (before == after).all()
    assert module("blender.scene.mesh_noise").degrees_of_noise(ball.data) == 0
    assert bpy.ops.irpso.denoise_normals() == {"CANCELLED"}


@pytest.mark.parametrize("sides", [3, 4])
def test_a_rough_scan_gets_a_uv_map_of_few_charts(scene, module, sides) -> None:
    """A ball whose corners are off by a fifth of an edge, as in photogrammetry; of triangles and of quads."""
    ball = bpy.data.objects["Ball"]
    made = bmesh.new()
    if sides == 3:
        bmesh.ops.create_icosphere(made, subdivisions=7, radius=1)
    else:
        bmesh.ops.create_uvsphere(made, u_segments=256, v_segments=128, radius=1)
    made.to_mesh(ball.data)
    corners = np.empty(3 * len(ball.data.vertices), np.float32)
    ball.data.vertices.foreach_get("co", corners)
    edge = np.sqrt(4 * np.pi / len(ball.data.polygons))
    ball.data.vertices.foreach_set("co", corners + np.random.default_rng(0).normal(0, edge / 5, len(corners)))
    while ball.data.uv_layers:
        ball.data.uv_layers.remove(ball.data.uv_layers[0])
    unwrap = module("blender.shoot.uv_unwrap")
    (line,) = unwrap.unwrap(ball)
    found = re.fullmatch(r"'Ball': has no UV map; one was made \((\d+) charts, because Smart UV Project would use "
                         r"(\d+) % of it\)", line)
    assert found is not None
    assert int(found[1]) < 30
    assert int(found[2]) < 30
    uvs = np.empty(2 * len(ball.data.loops), np.float32)
    ball.data.uv_layers[0].uv.foreach_get("vector", uvs)
    assert uvs.min() >= 0 and uvs.max() <= 1
    assert unwrap._used(ball.data) > 0.4
    assert bpy.context.mode == "OBJECT"


def test_the_slots_of_a_mesh_stay_where_it_gets_a_material(scene) -> None:
    """Faces are assigned to them, and another object with this mesh has materials of its own in them."""
    ball = bpy.data.objects["Ball"]
    ball.data.materials[0] = None
    ball.data.materials.append(None)
    ball.data.polygons[0].material_index = 1
    twin = bpy.data.objects.new("Twin", ball.data)
    scene.collection.objects.link(twin)
    twin.material_slots[1].link, twin.material_slots[1].material = "OBJECT", bpy.data.materials.new("Twin's")
    assert bpy.ops.irpso.unwrap() == {"FINISHED"}
    assert [slot.material.name for slot in ball.material_slots] == ["Ball", "Ball"]
    assert twin.material_slots[1].material.name == "Twin's" and ball.data.polygons[0].material_index == 1


def test_a_file_that_was_never_saved(extension) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=False)
    bpy.context.view_layer.objects.active = next(o for o in bpy.data.objects if o.type == "MESH")
    with pytest.raises(RuntimeError, match="never saved"):
        bpy.ops.irpso.solve()
    bpy.context.scene.irpso.captures = "//captures.json"
    with pytest.raises(RuntimeError, match="never saved"):
        bpy.ops.irpso.load_captures()


def test_solving_again_decides_the_model_anew(scene, module) -> None:
    scene.irpso.captures, scene.irpso.model = "//captures.json", "lambert"
    bpy.ops.irpso.solve()
    specular = bpy.data.materials["Paint"].node_tree.nodes["Principled BSDF"].inputs["Specular IOR Level"]
    assert specular.default_value == 0.0
    scene.irpso.model = "one-lobe"
    bpy.ops.irpso.solve()
    assert specular.default_value == 0.5
    warnings = module("blender.jobs.session").session.solution_of(bpy.data.objects["Ball"]).warnings
    assert not any("Specular" in warning for warning in warnings)


def test_settings_come_from_the_table(scene, module) -> None:
    table, settings = module("core.params"), module("blender.properties").settings
    assert settings(scene.irpso) == table.SolveSettings(size=SIZE)
    scene.irpso.model, scene.irpso.method, scene.irpso.seed = "lambert", "swarm", 7
    assert settings(scene.irpso) == table.SolveSettings(size=SIZE, model="lambert", method="swarm", seed=7)
    scene.irpso.size = 1
    assert scene.irpso.size == 16  # the table's limit
    for name, row in table.SolveSettings.__dataclass_fields__.items():
        assert scene.irpso.bl_rna.properties[name].name == row.metadata["label"]
        assert scene.irpso.bl_rna.properties[name].description == row.metadata["doc"]


def test_registering_twice_over(extension) -> None:
    """Unregister takes everything back, so that the extension can be switched off and on."""
    extension.unregister()
    assert not hasattr(bpy.types.Scene, "irpso") and not hasattr(bpy.types, "IRPSO_PT_solve")
    assert not any("irpso" in str(h.__module__) for h in bpy.app.handlers.load_pre)
    extension.register()
    assert hasattr(bpy.types.Scene, "irpso") and bpy.ops.irpso.solve.idname() == "IRPSO_OT_solve"
