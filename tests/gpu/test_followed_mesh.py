"""The mesh of a scan follows its refined normals; one whose places are right stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.data import MeshArrays
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu.device import thread
from irpso_addon.solve import pipeline, refined_scene
from irpso_addon.solve.one_round import Outcome
from tests.support import shoots
from tests.support import synthetic as syn

QUICK = {"model": "one-lobe", "registration": "given", "indirect": "off", "normals": "auto", "size": 128}
PIXELS = (128, 128)
WAVE = np.array([11.0, 7.0])  # radians a metre, on a plane of 2 m
HEIGHT = 0.008  # half a pixel's width


def texture(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Spots of a few pixels in three colours."""
    spots = np.sin(60 * u + 9 * np.sin(8 * v)) * np.sin(56 * v)
    return 0.45 + 0.3 * spots[..., None] * np.array([1.0, 0.8, 0.5])


def false_waves(mesh: MeshArrays, places: bool) -> MeshArrays:
    """Its normals are those of waves that the plane does not have; ``places``: its vertices too."""
    x, y = mesh.positions[..., 0].astype(np.float64), mesh.positions[..., 1].astype(np.float64)
    phase = WAVE[0] * x + WAVE[1] * y
    rise = HEIGHT * np.cos(phase)
    normals = mesh.normals / mesh.normals[..., 2:] - np.stack([WAVE[0] * rise, WAVE[1] * rise, 0 * rise], -1)
    positions = mesh.positions.copy()
    if places:
        positions[..., 2] += HEIGHT * np.sin(phase)
    return replace(mesh, positions=positions, normals=(
        normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32))


@pytest.fixture(scope="module")
def pictures() -> syn.Shoot:
    truth = syn.Truth(base=texture, roughness=lambda u, v: np.full_like(np.asarray(u, np.float64), 0.45))
    return syn.shoot(truth, shoots.rig(3, 8), PIXELS, noise=0.005, samples=2)


def solved(pictures: syn.Shoot, places: bool) -> Outcome:
    scene = replace(pictures.scene, mesh=false_waves(pictures.scene.mesh, places))
    settings = SolveSettings(**{**shoots.AS_GIVEN, **QUICK})
    return thread.run(lambda: pipeline.outcome(scene, settings, pictures.read_image))


def test_the_mesh_of_a_scan_follows(pictures) -> None:
    """Its vertices come nearer to the plane; the scene that later rounds begin with keeps them."""
    found = solved(pictures, places=True)
    normals = found.solution.normals
    assert normals is not None and 0.3 * HEIGHT < 2 * normals.moved < HEIGHT  # the plane is 2 m wide
    assert any("followed" in line for line in found.solution.warnings)
    before, after = (float(scene.mesh.positions[..., 2].std()) for scene in (found.given, found.scene))
    assert before > 0.65 * HEIGHT and after < 0.5 * before


@pytest.mark.one_python
def test_normals_that_begin_near_those_of_fewer_texels_are_the_same(pictures, monkeypatch) -> None:
    """As from no tilts at all, but for a fiftieth of what the mesh's own are off by."""
    near = solved(pictures, places=True).solution.maps
    refined_normals = refined_scene.refined_normals
    monkeypatch.setattr(refined_scene, "refined_normals",
                        lambda *given, near=None, **named: refined_normals(*given, **named))
    far = solved(pictures, places=True).solution.maps
    assert near.normal is not None and far.normal is not None
    seen = near.coverage & ~near.filled
    apart = np.linalg.norm((near.normal - far.normal)[seen], axis=-1)
    assert 0 < apart.mean() < 0.02 * HEIGHT * np.linalg.norm(WAVE)


def test_a_mesh_whose_places_are_right_stays(pictures) -> None:
    found = solved(pictures, places=False)
    assert found.solution.normals is not None and found.solution.normals.moved == 0
    assert found.scene.mesh.positions is found.given.mesh.positions
    assert not any("followed" in line for line in found.solution.warnings)
