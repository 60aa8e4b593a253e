"""Measured materials: the networks, the published models, the fits and the judge, each against something else."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.change_records import PredictionError
from irpso_addon.core.data import F64, MaterialPrediction
from irpso_addon.core.shading import brdf
from irpso_addon.gpu.device.context import Device
from studies.stability.measured import fit, foreseen, merl, rig
from studies.stability.measured.judge import Judge, Judgement, Shown
from studies.stability.measured.recover import Principled, recover
from studies.stability.measured.run import Material

UP = np.array([[0.0, 0.0, 1.0]])
DATA = os.environ.get("IRPSO_MERL", "")


def directions(count: int, seed: int = 0) -> F64:
    """Unit vectors above the horizon."""
    v = np.random.default_rng(seed).standard_normal((count, 3))
    v[:, 2] = np.abs(v[:, 2]) + 0.05
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def tilted(degrees: float, turn: float = 0.0) -> F64:
    """A unit vector at so many degrees from the normal."""
    a, b = np.radians(degrees), np.radians(turn)
    return np.array([[np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)]])


@pytest.mark.skipif(not DATA, reason="IRPSO_MERL names no folder with the networks")
def test_networks_against_published_albedo() -> None:
    """Two matte materials: f pi is the albedo that Low et al. 2012 found, within 3 %."""
    fits = merl.fits(Path(DATA))["Low E2"]
    for network in merl.networks(Path(DATA)):
        if network.name in ("white-diffuse-bball", "white-paint"):
            ratio = network(UP, tilted(60)) * np.pi / fits[network.name].diffuse
            np.testing.assert_allclose(ratio, 1.0, atol=0.03)


def test_network_by_hand() -> None:
    """Layers written out with loops, on numbers of no meaning."""
    rng = np.random.default_rng(3)
    weights = tuple(rng.normal(0, 0.5, shape) for shape in ((6, 21), (21, 21), (21, 3)))
    biases = tuple(rng.normal(0, 0.2, n) for n in (21, 21, 3))
    network = merl.Network("none", weights, biases)
    L, V = tilted(50, 20), tilted(30, 140)
    at = list(np.concatenate(merl.half_difference(L, V), axis=-1)[0])
    for layer in range(3):
        at = [sum(a * w for a, w in zip(at, column, strict=True)) + b
              for column, b in zip(weights[layer].T, biases[layer], strict=True)]
        at = [max(a, 0.0) for a in at] if layer < 2 else [max(np.exp(a) - 1, 0.0) for a in at]
    np.testing.assert_allclose(network(L, V)[0], at, rtol=1e-12)
    assert not network(tilted(95), V).any() and not network(L, tilted(95)).any()


def test_half_difference_by_turning() -> None:
    """Turned by matrices, as Rusinkiewicz defines it: about z by -phi_h, then about y by -theta_h."""
    L, V = directions(50, 1), directions(50, 2)
    half, difference = merl.half_difference(L, V)
    for i in range(50):
        h = L[i] + V[i]
        h /= np.linalg.norm(h)
        phi, theta = np.arctan2(h[1], h[0]), np.arccos(h[2])
        z = np.array([[np.cos(phi), np.sin(phi), 0], [-np.sin(phi), np.cos(phi), 0], [0, 0, 1]])
        y = np.array([[np.cos(theta), 0, -np.sin(theta)], [0, 1, 0], [np.sin(theta), 0, np.cos(theta)]])
        np.testing.assert_allclose(half[i], z @ h, atol=1e-12)
        np.testing.assert_allclose(difference[i], y @ z @ L[i], atol=1e-12)


def test_cook_torrance_by_hand() -> None:
    """Head on, D = 1 / m^2 and F = ((n - 1) / (n + 1))^2; at the Brewster angle one polarisation is left."""
    low = merl.CookTorrance(np.full(3, 0.2), np.array([0.1, 0.2, 0.4]), 0.3, 1.5, False)
    head_on = 0.2 / np.pi + low.specular * 0.04 / (np.pi * 0.09)
    np.testing.assert_allclose(low(UP, UP)[0], head_on, rtol=1e-12)
    brewster = np.degrees(np.arctan(1.5))
    reflected = 0.5 * ((1.5**2 - 1) / (1.5**2 + 1)) ** 2
    value = 0.2 / np.pi + low.specular * reflected / (np.pi * 0.09 * np.cos(np.radians(brewster)) ** 2)
    np.testing.assert_allclose(low(tilted(brewster), tilted(brewster, 180))[0], value, rtol=1e-9)
    ngan = merl.CookTorrance(np.zeros(3), np.ones(3), 0.3, 0.05, True)
    np.testing.assert_allclose(ngan(UP, UP)[0], 0.05 / (np.pi**2 * 0.09), rtol=1e-12)
    # V-grooves: at 60 degrees, both on one side, h at 60 degrees too: G = 2 cos60 cos60 / 1.
    np.testing.assert_allclose(merl.v_grooves(*(np.array(c) for c in (0.5, 0.5, 0.5, 1.0))), 0.5)


@pytest.mark.parametrize("schlick", [False, True])
def test_cook_torrance_is_reciprocal(schlick: bool) -> None:
    of = merl.CookTorrance(np.full(3, 0.3), np.full(3, 0.5), 0.25, 0.1 if schlick else 1.7, schlick)
    L, V = directions(200, 4), directions(200, 5)
    np.testing.assert_allclose(of(L, V), of(V, L), rtol=1e-10)


def test_cook_torrance_energy() -> None:
    """Cook and Torrance's 1 / pi and a D that is not normalised: a mirror's lobe head on returns four times ks."""
    of = merl.CookTorrance(np.zeros(3), np.full(3, 0.25), 0.1, 1e6, False)
    assert albedo(of) == pytest.approx(1.0, abs=0.01)


def test_metal_loses_no_energy() -> None:
    """White metal: what the lobe loses between microfacets, multiple scattering returns; 1.5 % by its approximation."""
    for r in (0.3, 0.6, 0.9):
        white = fit.Fitted("metal", np.ones((1, 3)), np.array([r]), 0.0)
        assert albedo(white) == pytest.approx(1.0, abs=0.015)


def albedo(reflectance: rig.Reflectance) -> float:
    """What is reflected of light from the zenith, by the midpoint rule."""
    theta = (np.arange(4000) + 0.5) / 4000 * np.pi / 2
    L = np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], -1)
    f = reflectance(L, np.broadcast_to(UP, L.shape))[:, 0]
    return float((f * np.cos(theta) * np.sin(theta)).sum() * 2 * np.pi * (np.pi / 2) / 4000)


def test_one_lobe_is_the_products() -> None:
    """The fitted model in its own words, against core/shading/brdf.py."""
    base, L, V = np.array([[0.6, 0.3, 0.1]]), directions(200, 6), directions(200, 7)
    for r, level in ((0.2, 0.8), (0.5, 0.3), (0.9, 0.1)):
        fitted = fit.Fitted("one-lobe-specular", base, np.array([r, level]), 0.0)
        np.testing.assert_allclose(fitted(L, V), brdf.principled(base, r, L, V, rig.NORMAL, level), rtol=1e-5)


@pytest.mark.parametrize("loss", fit.LOSSES)
def test_every_loss_finds_exact_data(loss: str) -> None:
    """Where the model is right, losses agree."""
    truth = fit.Fitted("one-lobe-specular", np.array([[0.4, 0.2, 0.1]]), np.array([0.35, 0.6]), 0.0)
    of = spheres_samples(truth)
    found = fit.fit("one-lobe-specular", of, loss, 0.01)
    np.testing.assert_allclose(found.shared, truth.shared, atol=2e-3)
    np.testing.assert_allclose(found.by_channel, truth.by_channel, atol=2e-3)


def test_cook_torrance_is_found_again() -> None:
    truth = merl.CookTorrance(np.array([0.3, 0.2, 0.1]), np.array([0.2, 0.3, 0.4]), 0.25, 1.6, False)
    found = fit.fit("cook-torrance", spheres_samples(truth), "relative")
    L, V = directions(300, 8), directions(300, 9)
    np.testing.assert_allclose(found(L, V), truth(L, V), rtol=0.03)


def spheres_samples(truth: rig.Reflectance) -> fit.Samples:
    views = rig.views(rig.sphere(16), rig.CAMERAS, rig.lamps(6))
    return fit.samples(views, rig.observe(views, truth), rig.geometry(views).quality)


def test_judge() -> None:
    """Nothing off is 0; a tenth more light is 0.1 relative, and on grey what sRGB makes of it."""
    surface = rig.sphere(16)
    views = rig.views(surface, rig.CAMERAS[:1], rig.lamps(2))

    def grey(scale: float) -> Shown:
        return lambda v, m: np.full((int(m.sum()), 3), scale / np.pi)

    judge = Judge(views, grey(0.2), surface.covered, 1.0)
    assert judge(grey(0.2)).display == judge(grey(0.2)).relative == 0
    assert judge(grey(0.2)).as_predicted == PredictionError(0.0, 0.0)
    assert judge(grey(0.22)).relative == pytest.approx(0.1)
    # sRGB is about x^(1/2.4): 10 % more is 4 % of values that are .9 and less.
    assert 0.01 < judge(grey(0.22)).display < 0.04
    assert judge(grey(0.22)).as_predicted.relative_rms == pytest.approx(0.1)


def test_judge_sees_lightness() -> None:
    """All white for 18 % grey under one irradiance: L* 100 for 49.5 (CIE 15:2004)."""
    at = np.full((1, 1, 3), [0.0, 0.0, 1.0])
    view = rig.View(0, 0, at, at, np.full((1, 1), 2.0), np.ones((1, 1), bool), np.ones((1, 1)))
    judge = Judge([view], lambda v, m: np.full((1, 3), 0.09), np.ones((1, 1), bool), 1.0)
    shown = judge(lambda v, m: np.full((1, 3), 0.5)).as_predicted
    assert shown.lightness == pytest.approx(100 - 49.5, abs=0.05)
    assert shown.relative_rms == pytest.approx((1 - 0.18) / 0.18)


def test_product_recovers_what_it_can_make() -> None:
    """A Principled on the sphere: maps and one value are right, and relight as the truth."""
    truth = fit.Fitted("one-lobe-specular", np.array([[0.5, 0.3, 0.2]]), np.array([0.4, 0.5]), 0.0)
    surface = rig.sphere(24)
    seen = rig.geometry(rig.views(surface, rig.CAMERAS, rig.lamps(rig.LAMPS)))
    found = recover(Device(), seen, rig.observe(seen.views, truth), "one-lobe")
    one = found.uniform()
    assert float(one.roughness) == pytest.approx(0.4, abs=2e-3)
    np.testing.assert_allclose(one.base, [0.5, 0.3, 0.2], atol=2e-3)
    held_out = rig.views(surface, rig.HELD_OUT_CAMERA[None], rig.lamps(4, turn=1.3))
    judge = Judge(held_out, lambda v, m: truth(v.L[m], v.V[m]), (seen.quality > 0).sum(-1) >= 3, 1.0)
    assert judge(lambda v, m: found.maps.at(m)(v.L[m], v.V[m])).display < 2e-3


def test_auto_says_what_it_foresaw() -> None:
    """Metal that the model can make: ``auto`` takes it by prediction, and its numbers come with the maps."""
    truth = fit.Fitted("metallic", np.array([[0.5, 0.3, 0.2]]), np.array([0.4, 0.5, 0.6]), 0.0)
    seen = rig.geometry(rig.views(rig.sphere(24), rig.CAMERAS, rig.lamps(rig.LAMPS)))
    found = recover(Device(), seen, rig.observe(seen.views, truth), "auto", loss="auto")
    assert found.prediction is not None
    assert "metallic" in found.prediction.taken
    assert found.maps.model == "one-lobe-metallic"
    one = found.uniform()
    assert one.metallic == pytest.approx(0.6, abs=0.02)
    L, V = directions(100, 10), directions(100, 11)
    np.testing.assert_allclose(one(L, V), truth(L, V), rtol=0.1)


def test_foreseen_beside_the_truth() -> None:
    """Two materials of which one is foreseen rightly, and one taken where a smaller rung is better."""
    materials = [told("right", 0.1, 0.1, 0.2), told("wrong", 0.1, 0.3, 0.2)]
    ratios = [case.ratio("relative RMS of radiance") for case in foreseen.foreseen(materials, "auto")]
    np.testing.assert_allclose(ratios, [1.0, 3.0])
    beside = foreseen.beside(materials, lambda j: j.as_predicted.relative_rms, foreseen.smaller)
    np.testing.assert_allclose([case.ratio for case in beside], [0.5, 1.5])
    assert "| one value | 2 | 0 | 0 | 0 |" in foreseen.taken(materials)
    (_, rows), _ = foreseen.beside_rungs(materials)
    assert "wrong, sphere, no noise: 1.50 times" in [row[-1] for row in rows]
    assert "wrong on the sphere, no noise" in foreseen.said_of_ratios(materials)
    assert "1 of 2 by relative RMS error (wrong)" in foreseen.said_of_rungs(materials)


def told(name: str, predicted: float, true: float, lambert: float) -> Material:
    """A material of one scene, on which ``auto`` took one lobe; by relative RMS."""
    scene, nothing = "sphere, no noise", np.zeros(3)
    material = Material(name, "metal", merl.Network(name, (), ()), {})
    material.predictions[scene] = MaterialPrediction("lamps", "one value", {
        "lambert": PredictionError(lambert, 1.0), "one value": PredictionError(predicted, 1.0)})
    for what, error in (("auto", true), ("lambert", lambert)):
        material.errors[f"{scene}: {what}"] = Judgement(0.1, 0.1, PredictionError(error, 1.0))
    material.uniform[f"{scene}: auto"] = Principled("one-lobe", *[nothing] * 5)
    return material
