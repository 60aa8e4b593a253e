"""The whole pipeline on exact synthetic pictures (tests/gpu/synthetic.py): what was put in must come out.

Without noise the pictures obey the model to float32; a texel is matched to a pixel up to half a pixel away, so texels
near a border between materials may take the neighbour's: errors are told by quantiles over texels away from borders.
"""

from __future__ import annotations

import gc
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
import pytest

from irpso_addon import pipeline
from irpso_addon.core import brdf, lights
from irpso_addon.core.data import Light, RadianceImage, Solution
from irpso_addon.core.errors import BadInput, Cancelled
from irpso_addon.core.job import Progress
from irpso_addon.core.params import SolveSettings
from irpso_addon.gpu import atlas as gpu_atlas
from irpso_addon.gpu import thread
from tests.gpu import synthetic as syn

SIZE = 64
METHODS = ("refined", "swarm")


def run(shoot: syn.Shoot, **settings: Any) -> Solution:
    chosen = SolveSettings(**{"size": SIZE, **settings})
    return thread.run(lambda: pipeline.solve(shoot.scene, chosen, shoot.read_image))


def rig(cameras: int = 2, lamps: int = 8, **settings: Any) -> list[tuple[Any, list[Light]]]:
    """Each camera with each lamp."""
    return [(camera, [light]) for camera in syn.cameras(cameras) for light in syn.lamps(lamps, **settings)]


@dataclass(frozen=True)
class Errors:
    """Absolute errors over solved texels away from the borders between quarters."""

    rough: np.ndarray
    base: np.ndarray
    share: float  # solved texels of the covered ones


def errors(solution: Solution, truth: syn.Truth, border: float = 2.5) -> Errors:
    maps = solution.maps
    size = maps.roughness.shape[0]
    at = (np.arange(size) + 0.5) / size
    u, v = np.meshgrid(at, at)
    away = (np.abs(u - 0.5) > border / size) & (np.abs(v - 0.5) > border / size)
    solved = maps.coverage & ~maps.filled
    ok = solved & away
    return Errors(np.abs(maps.roughness - truth.roughness(u, v))[ok],
                  np.abs(maps.base_color - truth.base(u, v)).max(-1)[ok], float(solved.sum() / maps.coverage.sum()))


@pytest.fixture(scope="module")
def patches() -> syn.Shoot:
    return syn.shoot(syn.PATCHES, rig())


@pytest.fixture(scope="module")
def solved(patches) -> dict[str, Solution]:
    return {method: run(patches, method=method) for method in METHODS}


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
    assert set(found.seconds) == {"gbuffer", "observe", "solve", "maps"}
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
    assert (found.model, found.why) == ({"Paint": model}, {"Paint": "asked for"})


# ---- the same bytes


def raw(solution: Solution) -> list[bytes]:
    maps = solution.maps
    return [a.tobytes() for a in (maps.base_color, maps.roughness, maps.confidence, maps.error, maps.filled)]


@pytest.mark.parametrize("method", METHODS)
def test_the_same_run_gives_the_same_bytes(patches, solved, method):
    assert raw(run(patches, method=method)) == raw(solved[method])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("tile", [(64, 16), (24, 10)])
def test_tiles_do_not_change_a_byte(patches, solved, monkeypatch, method, tile):
    monkeypatch.setattr(gpu_atlas, "TILE", tile)
    assert raw(run(patches, method=method)) == raw(solved[method])


@pytest.mark.parametrize("method", METHODS)
def test_another_seed_changes_nothing_that_matters(patches, solved, method):
    other = run(patches, method=method, seed=12345).maps
    maps = solved[method].maps
    difference = np.abs(other.roughness - maps.roughness)[maps.coverage & ~maps.filled]
    assert np.quantile(difference, 0.98) < 0.001
    assert difference.max() < 0.1
    if method == "swarm":
        assert difference.any()  # else the seed does not arrive


# ---- stopping


