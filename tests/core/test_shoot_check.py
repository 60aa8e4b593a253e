"""The check before a solve, without files: shifts of shapes, places of lamps from votes, thresholds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.checks.drawn_view import DrawnView
from irpso_addon.core.checks.edge_shift import EdgeMatch, match_of, outline_distance, together
from irpso_addon.core.checks.highlights import LampVotes, axes_of, highlight_of, peak_of
from irpso_addon.core.checks.shoot_check import (
    BACKS,
    CLIPPED,
    DARK,
    HIDDEN,
    LIT,
    OFF,
    OUTLINE,
    SHIFT,
    SHIFT_UNOUTLINED,
    UNLIKE,
    WHITE,
    LampFigures,
    PairFigures,
    ShootCheck,
    ViewFigures,
    findings,
)
from irpso_addon.core.checks.shoot_measure import ShootMeasure, clipped_share, goes_with_camera
from irpso_addon.core.data import RadianceImage, View
from irpso_addon.core.images.shot_settings import ShotSettings
from tests.support import synthetic as syn

FINE = 8  # points along a pixel's side
SIDE = 96
STRENGTH = 0.3  # of a shape under paint


def shape(shift: tuple[float, float], turn: float = 0.0) -> np.ndarray:
    """(SIDE, SIDE) share of each pixel that lies inside a lobed outline, which is turned, and moved right and up."""
    at = (np.arange(SIDE * FINE) + 0.5) / FINE - SIDE / 2
    x, y = np.meshgrid(at - shift[0], at - shift[1])
    inside = np.hypot(x, y) < 28 + 5 * np.cos(3 * np.arctan2(y, x) + turn)
    return inside.reshape(SIDE, FINE, SIDE, FINE).mean((1, 3)).astype(np.float32)


def drawn(shift: tuple[float, float], background: float, coverage: bool, noise: float = 0.0,
          turn: float = 0.0) -> DrawnView:
    """The shape, grey over a background, drawn where it should be and pictured beside that."""
    share, seen = shape((0, 0), turn), shape(shift, turn)
    rng = np.random.default_rng(4)
    grey = (0.5 * seen + background * (1 - seen) + noise * rng.normal(size=seen.shape)).astype(np.float32)
    image = RadianceImage(np.repeat(grey[..., None], 3, 2), seen if coverage else np.ones_like(seen),
                          np.ones(seen.shape, bool))
    covered = share > 0.5
    normal = np.where(covered[..., None], np.float32((0, 0, 1)), np.float32(0))
    view = View(Path("a.exr"), syn.camera((0, 0, 5)), (syn.lamp((0, 0, 5)),))
    return DrawnView(view, image, np.zeros_like(normal), normal, covered, share, (covered.astype(np.float32),))


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.4, -0.3), (3.0, 1.5), (-11.0, 17.0)])
@pytest.mark.parametrize(("background", "coverage"), [(0.0, True), (0.0, False), (0.9, False), (0.2, False)])
def test_shifts_to_a_tenth_of_a_pixel(shift, background, coverage) -> None:
    """With alpha or without, before black or before what is brighter; 2 % noise."""
    view = drawn(shift, background, coverage, noise=0.01)
    found = match_of(view, view.covered.astype(np.float32)).shift
    assert found is not None and found.outlined == coverage
    assert found.shift == pytest.approx(shift, abs=0.1)


def test_nothing_clear_is_not_told() -> None:
    """A picture of something else, one of nothing, and one that is too far off."""
    view = drawn((0, 0), 0.0, False)
    noise = np.random.default_rng(1).random((SIDE, SIDE, 1)).astype(np.float32).repeat(3, 2)
    for rgb in (noise, np.full_like(noise, 0.3)):
        other = replace(view, image=replace(view.image, rgb=rgb))
        assert match_of(other, other.covered.astype(np.float32)).shift is None
    assert match_of(drawn((40, 0), 0.0, False), view.covered.astype(np.float32)).shift is None


def unclear(seed: int, shift: tuple[float, float] | None) -> EdgeMatch:
    """Of a shape that is hardly brighter than what is around it, under paint of hard edges; None: of paint alone."""
    view = drawn(shift or (0, 0), 0.0, False, turn=float(seed))
    paint = np.kron(np.random.default_rng(seed).random((SIDE // 4, SIDE // 4)), np.ones((4, 4)))
    rgb = 0.2 + 0.5 * paint[..., None] + (0.0 if shift is None else STRENGTH) * view.image.rgb
    view = replace(view, image=replace(view.image, rgb=rgb.astype(np.float32)))
    return match_of(view, view.covered.astype(np.float32))


@pytest.mark.parametrize("shift", [(0.0, 0.0), (4.0, -3.0)])
def test_what_no_view_shows_clearly_all_together_do(shift) -> None:
    """To a pixel.  Pictures of something else, and views that are off by themselves, have nothing in common."""
    matches = [unclear(seed, shift) for seed in range(12)]
    assert all(match.shift is None for match in matches)
    found = together(matches)
    assert found is not None and found.shift == pytest.approx(shift, abs=1.0) and not found.outlined
    assert together([unclear(seed, None) for seed in range(12)]) is None
    assert together([unclear(n, (20 * np.cos(n), 20 * np.sin(n))) for n in range(12)]) is None
    assert together([]) is None


def test_an_outline_that_the_lamps_light_does_not_show() -> None:
    """A highlight in the middle, and a rim that shines by itself: the light falls off inside, the outline is seen."""
    view = drawn((3.0, 1.5), 0.0, False, noise=0.01)
    at = np.arange(SIDE) - SIDE / 2
    falls = np.exp(-(at[:, None] ** 2 + at**2) / 60).astype(np.float32) * view.covered
    found = match_of(view, falls).shift
    assert found is not None and found.shift == pytest.approx((3.0, 1.5), abs=0.2)


def test_distance_of_outlines() -> None:
    """Of a shape and one that is 2 pixels larger all round: 2; of the shape and itself: 0.  To a tenth."""
    at = np.arange(SIDE * FINE) / FINE - SIDE / 2
    radius = np.hypot(*np.meshgrid(at, at))
    small, large = ((radius < r).reshape(SIDE, FINE, SIDE, FINE).mean((1, 3)).astype(np.float32) for r in (25, 27))
    assert outline_distance(small, large) == pytest.approx(2.1, abs=0.25)  # its worst tenth is a little more
    assert outline_distance(small, small) == 0
    assert outline_distance(np.zeros_like(small), small) is None


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.2, -0.1), (-0.35, 0.3)])
def test_place_of_a_lamp_from_votes(place) -> None:
    """To 0.02 of its distance, though paint varies by 1 to 5."""
    rng = np.random.default_rng(7)

    def votes(count: int) -> LampVotes:
        at = rng.uniform(-1, 1, (count, 2))
        paint = rng.choice([0.1, 0.3, 0.5], count)
        lobe = np.exp(-((at - place) ** 2).sum(-1) / (2 * 0.08**2))
        ones = np.ones(count)
        return LampVotes(np.arange(count, dtype=np.int32), at, paint + 0.6 * lobe, ones, ones, np.eye(3)[:2], 1.0)

    found = peak_of([votes(10_000) for _ in range(4)])
    assert found is not None and found.place == pytest.approx(place, abs=0.02)
    matt = [replace(v, value=rng.choice([0.1, 0.3, 0.5], 10_000)) for v in (votes(10_000), votes(10_000))]
    assert peak_of(matt) is None
    assert peak_of([]) is None


def dark_votes(place: tuple[float, float]) -> LampVotes:
    """Of a view whose flash did not fire, and whose black level is a little too high: noise about what is below 0."""
    rng = np.random.default_rng(9)
    at = rng.normal(place, 0.05, (3_000, 2))
    ones = np.ones(len(at))
    return LampVotes(np.arange(len(at), dtype=np.int32), at, rng.normal(-1e-4, 1e-4, len(at)), ones, ones,
                     np.eye(3)[:2], 1.0)


def test_views_in_the_dark_say_nothing_of_a_lamp() -> None:
    """Five views with a highlight at the lamp's place, two dark ones that share another: the place stays."""
    rng = np.random.default_rng(3)
    at = rng.uniform(-1, 1, (5, 10_000, 2))
    lobe = np.exp(-(at**2).sum(-1) / (2 * 0.08**2))
    ones = np.ones(10_000)
    views = [LampVotes(np.arange(10_000, dtype=np.int32), p, 0.3 + 0.6 * v, ones, ones, np.eye(3)[:2], 1.0)
             for p, v in zip(at, lobe, strict=True)]
    dark = dark_votes((0.5, 0.2))
    found = peak_of([*views, dark, dark])
    assert found is not None and found.place == pytest.approx((0, 0), abs=0.02)
    assert peak_of([dark]) is None
    assert highlight_of(dark, (60, 50)).seen is None


