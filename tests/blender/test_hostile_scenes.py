"""What no user means and a file may hold: refused by name, not computed with.  `python -m studies.fuzz` found them."""

from __future__ import annotations

import math

import pytest

from irpso_addon.core.data import View
from irpso_addon.core.errors import BadInput

bpy = pytest.importorskip("bpy")
NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(("kind", "name", "value"), [
    ("POINT", "energy", NAN), ("POINT", "energy", INF), ("POINT", "color", (1, NAN, 1)),
    ("POINT", "shadow_soft_size", NAN),
    ("SPOT", "spot_size", NAN), ("SUN", "angle", NAN), ("AREA", "size", NAN), ("AREA", "spread", 0.0),
])
def test_lamps(stage, kind, name, value):
    stage.key.data.type = kind
    setattr(stage.key.data, name, value)
    with pytest.raises(BadInput, match="light 'Key'"):
        stage.read()


@pytest.mark.parametrize(("name", "value"), [("shift_y", NAN), ("shift_x", 1e30), ("lens", NAN)])
def test_cameras(stage, name, value):
    setattr(stage.camera.data, name, value)
    with pytest.raises(BadInput, match="camera 'Cam'"):
        stage.read()


@pytest.mark.parametrize(("name", "value", "words"), [
    ("film_exposure", 0.0, "film exposure"), ("film_exposure", NAN, "film exposure"),
    ("filter_width", NAN, "pixel filter"),
])
def test_settings_of_the_render(stage, name, value, words):
    stage.scene.cycles.pixel_filter_type = "GAUSSIAN"
    setattr(stage.scene.cycles, name, value)
    with pytest.raises(BadInput, match=f"scene 'Scene': its {words}"):
        stage.read()


@pytest.mark.parametrize("place", [(1e30, 0, 0), (0, NAN, 0)])
def test_places(stage, place):
    stage.subject.location = place
    with pytest.raises(BadInput, match="object 'Subject'"):
        stage.read()


@pytest.mark.parametrize("exposure", [NAN, INF, 1e20, -65.0])
def test_exposures_of_the_list(stage, module, exposure):
    module("blender.properties").register()
    entry = stage.scene.irpso.views.add()
    entry.image, entry.camera, entry.exposure = "//a.exr", stage.camera, exposure
    with pytest.raises(BadInput, match="view 0 of scene 'Scene': exposure"):
        stage.read(captures=None)


def test_meshes_of_libraries_with_normal_maps(stage):
    """Tangents of a mesh that cannot be edited crash Blender."""
    tree = stage.subject.data.materials[0].node_tree
    texture, bump = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeNormalMap")
    texture.image = bpy.data.images.new("normals", 4, 4, is_data=True)
    tree.links.new(texture.outputs["Color"], bump.inputs["Color"])
    tree.links.new(bump.outputs["Normal"], tree.nodes["Principled BSDF"].inputs["Normal"])
    assert stage.read().mesh.tangents is not None
    library = stage.folder / "library.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(library), copy=True)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(library), link=True) as (there, here):
        here.objects = list(there.objects)
    for obj in here.objects:
        bpy.context.scene.collection.objects.link(obj)
    bpy.context.scene.render.resolution_x, bpy.context.scene.render.resolution_y = 36, 24
    bpy.ops.wm.save_as_mainfile(filepath=str(stage.folder / "stage.blend"))
    with pytest.raises(BadInput, match="object 'Subject': its mesh is linked"):
        stage.read()


@pytest.mark.parametrize("value", [3, 0.5, "x", [1, 2], {"base_color": 3}, {"a": {"b": "c"}}, b"bytes"])
def test_other_things_under_our_names(stage, value):
    from irpso_addon.blender import files
    from irpso_addon.blender.jobs import solve_region
    from irpso_addon.blender.material.tags import TAG

    stage.subject[TAG] = value
    with pytest.raises(BadInput):
        files.read_maps(files.solved_object("Subject"))
    data = stage.read()
    assert solve_region.with_part(None, stage.subject, data, "last", "ALL").start is None
    assert all(isinstance(view, View) for view in data.views)