def stopped(shoot: syn.Shoot, stage: str, monkeypatch: pytest.MonkeyPatch, after: int = 3) -> Solution:
    """Stop at the ``after``-th step of a stage; the pipeline's own answer to Cancelled."""
    monkeypatch.setattr(gpu_atlas, "TILE", (16, 16))

    def job():
        steps = pipeline.solve(shoot.scene, SolveSettings(size=SIZE), shoot.read_image)
        seen = 0
        try:
            while True:
                step = next(steps)
                seen += step.stage == stage
                if seen == after:
                    seen += 1
                    step = steps.throw(Cancelled())
                yield step
        except StopIteration as stop:
            return stop.value

    return thread.run(job)


def test_a_stop_in_the_search_keeps_what_was_found(patches, monkeypatch):
    """Three tiles of sixteen are solved, the rest is filled from them."""
    found = stopped(patches, "solve", monkeypatch)
    assert found.cancelled
    maps = found.maps
    for values in (maps.base_color, maps.roughness, maps.confidence, maps.error):
        assert np.isfinite(values).all()
    rows, _ = np.nonzero(maps.coverage & ~maps.filled)
    assert 100 < len(rows) <= 3 * 16 * 16
    assert rows.max() < 32
    off = errors(found, syn.PATCHES)
    assert np.median(off.rough) < 1e-4
    assert np.median(off.base) < 0.05
    assert found.texels["solved"] + found.texels["filled"] == found.texels["covered"]


@pytest.mark.parametrize("after", [1, 17, 33])
def test_a_stop_at_any_step_of_the_search_gives_a_solution(patches, monkeypatch, after):
    found = stopped(patches, "solve", monkeypatch, after)
    assert found.cancelled
    assert np.isfinite(found.maps.base_color).all()
    assert found.texels["solved"] > 0


def test_a_stop_in_the_base_colour_keeps_the_roughness(patches, solved, monkeypatch):
    found = stopped(patches, "maps", monkeypatch)
    assert found.cancelled
    assert np.isfinite(found.maps.base_color).all()
    np.testing.assert_allclose(found.maps.roughness, solved["refined"].maps.roughness, atol=1e-6)


@pytest.mark.parametrize("stage", ["gbuffer", "observe"])
def test_a_stop_before_the_search_has_nothing_to_keep(patches, monkeypatch, stage):
    with pytest.raises(Cancelled):
        stopped(patches, stage, monkeypatch, after=1)


def test_progress_only_grows(patches):
    told: list[Progress] = []

    def job():
        steps = pipeline.solve(patches.scene, SolveSettings(size=SIZE), patches.read_image)
        while True:
            try:
                told.append(next(steps))
            except StopIteration as stop:
                return stop.value
            yield told[-1]

    thread.run(job)
    fractions = [step.fraction for step in told]
    assert fractions == sorted(fractions)
    assert 0 <= fractions[0]
    assert 0.99 < fractions[-1] <= 1
    stages = [step.stage for step in told]
    assert list(dict.fromkeys(stages)) == ["gbuffer", "observe", "solve", "maps"]


KINDS = (moderngl.Texture, moderngl.Framebuffer, moderngl.Buffer, moderngl.VertexArray, moderngl.Program)


def on_device() -> int:
    """Objects that Python still holds and that were not released, and those it dropped without release."""
    def job():
        yield Progress(0.0, "test")
        gc.collect()
        held = [thing for thing in gc.get_objects() if isinstance(thing, KINDS)]
        waiting = thread.device().ctx.objects
        alive = [thing.mglo for thing in held if thing.ctx is thread.device().ctx] + list(waiting)
        return sum(not isinstance(mglo, moderngl.InvalidObject) for mglo in alive)

    return thread.run(job)


def test_nothing_is_left_on_the_device(patches):
    """Whether it ends well, is stopped or fails; programs stay, and so they are built before."""
    run(patches)
    before = on_device()
    for _ in range(2):
        run(patches)
        assert on_device() == before
    with pytest.raises(BadInput):
        run(turned_away(patches, len(patches.scene.views)))
    assert on_device() == before