def test_views_that_show_nothing_of_a_lamp_are_not_counted() -> None:
    """Two views that tell, and four without a pixel that does: too few."""
    cameras = [syn.camera(place, name=str(place)) for place in ((5, 0, 1), (0, 5, 1), (-4, 3, 2))]
    views = [View(Path(f"{n}.exr"), cameras[n % 3], (syn.lamp((1, 2, 6)),)) for n in range(6)]
    scene = replace(syn.shoot(syn.PATCHES, [(views[0].camera, views[0].lights)], (16, 16)).scene, views=tuple(views))
    measure = ShootMeasure(scene, views)
    none = replace(dark_votes((0, 0)), at=np.zeros(0, np.int32), place=np.zeros((0, 2)), value=np.zeros(0))
    for number, view in enumerate(views):
        measure._keep(view, [none if number > 1 else dark_votes((0, 0))])
    assert [len(votes) for votes in measure.votes.values()] == [2]


def test_pixels_that_are_clipped_one_by_one() -> None:
    """One in 1000, each of which spoils a whole pixel of the reduced picture: the share stays one in 1000."""
    view = drawn((0, 0), 0.0, False)
    image = replace(view.image, valid=np.random.default_rng(2).random((SIDE, SIDE)) > 0.05, clipped_share=1e-3)
    reduced = replace(view, image=image)
    inside = np.count_nonzero(reduced.shown) / reduced.shown.size
    assert clipped_share(reduced) == pytest.approx(1e-3 / inside)
    image = replace(image, clipped_share=0.5)  # most of it beside the object
    assert clipped_share(replace(view, image=image)) == pytest.approx(0.05, abs=0.02)


