"""Normals that are a little off: what a tilt explains of a texel's observations says nothing of its roughness."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.data import Light
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading import brdf
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.observe import observation_atlas
from irpso_addon.gpu.observe.observation_atlas import CAMERA_SLACK
from irpso_addon.gpu.solve import neighbours, tilt_size
from irpso_addon.gpu.solve.solver import Solver
from irpso_addon.gpu.solve.texel_records import SolvedTexels
from irpso_addon.gpu.solve.tilt_size import TRIED, likeliest, tilt_fits
from tests.support import shoots
from tests.support import synthetic as syn
from tests.support.texels import Texels, Twin, finish, known_roughly, random_texels, with_values

MESH = syn.plane_normal
WAVES = 4.0  # radians a metre


@dataclass(frozen=True)
class Found:
    """How right maps are."""

    error: float  # mean, of roughness
    wrong: float  # share of the confident texels that are off by more than 0.1
    held: float  # share of 90 % intervals that hold the truth


def beside_their_cameras() -> list[tuple[Any, list[Light]]]:
    """Lamps that make no highlight: half vectors are 25 degrees and more from the plane's normal."""
    rig = []
    for i, camera in enumerate(syn.cameras(3)):
        for k in range(8):
            tilt = np.radians(30 + 5 * k)
            turn = np.arctan2(camera.position[1], camera.position[0]) + np.radians(20 * k - 70)
            place = 3.1 * np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
            rig.append((camera, [syn.lamp(place, name=f"Light {i} {k}")]))
    return rig


def solved(patch: pytest.MonkeyPatch, slope: float, tilts: bool) -> Found:
    """Pictures with 0.2 % noise of a surface with waves of this slope that the mesh lacks."""
    def wavy(points: np.ndarray) -> np.ndarray:
        x, y = points[..., 0], points[..., 1]
        normal = MESH(points) + slope * np.stack([np.sin(WAVES * x + 2 * y), np.cos(WAVES * y - x), 0 * x], -1)
        return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))

    with patch.context() as there:
        there.setattr(syn, "plane_normal", wavy)
        shoot = syn.shoot(syn.PATCHES, beside_their_cameras(), (96, 96), noise=0.002)
    with patch.context() as without:
        if not tilts:
            without.setattr(observation_atlas, "Tilts", lambda *_: None)
        maps = shoots.run(shoot, model="one-lobe", registration="given", indirect="off").maps
    at = (np.arange(shoots.SIZE) + 0.5) / shoots.SIZE
    u, v = np.meshgrid(at, at)
    inner = (np.abs(u - 0.5) > 0.04) & (np.abs(v - 0.5) > 0.04) & maps.coverage & ~maps.filled
    off = np.abs(maps.roughness - shoot.truth.roughness(u, v))[inner]
    sure = maps.confidence[inner] > 0.5
    assert sure.mean() > 0.5
    return Found(float(off.mean()), float((off[sure] > 0.1).mean()),
                 float((off < 1.645 * maps.roughness_sigma[inner]).mean()))


@pytest.mark.one_python
def test_normals_that_are_off_are_not_taken_for_roughness(monkeypatch) -> None:
    """Waves of a quarter of a degree: found are 0.0130 with tilts and 0.0201 without."""
    with_tilts, without = (solved(monkeypatch, 0.005, tilts) for tilts in (True, False))
    assert with_tilts.error < 0.75 * without.error
    assert with_tilts.wrong < 0.002 < without.wrong
    assert with_tilts.held > without.held + 0.05


@pytest.mark.one_python
def test_where_normals_are_right_little_is_lost(monkeypatch) -> None:
    """Found are 0.0071 and 0.0068."""
    with_tilts, without = (solved(monkeypatch, 0.0, tilts) for tilts in (True, False))
    assert with_tilts.error < 1.1 * without.error
    assert 0.93 < with_tilts.held < 0.98


