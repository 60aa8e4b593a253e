"""Light from all around: the small form of ``python -m studies.environment``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.blender.oiio import ensure_openimageio
from irpso_addon.core.data import Environment
from irpso_addon.core.shading import environment
from studies.environment import converge, photographs, poor, radiance, shoot
from studies.environment.hdris import radiance as radiance_of
from studies.environment.recover import recover

pytest.importorskip("bpy")


@pytest.fixture(autouse=True)
def images():
    ensure_openimageio()


@pytest.mark.parametrize(("kinds", "most", "undivided"), [
    (("day", "room", "overcast"), 0.006, 0.02), (("clear", "studio"), 0.01, 0.019)])
def test_directions_that_divide_are_exact_where_lobes_are_sharp(monkeypatch, kinds, most, undivided):
    monkeypatch.setattr(converge, "KINDS", kinds)
    monkeypatch.setattr(converge, "PLACES", 12)
    monkeypatch.setattr(converge, "HEIGHT", 128)
    monkeypatch.setattr(converge, "SETTINGS", ((1024, False), (1024, True)))
    plain, divided = converge.convergence()
    rough = np.array(environment.NODE_ROUGHNESS)
    assert np.max(np.array(divided.errors)[rough >= 0.19]) < most
    whole, parts = np.array(plain.errors), np.array(divided.errors)
    assert whole[rough < 0.12].min() > 0.03 and parts[rough < 0.12].max() < 0.003  # 0.04 and 0.0018
    assert (whole > np.maximum(undivided, 2.5 * parts))[(rough > 0.15) & (rough < 0.25)].all()


@pytest.mark.parametrize("shape", radiance.SHAPES)
def test_radiance_is_that_of_cycles(shape):
    """An overcast sky, at which Cycles has little noise; docs/environment.md has the others."""
    rough, shiny = radiance.errors(shape, "overcast", (0.5, 0.2), 24, 2048, environment.COUNT)
    for error, most in ((rough, 0.006), (shiny, 0.02)):
        assert error.noise < 0.004
        assert error.middle < 0.004 and abs(error.mean) < 0.003
        assert error.rest < (most if shape == "sphere" else 2 * most)


def test_a_bottle_is_solved_without_any_lamp(tmp_path, monkeypatch):
    monkeypatch.setattr(shoot, "BOTTLE", replace(shoot.BOTTLE, pixels=64))
    monkeypatch.setattr(shoot, "CAMERAS", ((6, 0.2),))
    found, solution = recover(replace(shoot.RIGS[0], samples=128), tmp_path, 32, "one-lobe")
    assert found.albedo > 20 and found.median < 0.1
    assert solution.texels["solved"] > 0.9 * solution.texels["covered"]


LEVEL = photographs.Lamps(np.zeros((0, 3)), np.zeros((0, 3)), np.eye(3))  # whose camera looks along -Z, its up +Y


def test_a_world_of_lamps_lights_as_they_do():
    rng = np.random.default_rng(1)
    toward = rng.standard_normal((9, 3))
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    lamps = replace(LEVEL, toward=toward, irradiance=rng.uniform(1, 3, (9, 3)))
    weights = rng.uniform(0.2, 2, (9, 3))
    light = environment.directions(Environment("lamps", lamps.picture(weights).astype(np.float32), np.eye(3)))
    of = (light.toward @ toward.T).argmax(1)
    for n, expected in enumerate(lamps.irradiance * weights):
        power = light.power[of == n]
        middle = power.mean(1) @ light.toward[of == n]
        assert np.allclose(power.sum(0), expected, rtol=1e-4)
        assert np.degrees(np.arccos(np.clip(middle @ toward[n] / np.linalg.norm(middle), -1, 1))) < 0.02


@pytest.mark.parametrize(("turn", "at"), [
    (0.0, (0.3, 0.5, -0.9)), (np.pi, (-0.3, 0.5, 0.9)), (np.pi / 2, (-0.9, 0.5, -0.3))])
def test_lamps_weigh_what_an_environment_has_near_them(monkeypatch, turn, at):
    """The brighter of the room's two lamps, at (0.3, 0.9, 0.5) before it is turned."""
    monkeypatch.setattr(photographs, "HDRI_HEIGHT", 64)
    toward = np.concatenate([np.eye(3), -np.eye(3), [at]])
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    weights = replace(LEVEL, toward=toward).weights("room", turn)
    assert weights.mean(1).argmax() == len(toward) - 1
    unit, solid = environment.texel_directions(64, 128)
    whole = (radiance_of(unit, "room") * solid[..., None]).sum((0, 1))
    dense = all_over(400)
    assert np.allclose(replace(LEVEL, toward=dense).weights("room", turn).sum(0), whole, rtol=0.02)


def all_over(count):
    """So many, all over the sphere."""
    made = np.random.default_rng(0).standard_normal((count, 3))
    return made / np.linalg.norm(made, axis=1, keepdims=True)


def test_poor_pictures_of_a_world_keep_their_light_or_lose_it() -> None:
    directions, _ = environment.texel_directions(64, 128)
    world = Environment("day", radiance_of(directions, "day").astype(np.float32), np.eye(3))
    few = poor.coarser(world, 32)
    assert few.radiance.shape == (16, 32, 3)
    assert poor.light(few) == pytest.approx(poor.light(world), rel=1e-5)
    assert few.radiance.max() < 0.9 * world.radiance.max()  # the sun is spread
    flat = replace(world, radiance=np.full_like(world.radiance, 2.0))
    assert poor.light(flat) == pytest.approx(2 * 3 * 4 * np.pi, rel=1e-3)
    dim = poor.clipped(world, 0.1)
    assert dim.radiance.max() == pytest.approx(0.1 * world.radiance.max())
    assert 0.02 < 1 - poor.light(dim) / poor.light(world) < 0.5
