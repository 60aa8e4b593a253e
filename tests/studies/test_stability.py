"""The atlas itself: its problems against the twin and by hand, what it records, what it keeps, what it writes."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.calibration.calibrate import calibrate
from irpso_addon.core.shading import brdf
from irpso_addon.gpu.device.context import Device
from studies.bench.opengl import result
from studies.stability import page, store
from studies.stability.axes import AXES, ROW, Axis, Point
from studies.stability.identical import _arrays
from studies.stability.material import COAT, GGX, fresnel, reflected, tail_ratio, through_a_surface
from studies.stability.measure import record, summary
from studies.stability.methods import BY_KEY, METHODS, Answer, Table, middle, paper
from studies.stability.problem import CAMERA_ANGLE, Angles, Problem, Trial, make
from studies.stability.righted import rig_sample
from studies.stability.spoil import shifted, stored
from studies.stability.sweep import answered, sweep
from studies.stability.warned import checked_views, checks_of, kind_of, views_of
from studies.stability.words import filled, parts

TINY = Trial(size=20, noise=0.0)


@pytest.fixture(scope="module")
def device() -> Iterator[Device]:
    made = Device()
    yield made
    made.release()


def answer_of(problem: Problem, roughness: np.ndarray, confidence: np.ndarray | None = None) -> Answer:
    solved = (problem.quality > 0).any(-1)
    sigma = None if confidence is None else np.full(roughness.shape, 0.01, np.float32)
    observed = (problem.quality > 0).sum(-1).astype(np.float32)
    return Answer(problem.truth.base, roughness, solved, sigma, confidence, observed)


# ---- records


def test_records_depend_on_files_that_exist() -> None:
    """Else a method could change, and its old records would stay."""
    for method in METHODS:
        assert [name for name in (*store.COMMON, *method.files) if not (store.ROOT / name).exists()] == [], method.key


# ---- problems


def test_observation_is_the_brdf_of_the_scene() -> None:
    p = make(TINY)
    g, at = p.believed, (7, 11)
    for k, camera in enumerate(p.groups):
        light, view = g.lamps[k] - g.place[at], g.cameras[camera] - g.place[at]
        light, view = (v / np.linalg.norm(v) for v in (light, view))
        if p.quality[*at, k] > 0:
            value = brdf.principled(p.truth.base[at], p.truth.roughness[at], light, view, g.normal[at])
            np.testing.assert_allclose(p.rgb[*at, k], value, rtol=1e-4)
    assert (p.quality > 0).mean() > 0.9


def test_arrays_and_truth_predict_the_pictures() -> None:
    """What the checks are shown agrees with the observations where nothing is wrong."""
    p = make(TINY)
    for k, view in enumerate(checked_views(p, answer_of(p, p.truth.roughness), views_of(p))):
        np.testing.assert_allclose(view.predicted[view.good], view.observed[view.good], rtol=5e-4)
        assert view.good.sum() == (p.quality[..., k] > 0).sum()


@pytest.mark.parametrize("axis", AXES, ids=lambda axis: axis.key)
def test_every_axis_changes_what_it_says(axis: Axis) -> None:
    """Its last point differs from its first in what is observed; no number is missing; words name its points."""
    first, last = (make(replace(axis.points[i].trial, size=20)) for i in (0, -1))
    for p in (first, last):
        assert np.isfinite(p.rgb).all() and np.isfinite(p.lobes).all()
        assert np.isfinite(p.radiance).all() or p.clipped.any()
    assert first.rgb.shape != last.rgb.shape or (first.rgb != last.rgb).any()
    named = re.findall(r"\{(\w+)\.(\w+)@([^}]+)\}", parts()[axis.key])
    assert named and {label for *_, label in named} <= {p.label for p in axis.points}
    assert {method for method, *_ in named} <= set(BY_KEY)


@pytest.mark.parametrize("field", ["noise", "shot", "read"])
def test_noise_is_as_told(field: str) -> None:
    clean, noisy = make(replace(TINY, size=32)), make(replace(TINY, size=32, **{field: 0.02}))
    seen = clean.quality > 0
    value = clean.radiance[seen].astype(np.float64)
    unit = {"noise": value, "shot": np.sqrt(value), "read": 1.0}[field]
    assert ((noisy.radiance[seen] - value) / unit).std() == pytest.approx(0.02, rel=0.03)
    np.testing.assert_array_equal(clean.truth.roughness, noisy.truth.roughness)


def test_files_have_their_steps() -> None:
    value = np.linspace(0.001, 2.0, 4001)
    for bits in (10, 12, 16):
        assert np.abs(stored(value, str(bits)) - value).max() == pytest.approx(1.0 / (2**bits - 1), rel=0.05)
    assert np.abs(stored(value, "half") / value - 1).max() == pytest.approx(2.0**-11, rel=0.05)
    code = np.unique(stored(value, "8")) / 2.0  # sRGB: a bright step is 2.4 / 1.055 / 255 of full scale (its slope)
    assert code[-1] - code[-2] == pytest.approx(2.4 / 1.055 / 255, rel=0.01)


def test_a_camera_that_is_off_shows_the_place_beside() -> None:
    ramp = np.tile(np.arange(12.0)[None, :, None], (9, 1, 3)) + 5 * np.arange(9.0)[:, None, None]
    np.testing.assert_allclose(shifted(ramp, np.array([0.3, -0.6]))[3:-3, 3:-3],
                               (ramp + 0.3 - 5 * 0.6)[3:-3, 3:-3])
    whole = shifted(ramp, np.array([2.0, 0.0]))
    np.testing.assert_array_equal(whole[:, :-2], ramp[:, 2:])


def test_outliers_are_as_many_as_told_and_lie_together_where_asked() -> None:
    clean = make(replace(TINY, size=32))
    seen = clean.quality > 0
    for blobs in (False, True):
        spoilt = make(replace(TINY, size=32, shadows=0.05, doubled=0.05, blobs=blobs))
        hit = (spoilt.radiance != clean.radiance).any(-1)
        assert hit[seen].mean() == pytest.approx(0.1, abs=0.015)
        beside = (hit[:, 1:] & hit[:, :-1]).sum() / hit.sum()
        assert (beside > 0.5) == blobs


def test_the_best_view_is_as_far_from_the_highlight_as_told() -> None:
    p = make(replace(TINY, views=6, coverage=2.0))
    sin2h = np.where(p.quality > 0, p.lobes[..., 0, 0], 1.0).min(-1).astype(np.float64)
    ratio = np.sqrt(sin2h / (1 - sin2h)) / p.truth.roughness**2
    assert np.median(ratio) == pytest.approx(2.0, rel=0.02)


def test_fresnel() -> None:
    c = np.linspace(0.1, 1, 20)
    np.testing.assert_allclose(fresnel("1.5", c), brdf.F_dielectric(c))
    assert fresnel("2.4", np.array(1.0)) == pytest.approx((1.4 / 3.4) ** 2)
    assert fresnel("Schlick", np.array(1.0)) == pytest.approx(0.04)


def slopes_of(cos: np.ndarray) -> Angles:
    """Light from all sides, the view along the normal: sin2h is that of half the light's angle."""
    half = np.sqrt((1 + cos) / 2)
    return Angles(cos, np.ones_like(cos), half, 1 - half**2, np.ones_like(cos))