def test_axes_across_a_lamp() -> None:
    """Right and up as the camera has them, for a lamp beside it."""
    axes = axes_of(syn.lamp((0.1, 0, 5)), np.zeros(3), np.array([0.0, 1, 0]))
    assert axes == pytest.approx(np.eye(3)[:2], abs=0.03)
    upright = axes_of(syn.lamp((0, 0, 5)), np.zeros(3), np.array([0.0, 0, 1]))  # up is the lamp's own direction
    assert upright @ upright.T == pytest.approx(np.eye(2), abs=1e-9)


def test_flash_on_the_camera_or_lamp_in_the_room() -> None:
    cameras = [syn.camera(place, name=str(place)) for place in ((5, 0, 1), (0, 5, 1), (-4, 3, 2))]

    def view(camera, lamp) -> View:
        return View(Path("a.exr"), camera, (lamp,))

    flashes = [view(c, syn.lamp(c.position + 0.3 * c.world_to_camera[0, :3], name=c.name)) for c in cameras]
    assert goes_with_camera(flashes, np.zeros(3))
    assert not goes_with_camera([view(c, syn.lamp((1, 2, 6))) for c in cameras], np.zeros(3))
    assert not goes_with_camera(flashes[:1], np.zeros(3))
    other = view(cameras[0], syn.lamp(cameras[0].position + cameras[0].world_to_camera[1, :3]))
    assert not goes_with_camera([other, *flashes[1:]], np.zeros(3))


# ---- lines

GOOD = ViewFigures("a.exr", ("Flash",), 1.0, True, (0.1, 0.1), True, 0.0, 0.3, 1.0, 0.2, 0.8, (1.0, 0.5), False,
                   1.0, 0.1)
LAMP = LampFigures("Flash", 6, True, False, 0.5, (0.01, 0.0), 0.01, (0.0, 0.0, 0.0))
CHECK = ShootCheck("Vase", tuple(replace(GOOD, view=f"{n}.exr") for n in range(6)), 40, (), (LAMP,))


