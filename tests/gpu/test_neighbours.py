"""Which neighbours a texel without a highlight takes its roughness from: those of its base colour, if that matters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading.brdf import ROUGHNESS_MIN
from irpso_addon.core.tiled.tiled_plan import Noise, PriorKnowledge
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.solve import neighbours
from irpso_addon.gpu.solve.solver import Solver
from irpso_addon.gpu.solve.typical import typical
from tests.support.texels import as_metal, exact, finish

SIZE, SHARED = 256, 1.0  # nothing but the model's error
NODES = ROUGHNESS_MIN ** (1 - np.arange(32) / 31)
SMOOTH, ROUGH = 0.25, 0.6
DARK, LIGHT = np.array([0.1, 0.16, 0.3]), np.array([0.6, 0.5, 0.4])
Pyramid = Callable[..., tuple[np.ndarray, np.ndarray]]


@pytest.fixture
def pyramid(on_gl: Any) -> Pyramid:
    """pyramid(tables, base colour) -> (estimate, prior), (h, w, 4) each."""
    def call(
        tables: np.ndarray, base: np.ndarray, shared: float = SHARED, **more: Any,
    ) -> tuple[np.ndarray, np.ndarray]:
        def job(device: Device) -> tuple[np.ndarray, np.ndarray]:
            with device.scope():
                height, width = tables.shape[:2]
                each = tuple(device.texture(width, height, data=tables[..., 4 * i:4 * i + 4]) for i in range(8))
                colour = np.concatenate([base, np.ones((height, width, 1))], -1)
                found = neighbours.pyramid(device, each, device.texture(width, height, data=colour),
                                           neighbours.Shared(shared), **more)
                return device.read(found[0]), device.read(found[1])

        result: tuple[np.ndarray, np.ndarray] = on_gl(job)
        return result

    return call


def stripes(width: int, size: int = SIZE) -> np.ndarray:
    """(size, size) bool, aslant."""
    y, x = np.mgrid[:size, :size]
    return np.asarray(((x + y // 2) // width) % 2 == 0)


def told(roughness: np.ndarray, informed: np.ndarray, error: float = 0.02) -> np.ndarray:
    """Tables (h, w, 32) of texels whose data are normal about their roughness, each with an error of its own."""
    off = error * np.random.default_rng(3).standard_normal(roughness.shape)
    cost = 0.5 * ((NODES - (roughness + off)[..., None]) / error) ** 2
    return np.where(informed[..., None], cost - cost.min(-1, keepdims=True), 0.0)


def patch() -> np.ndarray:
    """Informed texels: some columns side by side, as a highlight leaves them, and then none for three times as many."""
    return np.broadcast_to(np.arange(SIZE) % 16 < 4, (SIZE, SIZE))


def painted(one: np.ndarray) -> np.ndarray:
    return np.asarray(np.where(one[..., None], DARK, LIGHT))


@pytest.mark.parametrize("width", [3, 6, 12])
def test_roughness_stays_on_its_colours_side_of_a_border(pyramid: Pyramid, width: int) -> None:
    dark = stripes(width)
    truth = np.where(dark, SMOOTH, ROUGH)
    tables = told(truth, patch())
    with_colour, _ = pyramid(tables, painted(dark))
    without, _ = pyramid(tables, painted(np.ones_like(dark)))
    error, before = np.abs(with_colour[..., 0] - truth), np.abs(without[..., 0] - truth)
    assert before.mean() > 0.1
    assert error.mean() < 0.01
    assert np.quantile(error, 0.99) < 0.05


def test_a_colour_without_data_in_a_cell_takes_nothing_from_the_other(pyramid: Pyramid) -> None:
    """A dark band through informed light texels: little of it is informed itself."""
    y, x = np.mgrid[:SIZE, :SIZE]
    band = np.abs(y - 30) < 4
    truth = np.where(band, SMOOTH, ROUGH)
    found, _ = pyramid(told(truth, ~band | (x % 16 < 2)), painted(band))
    assert np.abs(found[..., 0] - truth)[band].max() < 0.1  # of one colour: 0.26 in the mean


@pytest.mark.parametrize("rough", [lambda u: np.full_like(u, 0.4), lambda u: 0.3 + 0.3 * u], ids=["one", "slope"])
def test_colours_of_one_roughness_are_pooled(pyramid: Pyramid, rough: Callable[[np.ndarray], np.ndarray]) -> None:
    """A printed surface: the same estimates as of one colour."""
    truth = rough(np.broadcast_to((np.arange(SIZE) + 0.5) / SIZE, (SIZE, SIZE)))
    tables = told(truth, patch())
    print_ = painted(stripes(5)) * np.random.default_rng(4).uniform(0.6, 1.0, (SIZE, SIZE, 1))
    (printed, prior), (plain, plain_prior) = pyramid(tables, print_), pyramid(tables, painted(np.ones_like(patch())))
    off = np.abs(printed[..., 0] - plain[..., 0])
    assert np.mean(off > 2e-3) < 0.005
    assert off.max() < 0.02
    assert np.mean(np.abs(prior[..., 1] / plain_prior[..., 1] - 1) > 0.02) < 0.01
    assert np.abs(printed[..., 0] - truth).mean() < 1.01 * np.abs(plain[..., 0] - truth).mean()


@pytest.mark.parametrize("width", [3, 6, 12, 20])
def test_noisy_tables_of_many_texels_say_what_each_does_not(pyramid: Pyramid, width: int) -> None:
    """Each is off by 0.1.  When four of them counted for 1.2, whatever the noise, the mean error was 0.10 to 0.16."""
    dark = stripes(width)
    truth = np.where(dark, SMOOTH, ROUGH)
    found, _ = pyramid(told(truth, patch(), 0.1), painted(dark), shared=0.01)
    assert np.abs(found[..., 0] - truth).mean() < 0.02


def test_noisy_colours_of_one_roughness_are_about_as_good_as_one_colour(pyramid: Pyramid) -> None:
    truth = np.full((SIZE, SIZE), 0.4)
    tables = told(truth, patch(), 0.1)
    printed, plain = (np.abs(pyramid(tables, base, shared=0.01)[0][..., 0] - truth).mean()
                      for base in (painted(stripes(5)), painted(np.ones_like(patch()))))
    assert printed < 1.05 * plain < 0.015


@pytest.mark.parametrize("shared", [1.0, 0.4, 0.01])
@pytest.mark.parametrize("size", [(64, 64), (50, 37), (9, 20), (5, 3)])
def test_one_colour_is_a_plain_pyramid(pyramid: Pyramid, size: tuple[int, int], shared: float) -> None:
    """Against a plain pyramid in float64."""
    truth = np.random.default_rng(5).uniform(0.2, 0.8, size)
    tables = told(truth, np.random.default_rng(6).uniform(size=size) < 0.3, 0.1)
    found, prior = pyramid(tables, np.broadcast_to(LIGHT, (*size, 3)), shared=shared)
    expected, _, _, mean, variance, _ = plain_pyramid(tables, shared)
    np.testing.assert_allclose(found[..., 0], expected, atol=2e-4)
    np.testing.assert_allclose(prior[..., 0], mean, atol=2e-4)
    np.testing.assert_allclose(prior[..., 1], variance, rtol=2e-3)


def test_a_cell_of_two_minds_holds_no_texel_in_one_valley(pyramid: Pyramid) -> None:
    """A rough patch on a smooth surface, whose data allow a very smooth one too, though less.

    What lies around is nearer to that.
    """
    y, x = np.mgrid[:SIZE, :SIZE]
    inside, smooth, very = np.hypot(x - 130, y - 120) < 20, 0.22, 0.08
    everywhere = np.ones_like(inside)
    rough = told(np.full((SIZE, SIZE), ROUGH), everywhere, 0.05)
    other = 4 + told(np.full((SIZE, SIZE), very), everywhere, 0.01)
    tables = np.where(inside[..., None], np.minimum(np.minimum(rough, other), 10.0),
                      told(np.full((SIZE, SIZE), smooth), everywhere, 0.1))
    found, _ = pyramid(tables, np.broadcast_to(LIGHT, (SIZE, SIZE, 3)))
    off = np.abs(found[..., 0] - np.where(inside, ROUGH, smooth))
    core = np.hypot(x - 130, y - 120) < 14
    assert off[core].mean() < 0.03  # 0.52 where cells hold their texels in the valley that they have chosen
    assert off[~inside].mean() < 0.03


def test_a_part_of_a_map_starts_from_what_lies_around_it(pyramid: Pyramid) -> None:
    """Its coarse cells are given: colours that its own data do not tell apart take these."""
    given = np.zeros((4, 4, 4), np.float32)
    given[...] = 0.35, 0.01, 0.0, 1.0
    found, _ = pyramid(np.zeros((SIZE, SIZE, 32)), painted(stripes(6)),
                       before=PriorKnowledge(roughness=given))
    np.testing.assert_allclose(found[..., 0], 0.35, atol=1e-6)


def test_a_solve_borrows_from_texels_of_its_colour(on_gl: Any) -> None:
    """The same two roughnesses, seen on stripes of two base colours and on one base colour."""
    problem, _ = exact(views=5)
    one = stripes(4, problem.truth.roughness.shape[0])
    truth = np.where(one, SMOOTH, ROUGH)
    errors = []
    for base in (painted(one), np.broadcast_to(LIGHT, (*one.shape, 3))):
        texels = as_metal(replace(problem, truth=replace(problem.truth, roughness=truth, base=base)), 0.0)
        noise = 1 + 0.03 * np.random.default_rng(7).standard_normal(texels.rgb.shape)
        texels = replace(texels, rgb=(texels.rgb * noise).astype(np.float32))

        def job(device: Device, texels: Any = texels) -> np.ndarray:
            solver = Solver(device, texels.source(device), SolveSettings(size=one.shape[0]))
            maps = finish(solver.solve())
            found = maps.read(device)
            for thing in (maps, solver, solver.source):
                thing.release()
            return np.abs(found.roughness - truth)[found.solved]

        errors.append(on_gl(job).mean())
    assert errors[0] < 0.8 * errors[1]


def test_what_neighbours_share_is_what_is_left_in_the_mean_of_many() -> None:
    """Against the variance of the mean of 4^L texels, of whose errors one part is each texel's own.

    Of the other part the mean of four texels leaves half; all where errors are seen to be alike, or normals refined.
    """
    def part(noise: Noise, error: float, refined: bool = False) -> float:
        return neighbours.shared_by(noise, error, refined).part

    assert part(Noise(0.01**2, True), 0.0) == 0
    assert part(Noise(0.01**2, True), 0.001) == pytest.approx(0.01)
    assert part(Noise(0.01**2, True, 0.3), 0.001) == 0.3
    assert part(Noise(1e-8, True, 0.3), 0.001) == 1
    assert part(Noise(0.01**2, True), 0.001, refined=True) == pytest.approx(0.09)
    assert neighbours.shared_by(Noise(0.01**2, True, 0.3), 0.001, refined=False).together == neighbours.COMMON
    assert neighbours.shared_by(Noise(0.01**2, True, 0.005), 0.001, refined=False).together == neighbours.ALIKE
    for refined, left in ((False, 0.5), (True, 1.0)):
        together = neighbours.shared_by(Noise(1.0, True), 0.0, refined).together
        for shared in (0.0, 0.01, 0.5, 1.0):
            gain = neighbours.Shared(shared, together).gain
            said = [4.0**level * np.prod([gain(below) for below in range(level)]) for level in range(9)]
            variance = [(1 - shared) * 0.25**level + shared * left**level for level in range(9)]
            np.testing.assert_allclose(said, 1 / np.array(variance), rtol=1e-12)


def test_how_far_errors_are_alike() -> None:
    """Of a smooth field and of noise, in parts that are known; a few outliers do not count."""
    rng, (y, x) = np.random.default_rng(3), np.mgrid[:SIZE, :SIZE] / SIZE
    smooth = np.stack([np.sqrt(2) * np.cos(6 * x * (1 + i) + 5 * y) for i in range(3)], -1)
    noise = rng.standard_normal((SIZE, SIZE, 3))
    one = np.ones((SIZE, SIZE, 1))
    for part in (0.0, 0.3, 0.9):
        errors = np.sqrt(part) * smooth + np.sqrt(1 - part) * noise
        assert neighbours.alike(np.concatenate([errors, one], -1)) == pytest.approx(part, abs=0.03)
        errors[::50, ::50] = 1e3
        assert neighbours.alike(np.concatenate([errors, one], -1)) == pytest.approx(part, abs=0.05)
    assert neighbours.alike(np.zeros((SIZE, SIZE, 4))) == 0
    # A pixel is eight texels wide: half of those that are four apart share one, in whatever grid they are solved.
    wide = np.repeat(np.repeat(rng.standard_normal((SIZE // 8, SIZE // 8, 3)), 8, 0), 8, 1)
    errors = np.concatenate([wide, one], -1)
    assert neighbours.alike(errors) == pytest.approx(0.5, abs=0.05)
    assert neighbours.alike(errors[::2, ::2], 2) == pytest.approx(0.5, abs=0.05)
    assert neighbours.alike(errors[::2, ::2]) < 0.1


@pytest.mark.parametrize(("shared", "least", "most"), [(0.0, 0.0, 0.1), (0.02, 0.6, 1.0)])
def test_a_solve_measures_how_far_errors_are_alike(on_gl: Any, shared: float, least: float, most: float) -> None:
    """Each view errs in each texel by itself, or by what changes slowly from texel to texel as well."""
    _, texels = exact(views=8, size=64)
    rng = np.random.default_rng(2)
    y, x = np.mgrid[:64, :64] / 64
    views = texels.rgb.shape[2]
    slow = np.stack([np.cos(2 * np.pi * (rng.uniform(-1, 1) * x + rng.uniform(-1, 1) * y + rng.uniform()))
                     for _ in range(views)], -1)[..., None]
    own = rng.standard_normal((64, 64, views, 1))
    texels = replace(texels, rgb=(texels.rgb * (1 + shared * slow + 0.005 * own)).astype(np.float32))

    def job(device: Device) -> float:
        solver = Solver(device, texels.source(device), SolveSettings(size=64))
        finish(solver.solve()).release()
        solver.release()
        return solver.noise_of[1].alike

    assert least <= on_gl(job) <= most


def test_an_error_of_the_model_that_three_views_do_not_show_is_still_expected(on_gl: Any) -> None:
    """Observations that err by 0.1 %, alike in neighbours: three views fit them too well to show it."""
    problem, _ = exact(views=3)
    size = problem.truth.roughness.shape[0]
    y, x = np.mgrid[:size, :size] / size
    truth = 0.3 + 0.2 * np.sin(2 * np.pi * x)
    texels = as_metal(replace(problem, truth=replace(
        problem.truth, roughness=truth, base=np.broadcast_to(LIGHT, (size, size, 3)))), 0.0)
    rng = np.random.default_rng(2)
    smooth = np.stack([sum(np.cos(2 * np.pi * (rng.uniform(-2, 2, 2) @ (x.ravel(), y.ravel()) + rng.uniform()))
                           for _ in range(8)) / 2 for _ in range(3)], -1).reshape(size, size, 3, 1)
    texels = replace(texels, rgb=(texels.rgb * (1 + 0.001 * smooth)).astype(np.float32))

    def job(device: Device, shared: float) -> tuple[float, float]:
        source = texels.source(device)
        source.shared_error = shared
        solver = Solver(device, source, SolveSettings(size=size))
        maps = finish(solver.solve())
        found = maps.read(device)
        for thing in (maps, solver, source):
            thing.release()
        error = np.abs(found.roughness - truth)[found.solved]
        return float(error.mean()), float(np.mean(error < 1.645 * found.sigma[found.solved]))

    (plain, held), (error, holds) = (on_gl(lambda device, shared=s: job(device, shared)) for s in (0.0, 0.001))
    assert error < 0.85 * plain
    assert held < 0.7 and holds > 0.85


def plain_pyramid(table: np.ndarray, shared: float, level: int = 0) -> tuple[np.ndarray, ...]:
    """Of every cell, all of one kind: estimate, variance of its valley, whether known; mean and variance of the prior.

    And last the mean squared distance to what lies in other valleys.
    """
    height, width = table.shape[:2]
    mean, variance, known = np.full((height, width), 0.5), np.full((height, width), 0.1), np.zeros((height, width))
    if width > 8:
        even = np.pad(table, ((0, height % 2), (0, width % 2), (0, 0)))
        four = even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]
        own, alike = (1 - shared) * 0.25**level, shared * 0.5**level
        above = plain_pyramid((own + alike) / (own + 2 * alike) * four, shared, level + 1)
        mean, variance, elsewhere = handed_down(above, (height, width))
        variance = variance + np.maximum((neighbours.ROUGHNESS_SLOPE / width) ** 2, elsewhere)
        known = known + 1
    cost = table + np.minimum((NODES - mean[..., None]) ** 2 / (2 * variance[..., None]), neighbours.PRIOR_CUT)
    best = cost.argmin(-1)
    mid = np.clip(best, 1, 30)
    c0, c1, c2 = (np.take_along_axis(cost, (mid + i)[..., None], -1)[..., 0] for i in (-1, 0, 1))
    x0, x1, x2 = NODES[mid - 1], NODES[mid], NODES[mid + 1]
    s0, s1 = (c1 - c0) / (x1 - x0), (c2 - c1) / (x2 - x1)
    bend = 2 * (s1 - s0) / (x2 - x0)
    low = np.where(bend > 0, np.clip((x0 + x1) / 2 - s0 / np.where(bend > 0, bend, 1), x0, x2), NODES[best])
    said = table.max(-1) > 0
    return (np.where(said, low, mean), np.where(said, np.minimum(1 / np.maximum(bend, 1e-3), variance), variance),
            np.where(said, 1, known), mean, variance, np.where(said, other_valleys(cost, low, bend), 0.0))


def other_valleys(cost: np.ndarray, low: np.ndarray, bend: np.ndarray) -> np.ndarray:
    """Mean squared distance from a normal valley at ``low`` to nodes that are not its tail, by their likelihoods."""
    bend, off = np.maximum(bend, 1e-3), NODES - low[..., None]
    steps = np.abs(np.arange(32) - 31 * np.log(low / ROUGHNESS_MIN)[..., None] / np.log(1 / ROUGHNESS_MIN))
    share = np.exp(cost.min(-1, keepdims=True) - cost) * NODES * np.log(1 / ROUGHNESS_MIN) / 31
    share = np.where((steps > 1.5) & (off**2 * bend[..., None] > 9), share, 0.0)
    return np.asarray((share * off**2).sum(-1) / (share.sum(-1) + np.sqrt(2 * np.pi / bend)))


def handed_down(above: tuple[np.ndarray, ...], size: tuple[int, int]) -> np.ndarray:
    """Mean, variance and what lies elsewhere of the four nearest parents, by distance and by how exact they are."""
    y, x = (np.arange(n) / 2 - 0.25 for n in size)
    total = np.zeros((4, *size))
    for j in (0, 1):
        for i in (0, 1):
            near = (1 - np.abs(np.floor(y) + j - y))[:, None] * (1 - np.abs(np.floor(x) + i - x))
            rows, columns = (np.clip(np.floor(at).astype(int) + k, 0, n - 1)
                             for at, k, n in ((y, j, above[0].shape[0]), (x, i, above[0].shape[1])))
            estimate, variance, known, _, _, elsewhere = (values[rows[:, None], columns] for values in above)
            weight = near * known / variance
            total += weight * np.stack([estimate, variance, elsewhere, np.ones_like(weight)])
    unknown = np.array([0.5, 0.1, 0.0])[:, None, None]
    return np.where(total[3] > 0, total[:3] / np.where(total[3] > 0, total[3], 1), unknown)


def uneven(span: float) -> np.ndarray:
    """(SIZE, SIZE) roughness: waves about 0.3."""
    y, x = (np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE
    return np.asarray(0.3 + span * np.sin(9 * x) * np.cos(7 * y))


@pytest.mark.parametrize(("span", "before", "after"), [(0.02, 0.1, 0.012), (0.05, 0.1, 0.026)])
def test_texels_that_know_little_are_drawn_to_what_the_others_are(
    pyramid: Pyramid, span: float, before: float, after: float,
) -> None:
    """One highlight in each eighth of half the map; elsewhere data that say little, and that wrongly."""
    y, x = np.mgrid[:SIZE, :SIZE]
    truth, informed = uneven(span), (y < SIZE // 2) & (x % 32 < 6) & (y % 32 < 6)
    false = 0.5 * (NODES - 0.6) ** 2  # as of texels without a highlight, whose errors are alike
    tables = np.where(informed[..., None], told(truth, informed, 0.005), false - false.min())
    base = painted(np.ones_like(informed))
    of_all = typical(*(a[informed].astype(np.float32) for a in (truth, np.full_like(truth, 0.005), base)))
    plain, drawn = (np.abs(pyramid(tables, base, **more)[0][..., 0] - truth)[~informed].mean()
                    for more in ({}, {"of_all": of_all}))
    assert plain > before and drawn < after


def test_texels_that_know_little_are_drawn_to_what_those_of_their_colour_are(pyramid: Pyramid) -> None:
    """Patches of two paints, of which only those of half the map have a highlight; data elsewhere are wrong."""
    y, x = np.mgrid[:SIZE, :SIZE]
    dark, informed = (y // 32 + x // 32) % 2 == 0, (y < SIZE // 2) & (x % 32 < 6) & (y % 32 < 6)
    truth, false = np.where(dark, SMOOTH, ROUGH), 0.5 * (NODES - 0.4) ** 2
    tables = np.where(informed[..., None], told(truth, informed, 0.005), false - false.min())
    base = painted(dark)
    of_all = typical(*(a[informed].astype(np.float32) for a in (truth, np.full_like(truth, 0.005), base)))
    plain, drawn = (np.abs(pyramid(tables, base, **more)[0][..., 0] - truth)[~informed]
                    for more in ({}, {"of_all": of_all}))
    assert plain.mean() > 0.05
    assert plain.mean() > 0.15
    assert drawn.mean() < 0.025