def test_a_longer_tail_has_as_many_facets() -> None:
    """The distribution's projected area is 1 whatever the exponent, and its tail is longer."""
    cos = (np.arange(200_000) + 0.5) / 200_000
    for r in (0.2, 0.5, 0.9):
        D = brdf.D_ggx(r**4, 1 - cos**2)
        assert np.mean(2 * np.pi * D * cos) == pytest.approx(1.0, rel=1e-3)
        for exponent in (1.9, 1.5, 1.2):
            longer = D * tail_ratio(exponent, np.array(r), 1 - cos**2)
            assert np.mean(2 * np.pi * longer * cos) == pytest.approx(1.0, rel=1e-3), (r, exponent)
            assert longer[100] > D[100] and longer[-1] < D[-1]
    assert tail_ratio(GGX, np.array(0.4), np.array(0.3)) == pytest.approx(1.0)


def test_materials_that_no_model_describes() -> None:
    """Against what they are made of: a metal is Cycles', a diffuse through a surface is darker at grazing angles."""
    cos = (np.arange(100) + 0.5) / 100
    at, p = slopes_of(cos), make(TINY)
    truth = replace(p.truth, base=p.truth.base[:1, :1], roughness=np.full((1, 1), 0.4))
    plain, metal, coat, matt = (reflected(replace(TINY, **more), truth, at) for more in (
        {}, {"metallic": 0.6}, {"coat": 1.0}, {"diffuse": 1.0}))
    L, V = (np.stack([np.sqrt(1 - c**2), np.zeros_like(c), c], -1) for c in (cos, np.ones_like(cos)))
    N = np.array([0.0, 0.0, 1.0])
    want = brdf.principled(truth.base[0], np.full(cos.shape, 0.4), L, V, N, metallic=0.6)
    np.testing.assert_allclose((truth.base * metal[0] + metal[1])[0], want, rtol=1e-6)
    clear = brdf.principled(np.zeros(3), np.full(cos.shape, COAT), L, V, N)
    np.testing.assert_allclose(coat[1] - clear[None, :, :1], plain[1] * (coat[0] / plain[0]), atol=1e-9)
    assert (coat[0] < plain[0]).all() and (coat[0] > 0.9 * plain[0]).all()
    np.testing.assert_array_equal(matt[0][0, :, 0], through_a_surface(cos, np.ones_like(cos)))
    albedo = [np.mean(2 * np.pi * cos * through_a_surface(cos, np.full_like(cos, view))) for view in (0.2, 0.7, 1.0)]
    assert albedo[0] < 0.5 < albedo[1] < albedo[2] < 1.0  # the rest is the surface's own