def said(check: ShootCheck = CHECK, one: bool = False, **change: object) -> list[str]:
    """The problems, with all views or the first one changed."""
    views = tuple(replace(v, **change) if not one or n == 0 else v for n, v in enumerate(check.views))
    return [finding.problem for finding in findings(replace(check, views=views))]


@pytest.mark.parametrize(("below", "above", "words"), [
    ({"shift": (0.9 * SHIFT, 0.0)}, {"shift": (1.1 * SHIFT, 0.0)}, "line up with the mesh"),
    ({"shift": (0.9 * SHIFT_UNOUTLINED, 0.0), "outlined": False},
     {"shift": (1.1 * SHIFT_UNOUTLINED, 0.0), "outlined": False}, "line up with the mesh"),
    ({"shift": (3.9 * SHIFT, 0.0), "reduction": 4.0}, {"shift": (4.1 * SHIFT, 0.0), "reduction": 4.0}, "line up with"),
    ({"outline": 0.9 * OUTLINE}, {"outline": 1.1 * OUTLINE}, "outline differs from the mesh's"),
    ({"outline": 9.0, "masked": True}, {"outline": 9.0}, "outline differs from the mesh's"),
    ({"clipped": 0.9 * CLIPPED}, {"clipped": 1.1 * CLIPPED}, "clipped"),
    ({"brightness": 1.1 * DARK}, {"brightness": 0.9 * DARK}, "too dark"),
    ({"brightness": None}, {"brightness": 0.0}, "too dark"),
    ({"albedo": 0.15}, {"albedo": 0.0, "brightness": 0.0}, "is black where it shows the object"),
    ({"shown": 1.1 * HIDDEN}, {"shown": 0.9 * HIDDEN}, "its mask or alpha hides the object"),
    ({"lit": 1.1 * LIT}, {"lit": 0.9 * LIT}, "light too little"),
    ({"brightest": 0.9 * WHITE}, {"brightest": 1.1 * WHITE}, "too little power"),
    ({"albedo": 0.02}, {"albedo": 0.005}, "too much power"),
    ({"shift": (0.0, 0.0)}, {"shift": None}, "not found in the picture"),
    ({"backs": 0.9 * BACKS}, {"backs": 1.1 * BACKS}, "its faces look inwards"),
])
def test_thresholds(below, above, words) -> None:
    assert said(**below) == []
    (problem,) = said(**above)
    assert words in problem and ("'0.exr', '1.exr', '2.exr' and 3 more" in problem or "Vase" in problem)


def test_edges_that_all_views_show_together() -> None:
    """Nothing is wrong then, unless all lie beside the mesh."""
    views = tuple(replace(view, shift=None) for view in CHECK.views)
    check = replace(CHECK, views=views, common=0.9 * SHIFT_UNOUTLINED)
    assert findings(check) == () and "edges 1.4 checked pixels off, of all views together" in check.summary
    (finding,) = findings(replace(check, common=1.1 * SHIFT_UNOUTLINED))
    assert "not found in the picture" in finding.problem


def test_a_mesh_that_is_inside_out_explains_the_rest() -> None:
    """Edges, light and power are not what is wrong then; files are."""
    views = tuple(replace(view, view=f"{view.view}.jpg", backs=1.0, shift=None, lit=0.1, brightest=9.0)
                  for view in CHECK.views)
    first, second = findings(replace(CHECK, views=views))
    assert str(first) == ("object 'Vase': its faces look inwards (100 % of what the cameras see are backs, in the "
                          "median view); recalculate its normals outside (Mesh > Normals > Recalculate Outside)")
    assert "JPEG" in second.problem


def test_jpeg_files() -> None:
    """Are named, whatever else is wrong; other files are not."""
    views = tuple(replace(view, view=f"{n}.JPG" if n < 2 else view.view) for n, view in enumerate(CHECK.views))
    (finding,) = findings(replace(CHECK, views=views))
    assert finding.problem == "'0.JPG', '1.JPG': in JPEG format" and "tone curve" in finding.evidence
    assert "RAW" in finding.remedy


