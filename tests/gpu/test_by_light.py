"""Base colours of a material whose dim places no model explains: what is lit well says more of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import product

import moderngl
import numpy as np
import pytest

from irpso_addon.core.change_records import PredictionError
from irpso_addon.core.data import Camera, Light, MaterialPrediction
from irpso_addon.core.evaluation import folds
from irpso_addon.core.evaluation.sampled_texels import SampledTexels, noise_by_light, predicted
from irpso_addon.core.shading.lights import light_irradiance
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.maps import albedo
from irpso_addon.gpu.maps.albedo import AlbedoSolver, Gloss
from irpso_addon.gpu.solve.model_prediction import Decision, ModelPrediction
from irpso_addon.gpu.solve.trial_runs import BY_LIGHT, TrialRuns
from tests.support import shoots
from tests.support import synthetic as syn
from tests.support import tilted_sphere as balls
from tests.support.shoots import half_again

BASE = np.array([0.5, 0.35, 0.2])
run = partial(shoots.run, size=32)
SAMPLER_2D = 0x8B5E  # GL_SAMPLER_2D
EVEN = replace(syn.PATCHES, base=lambda u, v: np.broadcast_to(BASE, (*np.shape(u), 3)))


def glow_of(L: np.ndarray, N: np.ndarray) -> np.ndarray:
    """Over Lambert's: a wall on one side sends light of low lamps on to the plane."""
    cos_l = np.clip((L * N).sum(-1), 0, 1)
    return np.asarray(1 + 0.5 * (1 - cos_l) * (L[..., 0] > 0))


def glowing(base: np.ndarray, rough: np.ndarray, L: np.ndarray, V: np.ndarray, N: np.ndarray) -> np.ndarray:
    return np.asarray(base / np.pi * glow_of(L, N)[..., None])


GLOWING = replace(EVEN, reflect=glowing)


def lamps() -> list[tuple[Camera, list[Light]]]:
    """One camera; the lamps stand 5 to 75 degrees off the plane's axis."""
    (camera,), views = syn.cameras(1), []
    for n in range(12):
        turn, tilt = 2.39996 * n, np.radians(5 + 70 * (n + 0.5) / 12)
        place = 3.1 * np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
        views.append((camera, [syn.lamp(place, name=f"Light {n}")]))
    return views


def expected(views: list[tuple[Camera, list[Light]]], power: float, size: int) -> np.ndarray:
    """(size, size, 3): what observations say of texels if they count by a power of their irradiance."""
    low, high = syn.MARGIN, 1 - syn.MARGIN
    x, y = np.meshgrid(*2 * [2 * ((np.arange(size) + 0.5) / size - low) / (high - low) - 1])
    points = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3)
    up = syn.plane_normal(points)
    total = weights = 0.0
    for _, (lamp,) in views:
        toward = lamp.matrix[:3, 3] - points
        weight = (light_irradiance(lamp, points, up) * lamp.power.mean()) ** power
        total += weight * glow_of(toward / np.linalg.norm(toward, axis=-1, keepdims=True), up)
        weights += weight
    return np.asarray((total / weights).reshape(size, size, 1) * BASE)


def decide_on(power: float, monkeypatch: pytest.MonkeyPatch, noise: float = 1.0) -> None:
    """Lambert's model is taken, and this power.  ``noise``: how much more of it base colours then have."""
    def decide(*_: object) -> Iterator[Decision]:
        yield from ()
        return Decision("lambert", "given", prediction=MaterialPrediction(
            "lamps", "lambert", {"lambert": PredictionError(0.1, 2.0)}, by_light=power, noise_by_light=noise))

    monkeypatch.setattr(ModelPrediction, "decide", decide)


