"""Results live with the file: report, maps and figures are there after it was saved and opened again."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest

SIZE = 64


@pytest.fixture
def scene(extension, scenes: Path, tmp_path: Path) -> bpy.types.Scene:
    """A private copy of the good scene, its ball active, small maps asked for, and a solve that takes a second."""
    shutil.copytree(scenes / "good", tmp_path / "good")
    opened(tmp_path / "good" / "scene.blend")
    settings = bpy.context.scene.irpso
    settings.size, settings.captures = SIZE, "//captures.json"
    settings.model, settings.lamps, settings.exposures, settings.registration = "one-lobe", "given", "given", "given"
    return bpy.context.scene


def opened(path: Path) -> bpy.types.Object:
    bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
    bpy.context.view_layer.objects.active = bpy.data.objects["Ball"]
    return bpy.data.objects["Ball"]


def saved() -> Path:
    path = Path(bpy.data.filepath).with_name("tomorrow.blend")
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def pixels(name: str) -> np.ndarray:
    image = bpy.data.images[name]
    values = np.empty(image.size[0] * image.size[1] * 4, "f4")
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], 4)[..., :3]


def test_tomorrow_everything_is_there(scene, module) -> None:
    session = module("blender.jobs.session").session
    for name in ("model", "lamps", "exposures", "registration"):
        scene.irpso.property_unset(name)  # with all that a solve can find
    assert bpy.ops.irpso.solve() == {"FINISHED"}
    ball = bpy.data.objects["Ball"]
    before, label = session.solution_of(ball), session.results_of(ball)[-1].label
    assert any(name in label for name in ("Roughness", "Two Roughnesses", "Diffuse Only"))
    ball = opened(saved())
    result = session.results_of(ball)[-1]
    assert result.label == label and result.load is not None  # panels need no maps
    after = session.facts_of(ball)
    for name in ("texels", "warnings", "model", "seconds", "views_used", "checks", "predictions", "residual"):
        assert getattr(after, name) == getattr(before, name) or name == "checks", name
    assert after.checks.noise == before.checks.noise and len(after.checks.views) == len(before.checks.views)
    assert [picture.view for picture in after.pictures] == [picture.view for picture in before.pictures] != []
    assert bpy.ops.irpso.export_maps.poll()
    whole = session.solution_of(ball)
    for name in ("base_color", "roughness", "confidence", "error", "filled", "coverage", "roughness_sigma",
                 "base_sigma"):
        np.testing.assert_array_equal(getattr(whole.maps, name), getattr(before.maps, name), err_msg=name)
    folder = Path(bpy.data.filepath).parent / "again"
    assert bpy.ops.irpso.export_maps(directory=str(folder)) == {"FINISHED"}
    assert (folder / "Ball_filled.exr").exists()


def test_a_material_is_followed_through_renaming_and_saving(scene, module) -> None:
    session = module("blender.jobs.session").session
    ball, paint = bpy.data.objects["Ball"], bpy.data.materials["Paint"]
    bpy.ops.irpso.solve(write=False)
    paint.name = "Lacquer"
    assert set(session.facts_of(ball).model) == {"Lacquer"}
    assert bpy.ops.irpso.write_maps() == {"FINISHED"}
    paint.name = "Enamel"
    path = saved()
    ball = opened(path)
    bpy.data.materials["Enamel"].name = "Varnish"
    assert set(session.facts_of(ball).model) == {"Varnish"}
    ball = opened(path)
    assert set(session.facts_of(ball).model) == {"Enamel"}
    assert bpy.ops.irpso.write_maps() == {"FINISHED"}


def test_a_material_renamed_between_reading_and_placing(scene, module) -> None:
    place = module("blender.jobs.solve_object")
    properties = module("blender.properties")
    ball = bpy.data.objects["Ball"]
    order = place.read(bpy.context, ball, Path(bpy.path.abspath("//captures.json")),
                       properties.settings(scene.irpso))
    solution = place.run(order, Path(bpy.data.filepath), Path(bpy.data.filepath).parent, lambda _: None)
    bpy.data.materials["Paint"].name = "Lacquer"
    place.place_now(ball, order, solution)
    principled = bpy.data.materials["Lacquer"].node_tree.nodes["Principled BSDF"]
    assert principled.inputs["Base Color"].links[0].from_node.image == bpy.data.images["Ball_basecolor"]


def test_a_slot_without_faces_has_a_linked_material_of_the_same_name(scene, module, tmp_path: Path) -> None:
    """Also where the one with faces is renamed, and when the file is opened again."""
    session, place = module("blender.jobs.session").session, module("blender.jobs.solve_object")
    library = tmp_path / "library.blend"
    bpy.data.libraries.write(str(library), {bpy.data.materials["Paint"]})
    with bpy.data.libraries.load(str(library), link=True) as (_, into):
        into.materials = ["Paint"]
    ball, far = bpy.data.objects["Ball"], into.materials[0]
    ball.data.materials.append(far)
    assert far.library is not None and far.name == ball.material_slots[0].material.name == "Paint"
    assert bpy.ops.irpso.solve() == bpy.ops.irpso.write_maps() == {"FINISHED"}
    ball = opened(saved())
    assert bpy.ops.irpso.write_maps() == {"FINISHED"}
    order = place.read(bpy.context, ball, Path(bpy.path.abspath("//captures.json")),
                       module("blender.properties").settings(bpy.context.scene.irpso))
    solution = place.run(order, Path(bpy.data.filepath), Path(bpy.data.filepath).parent, lambda _: None)
    ball.material_slots[0].material.name = "Lacquer"
    place.place_now(ball, order, solution)
    assert set(session.facts_of(ball).model) == {"Lacquer"} and bpy.ops.irpso.write_maps() == {"FINISHED"}
    principled = bpy.data.materials["Lacquer", None].node_tree.nodes["Principled BSDF"]
    assert principled.inputs["Base Color"].links[0].from_node.image == bpy.data.images["Ball_basecolor"]


def test_a_material_that_is_deleted_while_its_solve_runs(scene, module) -> None:
    """The line names the way to bring the result onto another one, and it leads there."""
    place = module("blender.jobs.solve_object")
    ball = bpy.data.objects["Ball"]
    order = place.read(bpy.context, ball, Path(bpy.path.abspath("//captures.json")),
                       module("blender.properties").settings(scene.irpso))
    solution = place.run(order, Path(bpy.data.filepath), Path(bpy.data.filepath).parent, lambda _: None)
    bpy.data.materials.remove(bpy.data.materials["Paint"])
    new = ball.material_slots[0].material = bpy.data.materials.new("New")
    with pytest.raises(module("core.errors").BadInput, match=r"'Paint'.*of that name.*Write to Material") as caught:
        place.place_now(ball, order, solution)
    assert bpy.ops.irpso.write_maps.get_rna_type().name in str(caught.value)
    new.name = "Paint"
    assert bpy.ops.irpso.write_maps() == {"FINISHED"}
    assert new.node_tree.nodes["Principled BSDF"].inputs["Base Color"].links[0].from_node.image == (
        bpy.data.images["Ball_basecolor"])


@pytest.mark.parametrize("record", [
    b"", b"x" * 100, 7, {"number": "1", "record": b"zzz"}, {"number": [1], "record": 2}])
def test_whatever_a_file_holds_by_that_name(scene, module, record) -> None:
    session, stored = module("blender.jobs.session").session, module("blender.jobs.stored_result")
    bpy.ops.irpso.solve()
    bpy.data.objects["Ball"][stored.RECORD_TAG] = record
    ball = opened(saved())
    assert session.facts_of(ball) is not None  # the maps are there
    assert bpy.ops.irpso.export_maps(directory=str(Path(bpy.data.filepath).parent / "maps")) == {"FINISHED"}


def test_an_earlier_result_comes_back_by_a_click(scene, module) -> None:
    session = module("blender.jobs.session").session
    ball = bpy.data.objects["Ball"]
    scene.irpso.model = "lambert"
    bpy.ops.irpso.solve()
    opened(saved())  # also one of an earlier session
    scene, ball = bpy.context.scene, bpy.data.objects["Ball"]
    first = pixels("Ball_basecolor").copy()
    scene.irpso.model = "one-lobe"
    bpy.ops.irpso.solve()
    assert [("Diffuse Only" in r.label, "Roughness" in r.label) for r in session.results_of(ball)] == [
        (True, False), (False, True)]
    assert not np.array_equal(pixels("Ball_basecolor"), first)
    bpy.ops.ed.undo_push(message="solved")
    assert bpy.ops.irpso.restore_result("EXEC_DEFAULT", True, index=0) == {"FINISHED"}
    np.testing.assert_array_equal(pixels("Ball_basecolor"), first)
    assert set(session.facts_of(ball).model.values()) == {"lambert"}
    assert len(session.results_of(ball)) == 2
    assert module("blender.jobs.solve_object").is_placed(ball)
    ball = opened(saved())
    assert set(session.facts_of(ball).model.values()) == {"lambert"}


def test_a_shared_material_is_copied_or_shared_as_chosen(scene, module) -> None:
    material_sharing = module("blender.material.material_sharing")
    ball = bpy.data.objects["Ball"]
    other = bpy.data.objects.new("Other", ball.data)
    scene.collection.objects.link(other)
    assert material_sharing.shared_with(ball) == {"Paint": ["Other"]}
    scene.irpso.shared_material = "SHARE"
    bpy.ops.irpso.solve()
    assert ball.material_slots[0].material == other.material_slots[0].material
    scene.irpso.shared_material = "COPY"
    assert bpy.ops.irpso.solve() == {"FINISHED"}
    assert ball.material_slots[0].material != other.material_slots[0].material
    assert material_sharing.shared_with(ball) == {}


def test_another_scene_is_open_when_the_maps_come(scene, module) -> None:
    """Its setting is of no matter."""
    place = module("blender.jobs.solve_object")
    ball = bpy.data.objects["Ball"]
    other = bpy.data.objects.new("Other", ball.data)
    scene.collection.objects.link(other)
    scene.irpso.shared_material = "SHARE"
    order = place.read(bpy.context, ball, Path(bpy.path.abspath("//captures.json")),
                       module("blender.properties").settings(scene.irpso))
    solution = place.run(order, Path(bpy.data.filepath), Path(bpy.data.filepath).parent, lambda _: None)
    bpy.context.window.scene = bpy.data.scenes.new("Second")
    assert bpy.context.scene.irpso.shared_material == "COPY"
    place.place_now(ball, order, solution)
    assert ball.material_slots[0].material == other.material_slots[0].material == bpy.data.materials["Paint"]


def test_pictures_of_the_views_take_little_room(scene, module) -> None:
    data, stored = module("core.data"), module("blender.jobs.stored_result")
    many = tuple(data.ViewPicture(f"{i}.exr", "Camera", (), np.full((300, 200, 3), i, np.float16),
                                  np.zeros((300, 200, 3), np.float16), 1.0) for i in range(50))
    kept = stored._fewer_pixels(many)
    assert [(p.view, float(p.reference.min())) for p in kept] == [(f"{i}.exr", float(i)) for i in range(50)]
    assert 0.1 * stored.PICTURES < sum(p.reference.nbytes + p.predicted.nbytes for p in kept) <= 1.1 * stored.PICTURES
    assert stored._fewer_pixels(many[:1]) == many[:1] and stored._fewer_pixels(()) == ()


@pytest.mark.parametrize("finished", [False, True])
def test_a_stopped_solve_counts_what_it_has_solved(module, finished) -> None:
    """A draft alone has solved nothing; of half the texels at full size it has solved these."""
    live, display, params = module("core.live_maps").Live, module("blender.jobs.live_display"), module("core.params")

    class Data:
        mesh = type("Mesh", (), {"slot_names": ("Paint",), "slots": np.zeros(2, np.int32)})
        views, start = (), None

    maps = display.LiveMaps(Data, params.SolveSettings(size=16, model="one-lobe"))
    covered = np.ones((16, 16), bool)
    draft = {"base_color": np.full((16, 16, 3), 0.5, "f4"), "roughness": np.full((16, 16), 0.5, "f4"),
             "confidence": np.ones((16, 16), "f4"), "error": np.full((16, 16), 0.1, "f4")}
    maps.take_preview(live(draft, covered))
    if finished:
        half = np.where(np.arange(16)[:, None] < 8, np.full((16, 16), 0.3, "f4"), np.float32(np.nan))
        maps.take(live({"roughness": half, "confidence": half, "error": half}, covered))
    stopped = maps.solution()
    solved = 128 if finished else 0
    assert stopped.texels == {"covered": 256, "observed": solved, "solved": solved, "filled": 256 - solved}
    assert stopped.maps.filled.sum() == 256 - solved and (stopped.maps.confidence[stopped.maps.filled] == 0).all()
    assert "base colour is still coarse" in stopped.warnings[0]


def test_maps_so_far_of_a_file_that_was_saved_during_a_solve_are_no_result(scene, module) -> None:
    """The panel would offer an export of it, which fails."""
    material, session = module("blender.material.material"), module("blender.jobs.session").session
    for role, shape in (("base_color", (8, 8, 3)), ("roughness", (8, 8)), ("confidence", (8, 8)), ("error", (8, 8))):
        material.put_image(bpy.data.objects["Ball"], role, np.ones(shape, np.float32))
    ball = opened(saved())
    assert session.results_of(ball) == [] and not bpy.ops.irpso.export_maps.poll()
    for role in ("roughness_sigma", "basecolor_sigma"):  # as in a file from before there were records
        material.put_image(ball, role, np.ones((8, 8), np.float32))
    ball = opened(saved())
    assert len(session.results_of(ball)) == 1 and bpy.ops.irpso.export_maps.poll()


def test_maps_so_far_of_a_second_solve_are_not_the_first_ones_result(scene, module) -> None:
    """Saved during a second solve, a file has maps of that one: the panel would show and export them as the first."""
    live, display = module("core.live_maps").Live, module("blender.jobs.live_display")
    place, properties = module("blender.jobs.solve_object"), module("blender.properties")
    session = module("blender.jobs.session").session
    assert bpy.ops.irpso.solve() == {"FINISHED"}
    ball, first = bpy.data.objects["Ball"], pixels("Ball_basecolor")
    order = place.read(bpy.context, ball, Path(bpy.path.abspath("//captures.json")), properties.settings(scene.irpso))
    maps = display.LiveMaps(order.data, order.settings)
    maps.take_preview(live({role: np.full(shape, 0.5, "f4") for role, shape in (
        ("base_color", (SIZE, SIZE, 3)), ("roughness", (SIZE, SIZE)), ("confidence", (SIZE, SIZE)),
        ("error", (SIZE, SIZE)))}, np.ones((SIZE, SIZE), bool)))
    for _ in range(5):  # one image a call, then all of them onto the object
        maps.show(ball)
    assert (pixels("Ball_basecolor") == 0.5).all()
    during = saved()
    assert not place.is_placed(ball) and bpy.ops.irpso.write_maps() == {"FINISHED"}  # the first one is remembered ...
    np.testing.assert_array_equal(pixels("Ball_basecolor"), first)  # ... and goes back as it was
    assert place.is_placed(ball)
    assert session.results_of(opened(during)) == [] and not bpy.ops.irpso.export_maps.poll()


def test_a_stopped_solve_is_placed_beside_a_material_without_faces(scene, module) -> None:
    """Which needs no Principled BSDF: no map goes there."""
    live, display = module("core.live_maps").Live, module("blender.jobs.live_display")
    place, properties = module("blender.jobs.solve_object"), module("blender.properties")
    ball, glow = bpy.data.objects["Ball"], bpy.data.materials.new("Glow")
    if bpy.app.version < (5, 0, 0):
        glow.use_nodes = True
    tree = glow.node_tree
    tree.links.new(tree.nodes.new("ShaderNodeEmission").outputs[0], tree.get_output_node("ALL").inputs["Surface"])
    ball.data.materials.append(glow)
    settings = properties.settings(scene.irpso)
    order = place.read(bpy.context, ball, Path(bpy.path.abspath("//captures.json")), settings)
    maps = display.LiveMaps(order.data, settings)
    maps.take_preview(live({"base_color": np.full((SIZE, SIZE, 3), 0.5, "f4"), "roughness": np.ones((SIZE, SIZE), "f4"),
                            "confidence": np.ones((SIZE, SIZE), "f4"), "error": np.ones((SIZE, SIZE), "f4")},
                           np.ones((SIZE, SIZE), bool)))
    place.place_now(ball, order, maps.solution())
    principled = bpy.data.materials["Paint"].node_tree.nodes["Principled BSDF"]
    assert principled.inputs["Base Color"].links[0].from_node.image == bpy.data.images["Ball_basecolor"]
    assert not any("irpso" in node for node in tree.nodes)


def texel(path: Path) -> np.ndarray:
    """RGB in the middle of an EXR."""
    oiio = pytest.importorskip("OpenImageIO")
    return np.asarray(oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT))[SIZE // 2, SIZE // 2]


def test_what_is_painted_on_a_map_is_exported(scene, tmp_path: Path) -> None:
    """At once as after the file was opened again."""
    assert bpy.ops.irpso.solve() == {"FINISHED"}
    before = pixels("Ball_basecolor")
    for folder in ("solved", "painted", "opened"):
        if folder == "painted":
            image, red = bpy.data.images["Ball_basecolor"], np.empty((SIZE * SIZE, 4), "f4")
            red[:] = 0.75, 0.25, 0.125, 1
            image.pixels.foreach_set(red.ravel())
            image.update()
        elif folder == "opened":
            bpy.data.images["Ball_basecolor"].pack()
            opened(saved())
        assert bpy.ops.irpso.export_maps(directory=str(tmp_path / folder), target="irpso") == {"FINISHED"}
    np.testing.assert_array_equal(texel(tmp_path / "solved" / "Ball_basecolor.exr"), before[SIZE // 2 - 1, SIZE // 2])
    for folder in ("painted", "opened"):
        np.testing.assert_array_equal(texel(tmp_path / folder / "Ball_basecolor.exr"), [0.75, 0.25, 0.125])
    for name in ("roughness", "confidence", "filled"):
        assert (tmp_path / "painted" / f"Ball_{name}.exr").read_bytes() == (
            tmp_path / "solved" / f"Ball_{name}.exr").read_bytes()


def test_maps_whose_images_were_scaled_are_exported_as_they_are(scene, tmp_path: Path) -> None:
    """At once as after the file was opened again; until all of them have one size, a line states which has not."""
    oiio = pytest.importorskip("OpenImageIO")
    assert bpy.ops.irpso.solve() == {"FINISHED"}
    images = [image for image in bpy.data.images if image.name.startswith("Ball_")]
    folders = tmp_path / "scaled", tmp_path / "opened"
    for count, image in enumerate(images):
        image.scale(SIZE // 2, SIZE // 2)
        if count + 1 < len(images):
            with pytest.raises(RuntimeError, match=r"'Ball': its .* map has 32 x 32 texels, not 64 x 64 as"):
                bpy.ops.irpso.export_maps(directory=str(folders[0]))
    assert len(images) == 6 and not folders[0].exists()
    for folder in folders:
        for target in ("irpso", "unreal"):
            assert bpy.ops.irpso.export_maps(directory=str(folder), target=target) == {"FINISHED"}
        if folder == folders[0]:
            for image in images:
                image.pack()
            opened(saved())
    made = [{path.name: path.read_bytes() for path in folder.iterdir()} for folder in folders]
    assert made[0] == made[1] and {"Ball_basecolor.exr", "Ball_filled.exr", "T_Ball_ORM.png"} <= made[0].keys()
    assert {oiio.ImageBuf(str(folders[0] / name)).spec().width for name in made[0]} == {SIZE // 2}


def test_maps_that_are_gone_or_differ_in_size_are_named(scene, tmp_path: Path) -> None:
    """The panel still has the result's record, so the line must state what is wrong with its maps."""
    scene.irpso.out = str(tmp_path / "maps")
    assert bpy.ops.irpso.solve() == bpy.ops.irpso.write_maps(packed=False) == {"FINISHED"}
    lost, path = tmp_path / "maps" / "Ball_roughness.exr", saved()
    lost.rename(tmp_path / "aside.exr")
    opened(path)
    with pytest.raises(RuntimeError, match=r"'Ball': its roughness map cannot be read from .*Ball_roughness\.exr; put"):
        bpy.ops.irpso.export_maps(directory=str(tmp_path / "out"), target="gltf")
    (tmp_path / "aside.exr").rename(lost)
    opened(path)
    bpy.data.images["Ball_roughness"].scale(32, 32)
    bpy.data.images["Ball_roughness"].pack()
    opened(saved())
    with pytest.raises(RuntimeError, match="'Ball': its roughness map has 32 x 32 texels, not 64 x 64 as another one"):
        bpy.ops.irpso.export_maps(directory=str(tmp_path / "out"), target="gltf")
    assert not (tmp_path / "out").exists()
