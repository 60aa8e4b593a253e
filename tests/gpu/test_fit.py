"""solve/fit.glsl and solve/fit_two.glsl against their definition in float64, and their digits near the solution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from tests.support.texels import (
    Texels,
    Twin,
    evaluate,
    exact,
    known,
    known_roughly,
    random_texels,
    slope,
    with_values,
)

COLOURS = (0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5)  # camera and channel: two cameras, two views, three channels
LAYOUTS = {
    "one group": ((0,) * 6, 1, 0.0), "two groups": ((0, 0, 1, 1, 1), 1, 0.0), "slack": ((0, 0, 1, 1, 1, 2), 1, 3.0),
    "first slack": ((0, 0, 1, 1, 1, 2), 1, 300.0), "colours": (COLOURS, 3, 2.0),
    "too many to unroll": ((0,) * 9 + (1,) * 8 + (2,) * 4, 1, 1.0),
    "one group, tilts": ((0,) * 6, 1, 0.0), "slack, tilts": ((0, 0, 1, 1, 1, 2), 1, 3.0),
    "colours, tilts": (COLOURS, 3, 2.0), "too many to unroll, tilts": ((0,) * 9 + (1,) * 8 + (2,) * 4, 1, 1.0),
}


@dataclass(frozen=True)
class Case:
    """Random texels under one layout, and the numbers at which they are evaluated."""

    texels: Texels
    slack: float
    at: np.ndarray  # (h, w, 3) roughness1 <= roughness2, weight; float32


def case(layout: str, **more: Any) -> Case:
    groups, channels, slack = LAYOUTS[layout]
    texels = random_texels(groups, channels, **more)
    if "tilts" in layout:
        texels = known_roughly(texels)
    rng = np.random.default_rng(11)
    pair = np.sort(rng.uniform(0.15, 0.95, (*texels.quality.shape[:2], 2)), -1)
    at = np.concatenate([pair, rng.uniform(0.05, 0.95, (*pair.shape[:2], 1))], -1)
    cell = 465.0  # of the table of energies: its slope jumps at nodes, so stay between them
    at[..., :2] = (np.floor(at[..., :2] * cell) + rng.uniform(0.2, 0.8, pair.shape)) / cell
    return Case(texels, slack, at.astype(np.float32))


def close(got: np.ndarray, expected: np.ndarray, rtol: float, scale: np.ndarray | float = 0.0) -> None:
    """Within rtol of the value or of ``scale`` (what the value is a difference of)."""
    off = np.abs(got - expected) / np.maximum(np.abs(expected), scale)
    assert np.max(off) < rtol, f"off by {np.max(off):.3g}, 99 %: {np.quantile(off, 0.99):.3g}"


# ---- one lobe


def least_squares(twin: Twin, texel: int, a: np.ndarray, s: np.ndarray) -> float:
    """Residual of f = a (rho_channel + delta_group) + s by least squares on all unknowns, rho within 0 to 1.

    With what a tilt of each group's changes, where normals are known roughly.
    """
    _, own, _ = twin.groups(a, s)
    total = 0.0
    for channel in np.unique(twin.channel):
        groups = [g for g in range(len(twin.members)) if twin.channel[g] == channel
                  and twin.weight[texel, twin.members[g]].sum() > 0]
        if not groups:
            continue
        rows, right = [], []
        for column, g in enumerate(groups):
            for n in twin.members[g]:
                root = np.sqrt(twin.weight[texel, n])
                row = np.zeros(1 + len(groups))
                row[0] = row[1 + column] = root * a[texel, n]
                rows.append(row)
                right.append(root * (twin.f - s)[texel, n])
            row = np.zeros(1 + len(groups))
            row[1 + column] = 1 / (np.sqrt(twin.slack) * abs(own[texel, g])) if twin.slack else 1e8
            rows.append(row)
            right.append(0.0)
        matrix, values = np.array(rows), np.array(right)
        rho = np.clip(np.linalg.lstsq(matrix, values, rcond=None)[0][0], 0, 1)
        values = values - matrix[:, 0] * rho
        delta = np.linalg.lstsq(matrix[:, 1:], values, rcond=None)[0]
        total += float(((values - matrix[:, 1:] @ delta) ** 2).sum())
        for g in groups if twin.changes else []:
            members = twin.members[g]
            root = np.sqrt(twin.weight[texel, members])
            columns = [root * a[texel, members], *twin.changes[g][texel].T]
            prior = np.diag([0.0, 1.0, 1.0, 1.0])
            right = root * (twin.f - s)[texel, members]
            left = [np.linalg.lstsq(np.concatenate([np.stack(columns[:n], -1), prior[:, :n]]),
                                    np.concatenate([right, np.zeros(4)]), rcond=None)[1] for n in (1, 4)]
            total -= float(left[0][0] - left[1][0]) if left[0].size and left[1].size else 0.0
    return total


@pytest.mark.parametrize("layout", LAYOUTS)
def test_residual_of_one_lobe_is_that_of_least_squares(on_gl, layout):
    """Base colour of each channel and the cameras' differences from it, solved for as unknowns like any other."""
    c = case(layout)
    (fit, _), twin = on_gl(lambda d: evaluate(d, c.texels, "fit_one.kernel", c.at, 2, c.slack)), Twin(c.texels, c.slack)
    r = c.at[..., 0].ravel().astype(np.float64)
    a, s = twin.parts(r)
    seen = np.flatnonzero(known(c.texels))[::5]
    expected = np.array([least_squares(twin, texel, a, s) for texel in seen])
    got = fit.reshape(-1, 4)[seen]
    assert len(seen) > 40
    close(got[:, 0], expected, 1e-4, 1e-3)
    twin.weight, twin.changes = twin.whole, []
    lambert = np.array([least_squares(twin, t, np.full_like(a, 1 / np.pi), np.zeros_like(s)) for t in seen])
    close(got[:, 3], lambert, 1e-4, 1e-3)


