"""The lamps' power by a grey card that Cycles renders."""

from __future__ import annotations

import json

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Vector  # noqa: E402

from irpso_addon.blender import properties  # noqa: E402
from irpso_addon.blender.shoot.grey_card import GreyCard, set_power_by_grey_card  # noqa: E402
from irpso_addon.blender.shoot.view_pictures import listed_views, named_view  # noqa: E402
from irpso_addon.core.errors import BadInput  # noqa: E402
from irpso_addon.core.images.image_writer import write_image  # noqa: E402
from irpso_addon.core.lens import Lens  # noqa: E402
from tests.blender import cycles_rig as rig  # noqa: E402
from tests.support.picture_files import save  # noqa: E402

PIXELS, GREY, WATTS = 96, 0.18, 100.0
EYE, LAMP = (0.8, -2.0, 1.5), (-0.7, -0.9, 1.1)
COLOUR = (1.0, 0.8, 0.5)


def look(scene, folder):
    """Renders the camera's picture; returns it, row 0 at the top."""
    bpy.context.view_layer.update()
    rgb = rig.render()["rgb"]
    write_image(folder / "card.exr", rgb[::-1].astype(np.float32), kind="exr", color=True)
    return rgb


def pixel_of(point):
    """Where a pinhole camera at EYE shows a place, from the upper left."""
    local = np.array(bpy.context.scene.camera.matrix_world.inverted()) @ [*point, 1.0]
    focal = PIXELS / 2 / np.tan(np.radians(20.0))
    return PIXELS / 2 - focal * local[0] / local[2], PIXELS / 2 + focal * local[1] / local[2]


@pytest.fixture
def studio(tmp_path):
    """A plane of base colour 0.18, lit by one lamp of 100 W that the scene has forgotten, and two lights more."""
    scene = rig.scene(PIXELS, samples=16)
    if not hasattr(bpy.types.Scene, "irpso"):
        properties.register()
    rig.camera(EYE, degrees=40.0)
    floor = rig.plane(0.5)
    rig.principled(floor, (GREY,) * 3, 1.0, 0.0)
    lamp = rig.lamp("POINT", LAMP, shadow_soft_size=0.02, energy=WATTS)
    yield scene, floor, lamp, tmp_path


def add_view(scene, folder, *lights):
    view = scene.irpso.views.add()
    view.image, view.camera = str(folder / "card.exr"), scene.camera
    for light in lights:
        view.lights.add().light = light
    return view


def test_a_card_on_the_mesh(studio):
    """The factor is that of the powers to 2 %; each data block is scaled once, also those of other views."""
    scene, floor, lamp, folder = studio
    rgb = look(scene, folder)
    point = (0.2, 0.15, 0.0)
    x, y = pixel_of(point)
    offset = np.array(LAMP) - point  # what Lambert's law says is in the square
    says = GREY / np.pi * WATTS * offset[2] / np.linalg.norm(offset) / (4 * np.pi * offset @ offset)
    assert rgb[int(y), int(x), 1] == pytest.approx(says, rel=0.02)
    lamp.data.energy = 37.0
    twin = rig.add("twin", lamp.data, (1, 1, 1))
    other = rig.lamp("SUN", (0, 0, 2), energy=2.0)
    idle = rig.lamp("POINT", (0, 0, 2), energy=3.0)
    add_view(scene, folder, lamp)
    add_view(scene, folder, twin, other).image = str(folder / "other.exr")
    scene.irpso.photographs, scene.irpso.scale_known = True, False
    lines = set_power_by_grey_card(bpy.context, floor, GreyCard("card.exr", x, y, 8, GREY))
    assert lamp.data.energy == pytest.approx(WATTS, rel=0.02)
    assert other.data.energy == pytest.approx(2.0 * WATTS / 37, rel=0.02) and idle.data.energy == 3.0
    assert scene.irpso.scale_known and len(lines) == 2
    assert lines[0].startswith(f"power of '{lamp.data.name}' x 2.") and "card.exr" in lines[0]
    assert lines[0].endswith(f"{lamp.data.energy:.4g} W") and lines[1].endswith(f"{other.data.energy:.4g} W/m^2")


def test_exposure_and_no_light_of_its_own(studio):
    """The view's exposure counts; a view without lights is lit by all that render."""
    scene, floor, lamp, folder = studio
    look(scene, folder)
    add_view(scene, folder).exposure = -1.0  # the file's values are half the radiance, it says
    set_power_by_grey_card(bpy.context, floor, GreyCard(str(folder / "card.exr"), *pixel_of((0, 0, 0)), 8, GREY))
    assert lamp.data.energy == pytest.approx(2 * WATTS, rel=0.02)


