"""The whole pipeline on exact synthetic pictures (tests/support/synthetic.py): what was put in must come out.

Without noise the pictures obey the model to float32; a texel is matched to a pixel up to half a pixel away, so texels
near a border between materials may take the neighbour's: errors are told by quantiles over texels away from borders.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.core.data import Solution
from irpso_addon.core.shading import brdf, lights
from irpso_addon.gpu.observe import observation_atlas as gpu_atlas
from tests.support import synthetic as syn
from tests.support.shoots import METHODS, SIZE, errors, rig, run

# ---- recovery


@pytest.mark.parametrize("method", METHODS)
def test_exact_pictures_give_the_exact_maps(solved, method):
    """Roughness to 1e-5 in the median and 0.002 at 95 %, base colour to 1e-4 and 0.02."""
    found = errors(solved[method], syn.PATCHES)
    assert found.share > 0.99
    assert np.median(found.rough) < 1e-5
    assert np.quantile(found.rough, 0.95) < 0.002
    assert found.rough.max() < 0.1
    assert np.median(found.base) < 1e-4
    assert np.quantile(found.base, 0.95) < 0.02


def test_the_two_methods_agree(solved):
    a, b = solved["refined"].maps, solved["swarm"].maps
    np.testing.assert_array_equal(a.filled, b.filled)
    difference = np.abs(a.roughness - b.roughness)[a.coverage & ~a.filled]
    assert np.quantile(difference, 0.99) < 0.002
    assert difference.mean() < 5e-4


@pytest.mark.parametrize("method", METHODS)
def test_the_result_is_told_in_full(solved, patches, method):
    found = solved[method]
    maps = found.maps
    for name, shape in (("base_color", (SIZE, SIZE, 3)), ("roughness", (SIZE, SIZE)), ("confidence", (SIZE, SIZE)),
                        ("error", (SIZE, SIZE))):
        values = getattr(maps, name)
        assert values.shape == shape
        assert values.dtype == np.float32
        assert np.isfinite(values).all()
        assert values.min() >= 0
        assert values.max() <= 1
    assert maps.filled.dtype == maps.coverage.dtype == np.bool_
    assert maps.filled[~maps.coverage].all()
    assert not maps.confidence[maps.filled].any()
    assert found.texels["covered"] == maps.coverage.sum()
    assert found.texels["solved"] == (maps.coverage & ~maps.filled).sum()
    assert found.texels["solved"] + found.texels["filled"] == found.texels["covered"]
    assert set(found.seconds) == {"gbuffer", "observe", "cameras", "solve", "maps"}
    assert min(found.seconds.values()) > 0
    assert found.views_used == tuple(view.image.name for view in patches.scene.views)
    assert found.views_skipped == ()
    assert not found.cancelled
    assert found.residual < 0.005
    assert found.device["renderer"]
    assert found.model == {"Paint": "one-lobe"}
    assert "information criterion" in found.why["Paint"]


def test_the_coverage_is_the_uv_island(solved):
    at = (np.arange(SIZE) + 0.5) / SIZE
    inside = (at > syn.MARGIN) & (at < 1 - syn.MARGIN)
    np.testing.assert_array_equal(solved["refined"].maps.coverage, inside[:, None] & inside[None])


def test_padding_continues_the_island(solved):
    """Four texels beside the island hold about what its edge holds: a mip-map does not bleed."""
    maps = solved["refined"].maps
    first = int(np.flatnonzero(maps.coverage[SIZE // 4])[0])
    for row in (SIZE // 4, 3 * SIZE // 4):
        beside, edge = maps.roughness[row, :first], maps.roughness[row, first]
        assert np.abs(beside - edge).max() < 0.02


@pytest.mark.one_python
@pytest.mark.parametrize("size", [50, 100])
def test_sizes_that_are_no_power_of_two(patches, size):
    found = errors(run(patches, size=size), syn.PATCHES)
    assert found.share > 0.98
    assert np.median(found.rough) < 1e-5
    assert np.quantile(found.rough, 0.9) < 0.004
    assert np.median(found.base) < 1e-4


def smooth_truth() -> syn.Truth:
    return syn.Truth(
        base=lambda u, v: np.stack([0.2 + 0.6 * u, 0.3 + 0.3 * v, 0.5 + 0.2 * np.sin(6 * u)], -1),
        roughness=lambda u, v: 0.5 + 0.18 * np.sin(4 * u) * np.cos(5 * v))


def test_smooth_maps_come_out_smooth():
    """Gradients of 0.9 across the square: half a pixel's mismatch is 0.9 / 72 / 2 = 0.006, at most."""
    found = errors(run(syn.shoot(smooth_truth(), rig())), smooth_truth(), border=0)
    assert np.median(found.rough) < 0.0022
    assert np.quantile(found.rough, 0.95) < 0.007
    assert np.median(found.base) < 5e-4
    assert np.quantile(found.base, 0.95) < 0.002


