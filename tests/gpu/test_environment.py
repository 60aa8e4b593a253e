"""Light from all around on the device: against the twin in float64, and solved for from exact pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from irpso_addon.core.data import RadianceImage, SceneData, View
from irpso_addon.core.errors import BadInput
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading import environment
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.gbuffer.gbuffer import MeshBuffer
from irpso_addon.gpu.observe.observations import ObserveOptions, observe
from irpso_addon.solve import pipeline
from tests.support import skies
from tests.support import synthetic as syn
from tests.support.sky_shoot import shoot

SIZE = 48
DIRECTIONS = 128


def _white(view: View) -> RadianceImage:
    return RadianceImage(np.ones((SIZE, SIZE, 3), np.float32), np.ones((SIZE, SIZE), np.float32),
                         np.ones((SIZE, SIZE), bool))


def _observed(view: View, mesh, occluders=None, count: int = DIRECTIONS):
    """(irradiance, nodes (NODES, h, w, 4), position, normal) of a view's pixels."""
    scene = SceneData("sphere", mesh, np.zeros((0, 3, 3), np.float32) if occluders is None else occluders, (view,),
                      pixel_filter=0.01)

    def job():
        device = thread.device()
        with device.scope():
            seen = yield from observe(device, scene, MeshBuffer(device, mesh), _white,
                                      ObserveOptions(directions=count))
            camera = seen.cameras[0]
            held = camera.views[0].nodes
            nodes = device.read(held, (0, 0, *held.size))  # halves as floats
            parts = nodes.reshape(3, SIZE, 4, SIZE, 4).swapaxes(1, 2).reshape(12, SIZE, SIZE, 4)
            colour = device.read(camera.views[0].colour)
            return (1 / np.maximum(colour[..., :3], 1e-9), parts, device.read(camera.maps.position),
                    device.read(camera.maps.normal), colour[..., 3])

    return thread.run(job)


def test_nodes_and_irradiance_are_those_of_the_twin():
    turn = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    sky = skies.sky(128, turn, sun=300.0, window=8.0)
    mesh = syn.mesh_arrays(*syn.sphere(64, 32))
    cam = syn.camera((0, -4.0, 1.0), degrees=32)
    irradiance, nodes, position, normal, quality = _observed(View(Path("a.exr"), cam, (), environment=sky), mesh)
    light = environment.directions(sky, DIRECTIONS)
    good = np.argwhere((position[..., 3] > 0.5) & (quality > 0.1))
    worst = []
    for y, x in good[::17]:
        N = normal[y, x, :3].astype(np.float64)
        V = cam.position - position[y, x, :3]
        E, sent, _ = environment.node_values(light, N / np.linalg.norm(N), V / np.linalg.norm(V))
        # The sphere's own horizon is its facets' shadow: light from below a few degrees is cut softly there.
        assert np.allclose(irradiance[y, x], E, rtol=0.03)
        worst.append(np.abs(nodes[:, y, x, :3] * irradiance[y, x] / sent - 1).max(-1))
    worst = np.array(worst)
    assert len(worst) > 20
    assert np.quantile(worst, 0.9) < 0.03
    assert np.median(worst) < 0.004


def test_shadows_of_a_sky_are_soft():
    """A plate with a gap over the plane: what of the sky is seen through it and past its edges, ray by ray."""
    sky, mesh, high = skies.sky(128), syn.plane_mesh(), 0.6
    plate = np.concatenate([syn.quad([(x, -0.7, high), (x + 0.5, -0.7, high), (x + 0.5, 0.7, high), (x, 0.7, high)])
                            for x in (-0.7, 0.2)]).astype(np.float32)
    view = View(Path("a.exr"), syn.camera((0, -2.6, 0.5), degrees=44), (), environment=sky)
    irradiance, _, position, normal, quality = _observed(view, mesh, plate, environment.COUNT)
    at = (position[..., 3] > 0.5) & (quality > 0) & (np.abs(position[..., :2]) < 0.95).all(-1)
    P, N = position[at][:, :3].astype(np.float64), normal[at][:, :3].astype(np.float64)
    toward, solid = (a.reshape(-1, a.shape[-1]) for a in environment.texel_directions(*sky.radiance.shape[:2]))
    power = (sky.radiance * solid.reshape(len(sky.radiance), 1, 1)).reshape(-1, 3)
    power, toward = power[toward[:, 2] > 0], toward[toward[:, 2] > 0]
    crossing = P[:, None, :2] + toward[None, :, :2] * ((high - P[:, 2])[:, None] / toward[:, 2])[..., None]
    x, y = np.abs(crossing[..., 0]), np.abs(crossing[..., 1])
    hidden = (x > 0.2) & (x < 0.7) & (y < 0.7)
    want = (np.maximum(N @ toward.T, 0) * ~hidden) @ power
    assert len(P) > 200 and want[:, 0].min() < 0.7 * want[:, 0].max()
    off = np.abs(irradiance[at] / want - 1)
    assert off.mean() < 0.005  # 0.0044; hard shadows: 0.0078


# ---- solved for

def _errors(made: syn.Shoot, **settings: object) -> tuple[float, float]:
    """(median error of roughness, of base colour) away from the edges of the quarters."""
    solution = thread.run(lambda: pipeline.solve(made.scene, SolveSettings(size=32, **settings), made.read_image))
    at = (np.arange(32) + 0.5) / 32
    u, v = np.meshgrid(at, at)
    inner = solution.maps.coverage & ~solution.maps.filled & (np.abs(u - 0.5) > 0.06) & (np.abs(v - 0.5) > 0.06)
    rough = np.abs(solution.maps.roughness - made.truth.roughness(u, v))[inner]
    base = np.abs(solution.maps.base_color - made.truth.base(u, v))[inner]
    assert solution.texels["solved"] > 500
    return float(np.median(rough)), float(np.median(base))


def test_views_without_lamps_are_solved():
    sky = skies.sky(48, sun=60.0, width=0.12, window=8.0)
    made = shoot([View(Path(f"{n}.exr"), cam, (), environment=sky) for n, cam in enumerate(syn.cameras(6))])
    rough, base = _errors(made, model="one-lobe")
    assert rough < 0.02 and base < 0.01
    rough, base = _errors(made, model="auto")
    assert rough < 0.03 and base < 0.015


def test_lamps_and_the_world_count_together():
    sky = skies.sky(48, window=4.0)
    lamps, cams = syn.lamps(4), syn.cameras(2)
    views = [View(Path(f"{c}_{n}.exr"), cam, (lamp,), environment=sky)
             for c, cam in enumerate(cams) for n, lamp in enumerate(lamps)]
    rough, base = _errors(shoot(views), model="one-lobe-specular")
    assert rough < 0.02 and base < 0.01


def test_what_knows_lamps_alone_says_so():
    sky = skies.sky(16)
    views = [View(Path("a.exr"), syn.cameras(1)[0], (), environment=sky)]
    scene = SceneData("plane", syn.plane_mesh(), np.zeros((0, 3, 3), np.float32), tuple(views))
    for settings in ({"method": "paper"}, {"model": "two-lobe", "ndf": "beckmann"}):
        with pytest.raises(BadInput, match="works with lamps only"):
            thread.run(lambda settings=settings: pipeline.solve(scene, SolveSettings(**settings), _white))