@pytest.mark.parametrize(("layout", "level"), [*((name, None) for name in LAYOUTS), ("slack", 0.3), ("slack", 0.9)])
def test_one_lobe_is_its_twin(on_gl, layout, level):
    """Residual, slope and curvature; the information of groups held fixed in derivatives, as Kaufman's."""
    c = case(layout)
    fit, albedo = on_gl(lambda d: evaluate(d, c.texels, "fit_one.kernel", c.at, 2, c.slack, level))
    twin, seen = Twin(c.texels, c.slack, level=level), known(c.texels)
    r = c.at[..., 0].ravel().astype(np.float64)
    information = twin.groups(*twin.parts(r))[2]
    here = twin.errors(*twin.parts(r))
    got, power = fit.reshape(-1, 4)[seen], (here**2).sum(-1)[seen]
    close(got[:, 0], power, 2e-4, 1e-3)

    def half(at: np.ndarray) -> np.ndarray:
        return np.asarray((twin.errors(*twin.parts(at), information) ** 2).sum(-1) / 2)

    free = slope(lambda at: twin.errors(*twin.parts(at), information, bounded=False), r)
    curvature = (free**2).sum(-1)[seen]
    close(got[:, 1], -slope(half, r)[seen], 2e-3, np.maximum(1e-2 * np.sqrt(power * curvature), 1e-4))
    close(got[:, 2], curvature, 2e-3, 1e-3)
    assert (got[:, 0] > 1e-3).mean() > 0.7
    # Base colour: its slope and its variance, mean of the channels observed.
    rho = slope(lambda at: twin.between(twin.groups(*twin.parts(at))[1], information, bounded=False)[1], r)
    total = np.stack([information[:, twin.channel == k].sum(-1) for k in np.unique(twin.channel)], -1)
    has = total > 0
    count = np.maximum(has.sum(-1), 1)
    variance = (has / np.where(has, total, 1)).sum(-1) / count
    more = albedo.reshape(-1, 4)
    close(more[seen, 0], ((has * rho).sum(-1) / count)[seen], 2e-3, 0.05)
    close(more[seen, 1], variance[seen], 1e-4)
    np.testing.assert_array_equal(more[seen, 2], twin.good[seen])
    close(more[seen, 3], twin.free()[seen], 1e-4, 0.1)
    assert not fit.reshape(-1, 4)[~seen].any()