# ---- brute force


def best_roughness(
    shoot: syn.Shoot, seen: dict[str, np.ndarray], texel: tuple[int, int]
) -> tuple[float, float]:
    """Dense float64 search at one texel: (best roughness, range of roughness within one unit of the likelihood).

    ``seen``: the points of the plane that each camera's pixels show.
    The same observations: in each view the pixel nearest to the texel's centre, the mean of its channels over its
    irradiance.  Errors count relative to the observation; the albedo is the least-squares one at each roughness.
    """
    world = (np.array(texel) + 0.5) / SIZE
    world = (world - syn.MARGIN) / (1 - 2 * syn.MARGIN) * 2 - 1
    centre = np.array([*world, 0.0])
    candidates = np.linspace(0.05, 1, 951)
    rows = []
    for view in shoot.scene.views:
        image, points = shoot.images[view.image.name].rgb, seen[view.camera.name]
        at = np.unravel_index(np.nanargmin(np.linalg.norm(points - centre, axis=-1)), points.shape[:2])
        P = points[at]
        N = syn.plane_normal(P)
        V = (view.camera.position - P) / np.linalg.norm(view.camera.position - P)
        L = view.lights[0].matrix[:3, 3] - P
        E = view.lights[0].power[0] * lights.light_irradiance(view.lights[0], P, N)
        L = L / np.linalg.norm(L)
        if E <= 0 or N @ L < 0.1:
            continue
        H = (L + V) / np.linalg.norm(L + V)
        rows.append((image[at].astype(float).mean() / E, N @ L, N @ V, V @ H, np.sum(np.cross(N, H) ** 2)))
    f, cos_l, cos_v, cos_vh, sin2h = (np.array(c)[:, None] for c in zip(*rows, strict=True))
    specular = brdf.specular_principled(candidates, sin2h, 0.0, cos_l, cos_v, cos_vh)
    diffuse = brdf.diffuse_principled(candidates, np.broadcast_to(cos_v, specular.shape))
    w = 1 / f**2
    rho = np.clip((w * diffuse * (f - specular)).sum(0) / (w * diffuse**2).sum(0), 0, 1)
    residual = (w * (f - specular - rho * diffuse) ** 2).sum(0)
    best = int(np.argmin(residual))
    variance = residual[best] / max(len(f) - 2, 1)
    near = candidates[residual - residual[best] < variance]
    return float(candidates[best]), float((near.max() - near.min()) / 2)


@pytest.mark.one_python
@pytest.mark.parametrize("method", METHODS)
def test_a_texel_is_what_a_dense_search_finds(method):
    """With 0.5 % noise, at 40 texels: within what the noise leaves open, a few thousandths of roughness.

    Neighbours and another weighting of the same data move an estimate, but not beyond two of its standard errors
    (0.004 where that is less, the step that materials make at a pixel).
    """
    noisy = syn.shoot(syn.PATCHES, rig(), noise=0.005)
    maps = run(noisy, method=method).maps
    rng = np.random.default_rng(8)
    texels = [tuple(t) for t in rng.integers(6, SIZE - 6, (60, 2)) if (np.abs(t - SIZE / 2 + 0.5) > 3).all()][:40]
    assert len(texels) > 30
    seen = {view.camera.name: syn.meet_plane(*syn.pixel_rays(view.camera, 72, 72)) for view in noisy.scene.views}
    dense = np.array([best_roughness(noisy, seen, texel) for texel in texels])
    got = np.array([maps.roughness[texel[1], texel[0]] for texel in texels])
    off = np.abs(got - dense[:, 0])
    assert np.median(off) < 0.002
    assert (off < 2 * dense[:, 1] + 0.004).mean() > 0.9
    assert off.max() < 0.03


@pytest.mark.one_python
@pytest.mark.parametrize("noise", [0.01, 0.04])
def test_the_error_map_tells_the_noise(noise):
    """The weighted relative residual of a texel is about the noise of its observations, here the same everywhere.

    Four numbers are fitted to 16 observations: the residual is sqrt(12 / 16) of the noise.
    """
    found = run(syn.shoot(syn.PATCHES, rig(), noise=noise))
    solved = found.maps.coverage & ~found.maps.filled
    assert 0.6 * noise < np.median(found.maps.error[solved]) < 1.1 * noise
    assert 0.6 * noise < found.residual < 1.3 * noise


