"""Method `paper`: its equations number by number, its fitness in float64, and what it makes of exact observations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.errors import BadInput, Cancelled
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading import brdf
from irpso_addon.core.shading.tables import principled_table
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.observe import observation_atlas
from irpso_addon.gpu.solve.paper_swarm import Limits, PaperMaps, PaperSwarm, Swarms, limits_for, spans
from irpso_addon.solve import one_round, pipeline
from tests.support import synthetic as syn
from tests.support import texel_problem as bench

FREE = Limits(constriction=1.0, velocity=1e30, bounded=False)  # equation (2) as printed
SIZE = 24
COUNT = 5  # observations of the random texels
OnGL = Callable[[Callable[[Device], Any]], Any]


# ---- texels


def random_arrays(seed: int = 3, lights: int = 2) -> dict[str, Any]:
    """Observations of (SIZE, SIZE) texels that no material explains: two cameras, some not observed, one corner not."""
    rng = np.random.default_rng(seed)
    shape = (SIZE, SIZE, COUNT)
    quality = rng.choice([0.0, 0.3, 1.0], shape, p=[0.2, 0.3, 0.5])
    quality[:5, :7] = 0.0
    lobes = np.stack([rng.uniform(0, 0.4, (*shape, lights)), rng.uniform(0, 0.05, (*shape, lights)),
                      rng.uniform(0.2, 1, (*shape, lights)), rng.uniform(0.01, 0.2, (*shape, lights))], axis=-1)
    camera = np.array([0, 0, 1, 1, 1])
    return {
        "rgb": rng.uniform(0.02, 0.5, (*shape, 3)).astype(np.float32), "quality": quality.astype(np.float32),
        "cos_v": rng.uniform(0.2, 1.0, (SIZE, SIZE, 2))[:, :, camera].astype(np.float32),
        "lobes": lobes.astype(np.float32), "groups": (0, 0, 1, 1, 1),
    }


def exact(**spec: Any) -> tuple[bench.Problem, dict[str, Any]]:
    """A problem that a material explains, and its arrays."""
    problem = bench.make(bench.Spec(**{"size": SIZE, "plane": True, "views": 12, **spec}))
    names = ("rgb", "quality", "cos_v", "lobes", "groups")
    return problem, {name: getattr(problem, name) for name in names}


class ColouredSource(observation_atlas.ArraySource):
    """Every observation is of one channel: view k's R, then G, then B, of one camera each."""

    def __init__(self, device: Device, arrays: dict[str, Any]) -> None:
        super().__init__(device, observation_atlas.ObservedTexels(**arrays), principled_table())
        channels = np.arange(COUNT) % 3
        blocks = self.blocks.reshape(COUNT, -1, SIZE, SIZE, 4)
        for k, channel in enumerate(channels):
            blocks[k, 0, ..., 0] = arrays["rgb"][:, :, k, channel]
            blocks[k, 0, ..., 3] += 2.0 * channel
        groups = tuple(3 * k + int(channel) for k, channel in enumerate(channels))
        self.layers = replace(self.layers, groups=groups, channels=3)


# ---- running


def settings(**chosen: Any) -> SolveSettings:
    return SolveSettings(**{"size": SIZE, "method": "paper", "particles": 8, "iterations": 100, **chosen})


def source_of(device: Device, arrays: dict[str, Any]) -> observation_atlas.ArraySource:
    return observation_atlas.ArraySource(device, observation_atlas.ObservedTexels(**arrays), principled_table())


def finish(steps: Any) -> Any:
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


def run(on_gl: OnGL, arrays: dict[str, Any], model: str = "one-lobe", tile: tuple[int, int] = observation_atlas.TILE,
        **chosen: Any) -> tuple[np.ndarray, np.ndarray, int]:
    """(best, more, evaluations) of a whole run."""

    def job(device: Device) -> tuple[np.ndarray, np.ndarray, int]:
        source = source_of(device, arrays)
        solver = PaperSwarm(device, source, settings(**chosen), model, tile=tile)
        maps: PaperMaps = finish(solver.solve())
        return device.read(maps.best).copy(), device.read(maps.more).copy(), maps.evaluations

    return on_gl(job)