def test_believed_and_true_differ_by_as_much_as_told() -> None:
    a, b = (make(replace(TINY, size=32, normal=n)) for n in (0.0, 2.0))
    np.testing.assert_array_equal(a.believed.normal, b.believed.normal)  # the believed ones are given
    assert (a.rgb != b.rgb).any()
    wide, point = make(replace(TINY, radius=0.2)), make(TINY)
    ratio = wide.radiance[point.quality > 0] / point.radiance[point.quality > 0]
    # The disc's points are 2 % farther in the square's mean; peaks are lower.
    assert np.median(ratio) == pytest.approx(0.98, abs=0.01) and ratio.min() < 0.8
    tilt = np.degrees(np.arccos(make(replace(TINY, grazing=60.0)).believed.cameras[:, 2] / 5.0))
    np.testing.assert_allclose(tilt, 60.0)
    assert CAMERA_ANGLE == 25.0


# ---- methods and records


def test_clean_problems_are_solved(device: Device) -> None:
    for trial in (TINY, replace(TINY, colour=1.0), replace(TINY, cameras=1)):
        table = Table(device, make(trial))
        for key, most in (("refined", 0.01), ("squares", 0.01), ("swarm", 0.03), ("single", 0.6), ("adam", 0.7)):
            run = BY_KEY[key].run
            assert run is not None
            told = record(table.problem, run(table))
            assert told["nan"] == 0 and told["failures"] <= most, (trial, key)
        table.release()


def test_auto_is_judged_by_left_out_lamps(device: Device) -> None:
    """A metal is found with its base colour; a diffuse that is not Lambert's is predicted worse, and recorded so."""
    told = {}
    for name, trial in {"plain": TINY, "metal": replace(TINY, size=32, metallic=1.0, noise=0.002),
                        "matt": replace(TINY, diffuse=0.5)}.items():
        table = Table(device, make(trial))
        answer = BY_KEY["auto"].run(table)
        told[name] = record(table.problem, answer)
        if name == "metal":
            assert answer.metallic == pytest.approx(1.0, abs=0.05) and told[name]["albedo"] < 0.02
        table.release()
    assert told["plain"]["taken"] == "a value a texel" and told["plain"]["predicted"] < 0.05
    assert "metallic" in told["metal"]["taken"] and told["metal"]["failures"] < 0.05
    assert told["matt"]["predicted"] > 3 * told["plain"]["predicted"]
    whole = summary([told["plain"], told["matt"]])
    assert whole["predicted"] == pytest.approx((told["plain"]["predicted"] + told["matt"]["predicted"]) / 2, rel=1e-4)
    assert sum(whole["taken"].values()) == 2