METALS = [("one group", 0.3, None), ("one group, tilts", 0.3, None), ("colours, tilts", 0.5, None),
          ("one group", 1.0, None), ("slack", 0.3, None), ("slack", 0.7, 0.3),
          ("first slack", 0.6, None), ("colours", 0.5, None), ("too many to unroll", 0.3, None)]


@pytest.mark.parametrize(("layout", "metallic", "level"), METALS)
def test_a_metals_lobe_is_its_twin(on_gl, layout, metallic, level):
    """As of one lobe; with the base colour at its fixed point, and its change with roughness in the slopes."""
    c = case(layout)
    c.at[..., 0] = np.float32((np.round(c.at[..., 0] * 31 * 15 + 0.5) - 0.5) / (31 * 15))  # between all tables' nodes
    fit, _ = on_gl(lambda d: evaluate(d, c.texels, "fit_one.kernel", c.at, 2, c.slack, level, metallic))
    twin, seen = Twin(c.texels, c.slack, level=level, metallic=metallic), known(c.texels)
    r = c.at[..., 0].ravel().astype(np.float64)
    a, s = twin.parts(r)
    _, own, information = twin.groups(a, s)
    got, power = fit.reshape(-1, 4)[seen], (twin.errors(a, s) ** 2).sum(-1)[seen]
    close(got[:, 0], power, 2e-3, 1e-3)

    def half(at: np.ndarray) -> np.ndarray:
        return np.asarray((twin.errors(*twin.parts(at, information), information) ** 2).sum(-1) / 2)

    def line(at: np.ndarray) -> np.ndarray:
        """s of the problem linear about the groups' base colours, with the same a: what Kaufman's derivatives are of.

        The groups' base colours change as they do in the true problem.
        """
        there = twin.parts(at, information)
        straight = there[1] + twin.by_layer(own) * (there[0] - a)
        off = twin.groups(*there)[1] - twin.groups(a, straight)[1]
        return np.asarray(straight - a * twin.by_layer(off))

    free = slope(lambda at: twin.errors(a, line(at), information, bounded=False), r)
    curvature = (free**2).sum(-1)[seen]
    close(got[:, 2], curvature, 5e-3, 1e-3)
    close(got[:, 1], -slope(half, r)[seen], 5e-3, np.maximum(2e-2 * np.sqrt(power * curvature), 1e-4))


def test_slope_of_a_single_group_is_the_residuals_own(on_gl):
    """Nothing is left out of the slope where there is but one group: central differences of the residual itself."""
    c = case("one group")
    fit, _ = on_gl(lambda d: evaluate(d, c.texels, "fit_one.kernel", c.at, 2))
    twin, seen = Twin(c.texels, 0.0), known(c.texels)
    r = c.at[..., 0].ravel().astype(np.float64)
    rho = twin.groups(*twin.parts(r))[1][:, 0]
    inside = seen & (rho > 0) & (rho < 1)
    assert inside.sum() > 60
    expected = -0.5 * slope(lambda at: (twin.errors(*twin.parts(at)) ** 2).sum(-1), r)
    power = (twin.errors(*twin.parts(r)) ** 2).sum(-1)
    close(fit.reshape(-1, 4)[inside, 1], expected[inside], 2e-3, 0.05 * power[inside])


# ---- two lobes


@dataclass(frozen=True)
class Pair:
    """What fit_two.glsl is to say: residual, gradient, weight, curvature."""

    residual: np.ndarray
    gradient: np.ndarray
    weight: np.ndarray
    curvature: np.ndarray
    error: np.ndarray