def walk(on_gl: OnGL, arrays: dict[str, Any], passes: int, model: str = "one-lobe", limits: Limits | None = None,
         **chosen: Any) -> list[tuple[np.ndarray, np.ndarray]]:
    """(positions, bests) after each pass, the start included; positions and bests have 4 or 6 numbers."""

    def job(device: Device) -> list[tuple[np.ndarray, np.ndarray]]:
        swarms = Swarms(device, source_of(device, arrays), settings(**chosen), model, limits)
        for _ in swarms.gather((0, 0)):
            pass
        history = []
        for number in range(passes + 1):
            if number:
                swarms.step()
            best, more = (device.read(texture) for texture in swarms.best)
            bests = np.concatenate([best, more[..., :2]], axis=-1)[..., :4 if model == "one-lobe" else 6]
            history.append((swarms.positions(), bests))
        swarms.release()
        return history

    return on_gl(job)


# ---- the float64 twin of the fitness


def weights(f: np.ndarray, quality: np.ndarray) -> np.ndarray:
    """Relative to the observation where it is a highlight, else to the texel's typical one (docs/method.md)."""
    typical = np.full(f.shape[:2], np.inf)
    for number in range(4):
        w = quality / (1.0 if number == 0 else np.maximum(f, typical[..., None]))
        typical = np.maximum((w * f).sum(-1) / np.maximum(w.sum(-1), 1e-12), 1e-4)
    return quality / np.maximum(f, typical[..., None]) ** 2


def parts(arrays: dict[str, Any], r: np.ndarray, ndf: str) -> tuple[np.ndarray, np.ndarray]:
    """(diffuse factor, specular part) of every observation at the texels' roughness."""
    lobes, cos_v = arrays["lobes"].astype(np.float64), arrays["cos_v"].astype(np.float64)
    r = np.maximum(r.astype(np.float64), 0.05)[..., None]  # 0 where there is no swarm
    alpha2, cos_l = r[..., None] ** 4, lobes[..., 2]
    tan2_l, tan2_v = 1 / cos_l**2 - 1, 1 / cos_v[..., None] ** 2 - 1
    slopes = {"ggx": (brdf.D_ggx_spread, brdf.lambda_root),
              "beckmann": (brdf.D_beckmann_spread, brdf.lambda_root_beckmann)}
    distribution, root = slopes[ndf]
    value = distribution(alpha2, lobes[..., 0], lobes[..., 1]) / (root(alpha2, tan2_l) + root(alpha2, tan2_v))
    s = (lobes[..., 3] * value).sum(-1)
    if ndf == "beckmann":
        return np.full(s.shape, 1 / np.pi), s
    return brdf.diffuse_principled(r, cos_v), s * brdf.principled_energy(r, cos_v)[..., 0]


def fitness(arrays: dict[str, Any], best: np.ndarray, more: np.ndarray, ndf: str, coloured: bool) -> np.ndarray:
    """Weighted squared error of RGB over weighted squared signal, float64."""
    one, two = parts(arrays, best[..., 3], ndf), parts(arrays, more[..., 0], ndf)
    share = more[..., 1, None].astype(np.float64)
    a, s = (share * x + (1 - share) * y for x, y in zip(one, two, strict=True))
    rgb = arrays["rgb"].astype(np.float64)
    error = rgb - best[..., None, :3] * a[..., None] - s[..., None]
    counts = np.full((COUNT, 3), 1 / 3)
    f = rgb.mean(-1)
    if coloured:
        counts = np.eye(3)[np.arange(COUNT) % 3]
        f = (rgb * counts).sum(-1)
    w = weights(f, arrays["quality"].astype(np.float64))
    power = (w * (counts * rgb**2).sum(-1)).sum(-1)
    return (w * (counts * error**2).sum(-1)).sum(-1) / np.where(power > 0, power, 1)


@pytest.mark.parametrize(("model", "ndf"), [("one-lobe", "ggx"), ("two-lobe", "ggx"), ("two-lobe", "beckmann")])
@pytest.mark.parametrize("coloured", [False, True])
def test_the_fitness_of_the_best_is_that_of_the_model_in_float64(on_gl, model, ndf, coloured):
    arrays = random_arrays()

    def job(device: Device) -> tuple[np.ndarray, np.ndarray]:
        source = ColouredSource(device, arrays) if coloured else source_of(device, arrays)
        maps = finish(PaperSwarm(device, source, settings(iterations=20, ndf=ndf), model).solve())
        return device.read(maps.best).copy(), device.read(maps.more).copy()

    best, more = on_gl(job)
    has = (arrays["quality"] > 0).any(-1)
    assert not has[:5, :7].any()
    assert has.mean() > 0.9
    expected = fitness(arrays, best, more, ndf, coloured)
    np.testing.assert_allclose(more[..., 2][has], expected[has], rtol=2e-5, atol=2e-8)  # differences of 1 % in float32
    assert (best[~has] == 0).all()
    assert (more[~has][:, 2:] == 0).all()
    assert (more[has][:, 3] == 8 + 20).all()
    if model == "two-lobe":
        assert (best[has][:, 3] <= more[has][:, 0]).all()
    else:
        np.testing.assert_array_equal(more[has][:, 0], best[has][:, 3])
        assert (more[has][:, 1] == 1).all()