def test_paper_in_one_map_is_paper_alone(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    problems = [make(replace(TINY, seed=seed)) for seed in range(3)]
    alone, together = paper(device, problems[:1])[0], paper(device, problems)
    np.testing.assert_array_equal(alone.roughness, together[0].roughness)
    told = [record(p, a, middle(p)) for p, a in zip(problems, together, strict=True)]
    assert all(r["failures"] < 0.7 and r["texels"] == 144 for r in told)


def test_record_and_summary_by_hand() -> None:
    p = make(replace(TINY, size=16))
    rough = p.truth.roughness.copy()
    rough.ravel()[:32] += 0.2  # an eighth of 256
    sure = np.ones((16, 16), np.float32)
    sure.ravel()[:24] = 0.1  # of which three quarters are told
    told = record(p, answer_of(p, rough, sure))
    assert told["failures"] == told["gross"] == pytest.approx(32 / 256)
    assert (told["failed"], told["albedo"], told["nan"]) == (32, 0.0, 0)
    assert told["worst"] == pytest.approx(0.2, rel=1e-4)
    assert told["failed_low"] == 32  # all others are alike: none is above the median
    sure.ravel()[100:] = np.linspace(0.6, 0.9, 156)
    sure.ravel()[24:28], sure.ravel()[28:32] = 0.95, 0.45  # 4 are sure of it, 4 are not
    sure.ravel()[32:100] = 0.3
    sure.ravel()[100:180] = 0.4
    told = record(p, answer_of(p, rough, sure))
    assert (told["failed_low"], told["failed_told"]) == (24, 28)
    whole = summary([told, {**told, "failures": 0.0, "gross": 0.0}])
    assert whole["gross_maps"] == 1 and whole["failures"] == pytest.approx(1 / 16)
    assert whole["failures_spread"] == pytest.approx(1 / 16)


def test_checks_hear_what_is_wrong() -> None:
    """The whole way from arrays to measured checks, and each of the atlas's kinds."""
    p = make(replace(TINY, size=32, noise=0.002))
    answer = answer_of(p, p.truth.roughness, np.ones((32, 32), np.float32))
    checks = checks_of(p, answer)
    assert len(checks.views) == 12 and checks.noise == pytest.approx(0.002, rel=0.5)
    assert kind_of("view 3 is 0.8 pixels off") == "registration"


def test_a_camera_that_is_off_is_put_right(device: Device) -> None:
    """And an exposure, where asked; named either way."""
    p = make(replace(TINY, size=32, noise=0.002, shift=0.7, gain=0.05))
    table = Table(device, p)
    failures = {}
    for key in ("squares", "refined", "exposed"):
        answer, told = answered(device, table, BY_KEY[key])
        failures[key] = record(p, answer)["failures"]
        if told is not None:
            assert {"registration", "exposure"} <= {kind for kind, _ in told}
    table.release()
    assert failures["exposed"] < 0.5 * failures["squares"]


def test_tiles_change_no_byte(device: Device) -> None:
    p = make(replace(TINY, noise=0.01, shadows=0.05))
    for method in ("refined", "paper"):
        assert _arrays(device, p, method, (20, 20), 0) == _arrays(device, p, method, (7, 9), 0)
    assert _arrays(device, p, "refined", (20, 20), 0) == _arrays(device, p, "refined", (7, 9), 2)


# ---- what is kept and written


def small_axis() -> Axis:
    return Axis("noise", "Noise in proportion", "%", (Point("0", TINY), Point("1", replace(TINY, noise=0.01))))


def test_sweep_resumes_and_forgets_what_changed(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(store, "FOLDER", tmp_path)
    monkeypatch.setattr(store.Store.__init__, "__defaults__", (tmp_path,))
    axis, methods = small_axis(), [m for m in METHODS if m.key in ("squares", "single")]
    said: list[str] = []
    sweep(device, axis, methods, 1, said.append)
    assert len(said) == 2
    sweep(device, axis, methods, 1, said.append)
    assert len(said) == 2
    sweep(device, axis, methods, 2, said.append)
    assert len(said) == 4
    held = store.Store(axis)
    assert set(held.seeds(axis.points[1], methods[0])) == {"0", "1"}
    other = Point("1", replace(TINY, noise=0.02))
    assert held.seeds(other, methods[0]) == {}
    assert held.summaries(2)["1"]["squares"]["seeds"] == 2
    monkeypatch.setattr(page, "FOLDER", tmp_path)
    pytest.importorskip("studies.stability.chart", reason="matplotlib is not installed", exc_type=ImportError)
    monkeypatch.setattr(page, "AXES", (axis,))
    monkeypatch.setattr(page, "ALONE", (axis,))
    written = page.publish(device, 2, tmp_path / "docs")
    text = written[-1].read_text()
    assert "### Noise in proportion" in text and "noise.png" in text
    assert json.loads(written[0].read_text())["axes"]["noise"]["0"]["single"]["seeds"] == 2
    assert written[1].stat().st_size > 5000


def test_an_axis_measured_later_joins_the_others() -> None:
    """What is there stays with its machine and seeds; what is new is told apart; the order is the axes'."""
    old = {"machine": {"commit": "a", "date": "x"}, "seeds": 20, "identical": "all alike",
           "axes": {"noise": {"0": 1}, "coat": {"0": 2}, "row": {"none": 3}}}
    new = {"machine": {"commit": "b", "date": "y"}, "seeds": 6, "identical": None,
           "axes": {"coat": {"0": 4}, "views": {"1": 5}}}
    both = page.joined(old, new)
    assert list(both["axes"]) == ["views", "noise", "coat", "row"] and both["axes"]["coat"] == {"0": 4}
    assert both["machine"] == old["machine"] and both["seeds"] == 20 and both["identical"] == "all alike"
    assert both["apart"] == {key: {"commit": "b", "date": "y", "seeds": 6} for key in ("coat", "views")}
    assert page.joined({}, new) == new and page.joined(new, both) == both
    later = {**new, "machine": {"commit": "c", "date": "z"}, "seeds": 20, "axes": {**new["axes"], "tone": {"1": 6}}}
    kept = page.joined(both, later)["apart"]  # records of the run before are still at hand, and not measured again
    assert {key: made["commit"] for key, made in kept.items()} == {"coat": "b", "views": "b", "tone": "c"}


def test_words_are_filled() -> None:
    points = {"1": {"refined": {"failures": 0.0312, "roughness": 0.01234}, "paper": {"failures": 0.312}}}
    assert filled("{refined.failures@1}, {paper.failures@1}, {refined.roughness@1}, {adam.failures@1}", points) == \
        "3.1 %, 31 %, 0.012, -"
    assert ROW.key not in parts()


@pytest.mark.parametrize("seed", [0, 2, 3, 6])
def test_a_response_is_found_beside_all_else(seed: int) -> None:
    """Lamps, powers and ambient light are off too.

    Of seed 0 a diffuse that is not Lambert's was taken for it (23 % of the texels were spoilt), of seed 3 it was too
    little to be worth it (4 %).  Of seeds 2 and 6 ambient light came out 1.8 times too bright or more in its place:
    each round looked for a texel's roughness near that of the round before alone, which wrong lamps had made.
    """
    problem = make(Trial(moved=0.01, gain=0.03, tone=0.97, bounce=0.01, seed=seed))
    judged = result(calibrate(rig_sample(problem), lamps=True, exposures=True))
    assert judged is not None and judged.free.response and not judged.free.diffuse
    assert judged.found.change.log_response == pytest.approx(np.log(0.97), abs=0.004)
