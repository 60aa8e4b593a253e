"""The six greys of a chart that Cycles renders: the lamps' power, and whether the pictures are linear."""

from __future__ import annotations

import re

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from irpso_addon.blender import properties  # noqa: E402
from irpso_addon.blender.shoot import picture_image as pictures  # noqa: E402
from irpso_addon.blender.shoot.grey_chart import GreyChart, read_chart  # noqa: E402
from irpso_addon.blender.shoot.picture_image import picture_image, shown_picture  # noqa: E402
from irpso_addon.blender.shoot.view_pictures import active_view, listed_views  # noqa: E402
from irpso_addon.core.errors import BadInput  # noqa: E402
from irpso_addon.core.images.image_writer import write_image  # noqa: E402
from irpso_addon.core.images.response import curved, straight  # noqa: E402
from irpso_addon.core.shoot.grey_patch import CHART_GREYS  # noqa: E402
from tests.blender import cycles_rig as rig  # noqa: E402

PIXELS, WATTS = 160, 100.0
EYE, LAMP = (0.0, -1.2, 1.5), (-0.7, -0.5, 1.6)
SPACING, TILT = 0.1, 0.3  # metres, radians: the row is not level in the picture


def middle(number):
    along = (number - 2.5) * SPACING
    return along * np.cos(TILT), along * np.sin(TILT), 0.001


@pytest.fixture(scope="module")
def rendered():
    """Linear picture (h, w, 3) of the chart on a floor, row 0 at the top."""
    scene = build()
    for number, grey in enumerate(CHART_GREYS):
        card = rig.plane(SPACING * 0.46)
        card.location, card.rotation_euler = middle(number), (0, 0, TILT)
        rig.principled(card, (grey,) * 3, 1.0, 0.0)
    assert scene.camera
    return rig.render()["rgb"].astype(np.float32)


def build():
    scene = rig.scene(PIXELS, samples=32)
    scene.cycles.max_bounces = 0
    if not hasattr(bpy.types.Scene, "irpso"):
        properties.register()
    rig.camera(EYE, degrees=30.0)
    rig.principled(rig.plane(0.5), (0.3,) * 3, 1.0, 0.0)
    rig.lamp("POINT", LAMP, shadow_soft_size=0.02, energy=WATTS)
    return scene


@pytest.fixture
def studio(rendered, tmp_path):
    """The same without the greys: a floor, a lamp of 37 W, one view; a function that writes its picture."""
    scene = build()
    scene.camera = next(obj for obj in scene.objects if obj.type == "CAMERA")
    floor = next(obj for obj in scene.objects if obj.type == "MESH")
    bpy.context.view_layer.objects.active = floor
    lamp = next(obj for obj in scene.objects if obj.type == "LIGHT")
    lamp.data.energy = 37.0
    bpy.context.view_layer.update()
    view = scene.irpso.views.add()
    view.camera = scene.camera
    view.lights.add().light = lamp

    def written(name, values):
        view.image = str(tmp_path / name)
        write_image(tmp_path / name, values[::-1].astype(np.float32), kind=name[-3:], color=name.endswith("exr"))

    return floor, lamp, view, written


def pixel_of(point):
    local = np.array(bpy.context.scene.camera.matrix_world.inverted()) @ [*point, 1.0]
    focal = PIXELS / 2 / np.tan(np.radians(15.0))
    return PIXELS / 2 - focal * local[0] / local[2], PIXELS / 2 + focal * local[1] / local[2]


def click(floor, name):
    return read_chart(bpy.context, floor, GreyChart(name, pixel_of(middle(0)), pixel_of(middle(5))))