def test_errors_are_told_without_tilts(on_gl) -> None:
    """Whether a texel's roughness is its own or that of its neighbours."""
    texels = known_roughly(random_texels((0,) * 10, size=32))

    def solve(device: Device) -> tuple[SolvedTexels, SolvedTexels]:
        source = texels.source(device)
        solver = Solver(device, source, SolveSettings(size=32, loss="squares"))
        searched = finish(solver.searched())
        found = tuple(maps.read(device) for maps in (
            solver.alone(searched), finish(solver.among_neighbours(searched))))
        for thing in (solver, source):
            thing.release()
        return found

    def scoped(device: Device) -> tuple[SolvedTexels, SolvedTexels]:
        with device.scope():
            return solve(device)

    alone, among = on_gl(scoped)
    some = alone.solved & (alone.observations >= 4)
    for name, tolerance in (("residual", 0.1), ("lambert_residual", 1e-4)):
        one, other = (np.median(getattr(found, name)[some]) for found in (alone, among))
        assert one == pytest.approx(other, rel=tolerance)


def test_two_lamps_a_camera_show_the_noise(monkeypatch) -> None:
    """Tilts explain most of what two observations of a group differ by: less than one degree of freedom is left."""
    rig = []
    for i, camera in enumerate(syn.cameras(3)):
        for turn in (0.3 + 0.4 * i, 0.3 + 0.4 * i + np.pi):
            place = 3.1 * np.array([np.sin(np.pi / 3) * np.cos(turn), np.sin(np.pi / 3) * np.sin(turn), 0.5])
            rig.append((camera, [syn.lamp(place, name=f"Light {i} {turn:.1f}")]))
    shoot = syn.shoot(syn.PATCHES, rig, (96, 96), noise=0.003)
    found = []
    original = neighbours.noise_map

    def noise_map(*given: Any) -> tuple[Any, float]:
        found.append(original(*given)[1])
        return original(*given)

    monkeypatch.setattr(neighbours, "noise_map", noise_map)
    maps = shoots.run(shoot, model="one-lobe", registration="given", indirect="off").maps
    assert 0.001 < np.sqrt(found[-1]) < 0.01  # unknown it would be 0.05
    solved = maps.coverage & ~maps.filled
    assert (maps.confidence[solved] > 0.5).mean() > 0.25


