"""What the Image Editor shows of a solve: the choices, what is drawn, and that nothing of it is left in the file."""

from __future__ import annotations

import types

import bpy
import numpy as np
import pytest

from irpso_addon.blender.jobs.session import session
from irpso_addon.blender.viewer import editors, view_draw, view_properties, views
from irpso_addon.blender.viewer.plot import Box
from irpso_addon.core.data import Maps, Solution, ViewPicture
from irpso_addon.core.live_maps import Live

SIDE = 8


@pytest.fixture
def chosen(empty):
    """The choices, with a mesh active."""
    view_properties.register()
    views.register()
    editors.register()
    bpy.ops.mesh.primitive_plane_add()
    yield bpy.context.window_manager.irpso_views
    session.end(session.running)
    session.forget()
    editors.unregister()
    views.unregister()
    view_properties.unregister()


def picture(name: str, value: float) -> ViewPicture:
    reference = np.full((6, 9, 3), value, np.float16)
    return ViewPicture(name, "Cam", ("Key",), reference, reference * np.float16(1.1), 2.0)


def maps(value: float) -> Maps:
    flat = np.full((SIDE, SIDE), value, np.float32)
    return Maps(base_color=np.full((SIDE, SIDE, 3), value, np.float32), roughness=flat, confidence=flat, error=flat,
                filled=flat > 1, coverage=flat < 1, roughness_sigma=flat, base_sigma=flat)


def solution(value: float) -> Solution:
    return Solution(maps=maps(value), model={}, why={}, texels={}, seconds={"solve": 1.0}, residual=0.1, views_used=(),
                    views_skipped=(), warnings=(), device={}, pictures=(picture("a", 0.2), picture("b", 0.4)))


def test_nothing_is_shown_of_nothing(chosen):
    for show in ("MAPS", "VIEWS", "RESULTS", "CHART"):
        chosen.show = show
        assert views.plate(bpy.context) is None


def test_the_last_solution_then_the_running_one(chosen):
    obj = bpy.context.active_object
    session.keep(obj, solution(0.25), "first")
    chosen.map = "roughness"
    assert views.plate(bpy.context).kind == "data" and views.plate(bpy.context).first[0, 0] == 0.25
    job = types.SimpleNamespace()
    running = session.start(job, "Solve", obj.session_uid)
    assert views.plate(bpy.context).first[0, 0] == 0.25, "before the first look"
    running.live = Live(maps={"roughness": np.full((4, 4), 0.75, np.float32)}, pictures=(picture("live", 0.3),))
    running.curve.append((1.0, 0.2))
    editors.refresh()
    assert views.plate(bpy.context).first[0, 0] == 0.75
    running.live = Live(maps={"roughness": np.full((4, 4), 0.5, np.float32)})
    chosen.show = "VIEWS"
    assert views.picture(bpy.context).view == "live", "pictures stay until there are newer ones"
    chosen.show, chosen.map = "MAPS", "base_color"
    assert views.plate(bpy.context) is None, "not known yet"
    session.end(session.running)
    assert views.curve(bpy.context) == [(1.0, 0.2)], "the curve outlives the job"
    session.forget()
    views._forget()
    assert views.plate(bpy.context) is None and views.curve(bpy.context) == []


def test_views_and_results_are_chosen_by_number(chosen):
    obj = bpy.context.active_object
    session.keep(obj, solution(0.2), "old")
    chosen.show = "RESULTS"
    assert views.pair(bpy.context) is None
    session.keep(obj, solution(0.6), "new")
    first, second = views.pair(bpy.context)
    assert (first.label, second.label) == ("old", "new")
    plate = views.plate(bpy.context)
    assert plate.wipe and plate.first[0, 0, 0] == np.float32(0.2) and plate.second[0, 0, 0] == np.float32(0.6)
    assert views.figures(first.solution.maps, second.solution.maps).base_rms == pytest.approx(0.4, rel=1e-5)
    chosen.first = 9  # beyond: the oldest
    assert views.pair(bpy.context)[0].label == "old"
    chosen.show, chosen.view = "VIEWS", 1
    assert views.picture(bpy.context).view == "b"
    chosen.view = 99
    assert views.picture(bpy.context).view == "b"
    chosen.picture = "ERROR"
    assert views.plate(bpy.context).kind == "relative"