# ---- the equations


def moved_particle(before: np.ndarray, after: np.ndarray) -> int:
    changed = (before != after).any(axis=(1, 2, 3))
    assert changed.sum() == 1  # one particle a pass
    return int(np.argmax(changed))


@pytest.mark.parametrize("window", [3, 5])
@pytest.mark.parametrize("model", ["one-lobe", "two-lobe"])
def test_neighbours_pull_to_the_mean_of_the_windows_bests(on_gl, model, window):
    """c1 = c2 = 0, first move of a particle: x + c3 (mean - x), over the texels of the window that have a swarm."""
    arrays = random_arrays()
    has = (arrays["quality"] > 0).any(-1)
    (before, bests), (after, _) = walk(on_gl, arrays, 1, model, FREE, c1=0.0, c2=0.0, c3=0.4, window=window)
    particle = moved_particle(before, after)
    reach = window // 2
    padded = np.pad(bests.astype(np.float64), ((reach, reach), (reach, reach), (0, 0)))
    counted = np.pad(has.astype(np.float64), reach)
    places = [(y, x) for y in range(window) for x in range(window)]
    total = sum(padded[y:y + SIZE, x:x + SIZE] for y, x in places)
    number = sum(counted[y:y + SIZE, x:x + SIZE] for y, x in places)
    mean = total / np.maximum(number, 1)[..., None]
    expected = before[particle] + np.float32(0.4) * (mean - before[particle])
    np.testing.assert_allclose(after[particle][has], expected[has], atol=2e-6)
    assert (after[:, ~has] == 0).all()


def test_a_particle_is_pulled_by_a_random_share_to_the_texels_best(on_gl):
    """First move of a particle: it is its own best, so x + c2 R2 (g - x), R2 uniform and of each number by itself."""
    arrays = random_arrays()
    has = (arrays["quality"] > 0).any(-1)
    (before, bests), (after, _) = walk(on_gl, arrays, 1, limits=FREE, c1=1.5, c2=2.0, c3=0.0)
    particle = moved_particle(before, after)
    pull = (bests - before[particle])[has]
    far = (np.abs(pull) > 0.05).all(-1)
    share = ((after[particle] - before[particle])[has] / 2.0)[far] / pull[far]
    assert len(share) > 250
    assert share.min() > -1e-4
    assert share.max() < 1 + 1e-4
    np.testing.assert_allclose(share.mean(0), 0.5, atol=4 * 0.289 / np.sqrt(len(share)))
    np.testing.assert_allclose(np.corrcoef(share.T), np.eye(4), atol=4 / np.sqrt(len(share)))


def test_every_particle_moves_about_equally_often(on_gl):
    history = walk(on_gl, random_arrays(), 200, particles=4)
    moved = [moved_particle(a[0], b[0]) for a, b in pairwise(history)]
    counts = np.bincount(moved, minlength=4)
    assert (np.abs(counts - 50) < 4 * np.sqrt(200 * 0.25 * 0.75)).all()
    assert len(set(pairwise(moved))) == 16  # in no order


def test_the_equation_as_printed_diverges_and_the_constricted_one_stays(on_gl):
    arrays = random_arrays()
    low = np.array([0, 0, 0, 0.05], np.float32)
    printed = walk(on_gl, arrays, 1200, limits=FREE, c1=2.0, c2=2.0)[-1][0]
    has = (arrays["quality"] > 0).any(-1)
    assert np.median(np.abs(printed[:, has])) > 100
    for model, floor in (("one-lobe", low), ("two-lobe", np.array([*low, 0.05, 0], np.float32))):
        history = walk(on_gl, arrays, 800, model)
        for positions, _ in history[::20]:
            assert (positions[:, has] >= floor).all()
            assert (positions[:, has] <= 1).all()
        spread = [positions[:, has].std(axis=0).mean() for positions, _ in (history[0], history[-1])]
        assert spread[1] < 0.15 * spread[0]