def test_pairs() -> None:
    """Off by more than a checked pixel; not where edges have told it, and not where nothing tells."""
    good, off = PairFigures("1.exr", "2.exr", 90, 1.9, 2.0), PairFigures("3.exr", "4.exr", 70, 2.1, 2.0)
    check = replace(CHECK, pairs=(good, PairFigures("0.exr", "5.exr", 3, float("nan"), 2.0), off))
    (finding,) = findings(check)
    assert finding.problem == "'3.exr', '4.exr': their cameras contradict each other"
    assert finding.evidence.startswith("1 of 2 pairs; 70 points") and "2.1 pixels" in finding.evidence
    assert "epipolar lines 2.00 pixels off (worst of 2 pairs 2.10)" in check.summary
    assert "epipolar lines not measured" in CHECK.summary and findings(replace(check, pairs=(good,))) == ()
    views = tuple(replace(view, shift=(5.0, 0.0) if view.view == "4.exr" else view.shift) for view in check.views)
    (finding,) = findings(replace(check, views=views))
    assert finding.problem == "'4.exr': the picture does not line up with the mesh"


def test_a_view_that_is_unlike_the_others() -> None:
    assert said(one=True, albedo=0.2 * 0.9 * UNLIKE) == []
    assert said(one=True, albedo=0.2 * 1.1 * UNLIKE) == ["'0.exr': differs in brightness from the other views"]


def test_an_exposure_that_exif_contradicts() -> None:
    """A view of half a step more, which EXIF states and Exposure does not: it is brighter by that too."""
    shot, more = ShotSettings(1 / 60, 8.0, 100.0), ShotSettings(1 / 60, 8.0, 140.0)
    views = tuple(replace(view, shot=shot, exposure=0.5) for view in CHECK.views)

    def of(**change: object) -> list[str]:
        return [str(each) for each in findings(replace(CHECK, views=(replace(views[0], **change), *views[1:])))]

    (line,) = of(shot=more, albedo=0.2 * 1.4)
    assert line == ("'0.exr': EXIF states another exposure than for the other views (+0.49 EV beside the Exposure of "
                    "'0.exr', whose brightness differs too); set its Exposure to 0.985")
    assert of(shot=more, albedo=0.2 * 1.4, exposure=0.985) == of(shot=ShotSettings(), albedo=0.2 * 1.4) == of() == []
    assert of(shot=more, albedo=0.19) == []  # a flash shorter than the exposure time
    (line,) = of(shot=ShotSettings(1 / 15, 8.0, 100.0), albedo=0.8)  # in place of the line about its brightness alone
    assert "+2.00 EV" in line
    two = (*(replace(view, shot=more, albedo=0.28) for view in views[:2]), *views[2:])
    (finding,) = findings(replace(CHECK, views=two))
    assert finding.problem.startswith("'0.exr', '1.exr': EXIF") and finding.remedy.endswith("the others likewise")


def test_lamps() -> None:
    """Off by more than a twentieth of the distance, and beyond doubt; not where cameras are off."""
    far = replace(LAMP, place=(0.0, 1.1 * OFF))
    assert said(replace(CHECK, lamps=(replace(LAMP, place=(0.0, 0.9 * OFF)),))) == []
    assert said(replace(CHECK, lamps=(replace(far, error=0.05),))) == []
    (finding,) = findings(replace(CHECK, lamps=(far,)))
    assert "28 mm up," in finding.remedy  # 1.1 times a twentieth of 0.5 m
    assert said(replace(CHECK, lamps=(far,)), shift=(5.0, 0.0)) == [
        "'0.exr', '1.exr', '2.exr' and 3 more: the picture does not line up with the mesh"]
    room = replace(far, on_camera=False, world=(0.1, 0.0, -0.2))
    assert "(+0.1, +0, -0.2) m" in findings(replace(CHECK, lamps=(room,)))[0].remedy
    sun = replace(far, on_camera=False, sun=True, place=(0.2, 0.0))
    assert "turn it by 11 degrees" in findings(replace(CHECK, lamps=(sun,)))[0].remedy


def test_little_is_left_to_the_solve() -> None:
    (small,) = findings(replace(CHECK, views=(replace(GOOD, shift=(1.5, 0.0)), *CHECK.views[1:])))
    assert "Camera Alignment to Auto" in small.remedy
    (outside,) = findings(replace(CHECK, outside=("7.exr",)))
    assert str(outside).startswith("'7.exr': does not show 'Vase' (1 of 40 cameras")