def srgb(linear):
    """IEC 61966-2-1."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.abs(linear) ** (1 / 2.4) - 0.055)


def test_a_linear_picture(studio, rendered):
    """The power is that of the render to 2 %, though the light falls off by a third along the chart."""
    floor, lamp, _, written = studio
    written("card.exr", rendered)
    found = click(floor, "card.exr")
    assert found.response == "These pictures are linear: exponent 1.00 ± 0.01" and found.linear
    assert lamp.data.energy == pytest.approx(WATTS, rel=0.02) and bpy.context.scene.irpso.scale_known
    assert any("by the six greys in card.exr" in line for line in found.messages)


def test_curves(studio, rendered):
    """The line says what to do, and the lamps keep their power where the views get no curve."""
    floor, lamp, view, written = studio
    bpy.context.scene.irpso.scale_known = False
    bright = rendered / rendered.max() * 0.8
    written("bent.exr", bright ** 0.58)
    found = click(floor, "bent.exr")
    assert found.response == ("These pictures look non-linear (exponent 0.58). Use RAW files, or set the colour space "
                              "of all views to sRGB.") and not found.linear
    assert lamp.data.energy == 37.0 and not bpy.context.scene.irpso.scale_known and not found.scaled
    assert any("the lamps keep their power" in line for line in found.messages) and view.response == 1.0
    written("other.png", bright ** 0.3)  # read as sRGB, it is near the power 0.3 * 2.2
    found = click(floor, "other.png")
    assert "look non-linear" in found.response and not found.linear
    assert "the curve of other.png is not sRGB. Response 0.65 and Shoulder 1 fit its greys to 1." in found.response
    assert view.response == pytest.approx(0.65, abs=0.005) and view.shoulder == 1.0
    view.response = 1.0
    written("good.png", srgb(bright))
    assert click(floor, "good.png").response.startswith("These pictures are linear: exponent 1.0")
    view.colorspace = "Linear Rec.709"
    assert click(floor, "good.png").response.endswith("or set the colour space of all views to sRGB.")


def test_a_tone_curve_becomes_that_of_the_views(studio, rendered):
    """A tone curve before sRGB is found and set for all views of its kind, and by it the power.

    Its greys lie on no straight line, which is not the chart's fault.
    """
    floor, lamp, view, written = studio
    factor = 0.8 / rendered.max()
    written("toned.png", srgb(curved(rendered * factor, 1.2, 6.0)))
    view.exposure = float(np.log2(factor))
    others = [bpy.context.scene.irpso.views.add() for _ in range(2)]
    others[0].image, others[1].image, others[0].enabled = view.image, view.image[:-3] + "exr", False
    found = click(floor, "toned.png")
    response, shoulder = map(float, re.search(r"Response ([\d.]+) and Shoulder ([\d.]+) fit", found.response).groups())
    assert response == pytest.approx(1.2, rel=0.03) and shoulder == pytest.approx(6.0, rel=0.1)
    for entry in (view, others[0]):
        assert entry.response == pytest.approx(response, abs=0.006)
        assert entry.shoulder == pytest.approx(shoulder, abs=0.06)
    assert others[1].response == others[1].shoulder == 1.0
    assert found.scaled and not found.linear and lamp.data.energy == pytest.approx(WATTS, rel=0.05)
    assert click(floor, "toned.png").linear and lamp.data.energy == pytest.approx(WATTS, rel=0.05)
    view.response = 2.0
    assert " fit its greys" not in click(floor, "toned.png").response  # of a picture whose curve is set


def test_a_curve_is_taken_back_where_the_power_cannot_be_set(studio, rendered):
    floor, lamp, view, written = studio
    written("toned.png", srgb(curved(rendered * 0.8 / rendered.max(), 1.2, 6.0)))
    lamp.data.keyframe_insert("energy", frame=1)
    with pytest.raises(BadInput, match="keyframes or a driver set its power"):
        click(floor, "toned.png")
    assert view.response == view.shoulder == 1.0


def test_a_picture_without_a_camera(studio, rendered, tmp_path):
    """Of another shape than the views, as one that photogrammetry did not align: its curve is theirs, the power stays.

    The light falls off by a third along the chart and is taken to be even, so that the curve is that of both.
    """
    floor, lamp, view, written = studio
    written("view.png", srgb(rendered / rendered.max() * 0.8))
    own = view.image
    written("chart.png", srgb(curved(rendered * 0.8 / rendered.max(), 1.2, 6.0))[20:-20])
    view.image, ends = own, [(x, y - 20) for x, y in (pixel_of(middle(0)), pixel_of(middle(5)))]
    bpy.context.scene.irpso.scale_known = False
    chart = GreyChart(str(tmp_path / "chart.png"), *ends)
    found = read_chart(bpy.context, floor, chart)
    assert found.response.startswith("These pictures look non-linear") and not found.scaled
    assert found.messages == ("chart.png: has no camera, so that the light on the chart is not known; it is taken to "
                              "be even; the lamps keep their power",)
    assert lamp.data.energy == 37.0 and not bpy.context.scene.irpso.scale_known
    seen = rendered / rendered.max() * 0.8
    spots = [seen[int(y) - 3:int(y) + 3, int(x) - 3:int(x) + 3].mean() for x, y in map(pixel_of, map(middle, range(6)))]
    straightened = straight(curved(np.array(spots), 1.2, 6.0), view.response, view.shoulder)
    slope = np.polyfit(np.log(CHART_GREYS), np.log(straightened), 1)[0]
    assert slope == pytest.approx(1.0, abs=0.01)  # the greys, as they were lit, are what is linear now
    again = read_chart(bpy.context, floor, chart)  # it is read as the views are
    assert again.linear and "exponent 1.0" in again.response and len(again.messages) == 1


def test_files_that_are_no_chart_of_the_views(studio, rendered, tmp_path):
    floor, _, view, written = studio
    written("view.png", srgb(rendered))
    own = view.image
    written("chart.exr", rendered)
    view.image = own
    for name, words in ((tmp_path / "chart.exr", "chart.exr: is a .exr file, and no view has one"),
                        (tmp_path / "none.png", "no view has this picture")):
        with pytest.raises(BadInput, match=words) as caught:
            read_chart(bpy.context, floor, GreyChart(str(name), (20.0, 20.0), (90.0, 20.0)))
        assert "\n" not in str(caught.value) and view.response == 1.0


def test_one_patch_that_shines_is_left_out(studio, rendered):
    """Two are a wrong click."""
    floor, lamp, _, written = studio
    values = rendered.copy()
    x, y = map(int, pixel_of(middle(5)))
    values[y - 1:y + 2, x - 1:x + 2] *= 4.0
    written("card.exr", values)
    found = click(floor, "card.exr")
    assert found.linear and lamp.data.energy == pytest.approx(WATTS, rel=0.02)
    assert found.messages[0].startswith("card.exr, black patch: the square shows more than one patch, or a shine")
    x, y = map(int, pixel_of(middle(4)))
    values[y - 1:y + 2, x - 1:x + 2] *= 4.0
    written("card.exr", values)
    with pytest.raises(BadInput, match="black patch: the square shows more than one patch, or a shine"):
        click(floor, "card.exr")


def test_a_clipped_and_a_black_patch_are_left_out(studio, rendered):
    """One line names each; the power follows from the others."""
    floor, lamp, _, written = studio
    x, y = map(int, pixel_of(middle(0)))
    level = rendered[y, x].mean() * 0.9
    values = np.minimum(rendered / level, 1.0)
    x, y = map(int, pixel_of(middle(5)))
    values[y - 6:y + 6, x - 6:x + 6] = 0.0
    written("card.png", srgb(values))
    found = click(floor, "card.png")
    assert "card.png, white patch: " in found.messages[0] and "clipped" in found.messages[0]
    assert found.messages[1] == ("card.png, black patch: the patch is black; use a brighter exposure or choose the "
                                 "patch again; it is left out")
    assert lamp.data.energy == pytest.approx(WATTS / level, rel=0.03) and found.linear


def test_ambient_light_of_the_view_is_none_of_the_lamps(studio, rendered):
    """Uneven in colour; of the room's light the chart shows its reflectance too."""
    floor, lamp, view, written = studio
    values = rendered.copy()
    for number, grey in enumerate(CHART_GREYS):
        x, y = map(round, pixel_of(middle(number)))
        values[y - 7:y + 7, x - 7:x + 7] += np.float32(grey) * np.float32((0.6, 0.4, 0.2))
    written("card.exr", values)
    click(floor, "card.exr")
    assert lamp.data.energy > 1.05 * WATTS
    lamp.data.energy, view.ambient_radiance = 37.0, (0.6, 0.4, 0.2)
    assert click(floor, "card.exr").linear and lamp.data.energy == pytest.approx(WATTS, rel=0.02)
    view.ambient_radiance = (60, 40, 20)
    with pytest.raises(BadInput, match="Ambient Light alone would make the chart brighter"):
        click(floor, "card.exr")