def pair_twin(twin: Twin, at: np.ndarray) -> Pair:
    """A Gauss-Newton step of the weight from the one given, and derivatives by the roughnesses about it."""
    r1, r2, w = at.reshape(-1, 3).astype(np.float64).T
    information = twin.groups(*twin.mixed(r1, r2, w))[2]

    def error(a: np.ndarray, b: np.ndarray, share: np.ndarray) -> np.ndarray:
        return twin.errors(*twin.mixed(a, b, share), information, bounded=False)

    here = error(r1, r2, w)
    by_w = slope(lambda x: error(r1, r2, x), w)
    by_r = [slope(lambda x: error(x, r2, w), r1), slope(lambda x: error(r1, x, w), r2)]
    uu = np.maximum((by_w**2).sum(-1), 1e-20)
    wanted = w - (here * by_w).sum(-1) / uu
    weight = np.clip(wanted, 0, 1)
    left = here + (weight - w)[:, None] * by_w
    gradient = np.stack([-(left * j).sum(-1) for j in by_r], -1)
    inside = weight == wanted
    flat = [j - np.where(inside, (j * by_w).sum(-1) / uu, 0)[:, None] * by_w for j in by_r]
    curvature = np.stack([(flat[0] ** 2).sum(-1), (flat[0] * flat[1]).sum(-1), (flat[1] ** 2).sum(-1)], -1)
    raw = np.stack([(j**2).sum(-1) for j in by_r], -1)
    return Pair((left**2).sum(-1), gradient, weight, curvature, raw)


NDFS = {"ggx": {"LOBES": "2"}, "beckmann": {"LOBES": "2", "NDF_BECKMANN": "1"}}


@pytest.mark.parametrize("ndf", NDFS)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_two_lobes_are_their_twin(on_gl, layout, ndf):
    c = case(layout)
    first, second = on_gl(lambda d: evaluate(d, c.texels, "fit_pair.kernel", c.at, 2, c.slack, **NDFS[ndf]))
    seen = known(c.texels)
    got, bend = first.reshape(-1, 4)[seen], second.reshape(-1, 4)[seen]
    want = pair_twin(Twin(c.texels, c.slack, ndf), c.at)
    residual, raw = want.residual[seen], want.error[seen]
    several = residual > 1e-3  # else the few observations fit exactly, and any weight does
    assert several.mean() > 0.75
    close(got[several, 0], residual[several], 3e-3, 1e-2)
    close(got[several, 3], want.weight[seen][several], 2e-3, 0.1)
    scale = np.sqrt(residual[:, None] * raw)
    close(got[several, 1:3], want.gradient[seen][several], 5e-3, np.maximum(0.1 * scale[several], 1e-4))
    of = np.stack([raw[:, 0], np.sqrt(raw[:, 0] * raw[:, 1]), raw[:, 1]], -1)
    close(bend[several, :3], want.curvature[seen][several], 5e-3, np.maximum(0.1 * of[several], 1e-4))
    assert ((got[:, 3] > 0) & (got[:, 3] < 1)).sum() > 20
    assert ((got[:, 3] == 0) | (got[:, 3] == 1)).sum() > 20