def test_noise_lowers_confidence(solved):
    noisy = run(syn.shoot(syn.PATCHES, rig(), noise=0.05)).maps
    clean = solved["refined"].maps
    assert np.median(noisy.confidence[noisy.coverage]) < 0.9 * np.median(clean.confidence[clean.coverage])


# ---- which model


@pytest.mark.one_python
def test_auto_chooses_lambert_where_nothing_shines():
    dull = replace(syn.PATCHES, lobe=lambda u, v: np.zeros_like(u))
    found = run(syn.shoot(dull, rig()))
    assert found.model == {"Paint": "lambert"}
    assert "information criterion" in found.why["Paint"]
    solved = found.maps.coverage & ~found.maps.filled
    assert (found.maps.roughness[solved] == 1).all()
    off = errors(found, dull)
    assert np.median(off.base) < 1e-4
    assert np.quantile(off.base, 0.95) < 0.02


@pytest.mark.one_python
def test_each_material_gets_its_own_model():
    """Left half shines, right half does not."""
    mixed = replace(syn.PATCHES, lobe=lambda u, v: (np.asarray(u) < 0.5).astype(float))
    mesh = syn.plane_mesh(lambda u, v: (u > 0.5).astype(int), ("Gloss", "Chalk"))
    found = run(syn.shoot(mixed, rig(), mesh=mesh))
    assert found.model == {"Gloss": "one-lobe", "Chalk": "lambert"}
    assert set(found.why) == {"Gloss", "Chalk"}
    left = np.s_[4:-4, 4:SIZE // 2 - 3]
    right = np.s_[4:-4, SIZE // 2 + 3:-4]
    at = (np.arange(SIZE) + 0.5) / SIZE
    u, v = np.meshgrid(at, at)
    rough, base = np.abs(found.maps.roughness - mixed.roughness(u, v)), np.abs(found.maps.base_color - mixed.base(u, v))
    assert np.median(rough[left]) < 1e-5
    assert (found.maps.roughness[right] == 1).all()
    assert np.median(base[left]) < 1e-4
    assert np.median(base[right]) < 1e-4


@pytest.mark.parametrize("model", ["lambert", "one-lobe"])
def test_a_model_asked_for_is_taken(patches, model):
    found = run(patches, model=model)
    assert (found.model, found.why) == ({"Paint": model}, {"Paint": "chosen"})


# ---- the same bytes


def raw(solution: Solution) -> list[bytes]:
    maps = solution.maps
    return [a.tobytes() for a in (maps.base_color, maps.roughness, maps.confidence, maps.error, maps.filled)]


@pytest.mark.one_python
@pytest.mark.parametrize("method", METHODS)
def test_the_same_run_gives_the_same_bytes(patches, solved, method):
    assert raw(run(patches, method=method)) == raw(solved[method])


@pytest.mark.one_python
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("tile", [(64, 16), (24, 10)])
def test_tiles_do_not_change_a_byte(patches, solved, monkeypatch, method, tile):
    monkeypatch.setattr(gpu_atlas, "TILE", tile)
    assert raw(run(patches, method=method)) == raw(solved[method])


@pytest.mark.one_python
@pytest.mark.parametrize("method", METHODS)
def test_another_seed_changes_nothing_that_matters(patches, solved, method):
    other = run(patches, method=method, seed=12345).maps
    maps = solved[method].maps
    difference = np.abs(other.roughness - maps.roughness)[maps.coverage & ~maps.filled]
    assert np.quantile(difference, 0.98) < 0.001
    assert difference.max() < 0.1
    if method == "swarm":
        assert difference.any()  # else the seed does not arrive


@pytest.mark.one_python
def test_read_noise_below_zero(patches):
    """A quarter of the values are negative: nothing becomes NaN, and dark quarters are not lifted by a cut to 0."""
    rng = np.random.default_rng(3)
    seen = [image.rgb[image.coverage > 0] for image in patches.images.values()]
    noise = 0.5 * np.median(np.concatenate(seen))
    images = {name: replace(image, rgb=image.rgb + rng.normal(0, noise, image.rgb.shape).astype(np.float32))
              for name, image in patches.images.items()}
    assert np.mean([(image.rgb < 0).mean() for image in images.values()]) > 0.2
    found = run(replace(patches, images=images))
    for values in (found.maps.base_color, found.maps.roughness, found.maps.error, found.maps.base_sigma):
        assert np.isfinite(values).all()
    assert np.isfinite(found.residual)
    assert found.checks is not None
    assert all(np.isfinite([view.residual.gain, view.residual.spread]).all() for view in found.checks.views)
    assert np.median(errors(found, syn.PATCHES).rough) < 0.05  # 0.027; 0.034 where noise is cut to 0