@pytest.mark.parametrize("power", [1.0, 2.0])
def test_views_count_by_their_light(power: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The observations of a texel differ by up to a half; none loses its weight by that."""
    decide_on(power, monkeypatch)
    views = lamps()
    made = syn.shoot(GLOWING, views)
    found = run(made, model="auto")
    # A part that is solved again goes by the same power: prediction is not asked again.
    monkeypatch.setattr(ModelPrediction, "decide", None)
    for maps in (found.maps, run(half_again(made, found), model="auto").maps):
        own = maps.coverage & ~maps.filled
        off = np.abs(maps.base_color / expected(views, power, len(own)) - 1)[own]
        assert own.sum() > 0.7 * own.size
        assert np.median(off) < 0.003 and np.quantile(off, 0.95) < 0.02  # counted alike: 0.03 and more, in the mean


def test_most_pixels_may_be_dark(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of an object that shades most of itself: the typical radiance is 0 then."""
    decide_on(2.0, monkeypatch)
    views = lamps()
    made = syn.shoot(GLOWING, views)
    images = {}
    for name, image in made.images.items():
        lit = np.arange(image.rgb.shape[1]) < 0.4 * image.rgb.shape[1]
        images[name] = replace(image, rgb=image.rgb * lit[None, :, None])
    maps = run(replace(made, images=images), model="auto").maps
    own = maps.coverage & ~maps.filled & (maps.base_color.max(-1) > 0.1)
    off = np.abs(maps.base_color / expected(views, 2.0, len(own)) - 1)[own]
    assert own.sum() > 0.2 * own.size and np.median(off) < 0.003


def base_contest(sample: SampledTexels) -> TrialRuns:
    """Lambert's model was taken."""
    made = object.__new__(TrialRuns)
    made.observed, made.folds, made.trials = sample, folds.split(sample), {}
    made.judge = folds.Judge(sample, made.folds)
    made.lobes = {"lambert": [None] * len(made.folds.left_out)}
    made.judge.add("lambert", [predicted(sample, None, ~out) for out in made.folds.left_out])
    return made


def power_of(made: TrialRuns) -> float:
    steps = made._by_light("lambert")
    try:
        while True:
            next(steps)
    except StopIteration as stop:
        return float(stop.value)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_prediction_decides_by_which_power(seed: int) -> None:
    """Noise in proportion to the signal is alike under all lights, and what terminators show wrongly is not."""
    noisy, _ = balls.sphere(balls.principled(1.0), lamps=24, noise=0.1, seed=seed)
    assert power_of(base_contest(noisy.texels)) == 0.0
    dim = noisy.texels.irradiance.mean(-1, keepdims=True) < 0.4 * noisy.texels.irradiance.max()
    wrong = np.random.default_rng(seed).choice([0.7, 1.3], dim.shape)
    made = base_contest(replace(noisy.texels, reflected=np.where(dim, wrong, 1.0) * noisy.texels.reflected))
    before = made.judge.error("lambert")
    assert power_of(made) in BY_LIGHT
    assert made.judge.error("lambert").relative_rms < before.relative_rms


def spread(power: float, seed: int) -> tuple[np.ndarray, float]:
    """((lit texels,) base colour of the camera's views that one run of noise gives; the ratio that is stated)."""
    sample, _ = balls.sphere(balls.principled(1.0), lamps=12, texels=300)
    texels, rng = sample.texels, np.random.default_rng(seed)
    noisy = replace(texels, reflected=texels.reflected * (1 + 0.02 * rng.standard_normal(texels.reflected.shape)))
    shown = predicted(noisy, None, np.ones(len(texels.camera), bool), by_light=power)
    return shown[(texels.quality > 0).sum(1) >= 3, 0, 0], noise_by_light(noisy, power)


@pytest.mark.parametrize("power", [1.0, 2.0])
def test_fewer_observations_keep_more_of_the_noise(power: float) -> None:
    """Observations that count more than others are as many as fewer that count alike."""
    runs = {given: [spread(given, seed) for seed in range(40)] for given in (0.0, power)}
    alike, by_light = (np.stack([shown for shown, _ in runs[given]]).std(0) for given in (0.0, power))
    stated = runs[power][0][1]
    assert stated > 1.05 and runs[0.0][0][1] == pytest.approx(1.0, abs=1e-9)
    assert np.sqrt((by_light**2).mean() / (alike**2).mean()) == pytest.approx(stated, rel=0.04)


def plain(base: np.ndarray, rough: np.ndarray, L: np.ndarray, V: np.ndarray, N: np.ndarray) -> np.ndarray:
    return np.broadcast_to(base / np.pi, (*np.broadcast_shapes(base.shape[:-1], L.shape[:-1]), 3))


def ratio_of(views: list[tuple[Camera, list[Light]]], power: float) -> float:
    """Of standard errors of weighted means over the plane, by that power of the irradiance and of alike ones."""
    points = np.stack([*np.meshgrid(*2 * [np.linspace(-1, 1, 15)]), np.zeros((15, 15))], -1).reshape(-1, 3)
    up = syn.plane_normal(points)
    weight = np.stack([light_irradiance(lamp, points, up) for _, (lamp,) in views], 1) ** power
    return float(np.sqrt(np.mean(len(views) * (weight**2).sum(1) / weight.sum(1) ** 2)))


@pytest.mark.one_python
def test_maps_state_what_noise_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside observations that count alike; doubt of views that are far from the others adds noise of its own."""
    monkeypatch.setattr(albedo, "OUTLIER", 1e6)
    views, found = lamps(), []
    made = syn.shoot(replace(EVEN, reflect=plain), views, noise=0.03)
    for power in (0.0, 2.0):
        decide_on(power, monkeypatch, ratio_of(views, power))
        maps = run(made, model="auto").maps
        own = maps.coverage & ~maps.filled
        found.append((maps.base_color[own].std(0).mean(), np.sqrt(np.mean(maps.base_sigma[own] ** 2))))
    (spread_alike, stated_alike), (spread, stated) = found
    assert spread > 1.15 * spread_alike and stated / stated_alike == pytest.approx(spread / spread_alike, rel=0.05)


@pytest.mark.one_python
def test_prediction_says_how_much_noise_that_adds() -> None:
    made = syn.shoot(replace(GLOWING, base=lambda u, v: (0.6 + 0.8 * u)[..., None] * BASE), lamps(), noise=0.03)
    prediction = run(made, model="auto").predictions["Paint"]
    assert prediction.by_light > 0
    assert prediction.noise_by_light == pytest.approx(ratio_of(lamps(), prediction.by_light), rel=0.06)


def most_textures(device: Device) -> int:
    """Of a draw that adds views to base colours, whatever an object's materials have."""
    most = []
    with device.scope():
        whole = device.texture(1, 1, data=np.ones((1, 1, 4), np.float32))
        for level, metallic, coat, rough in product((None, whole), repeat=4):
            solver = AlbedoSolver(device, None, None, Gloss(whole, level, metallic, coat, rough, by_light=whole))
            program = device.programs.get("include/screen.vert", "maps/albedo_pixel.frag",
                                          {**solver.defines, "VIEWS": str(solver.at_once)})
            uniforms = [program[name] for name in program if isinstance(program[name], moderngl.Uniform)]
            most.append(sum(of.array_length for of in uniforms if of.gl_type == SAMPLER_2D))
    return max(most)


def test_no_draw_has_more_textures_than_opengl_promises(on_gl: Callable[..., int]) -> None:
    assert on_gl(most_textures) == 16  # a metal, a rough diffuse, a coat, and other levels