def test_the_constriction_follows_the_pulls():
    """Clerc and Kennedy's 0.7298 for phi = 4.1, and a stable swarm for the strongest pulls that may be set."""
    assert limits_for(2.05, 2.05).constriction == pytest.approx(0.72984, abs=1e-5)
    assert limits_for(0.5, 0.5).constriction == pytest.approx(0.72984, abs=1e-5)
    assert limits_for(4.0, 4.0).constriction == pytest.approx(2 / (6 + np.sqrt(32)), abs=1e-7)


@pytest.mark.parametrize("model", ["one-lobe", "two-lobe"])
def test_compute_shaders_do_what_fragment_shaders_do(on_gl, monkeypatch, model):
    arrays = random_arrays()
    if on_gl(lambda device: device.ctx.version_code) < 430:
        pytest.skip("no compute shaders here")
    device = on_gl(lambda device: device)
    found = []
    for compute in (False, True):
        monkeypatch.setattr(device, "compute_faster", compute)
        found.append(walk(on_gl, arrays, 2, model))
    for drawn, computed in zip(*found, strict=True):
        np.testing.assert_allclose(computed[0], drawn[0], atol=1e-5)
        np.testing.assert_allclose(computed[1], drawn[1], atol=1e-5)


# ---- results


def test_it_converges_on_exact_observations(on_gl):
    """A plane, 12 views, roughness 0.3 to 0.7: most texels to 5e-4.  One in ten ends in a wrong valley: so does it.

    Of seeds 0 (this one) to 3: wrong 10.4 to 12.5 %; median 3.1e-4 to 3.7e-4; albedo 0.0095 to 0.0103; residual
    3.0e-4 to 3.1e-4.  The limits leave room for another driver's rounding, which is another draw of the same kind.
    """
    problem, arrays = exact()
    best, more, evaluations = run(on_gl, arrays, particles=16, iterations=1600)
    found = bench.Estimate(best[..., :3], best[..., 3])
    off = problem.roughness_error(found)
    assert np.median(off) < 5e-4
    assert (off > bench.FAILED).mean() < 0.13
    assert problem.score(found).albedo < 0.011
    assert np.sqrt(np.median(more[..., 2])) < 3.5e-4
    assert evaluations == SIZE * SIZE * (16 + 1600)


def test_two_lobes_explain_the_observations(on_gl):
    """24 views: it fits them to half a percent, whatever lobes it finds."""
    _, arrays = exact(model="two-lobe", plane=False, views=24)
    _, more, _ = run(on_gl, arrays, "two-lobe", particles=16, iterations=1600)
    assert np.sqrt(np.median(more[..., 2])) < 0.005


@pytest.mark.parametrize("model", ["one-lobe", "two-lobe"])
def test_a_seed_gives_the_same_bytes_and_another_one_others(on_gl, model):
    arrays = random_arrays()
    first, again, other = (run(on_gl, arrays, model, seed=seed) for seed in (5, 5, 6))
    assert first[0].tobytes() == again[0].tobytes()
    assert first[1].tobytes() == again[1].tobytes()
    assert first[0].tobytes() != other[0].tobytes()


def test_swarms_stop_below_the_threshold(on_gl):
    """A texel that is good enough keeps its best and is evaluated no more; the others go on as ever."""
    _, arrays = exact()
    threshold = np.float32(0.03)
    stopped, stopped_more, _ = run(on_gl, arrays, iterations=300, threshold=0.03, c3=0.0)
    free, free_more, _ = run(on_gl, arrays, iterations=300, c3=0.0)
    good = stopped_more[..., 2] <= threshold**2
    assert 0.1 < good.mean() < 0.99
    assert np.median(stopped_more[good][:, 3]) < 200
    np.testing.assert_array_equal(stopped_more[~good], free_more[~good])
    np.testing.assert_array_equal(stopped[~good], free[~good])
    assert (free_more[good][:, 2] <= stopped_more[good][:, 2]).all()
    assert (free_more[..., 3] == 300 + 8).all()


def test_a_run_ends_when_all_swarms_rest(on_gl):
    _, arrays = exact()
    _, more, evaluations = run(on_gl, arrays, iterations=1_000_000, threshold=0.5)
    assert (more[..., 2] <= 0.25).all()
    assert evaluations < SIZE * SIZE * 300