def two_lamps(cameras: int, tilt: float, noise: float = 0.004, size: int = 48) -> tuple[Texels, np.ndarray]:
    """Texels that each camera sees under two lamps on their two sides, and their roughness (h, w).

    They scatter light as under tilted normals, another in each camera; ``tilt``: standard deviation, radians.
    """
    rng = np.random.default_rng(4)
    groups = tuple(n // 2 for n in range(2 * cameras))
    texels = random_texels(groups, lights=1, spread=0.0, size=size)
    shape = texels.quality.shape
    up, turn = np.radians(rng.uniform(30, 85, (len(groups), 1))), rng.uniform(0, 2 * np.pi, (cameras, 1))
    turn = (turn + np.array([0, np.pi])).reshape(-1, 1)
    toward = np.stack([np.sin(up) * np.cos(turn), np.sin(up) * np.sin(turn), np.cos(up)], -1)[:, 0]
    normal = np.broadcast_to([0.0, 0.0, 1.0], (*shape[:2], 3))
    lift, side = np.radians(rng.uniform(0, 60, cameras))[list(groups)], rng.uniform(0, 2 * np.pi, cameras)[list(groups)]
    view = np.stack([np.sin(lift) * np.cos(side), np.sin(lift) * np.sin(side), np.cos(lift)], -1)
    half = (toward + view) / np.linalg.norm(toward + view, axis=-1, keepdims=True)
    cos_l, cos_v, cos_vh = toward[:, 2], view[:, 2], (view * half).sum(-1)
    lobe = np.stack([1 - half[:, 2]**2, 0 * cos_l, cos_l, brdf.F_dielectric(cos_vh) / (2 * cos_l * cos_v)], -1)
    texels = replace(
        texels, quality=np.ones(shape), cos_v=np.broadcast_to(cos_v, shape), edge=None, normal=normal,
        lobes=np.broadcast_to(lobe[:, None], (*shape, 1, 4)),
        lamps=np.concatenate([toward, np.zeros((len(groups), 1))], -1)[:, None])
    truth = rng.uniform(0.2, 0.7, shape[:2])
    a, lit = Twin(texels, 0.0).parts(truth.ravel())
    diffuse = rng.uniform(0.2, 0.7, (truth.size, 1)) * a
    diffuse *= 1 + CAMERA_SLACK * rng.standard_normal((truth.size, cameras))[:, list(groups)]
    slopes = toward[:, :2] / cos_l[:, None]
    tilts = tilt * rng.standard_normal((truth.size, cameras, 2))[:, list(groups)]
    f = diffuse * (1 + (slopes * tilts).sum(-1)) + lit
    return with_values(texels, f * (1 + noise * rng.standard_normal(f.shape))), truth


@pytest.mark.parametrize(("of_noise", "expected"), [(0.0, 0.1), (1.5, 1.0)])
def test_the_size_of_tilts_is_that_of_what_observations_differ_by(on_gl, of_noise, expected) -> None:
    """Right normals and two lamps a camera: most of what observations say of roughness was taken for tilts.

    Found are errors of 0.0154 where tilts are as usual, and 0.0112 where they are as small as they seem to be.
    """
    texels, truth = two_lamps(3, of_noise * 0.004)

    def solve(device: Device) -> tuple[np.ndarray, list[float]]:
        with device.scope():
            source, errors = texels.source(device), []
            assert source.tilts is not None
            source.camera_slack = CAMERA_SLACK
            solver = Solver(device, source, SolveSettings(size=48, loss="squares"))
            fits = finish(tilt_fits(solver, np.ones(truth.shape, bool)))
            for deviation in (1.0, expected):
                source.tilts = replace(source.tilts, deviation=deviation)
                found = solver.alone(finish(solver.searched())).read(device)
                errors.append(float(np.abs(found.roughness - truth).mean()))
            solver.release()
            return fits, errors

    fits, errors = on_gl(solve)
    assert likeliest(fits) == expected
    if expected < 1:
        assert errors[1] < 0.8 * errors[0]


def test_how_far_tilts_widen_what_is_expected(on_gl) -> None:
    """As the determinant of the covariance that they make, in float64."""
    texels = known_roughly(random_texels((0, 0, 0, 1, 1, 1, 1), size=16))

    def fit(device: Device) -> np.ndarray:
        with device.scope():
            solver = Solver(device, texels.source(device), SolveSettings(size=16, loss="squares"))
            fits = finish(tilt_fits(solver, np.ones((16, 16), bool)))
            solver.release()
            return np.asarray(fits)

    fits, twin = on_gl(fit), Twin(texels, 0.0)
    some = twin.good >= 4
    for k, deviation in enumerate(TRIED):
        expected = sum(np.linalg.slogdet(np.eye(change.shape[1]) + deviation**2 * np.einsum(
            "tki,tli->tkl", change, change))[1] for change in twin.changes)
        np.testing.assert_allclose(fits[some, k, 2], expected[some], rtol=2e-3, atol=2e-3)
    np.testing.assert_array_equal(fits[some, 0, 3], (twin.good - twin.groups_seen)[some])


@pytest.mark.one_python
def test_a_solve_goes_by_how_large_tilts_seem_to_be(monkeypatch) -> None:
    """Three cameras, four lamps each, right normals: tilts as usual cost 0.13 nats a degree of freedom.

    Where that is too dear, maps are as without tilts: roughness errors of 0.0033; usual ones leave 0.0041.
    """
    rig = []
    for i, camera in enumerate(syn.cameras(3)):
        for turn in 0.3 + 0.4 * i + np.pi / 2 * np.arange(4):
            place = 3.1 * np.array([np.sin(np.pi / 3) * np.cos(turn), np.sin(np.pi / 3) * np.sin(turn), 0.5])
            rig.append((camera, [syn.lamp(place, name=f"Light {i} {turn:.1f}")]))
    shoot = syn.shoot(syn.PATCHES, rig, (96, 96), noise=0.003)
    found = {}
    for dear in (0.1, 0.2):
        monkeypatch.setattr(tilt_size, "DEAR", dear)
        maps = shoots.run(shoot, model="one-lobe", registration="given", indirect="off").maps
        at = (np.arange(shoots.SIZE) + 0.5) / shoots.SIZE
        off = np.abs(maps.roughness - shoot.truth.roughness(*np.meshgrid(at, at)))
        found[dear] = float(off[maps.coverage & ~maps.filled].mean())
    assert found[0.1] < 0.9 * found[0.2]