def test_what_a_solve_undoes_is_undone(studio):
    """Light of the room, a lens that falls off, a black level: the power is that of the lamp alone."""
    scene, floor, lamp, folder = studio
    rgb = look(scene, folder)
    room, black = np.float32(0.3) * rgb + np.float32(0.2), (0.11, 0.07, 0.05)
    fall = np.linspace(0.5, 1.0, PIXELS, dtype=np.float32)[:, None, None]
    for name, values in (("shot", (rgb + room) * fall + black), ("room", room * fall + black),
                         ("flat", np.ones_like(rgb) * fall + black)):
        write_image(folder / f"{name}.exr", values[::-1].astype(np.float32), kind="exr", color=True)
    view = add_view(scene, folder, lamp)
    view.image, view.ambient, view.flat = (str(folder / f"{name}.exr") for name in ("shot", "room", "flat"))
    view.black_level = black
    lamp.data.energy = 37.0
    set_power_by_grey_card(bpy.context, floor, GreyCard("shot.exr", *pixel_of((0, 0, 0)), 8, GREY))
    assert lamp.data.energy == pytest.approx(WATTS, rel=0.03)  # the flat field's white is its 99 % point


def test_ambient_light_of_the_view_is_none_of_the_lamps(studio):
    """Radiance L from everywhere adds rho L to a matt card."""
    scene, floor, lamp, folder = studio
    ambient = np.array((0.3, 0.2, 0.1))
    rgb = look(scene, folder) + np.float32(GREY * ambient)
    write_image(folder / "card.exr", rgb[::-1].astype(np.float32), kind="exr", color=True)
    view = add_view(scene, folder, lamp)
    card = GreyCard("card.exr", *pixel_of((0, 0, 0)), 8, GREY)
    view.ambient_radiance = 100 * ambient
    with pytest.raises(BadInput, match="Ambient Light alone would make the patch brighter"):
        set_power_by_grey_card(bpy.context, floor, card)
    view.ambient_radiance = ambient
    set_power_by_grey_card(bpy.context, floor, card)
    assert lamp.data.energy == pytest.approx(WATTS, rel=0.02)


@pytest.mark.parametrize(("states", "shade", "warned"), [(0.18, 1.0, False), (0.9, 1.0, True), (0.18, 0.1, True)])
def test_a_card_that_makes_the_mesh_whiter_than_white(studio, states, shade, warned):
    """In shadow, or with another reflectance than stated; the floor's base colour is 0.4."""
    scene, floor, lamp, folder = studio
    rgb = look(scene, folder) * np.float32(0.4 / GREY)
    x, y = map(int, pixel_of((0, 0, 0)))
    rgb[y - 6:y + 6, x - 6:x + 6] *= shade * GREY / 0.4
    write_image(folder / "card.exr", rgb[::-1].astype(np.float32), kind="exr", color=True)
    add_view(scene, folder, lamp)
    lines = set_power_by_grey_card(bpy.context, floor, GreyCard("card.exr", x, y, 8, states))
    found = [line for line in lines if "times as bright as a white surface" in line]
    assert bool(found) == warned
    if warned:
        times = float(found[0].split(" is ")[1].split(" times")[0])
        assert times == pytest.approx(0.4 * states / GREY / shade, rel=0.1)


@pytest.mark.parametrize(("exposure", "warned"), [(0.0, True), (2.0, False)])
def test_a_card_that_was_exposed_otherwise(studio, exposure, warned):
    """Pictures that were added by hand have no Exposure; EXIF states two steps more for that of the card."""
    scene, floor, lamp, folder = studio
    rgb = look(scene, folder)[..., :3].astype(np.float32)
    for name, time, values in (("a.exr", 1 / 60, rgb), ("b.exr", 1 / 60, rgb), ("card.exr", 1 / 15, 4 * rgb)):
        save(folder / name, values / 100, "float", ExposureTime=time, FNumber=8.0, Exif__PhotographicSensitivity=100)
        view = add_view(scene, folder, lamp)
        view.image, view.exposure = str(folder / name), exposure if name == "card.exr" else 0.0
    lines = set_power_by_grey_card(bpy.context, floor, GreyCard("card.exr", *pixel_of((0, 0, 0)), 8, GREY))
    found = [line for line in lines if "EXIF" in line]
    line = ("card.exr: EXIF states an exposure of +2.00 EV beside the other views and their Exposure; set its Exposure "
            "to 2 and click again, unless a flash shorter than the exposure time lit all of them")
    assert found == ([line] if warned else [])
    assert lamp.data.energy == pytest.approx(WATTS / 100 * (4 if warned else 1), rel=0.02)


