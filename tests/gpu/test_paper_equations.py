"""Method `paper`: its equations number by number, and its fitness in float64."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.shading import brdf
from irpso_addon.core.shading.tables import principled_table
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.observe import observation_atlas
from irpso_addon.gpu.solve.paper_swarm import Limits, PaperSwarm, Swarms, limits_for
from tests.support.paper_runs import COUNT, SIZE, OnGL, finish, random_arrays, settings, source_of

FREE = Limits(constriction=1.0, velocity=1e30, bounded=False)  # equation (2) as printed


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


# ---- the fitness


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
    slopes = {"ggx": (brdf.D_ggx_disc, brdf.lambda_root),
              "beckmann": (brdf.D_beckmann_disc, brdf.lambda_root_beckmann)}
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


@pytest.mark.one_python
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