@pytest.mark.parametrize("ndf", NDFS)
def test_slope_of_two_lobes_is_the_residuals_own_at_the_best_weight(on_gl, ndf):
    """Variable projection: at the best weight the slope of what it leaves is that of the residual at fixed weight."""
    c = case("one group")
    twin, seen = Twin(c.texels, 0.0, ndf), known(c.texels)

    def run(at: np.ndarray) -> np.ndarray:
        return on_gl(lambda d: evaluate(d, c.texels, "fit_pair.kernel", at, 2, **NDFS[ndf]))[0].reshape(-1, 4)

    at = c.at.copy()
    at[..., 2] = run(at)[:, 3].reshape(at.shape[:2])
    got = run(at)
    r1, r2, _ = at.reshape(-1, 3).astype(np.float64).T

    def least(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Residual of the best of all weights."""
        (_, s1), (_, s2) = twin.parts(a), twin.parts(b)
        d, u = twin.f - s2, s1 - s2
        mean = [(twin.weight * x).sum(-1) / np.maximum(twin.weight.sum(-1), 1e-30) for x in (d, u)]
        d, u = d - mean[0][:, None], u - mean[1][:, None]
        best = np.clip((twin.weight * d * u).sum(-1) / np.maximum((twin.weight * u * u).sum(-1), 1e-30), 0, 1)
        return np.asarray((twin.weight * (d - best[:, None] * u) ** 2).sum(-1))

    power = least(r1, r2)
    use = seen & (power > 1e-3)
    assert use.sum() > 100
    close(got[use, 0], power[use], 1e-3, 1e-2)
    expected = np.stack([-0.5 * slope(lambda x: least(x, r2), r1), -0.5 * slope(lambda x: least(r1, x), r2)], -1)
    close(got[use, 1:3], expected[use], 5e-3, 0.1 * power[use, None])


# ---- digits near the solution


def test_one_lobe_keeps_its_digits_near_the_solution(on_gl):
    """On exact data the relative residual is below 1e-10, and 0.1 % beside the solution it is told to a tenth."""
    problem, texels = exact()
    truth = problem.truth.roughness
    twin = Twin(texels, 0.0)
    count = twin.good.astype(np.float64)
    at_truth = on_gl(lambda d: evaluate(d, texels, "fit_one.kernel", truth[..., None], 2))[0].reshape(-1, 4)
    assert np.quantile(at_truth[:, 0] / count, 0.99) < 1e-11
    assert (at_truth[:, 0] / count).max() < 1e-10
    beside = (truth * 1.001).astype(np.float32)
    got = on_gl(lambda d: evaluate(d, texels, "fit_one.kernel", beside[..., None], 2))[0].reshape(-1, 4)
    expected = (twin.errors(*twin.parts(beside.ravel().astype(np.float64))) ** 2).sum(-1)
    told = expected / count > 1e-9
    assert told.mean() > 0.5
    assert np.median(np.abs(got[told, 0] / expected[told] - 1)) < 0.02
    assert np.quantile(np.abs(got[told, 0] / expected[told] - 1), 0.95) < 0.1


def test_two_lobes_keep_their_digits_near_the_solution(on_gl):
    """Residuals that cancel to nothing stop the search where it stands: a quarter of all texels once failed so."""
    problem, texels = exact(model="two-lobe")
    truth = problem.truth
    twin = Twin(texels, 0.0)
    count = twin.good.astype(np.float64)

    def run(at: np.ndarray) -> np.ndarray:
        return on_gl(lambda d: evaluate(d, texels, "fit_pair.kernel", at, 2, LOBES="2"))[0].reshape(-1, 4)

    at = np.stack([truth.roughness, truth.roughness2, truth.weight], -1).astype(np.float32)
    there = run(at)[:, 0] / count
    assert np.quantile(there, 0.99) < 1e-11
    assert there.max() < 1e-10
    for which in (0, 1):
        beside = at.copy()
        beside[..., which] *= np.float32(1.002)
        got, want = run(beside), pair_twin(twin, beside).residual
        told = want / count > 1e-9
        assert told.mean() > 0.3
        assert np.median(np.abs(got[told, 0] / want[told] - 1)) < 0.02
        assert np.quantile(np.abs(got[told, 0] / want[told] - 1), 0.95) < 0.2
        assert (got[told, 0] > 0).all()


def test_a_base_colour_is_between_black_and_white(on_gl):
    """Twice as much light as white reflects is an error that no roughness takes away; nor less than none."""
    _, texels = exact(size=8)
    twin = Twin(texels, 0.0)
    a, s = twin.parts(np.full(64, 0.5))
    at = np.full((8, 8, 1), 0.5, np.float32)
    for rho, excess in ((2.0, 1.0), (-0.2, 0.2), (0.9, 0.0)):
        bright = with_values(texels, np.maximum(rho * a + s, 1e-3) if rho > 0 else s + rho * a)
        got = on_gl(lambda d, t=bright: evaluate(d, t, "fit_one.kernel", at, 2))[0].reshape(-1, 4)[:, 0]
        expected = (Twin(bright, 0.0).weight * (excess * a) ** 2).sum(-1)
        np.testing.assert_allclose(got, expected, rtol=1e-3, atol=1e-9)