def test_a_card_beside_the_mesh(studio):
    """It is taken to stand as far away as the mesh, and to face the camera: so it does here."""
    scene, floor, lamp, folder = studio
    rig.principled(floor, (0.7, 0.5, 0.4), 1.0, 0.0)
    card = rig.plane(0.15)
    away = np.linalg.norm(EYE)
    towards = np.array((-0.35, 0.1, 0.25)) - EYE
    towards *= away / np.linalg.norm(towards)
    card.location = EYE + towards
    card.rotation_euler = Vector(-towards).to_track_quat("Z", "Y").to_euler()
    rig.principled(card, (GREY,) * 3, 1.0, 0.0)
    look(scene, folder)
    add_view(scene, folder, lamp)
    lamp.data.energy = 37.0
    lines = set_power_by_grey_card(bpy.context, floor, GreyCard("card.exr", *pixel_of(card.location), 6, GREY))
    assert lamp.data.energy == pytest.approx(WATTS, rel=0.02)
    assert "is not on" in lines[0] and f"{away:.3g} m" in lines[0]


def test_the_colour_of_the_light_is_told(studio):
    scene, floor, lamp, folder = studio
    lamp.data.color = COLOUR
    look(scene, folder)
    lamp.data.color = (1, 1, 1)
    add_view(scene, folder, lamp)
    lines = set_power_by_grey_card(bpy.context, floor, GreyCard("card.exr", *pixel_of((0, 0, 0)), 8, GREY))
    mean = float(np.array([0.2126, 0.7152, 0.0722]) @ COLOUR)
    assert lamp.data.energy == pytest.approx(WATTS * mean, rel=0.02)
    assert f"red x {1 / mean:.3f}"[:-1] in lines[1] and "colour of the light" in lines[1]


@pytest.mark.parametrize(("card", "words"), [
    (GreyCard("card.exr", 2, 40, 20, GREY), "is not inside the picture"),
    (GreyCard("card.exr", np.nan, 40, 20, GREY), "is not inside the picture"),
    (GreyCard("card.exr", 48, 48, 8, 0.0), "its reflectance is 0"),
    (GreyCard("none.exr", 48, 48, 8, GREY), "no view has this picture"),
    (GreyCard("card.exr", 48, 48, 2, GREY), "fewer than 16 pixels"),
])
def test_what_is_refused_changes_nothing(studio, card, words):
    scene, floor, lamp, folder = studio
    look(scene, folder)
    add_view(scene, folder, lamp)
    scene.irpso.scale_known = False
    with pytest.raises(BadInput, match=words):
        set_power_by_grey_card(bpy.context, floor, card)
    assert lamp.data.energy == WATTS and not scene.irpso.scale_known


def test_a_lamp_of_no_view_keeps_its_power(studio):
    """Though it shares its data with one that is scaled."""
    scene, floor, lamp, folder = studio
    look(scene, folder)
    add_view(scene, folder, lamp)
    add_view(scene, folder, lamp).image = str(folder / "other.exr")
    lamp.data.energy = 37.0
    idle = rig.add("idle", lamp.data, (1, 1, 1))
    lines = set_power_by_grey_card(bpy.context, floor, GreyCard("card.exr", *pixel_of((0, 0, 0)), 8, GREY))
    assert lamp.data.energy == pytest.approx(WATTS, rel=0.02) and idle.data.energy == 37.0
    assert len(lines) == 1 and lines[0].startswith(f"power of '{lamp.data.name}' x 2.")


def test_keyframes_of_the_power_are_refused(studio):
    """They would set it back at the next frame."""
    scene, floor, lamp, folder = studio
    look(scene, folder)
    add_view(scene, folder, lamp)
    lamp.data.energy = 37.0
    lamp.data.keyframe_insert("energy", frame=1)
    with pytest.raises(BadInput, match=f"light '{lamp.name}': keyframes or a driver set its power"):
        set_power_by_grey_card(bpy.context, floor, GreyCard("card.exr", *pixel_of((0, 0, 0)), 8, GREY))
    assert lamp.data.energy == 37.0