def test_without_light_the_response_is_told(studio, rendered):
    floor, lamp, _, written = studio
    even = np.full_like(rendered, 0.3)
    for number, grey in enumerate(CHART_GREYS):
        x, y = map(round, pixel_of(middle(number)))
        even[y - 7:y + 7, x - 7:x + 7] = 0.8 * grey
    written("card.exr", even)
    lamp.location.z = -1.0  # behind the floor
    bpy.context.view_layer.update()
    found = click(floor, "card.exr")
    assert found.response == "These pictures are linear: exponent 1.00 ± 0.01" and lamp.data.energy == 37.0
    assert found.messages == ("card.exr: no lamp of the scene lights the chart; the lamps keep their power",)


def test_what_is_refused_changes_nothing(studio, rendered):
    floor, lamp, _, written = studio
    written("card.exr", rendered)
    white, black = pixel_of(middle(0)), pixel_of(middle(5))
    for chart, words in ((GreyChart("card.exr", black, white), "click white first"),
                         (GreyChart("card.exr", white, white), "too close"),
                         (GreyChart("card.exr", (2.0, 2.0), black), "is not inside the picture")):
        with pytest.raises(BadInput, match=words) as caught:
            read_chart(bpy.context, floor, chart)
        assert "\n" not in str(caught.value) and lamp.data.energy == 37.0