def test_the_image_is_not_the_files(chosen, tmp_path):
    """Neither saved nor unsaved, gone with the file; and Undo leaves it."""
    image = editors._image()
    assert editors.is_ours(image) and not image.is_dirty
    image.generated_width = 300
    assert not image.is_dirty
    stranger = bpy.data.images.new(editors.NAME, 4, 4)
    assert not editors.is_ours(stranger)
    path = str(tmp_path / "a.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path, copy=True)
    with bpy.data.libraries.load(path) as (source, _):
        assert not any(name.startswith(editors.NAME) and name != stranger.name for name in source.images)
    bpy.ops.wm.open_mainfile(filepath=path)
    assert not any(map(editors.is_ours, bpy.data.images))


# ---- pixels: the shader beside sums in numpy

needs_gpu = pytest.mark.skipif(bpy.app.version < (5, 0, 0), reason="Blender 4.5 draws nothing without a window")


def drawn(plate: views.Plate, wipe: float = 0.5, exposure: float = 1.0, top: float = 0.2) -> np.ndarray:
    """(h, w, 4) as written to a linear frame buffer of the plate's own size."""
    import gpu
    from mathutils import Matrix

    gpu.init()
    height, width = plate.first.shape[:2]
    target = gpu.types.GPUOffScreen(width, height, format="RGBA32F")
    with target.bind(), gpu.matrix.push_pop(), gpu.matrix.push_pop_projection():
        buffer = gpu.state.active_framebuffer_get()
        buffer.clear(color=(0, 0, 0, 0))
        gpu.matrix.load_matrix(Matrix.Identity(4))
        gpu.matrix.load_projection_matrix(
            Matrix(((2 / width, 0, 0, -1), (0, 2 / height, 0, -1), (0, 0, 1, 0), (0, 0, 0, 1))))
        view_draw.draw_plate(plate, Box(0, 0, width, height), wipe, exposure, top)
        pixels = buffer.read_color(0, 0, width, height, 4, 0, "FLOAT")
    pixels.dimensions = width * height * 4
    values = np.array(pixels, np.float32).reshape(height, width, 4)
    target.free()
    return values


@pytest.fixture(scope="module")
def two() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(7)
    return rng.random((6, 8, 3)).astype(np.float32), rng.random((6, 8, 3)).astype(np.float32)


def brightness(plate: views.Plate, top: float) -> np.ndarray:
    """The heat map's green, which grows with the error."""
    return drawn(plate, top=top)[..., 1]


@needs_gpu
def test_wipe_shows_either_side(two):
    """Half floats hold 11 bits: 5e-4 of values up to 1."""
    a, b = two[0].copy(), two[1]
    a[2, 1] = np.nan
    seen = drawn(views.Plate("color", a, b, wipe=True, gain=0.5), wipe=0.25, exposure=1.5)
    want = np.clip(0.75 * np.concatenate([a[:, :2], b[:, 2:]], 1), 0, 1)
    known = np.isfinite(want).all(-1)
    assert np.abs(seen[known][:, :3] - want[known]).max() < 1e-3
    assert (seen[~known] == 0).all() and (seen[known][:, 3] == 1).all()


@needs_gpu
def test_data_are_shown_as_they_are(two):
    """The editor encodes to sRGB what is drawn: 0.5 is to come out as 0.5."""
    value = two[0][..., 0].copy()
    seen = drawn(views.Plate("data", value))[..., 0]
    encoded = np.where(seen <= 0.0031308, 12.92 * seen, 1.055 * seen ** (1 / 2.4) - 0.055)
    assert np.abs(encoded - value).max() < 2e-3


@needs_gpu
def test_heat_is_the_error(two):
    """Equal errors, however told, have one colour; larger ones are brighter."""
    a, b = two[0] + 0.5, two[1] + 0.5
    off = np.abs(a - b).mean(-1)
    for kind, value in (("relative", off / a.mean(-1)), ("difference", off)):
        seen = brightness(views.Plate(kind, a, b), top=0.8)
        want = brightness(views.Plate("heat", value.astype(np.float32)), top=0.8)
        assert np.abs(seen - want).max() < 3e-3, kind
        order = np.argsort(value, axis=None)
        assert (np.diff(seen.ravel()[order]) > -3e-3).all() and seen.max() > seen.min() + 0.02