def test_a_clipped_card_is_refused(studio):
    scene, floor, lamp, folder = studio
    rgb = look(scene, folder)
    clipped = np.clip(rgb / np.quantile(rgb, 0.9), 0, 1)
    write_image(folder / "card.png", clipped[::-1].astype(np.float32), kind="png", color=True)
    add_view(scene, folder, lamp).image = str(folder / "card.png")
    bright = np.argwhere(clipped[..., 1] >= 1).mean(0)
    with pytest.raises(BadInput, match="clipped"):
        set_power_by_grey_card(bpy.context, floor, GreyCard("card.png", bright[1], bright[0], 12, GREY))


def test_a_picture_is_named_by_its_path_or_the_end_of_it(studio):
    scene, _, lamp, folder = studio
    look(scene, folder)
    add_view(scene, folder, lamp)
    views = listed_views(bpy.context)
    for name in ("card.exr", f"{folder.name}/card.exr", str(folder / "card.exr")):
        assert named_view(views, name).view.image == folder / "card.exr"
    for name in ("other/card.exr", "/card.exr", "ard.exr"):
        with pytest.raises(BadInput, match="no view has this picture"):
            named_view(views, name)


def test_import_with_a_grey_card(studio, irpso_here):
    """irpso import --grey: the flash beside the lens gets the power that it had; nothing is estimated."""
    scene, floor, lamp, folder = studio
    rig.camera(EYE, degrees=40.0)
    right, up = 0.1, 0.05
    bpy.context.view_layer.update()
    lamp.location = scene.camera.matrix_world @ Vector((right, up, 0.0))
    rgb = look(scene, folder)
    pictures = folder / "pictures"
    pictures.mkdir()
    (folder / "card.exr").rename(pictures / "card.exr")
    focal = Lens(PIXELS, PIXELS, *[PIXELS / 2 / np.tan(np.radians(20.0))] * 2, PIXELS / 2, PIXELS / 2).fx
    (folder / "transforms.json").write_text(json.dumps({"camera_model": "OPENCV", "frames": [{
        "file_path": "pictures/card.exr", "transform_matrix": np.array(scene.camera.matrix_world).tolist(), "w": PIXELS,
        "h": PIXELS, "fl_x": focal, "fl_y": focal, "cx": PIXELS / 2, "cy": PIXELS / 2}]}))
    bpy.ops.object.select_all(action="DESELECT")
    floor.select_set(True)
    bpy.ops.wm.obj_export(filepath=str(folder / "mesh.obj"), export_selected_objects=True, forward_axis="Y",
                          up_axis="Z", export_materials=False)
    x, y = pixel_of((0.1, 0.2, 0.0))
    arguments = ("import", folder / "transforms.json", "--images", pictures, "--out", folder / "out.blend",
                 "--flash-right", 1000 * right, "--flash-above", 1000 * up, "--grey", "card.exr")
    refused = irpso_here(*arguments, x, "ten", 8, GREY)
    assert refused.returncode == 3 and "numbers" in refused.stderr and not (folder / "out.blend").exists()
    done = irpso_here(*arguments, x, y, 8, GREY)
    assert done.returncode == 0, done.stderr
    assert "by the grey card in card.exr" in done.stderr and "is not known" not in done.stderr
    bpy.ops.wm.open_mainfile(filepath=str(folder / "out.blend"))
    assert bpy.data.lights["Flash"].energy == pytest.approx(WATTS, rel=0.02)
    assert bpy.context.scene.irpso.scale_known and rgb.max() > 0


def test_operator_and_undo(studio, extension):
    """By the number of the view; the message is one line; one undo takes power and mark back."""
    scene, floor, lamp, folder = studio
    look(scene, folder)
    add_view(scene, folder, lamp)
    lamp.data.energy = 50.0
    scene.irpso.scale_known = False
    bpy.context.view_layer.objects.active = floor
    x, y = pixel_of((0, 0, 0))
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.irpso.grey_card(view=3, x=x, y=y, side=8, reflectance=GREY)
    assert len(str(caught.value).strip().splitlines()) == 1
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.irpso.grey_card("EXEC_DEFAULT", True, view=0, x=x, y=y, side=8, reflectance=GREY) == {"FINISHED"}
    scene = bpy.context.scene
    assert bpy.data.lights["lamp"].energy == pytest.approx(WATTS, rel=0.02) and scene.irpso.scale_known
    bpy.ops.ed.undo()
    assert bpy.data.lights["lamp"].energy == 50.0 and not bpy.context.scene.irpso.scale_known