def test_operator_and_undo(studio, rendered, extension):
    floor, _, _, written = studio
    written("card.exr", rendered)
    bpy.context.view_layer.objects.active = floor
    ends = {"white": pixel_of(middle(0)), "black": pixel_of(middle(5))}
    with pytest.raises(RuntimeError, match="too close"):
        bpy.ops.irpso.grey_chart(white=ends["white"], black=ends["white"])
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.irpso.grey_chart("EXEC_DEFAULT", True, **ends) == {"FINISHED"}
    assert bpy.data.lights["lamp"].energy == pytest.approx(WATTS, rel=0.02)
    bpy.ops.ed.undo()
    assert bpy.data.lights["lamp"].energy == 37.0


def test_the_operator_takes_the_panels_picture(studio, rendered, extension, tmp_path):
    """That of no view too, and one undo takes the curve back."""
    floor, _, view, written = studio
    written("view.png", srgb(rendered / rendered.max() * 0.8))
    own = view.image
    written("chart.png", srgb(curved(rendered * 0.8 / rendered.max(), 1.2, 6.0)))
    view.image = own
    bpy.context.scene.irpso.shoot.chart = str(tmp_path / "chart.png")
    bpy.context.view_layer.objects.active = floor
    bpy.ops.ed.undo_push(message="before")
    ends = {"white": pixel_of(middle(0)), "black": pixel_of(middle(5))}
    assert bpy.ops.irpso.grey_chart("EXEC_DEFAULT", True, **ends) == {"FINISHED"}
    assert bpy.context.scene.irpso.views[0].shoulder > 3 and bpy.data.lights["lamp"].energy == 37.0
    bpy.ops.ed.undo()
    assert bpy.context.scene.irpso.views[0].shoulder == 1.0


def test_the_picture_that_is_clicked_in(studio, rendered, monkeypatch):
    """Upright, reduced, white at its brightest; of the same file it is not made again, of a changed one it is."""
    _, _, view, written = studio
    monkeypatch.setattr(pictures, "MOST", PIXELS * PIXELS // 4)
    written("card.exr", rendered)
    image = picture_image(active_view(bpy.context))
    assert shown_picture(image) == (view.image, (PIXELS, PIXELS)) and tuple(image.size) == (PIXELS // 2, PIXELS // 2)
    assert image.is_runtime_data and image.packed_file is not None and not image.is_dirty
    seen = np.array(image.pixels).reshape(PIXELS // 2, PIXELS // 2, 4)[::-1, :, 1]
    values = [seen[int(y / 2), int(x / 2)] for x, y in (pixel_of(middle(n)) for n in range(6))]
    assert np.all(np.diff(values) < -0.02) and seen.max() > 0.98
    assert picture_image(active_view(bpy.context)) == image
    written("other.exr", rendered[::-1])
    view.camera.data.shift_x = 0.0
    picture_image(active_view(bpy.context), listed_views(bpy.context))
    again = np.array(image.pixels).reshape(PIXELS // 2, PIXELS // 2, 4)[:, :, 1]
    assert np.abs(again - seen).max() < 0.01 and shown_picture(image)[0].endswith("other.exr")
    assert shown_picture(None) is None and shown_picture(bpy.data.images.new("plain", 4, 4)) is None


def test_which_view_is_shown(studio, rendered):
    """The active one; for a camera the first of its views that can be used."""
    _, _, view, written = studio
    written("card.exr", rendered)
    other = bpy.context.scene.irpso.views.add()
    other.image, other.camera = view.image, bpy.context.scene.camera.copy()
    bpy.context.scene.collection.objects.link(other.camera)
    bpy.context.view_layer.update()
    assert active_view(bpy.context).entry == view and active_view(bpy.context, other.camera).entry == other
    view.enabled = False
    with pytest.raises(BadInput, match="view 1: is switched off"):
        active_view(bpy.context)
    with pytest.raises(BadInput, match="no view in use has it"):
        active_view(bpy.context, view.camera)