def test_a_stop_leaves_nothing_on_the_device(patches, monkeypatch):
    stopped(patches, "solve", monkeypatch)
    before = on_device()
    stopped(patches, "solve", monkeypatch)
    assert on_device() == before
    with pytest.raises(Cancelled):
        stopped(patches, "observe", monkeypatch)
    assert on_device() == before


# ---- what cannot be used, and what must be said


def turned_away(shoot: syn.Shoot, count: int) -> syn.Shoot:
    """The last ``count`` views look at the sky."""
    views = list(shoot.scene.views)
    for i in range(len(views) - count, len(views)):
        camera = views[i].camera
        away = syn.camera(camera.position, 2 * camera.position, name="away")
        views[i] = replace(views[i], camera=away)
    return replace(shoot, scene=replace(shoot.scene, views=tuple(views)))


def test_views_that_see_nothing_are_skipped_and_named(patches):
    found = run(turned_away(patches, 2))
    names = [view.image.name for view in patches.scene.views]
    assert found.views_used == tuple(names[:-2])
    assert [name for name, _ in found.views_skipped] == names[-2:]
    assert all("no usable pixel" in why for _, why in found.views_skipped)
    assert np.median(errors(found, syn.PATCHES).rough) < 1e-5


def test_no_view_that_sees_anything_is_an_error(patches):
    with pytest.raises(BadInput, match=r"view_00\.exr: no usable pixel"):
        run(turned_away(patches, len(patches.scene.views)))


def test_masked_and_clipped_pixels_say_nothing(patches):
    """A stripe of each picture is nonsense: clipped in half of the views, masked in the others."""
    images = {}
    for n, (name, image) in enumerate(patches.images.items()):
        rgb, coverage, valid = image.rgb.copy(), image.coverage.copy(), image.valid.copy()
        start = (11 * n) % 60
        rgb[start:start + 8] = 7.0
        if n % 2:
            coverage[start:start + 8] = 0
        else:
            valid[start:start + 8] = False
        images[name] = RadianceImage(rgb, coverage, valid)
    found = errors(run(replace(patches, images=images)), syn.PATCHES)
    assert found.share > 0.99
    assert np.median(found.rough) < 1e-5
    assert np.quantile(found.rough, 0.95) < 0.005
    assert np.median(found.base) < 1e-4