def test_tiles_do_not_show(on_gl):
    """Without neighbours' pull the tiles' layout changes no byte; with it, texels at seams fit as well as others."""
    _, arrays = exact()
    alone = run(on_gl, arrays, c3=0.0)
    together = run(on_gl, arrays, particles=16, iterations=800)
    tiled = run(on_gl, arrays, tile=(16, 10), c3=0.0)
    assert alone[0].tobytes() == tiled[0].tobytes()
    assert alone[1].tobytes() == tiled[1].tobytes()
    split = run(on_gl, arrays, tile=(16, 10), particles=16, iterations=800)
    assert (split[1][..., 3] == 16 + 800).all()
    whole_fit, split_fit = (np.sqrt(np.median(maps[1][..., 2])) for maps in (together, split))
    assert split_fit == pytest.approx(whole_fit, rel=0.25)


@pytest.mark.parametrize(("length", "tile", "halo"), [(128, 128, 4), (1024, 128, 4), (300, 128, 28), (100, 7, 4),
                                                      (64, 1, 4), (130, 128, 0)])
def test_spans_cover_each_texel_once_with_its_neighbours(length, tile, halo):
    kept = np.zeros(length, int)
    for start, low, high in spans(length, tile, halo):
        kept[low:high] += 1
        margin = min(halo, tile // 4)
        assert start == 0 or low - start >= margin
        assert high == length or start + tile - high >= margin
        assert high > low
    assert (kept == 1).all()


def test_a_stopped_run_gives_what_it_has(on_gl):
    arrays = random_arrays()

    def job(device: Device) -> tuple[bool, np.ndarray]:
        solver = PaperSwarm(device, source_of(device, arrays), settings(iterations=1_000_000), "one-lobe")
        steps = solver.solve()
        for _ in range(4):
            next(steps)
        try:
            steps.throw(Cancelled())
            maps = finish(steps)
        except StopIteration as end:
            maps = end.value
        return solver.cancelled, device.read(maps.more).copy()

    cancelled, more = on_gl(job)
    has = (arrays["quality"] > 0).any(-1)
    assert cancelled
    assert (more[has][:, 3] >= 8).all()
    assert more[..., 3].max() < 1_000_000


@pytest.mark.parametrize("model", ["auto", "one-lobe", "two-lobe"])
def test_through_the_pipeline(model):
    """Pictures in, maps out; the roughness of half the texels to 0.01 where one lobe is searched."""
    shoot = syn.shoot(syn.PATCHES, [(camera, [light]) for camera in syn.cameras(2) for light in syn.lamps(8)], (48, 48))
    chosen = settings(size=32, particles=16, iterations=600, model=model)
    solution = thread.run(lambda: pipeline.solve(shoot.scene, chosen, shoot.read_image))
    maps = solution.maps
    assert not maps.confidence.any() and one_round.NO_CONFIDENCE in solution.warnings
    # It cannot know where it is unsure.
    assert not any("highlight came near" in words or "observations" in words for words in solution.warnings)
    solved = maps.coverage & ~maps.filled
    assert solved.sum() > 0.9 * maps.coverage.sum()
    assert solution.model == {"Paint": "two-lobe" if model == "two-lobe" else "one-lobe"}
    at = (np.arange(32) + 0.5) / 32
    u, v = np.meshgrid(at, at)
    assert np.median(np.abs(maps.base_color - syn.PATCHES.base(u, v))[solved]) < 0.01
    if model == "two-lobe":
        assert maps.lobes is not None
        assert (maps.lobes[solved][:, 0] <= maps.lobes[solved][:, 1]).all()
    else:
        assert np.median(np.abs(maps.roughness - syn.PATCHES.roughness(u, v))[solved]) < 0.01


@pytest.mark.parametrize(("model", "chosen", "says"), [
    ("lambert", {}, "method paper: .* one-lobe and two-lobe, not lambert"),
    ("one-lobe-specular", {}, "not one-lobe-specular"),
    ("one-lobe-metallic", {}, "not one-lobe-metallic"),
    ("one-lobe", {"window": 4}, "window: 4 .* odd"),
])
def test_what_it_cannot_do_is_said(on_gl, model, chosen, says):
    with pytest.raises(BadInput, match=says):
        run(on_gl, random_arrays(), model, **chosen)