def test_overlapping_uvs_are_named(patches):
    mesh = patches.scene.mesh
    uvs = mesh.uvs.copy()
    uvs[: len(uvs) // 2] = uvs[len(uvs) // 2:]
    found = run(replace(patches, scene=replace(patches.scene, mesh=replace(mesh, uvs=uvs))))
    assert any("Subject" in w and "overlapping UVs" in w for w in found.warnings)


def test_uvs_outside_the_square_are_named(patches):
    mesh = patches.scene.mesh
    uvs = mesh.uvs.copy()
    uvs[: len(uvs) // 4, :, 0] += 1
    found = run(replace(patches, scene=replace(patches.scene, mesh=replace(mesh, uvs=uvs))))
    assert any("25.0 % of its faces lie outside" in w for w in found.warnings)


def test_a_clean_solve_warns_of_nothing(solved):
    assert solved["refined"].warnings == ()


def test_what_no_view_sees_is_filled_and_said(patches):
    """The last quarter of the plane is turned away from all cameras: taken off the pictures, kept in the mesh."""
    mesh = patches.scene.mesh
    positions = mesh.positions.copy()
    hidden = len(positions) // 4
    positions[:hidden, :, 2] -= 5  # far below: the cameras' frames do not reach it
    positions[:hidden, :, 0] -= 40
    moved = replace(mesh, positions=positions)
    found = run(replace(patches, scene=replace(patches.scene, mesh=moved)))
    assert any("seen lit by no view" in w for w in found.warnings)
    assert found.texels["filled"] > 0.2 * found.texels["covered"]
    assert np.isfinite(found.maps.base_color).all()


def test_too_few_views_are_said(patches):
    few = replace(patches, scene=replace(patches.scene, views=patches.scene.views[:2]))
    found = run(few)
    assert any("fewer than 3 good observations" in w for w in found.warnings)
    assert np.isfinite(found.maps.roughness).all()
    assert (found.maps.confidence < 0.5).mean() > 0.9


# ---- every kind of lamp, camera and view


def check(shoot: syn.Shoot, rough: float = 1e-5, base: float = 1e-4, tail: float = 0.005, **settings: Any) -> Solution:
    found = run(shoot, **settings)
    off = errors(found, shoot.truth)
    assert off.share > 0.98
    assert found.model == {"Paint": "one-lobe"}
    assert np.median(off.rough) < rough
    assert np.quantile(off.rough, 0.9) < tail
    assert np.median(off.base) < base
    return found


def test_lamps_of_colour():
    """All lamps (1, .6, .2): the base colour is what is under white light."""
    check(syn.shoot(syn.PATCHES, rig(power=(100.0, 60.0, 20.0))))


def test_lamps_of_many_colours():
    lamps = [replace(light, power=100 * np.roll([1.0, 0.6, 0.2], i)) for i, light in enumerate(syn.lamps(8))]
    check(syn.shoot(syn.PATCHES, [(c, [light]) for c in syn.cameras(2) for light in lamps]))


def test_lamps_of_pure_colours():
    """Red, green and blue lamps in turn: a view tells of one channel only."""
    lamps = [replace(light, power=100 * np.eye(3)[i % 3]) for i, light in enumerate(syn.lamps(12))]
    check(syn.shoot(syn.PATCHES, [(c, [light]) for c in syn.cameras(2) for light in lamps]), tail=0.02)


def test_two_lamps_in_one_view():
    lamps = syn.lamps(8)
    check(syn.shoot(syn.PATCHES, [(c, [lamps[i], lamps[(i + 3) % 8]]) for c in syn.cameras(2) for i in range(8)]))


def test_two_lamps_of_different_colour_in_one_view():
    lamps = [replace(light, power=100 * np.roll([1.0, 0.5, 0.2], i)) for i, light in enumerate(syn.lamps(8))]
    check(syn.shoot(syn.PATCHES, [(c, [lamps[i], lamps[(i + 4) % 8]]) for c in syn.cameras(2) for i in range(8)]))


def test_views_with_one_lamp_and_with_three():
    lamps = syn.lamps(8)
    views = [(c, lamps[i:i + 1] if i % 2 else [lamps[i], lamps[i - 3], lamps[i - 5]])
             for c in syn.cameras(2) for i in range(8)]
    check(syn.shoot(syn.PATCHES, views))


def of_kind(kind: str, count: int, **settings: Any) -> list[Light]:
    return [syn.lamp(light.matrix[:3, 3], kind=kind, name=light.name, **settings) for light in syn.lamps(count)]


@pytest.mark.parametrize(("kind", "settings"), [
    ("SUN", {"power": (3.0, 2.5, 2.0)}),
    ("SPOT", {"spot_angle": 1.2, "spot_blend": 0.5}),
    ("POINT", {"radius": 0.01}),
])
def test_lamps_without_a_size(kind, settings):
    """A radius of 1 cm at 3 m is 0.2 degrees: much narrower than any lobe here."""
    loose = 5e-4 if "radius" in settings else 1e-5
    check(syn.shoot(syn.PATCHES, [(c, [lamp]) for c in syn.cameras(2) for lamp in of_kind(kind, 8, **settings)],
                    (40, 40)), size=40,
          rough=loose, base=10 * loose)


@pytest.mark.parametrize(("kind", "settings"), [
    ("AREA", {"size": (0.4, 0.4)}),
    ("AREA", {"shape": "DISK", "size": (0.3, 0.3)}),
    ("POINT", {"radius": 0.15}),
    ("SUN", {"radius": np.radians(3)}),
])
def test_lamps_with_a_size(kind, settings):
    """The mean of the lobe over the emitter by the two-point rule: 0.0008 of roughness; one point has 0.003."""
    lamps = of_kind(kind, 8, **settings)
    check(syn.shoot(syn.PATCHES, [(c, [lamp]) for c in syn.cameras(2) for lamp in lamps], (32, 32)), size=32,
          rough=1.5e-3, base=5e-4, tail=0.006)


def test_orthographic_cameras():
    cameras = syn.cameras(2, width=2.3)
    check(syn.shoot(syn.PATCHES, [(c, [light]) for c in cameras for light in syn.lamps(8)]))


def test_pictures_that_are_not_square():
    cameras = syn.cameras(2, aspect=1.5, degrees=40.0, shift=(0.1, -0.05))
    check(syn.shoot(syn.PATCHES, [(c, [light]) for c in cameras for light in syn.lamps(8)], (102, 68)))


def test_cameras_with_pictures_of_two_sizes():
    """The same camera, photographed at two resolutions."""
    camera = syn.cameras(1)[0]
    small = syn.shoot(syn.PATCHES, [(camera, [light]) for light in syn.lamps(8)], (60, 60))
    large = syn.shoot(syn.PATCHES, [(camera, [light]) for light in syn.lamps(8)[:4]], (90, 90))
    views = [replace(view, image=Path("large_" + view.image.name)) for view in large.scene.views]
    images = small.images | {"large_" + name: image for name, image in large.images.items()}
    both = syn.Shoot(replace(small.scene, views=small.scene.views + tuple(views)), images, syn.PATCHES)
    check(both)


def test_a_single_camera():
    check(syn.shoot(syn.PATCHES, rig(cameras=1, lamps=9)))


def test_a_pixel_is_the_mean_over_its_square():
    """Pictures of 25 samples a pixel on rolling normals: half the error of taking a pixel for its centre."""
    shoot = syn.shoot(syn.PATCHES, rig(), (48, 48), samples=5)
    aware = errors(run(shoot), syn.PATCHES)
    point = errors(run(replace(shoot, scene=replace(shoot.scene, pixel_filter=0.01))), syn.PATCHES)
    assert aware.share > 0.9  # less the rim, which only edge pixels show
    assert np.median(aware.rough) < 0.0012
    assert np.quantile(aware.rough, 0.9) < 0.007
    assert np.median(aware.base) < 8e-4
    assert np.median(aware.rough) < 0.65 * np.median(point.rough)


TURN = np.linalg.qr(np.array([[0.9, 0.3, -0.2], [-0.4, 0.8, 0.5], [0.3, -0.35, 0.9]]))[0]


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize(("scale", "offset"), [(1, (3, -2, 5)), (1e-3, (0, 0, 0)), (1e3, (0, 0, 0)),
                                               (1, (800, -400, 500))])
def test_place_and_size_of_the_scene_do_not_matter(scale, offset, orthographic):
    """A millimetre, a kilometre, a kilometre away (where float32 has 6e-5 m left: 1e-4 of roughness)."""
    cameras = syn.cameras(2, width=2.3 if orthographic else None)
    shoot = syn.shoot(syn.PATCHES, [(c, [light]) for c in cameras for light in syn.lamps(8)])
    if orthographic:  # metres per image: part of the projection
        projection = np.diag([1 / scale, 1 / scale, 1, 1])
        views = tuple(replace(v, camera=replace(v.camera, projection=v.camera.projection @ projection))
                      for v in shoot.scene.views)
        shoot = replace(shoot, scene=replace(shoot.scene, views=views))
    check(syn.moved(shoot, scale, TURN * np.sign(np.linalg.det(TURN)), offset), rough=2e-4)


def test_more_views_than_the_kernel_keeps():
    check(syn.shoot(syn.PATCHES, rig(cameras=6, lamps=13), (48, 48)), size=48)


def test_shadows_do_not_darken_the_paint():
    """Two boxes over the plane: what one lamp does not reach, others show.  Under them nothing may be seen."""
    blocks = [((-0.5, -0.4, 0.2), (-0.1, 0.3, 0.5)), ((0.35, -0.6, 0.05), (0.55, 0.7, 0.25))]
    shoot = syn.shoot(syn.PATCHES, rig(cameras=4, lamps=8), blocks=blocks)
    dark = np.mean([(image.rgb[image.coverage > 0] == 0).mean() for image in shoot.images.values()])
    assert dark > 0.05
    off = errors(run(shoot), syn.PATCHES)
    assert off.share > 0.9
    assert np.median(off.rough) < 1e-5
    assert np.quantile(off.rough, 0.95) < 0.02
    assert np.median(off.base) < 1e-4
    assert np.quantile(off.base, 0.95) < 0.03


def test_one_view_per_camera_under_many_lamps():
    """All lamps stay on and only the camera moves, as in a room: highlights wander over the surface none the less."""
    lamps = syn.lamps(8)
    found = run(syn.shoot(syn.PATCHES, [(camera, lamps) for camera in syn.cameras(10)], (56, 56)))
    assert found.model == {"Paint": "one-lobe"}
    off = errors(found, syn.PATCHES)
    assert np.median(off.rough) < 0.01
    assert np.median(off.base) < 0.003


def test_slots_of_one_material_decide_together():
    """A material may sit in two slots.  A corner that shows no highlight does not take it from the rest."""
    mesh = syn.plane_mesh(lambda u, v: (u > 0.9) & (v > 0.9), ("Paint", "Paint"))
    dull_corner = replace(syn.PATCHES, lobe=lambda u, v: 1.0 - ((np.asarray(u) > 0.9) & (np.asarray(v) > 0.9)))
    found = run(syn.shoot(dull_corner, rig(), mesh=mesh))
    assert found.model == {"Paint": "one-lobe"}
    assert np.median(errors(found, syn.PATCHES).rough) < 1e-5


def test_more_material_slots_than_an_int_has_bits():
    """Forty materials, the right half of them dull."""
    names = tuple(f"Material {i}" for i in range(40))
    mesh = syn.plane_mesh(lambda u, v: np.minimum((u * 40).astype(int), 39), names)
    mixed = replace(syn.PATCHES, lobe=lambda u, v: (np.asarray(u) < 0.5).astype(float))
    found = run(syn.shoot(mixed, rig(), mesh=mesh))
    # The mesh has fewer columns of cells than materials: some slots have no face.
    assert {found.model[name] for name in names[4:18] if name in found.model} == {"one-lobe"}
    assert {found.model[name] for name in names[22:36] if name in found.model} == {"lambert"}
    at = (np.arange(SIZE) + 0.5) / SIZE
    base = np.abs(found.maps.base_color - mixed.base(*np.meshgrid(at, at))).max(-1)
    assert np.median(base[4:-4, 6:SIZE // 2 - 3]) < 1e-4
    assert np.median(base[4:-4, SIZE // 2 + 3:-6]) < 1e-4


def test_a_material_of_no_colour_and_a_mirror_like_one():
    """Black, white, smooth and fully rough quarters."""
    hard = syn.Truth(base=syn.quarters([(0.01, 0.01, 0.01), (0.95, 0.95, 0.95), (0.9, 0.1, 0.02), (0.3, 0.3, 0.3)]),
                     roughness=syn.quarters([0.5, 0.35, 0.85, 0.2]))
    found = run(syn.shoot(hard, rig(cameras=2, lamps=12)))
    off = errors(found, hard)
    assert np.median(off.rough) < 1e-4
    assert np.median(off.base) < 5e-4
    assert np.isfinite(found.maps.base_color).all()


def test_a_shadow_in_a_picture_that_the_scene_does_not_explain(patches):
    """A dark band over one view (something unmodelled): the robust base colour stays within 0.02."""
    images = dict(patches.images)
    name = patches.scene.views[4].image.name
    rgb = images[name].rgb.copy()
    rgb[20:50] *= 0.3
    images[name] = replace(images[name], rgb=rgb)
    off = errors(run(replace(patches, images=images)), syn.PATCHES)
    assert np.median(off.base) < 0.005
    assert np.quantile(off.base, 0.9) < 0.03
