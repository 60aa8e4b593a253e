"""Materials that are in part metals: roughness and base colour from observations of which everything is known."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from irpso_addon.core.change_records import PredictionError
from irpso_addon.core.data import JointPrior, MaterialPrediction, Region, Solution
from irpso_addon.core.errors import BadInput
from irpso_addon.core.maps import stride
from irpso_addon.core.params import SolveSettings
from irpso_addon.core.shading import brdf
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.observe import observation_atlas
from irpso_addon.gpu.solve.metal_ladder import seems_metal
from irpso_addon.gpu.solve.paint_beside_metal import metal_of, parts_of, unexplained
from irpso_addon.gpu.solve.prediction_trials import UNIFORM_METAL
from irpso_addon.gpu.solve.solver import Solver
from irpso_addon.gpu.solve.texel_records import SolvedTexels
from tests.support import shoots
from tests.support import synthetic as syn
from tests.support.texels import Texels, as_metal, by_channel, exact, finish

SIZE = 32
solve = partial(shoots.run, size=SIZE)


def solved(on_gl: Any, texels: Texels, metallic: float, level: float | None = None, joint: JointPrior | None = None,
           **chosen: Any) -> tuple[np.ndarray, np.ndarray]:
    """(roughness (h, w), base colour (h, w, 3)) of one lobe at a Metallic that is given."""
    shape = texels.quality.shape[:2]

    def run(device: Device) -> tuple[np.ndarray, np.ndarray]:
        solver = Solver(device, texels.source(device), SolveSettings(size=max(16, shape[0]), **chosen))
        solver.use_metallic(metallic)
        if level is not None:
            solver.use_level(np.full(shape, level, np.float32))
        solver.joint = joint
        maps = finish(solver.solve())
        base = finish(solver.albedo(maps.roughness))
        found = device.read(maps.roughness)[..., 0].copy(), device.read(base)[..., :3].copy()
        solver.use_level(None)
        for thing in (maps.roughness, maps.detail, base, solver, solver.source):
            thing.release()
        return found

    return on_gl(run)


@pytest.mark.parametrize("separate", [False, True], ids=["grey", "channels"])
@pytest.mark.parametrize(("metallic", "level", "cameras"), [(0.3, None, 1), (0.7, 0.3, 3), (1.0, None, 1)])
def test_roughness_and_base_colour_come_out(on_gl, metallic, level, cameras, separate):
    """Of strong colours; where the mean of the channels is observed, their multiple scattering is approximated."""
    problem, _ = exact(cameras=cameras)
    texels = as_metal(problem, metallic, 0.5 if level is None else level)
    rough, base = solved(on_gl, by_channel(texels) if separate else texels, metallic, level)
    off, colour = np.abs(rough - problem.truth.roughness), np.abs(base - problem.truth.base).max(-1)
    assert np.quantile(off, 0.99) < (1e-5 if separate else 5e-4)
    assert np.quantile(colour, 0.99) < (1e-4 if separate else 1e-3)


@pytest.mark.one_python
@pytest.mark.parametrize("level", [None, 0.8])
def test_outliers_cost_a_metal_little(on_gl, level):
    """A tenth of shadows taken for lit: disbelieved, they leave a third of the error at the most."""
    problem, _ = exact()
    texels = as_metal(problem, 0.4, 0.5 if level is None else level)
    rng = np.random.default_rng(5)
    shadow = np.where(rng.random(texels.quality.shape) < 0.1, 0.05, 1.0)[..., None]
    noisy = texels.rgb * (1 + 0.01 * rng.standard_normal(texels.rgb.shape)) * shadow
    texels = replace(texels, rgb=noisy.astype(np.float32))
    off = {loss: np.abs(solved(on_gl, texels, 0.4, level, loss=loss)[0] - problem.truth.roughness).mean()
           for loss in ("squares", "auto")}
    assert off["auto"] < off["squares"] / 3 and off["auto"] < 0.015


def test_a_prior_about_the_material_draws_a_metal_too(on_gl):
    """Of all texels one roughness, found in spite of noise."""
    problem, _ = exact()
    one = replace(problem, truth=replace(problem.truth, roughness=np.full_like(problem.truth.roughness, 0.3)))
    texels = as_metal(one, 0.4)
    noisy = texels.rgb * (1 + 0.1 * np.random.default_rng(6).standard_normal(texels.rgb.shape))
    texels = replace(texels, rgb=noisy.astype(np.float32))
    alone, drawn = (np.abs(solved(on_gl, texels, 0.4, joint=joint)[0] - 0.3).mean()
                    for joint in (None, JointPrior(0.3, 200.0, 0.01)))
    assert drawn < alone / 2


METALLIC = 0.4


@pytest.fixture(scope="module")
def shoot() -> syn.Shoot:
    return syn.shoot(replace(syn.PATCHES, reflect=partial(brdf.principled, metallic=METALLIC)), shoots.rig(lamps=10),
                     (56, 56))


@pytest.fixture(scope="module")
def found(shoot: syn.Shoot) -> Solution:
    """Solved at the right Metallic, which an earlier result gives."""
    earlier = solve(shoot, model="one-lobe", loss="squares")
    earlier = replace(earlier, model={"Paint": "one-lobe-metallic"}, metallic={"Paint": METALLIC})
    return solve(replace(shoot, scene=replace(shoot.scene, start=earlier)), start="last")


def test_maps_of_a_metal_come_out(shoot, found):
    off = shoots.errors(found, shoot.truth)
    assert off.share > 0.98
    assert (found.model, found.metallic) == ({"Paint": "one-lobe-metallic"}, {"Paint": METALLIC})
    assert found.levels == {}
    assert np.median(off.rough) < 1e-3 and np.quantile(off.rough, 0.9) < 0.005
    assert np.median(off.base) < 1e-3 and np.quantile(off.base, 0.9) < 0.01


@pytest.mark.one_python
def test_metallic_and_specular_level_go_together():
    shoot = syn.shoot(replace(syn.PATCHES, reflect=partial(brdf.principled, metallic=0.7, level=0.8)),
                      shoots.rig(lamps=10), (56, 56))
    earlier = solve(shoot, model="one-lobe", loss="squares")
    earlier = replace(earlier, model={"Paint": "one-lobe-metallic"}, metallic={"Paint": 0.7}, levels={"Paint": 0.8})
    found = solve(replace(shoot, scene=replace(shoot.scene, start=earlier)), start="last")
    off = shoots.errors(found, shoot.truth)
    assert (found.metallic, found.levels, found.warnings) == ({"Paint": 0.7}, {"Paint": 0.8}, ())
    assert np.median(off.rough) < 1e-3 and np.quantile(off.rough, 0.9) < 0.005
    assert np.median(off.base) < 1e-3 and np.quantile(off.base, 0.9) < 0.02


def test_views_show_what_a_metals_maps_predict(found):
    """Gain of each view, and what is left: the prediction that checks go by has the metal's lobe."""
    assert found.warnings == ()
    for view in found.checks.views:
        assert view.residual.gain == pytest.approx(1, abs=1e-3) and view.residual.structure < 1e-3


def test_a_part_keeps_metallic(shoot, found):
    corners = (shoot.scene.mesh.uvs[..., 0] > 0.5).astype(np.float32)
    part = solve(replace(shoot, scene=replace(shoot.scene, start=found, region=Region(corners=corners))))
    assert (part.model, part.metallic) == (found.model, found.metallic)
    off = np.abs(part.maps.roughness - found.maps.roughness)[part.maps.coverage & ~part.maps.filled]
    assert np.median(off) < 1e-5
    with pytest.raises(BadInput, match="its other region was solved as Roughness \\+ Metallic"):
        solve(replace(shoot, scene=replace(shoot.scene, start=found, region=Region(corners=corners))),
              model="one-lobe")


@pytest.mark.one_python
@pytest.mark.parametrize("model", ["one-lobe-metallic", "auto"])
def test_metallic_is_found(shoot, model):
    """By what all texels say together; `auto` takes it because left-out lamps show it."""
    solution = solve(shoot, model=model, loss="squares")
    assert solution.model == {"Paint": "one-lobe-metallic"}
    assert solution.metallic["Paint"] == pytest.approx(METALLIC, abs=0.02)
    off = shoots.errors(solution, shoot.truth)
    assert np.median(off.rough) < 0.01 and np.median(off.base) < 0.02


def beside_paint(base: np.ndarray, rough: np.ndarray, *vectors: np.ndarray) -> np.ndarray:
    """Two quarters of a plane are metal and two are paint."""
    return brdf.principled(base, rough, *vectors, metallic=np.where(rough < 0.42, 1.0, 0.0))


def middles(size: int) -> list[np.ndarray]:
    """u and v (size, size) of the texels."""
    return np.meshgrid(*2 * [(np.arange(size) + 0.5) / size])


AT = middles(SIZE)
IS_METAL = syn.PATCHES.roughness(*AT) < 0.42


@pytest.fixture(scope="module")
def mixed() -> syn.Shoot:
    return syn.shoot(replace(syn.PATCHES, reflect=beside_paint), shoots.rig(2, 8), (72, 72), noise=0.005)


@pytest.fixture(scope="module")
def apart(mixed: syn.Shoot) -> Solution:
    return solve(mixed, model="auto")


@pytest.mark.one_python
def test_paint_beside_metal_in_one_slot_has_its_own_metallic(mixed, apart) -> None:
    """One Metallic for all would bend the paint's roughness."""
    maps = apart.maps
    assert apart.model == {"Paint": "one-lobe-metallic"} and apart.metallic["Paint"] > 0.95
    assert apart.paint["Paint"] == pytest.approx(0.5, abs=0.02) and apart.levels == {}
    assert apart.warnings == ()
    assert set(np.unique(maps.metallic)) == {0.0, np.float32(apart.metallic["Paint"])}
    assert np.mean((maps.metallic > 0) == IS_METAL) > 0.99
    # A half at most, where the metal's texels are held together by a prior.
    sure, off = maps.confidence > 0.4, np.abs(maps.roughness - syn.PATCHES.roughness(*AT))
    base = np.abs(maps.base_color - syn.PATCHES.base(*AT)).max(-1)
    for part in (IS_METAL, ~IS_METAL):
        assert sure[part].mean() > 0.6
        assert np.median(off[part]) < 0.005 and np.mean(off[part & sure] > 0.05) < 0.002
        assert np.median(base[part]) < 0.01


def chipped(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Whether paint is gone: a disc of a twentieth of the square."""
    return np.asarray((u - 0.3)**2 + (v - 0.7)**2 < 0.13**2)


CHIPS = replace(
    syn.PATCHES, reflect=lambda base, rough, *vectors: brdf.principled(
        base, rough, *vectors, metallic=np.where(rough < 0.35, 1.0, 0.0)),
    base=lambda u, v: np.where(chipped(u, v)[..., None], (0.6, 0.58, 0.55), syn.PATCHES.base(u, v)),
    roughness=lambda u, v: np.where(chipped(u, v), 0.3, syn.quarters([0.4, 0.45, 0.6, 0.5])(u, v)))


@pytest.mark.one_python
def test_metal_where_paint_is_chipped_is_found() -> None:
    """No Metallic of all texels predicts better than none; the paint keeps what it has without the chips.

    Of fewer texels too many would lie at the chip's border.
    """
    found = solve(syn.shoot(CHIPS, shoots.rig(2, 8), (72, 72), noise=0.005), model="auto", size=64)
    at = middles(64)
    metal = chipped(*at)
    assert found.model == {"Paint": "one-lobe-metallic"} and found.metallic["Paint"] > 0.95
    assert found.paint["Paint"] == pytest.approx(1 - metal.mean(), abs=0.02)
    assert found.warnings == ()
    maps = found.maps
    assert np.mean((maps.metallic > 0) == metal) > 0.98
    off = np.abs(maps.roughness - CHIPS.roughness(*at))
    base, sure = np.abs(maps.base_color - CHIPS.base(*at)).max(-1), maps.confidence > 0.4
    for part in (metal, ~metal):
        assert np.median(off[part]) < 0.005 and np.median(base[part]) < 0.01
        assert sure[part].mean() > 0.5 and np.mean(off[part & sure] > 0.05) < 0.002


@pytest.mark.one_python
def test_paint_beside_metal_finds_its_level_where_the_scale_is_unknown(mixed) -> None:
    """Pictures of half the light: the paint's highlight is half as strong, its roughness the same."""
    images = {name: replace(image, rgb=image.rgb / 2) for name, image in mixed.images.items()}
    half = replace(mixed, images=images, scene=replace(mixed.scene, scale_known=False))
    found = solve(half, model="auto")
    assert found.paint["Paint"] == pytest.approx(0.5, abs=0.04)
    assert found.levels["Paint"] == pytest.approx(0.25, abs=0.02)
    off = np.abs(found.maps.roughness - syn.PATCHES.roughness(*AT))
    assert np.median(off[~IS_METAL]) < 0.005 and np.median(off[IS_METAL]) < 0.005


@pytest.mark.one_python
def test_texels_finer_than_the_pictures_are_metal_or_paint(monkeypatch) -> None:
    """Where every second texel alone is searched."""
    monkeypatch.setattr(stride, "LEAST", 16)
    coarse = syn.shoot(replace(syn.PATCHES, reflect=beside_paint), shoots.rig(2, 8), (28, 28))
    found = solve(coarse, model="auto", size=64)
    assert found.stride > 1 and found.paint["Paint"] == pytest.approx(0.5, abs=0.02)
    assert set(np.unique(found.maps.metallic)) == {0.0, np.float32(found.metallic["Paint"])}
    fine = middles(64)
    rough, metal = syn.PATCHES.roughness(*fine), syn.PATCHES.roughness(*fine) < 0.42
    assert np.mean((found.maps.metallic > 0) == metal) > 0.98
    for part in (metal, ~metal):
        assert np.median(np.abs(found.maps.roughness - rough)[part]) < 0.005


@pytest.mark.one_python
@pytest.mark.parametrize(("reflect", "least"), [
    (beside_paint, 0.3), (partial(brdf.principled, metallic=1.0), 0.7)], ids=["beside paint", "alone"])
def test_what_is_sure_of_a_metal_is_right(reflect, least) -> None:
    """Without noise; no line blames paint or lamps."""
    shoot = syn.shoot(replace(syn.PATCHES, reflect=reflect), shoots.rig(2, 8), (72, 72))
    solution = solve(shoot, model="auto")
    assert solution.model == {"Paint": "one-lobe-metallic"} and solution.metallic["Paint"] > 0.95
    assert not [line for line in solution.warnings if "do not look like metal" in line or line.startswith("light")]
    sure = solution.maps.confidence > 0.5
    wrong = np.abs(solution.maps.roughness - shoot.truth.roughness(*AT)) > 0.1
    assert sure.mean() > least and wrong[sure].mean() < 0.003  # of one Metallic for both, 0.4


@pytest.mark.one_python
@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_a_material_that_is_no_mixture_has_no_map_of_metallic(metallic) -> None:
    truth = replace(syn.PATCHES, reflect=partial(brdf.principled, metallic=metallic))
    solution = solve(syn.shoot(truth, shoots.rig(2, 8), (72, 72), noise=0.005), model="auto")
    assert (solution.maps.metallic, solution.paint) == (None, {})
    assert not [line for line in solution.warnings if "no metal" in line]
    assert (solution.model == {"Paint": "one-lobe-metallic"}) == (metallic > 0)


@pytest.mark.one_python
def test_a_part_keeps_what_is_metal_and_what_is_paint(mixed, apart) -> None:
    corners = (mixed.scene.mesh.uvs[..., 0] > 0.3).astype(np.float32)
    given = replace(mixed, scene=replace(mixed.scene, start=apart, region=Region(corners=corners)))
    part = solve(given, model="auto")
    assert (part.model, part.metallic) == (apart.model, apart.metallic)
    assert part.paint["Paint"] == pytest.approx(apart.paint["Paint"], abs=0.01)
    assert np.mean(part.maps.metallic == apart.maps.metallic) > 0.995
    sure = (part.maps.confidence > 0.4) & (apart.maps.confidence > 0.4)
    assert sure[IS_METAL].mean() > 0.6 and sure[~IS_METAL].mean() > 0.6
    assert np.quantile(np.abs(part.maps.roughness - apart.maps.roughness)[sure], 0.99) < 0.01
    with pytest.raises(BadInput, match="its other region is metal and paint, for which only model Auto"):
        solve(given, model="one-lobe-metallic")


@pytest.mark.one_python
def test_a_part_of_one_metallic_does_not_believe_paint(mixed, apart) -> None:
    """The material keeps the one value that its other part has."""
    one = replace(apart, maps=replace(apart.maps, metallic=None), paint={})
    corners = (mixed.scene.mesh.uvs[..., 0] > 0.3).astype(np.float32)
    part = solve(replace(mixed, scene=replace(mixed.scene, start=one, region=Region(corners=corners))))
    assert part.maps.metallic is None
    assert sum("do not look like metal" in line for line in part.warnings) == 1
    inside = np.broadcast_to(AT[0] > 0.35, IS_METAL.shape)
    sure, off = part.maps.confidence > 0.4, np.abs(part.maps.roughness - syn.PATCHES.roughness(*AT))
    assert np.mean(off[inside & ~IS_METAL] > 0.1) > 0.5 and sure[inside & IS_METAL].mean() > 0.6
    assert np.mean(off[inside & sure] > 0.1) < 0.01


@pytest.mark.one_python
def test_views_beyond_what_a_software_renderer_finishes(on_gl, shoot, monkeypatch):
    """Tables of metals would be wrong there without a message."""
    monkeypatch.setattr(observation_atlas, "LOOP_ROUNDS", 10)
    monkeypatch.setattr(on_gl(lambda device: device), "is_software", True)
    with pytest.raises(BadInput, match="model one-lobe-metallic: there are more views than it can take"):
        solve(shoot, model="one-lobe-metallic", loss="squares")
    assert solve(shoot, model="auto", loss="squares").metallic == {}


@pytest.mark.parametrize(("better", "found"), [(2.0, False), (7.0, True)])
def test_a_metal_whose_detail_is_finer_than_its_texels_has_no_paint(better: float, found: bool) -> None:
    """On a metal sphere half of the texels were explained twice as well as paint, and confidently wrong by 0.1."""
    paint = np.zeros((40, 40), bool)
    paint[:, :20] = True
    parts = parts_of(left_over(np.where(paint, 0.02, 0.01 * better)), left_over(np.where(paint, 0.02 * better, 0.01)),
                     np.ones(paint.shape, bool))
    assert (parts is not None) == found
    assert parts is None or (parts.paint == paint).mean() > 0.95


def left_over(error: np.ndarray) -> SolvedTexels:
    """Of which a model leaves this relative error, (h, w)."""
    count = np.full(error.shape, 9.0, np.float32)
    return SolvedTexels(*[np.full(error.shape, 0.4, np.float32)] * 3, np.ones(error.shape, bool), count,
                        (count * error**2).astype(np.float32), count, count)


@pytest.mark.parametrize(("chips", "odd", "found"), [(0.15, True, True), (0.05, True, False), (0.04, False, False)])
def test_what_stands_out_of_paint_is_metal_where_a_metal_explains_it(chips: float, odd: bool, found: bool) -> None:
    """Of paint that errs by 0.015: chips that one lobe misses by ``chips`` and a metal by 0.03."""
    metal = np.zeros((40, 40), bool)
    metal[10:20, 10:20] = True
    all_of = np.ones(metal.shape, bool)
    without = left_over(np.where(metal, chips, 0.015))
    stands_out = unexplained(without, all_of)
    assert (stands_out is not None) == odd
    parts = metal_of(without, left_over(np.where(metal, 0.03, 0.2)), all_of)
    assert (parts is not None) == found
    assert parts is None or (parts.metal == metal).mean() > 0.95
    assert stands_out is None or (stands_out | ~metal).mean() > 0.95
    few = np.where(metal & (np.indices(metal.shape)[0] < 12), chips, 0.015)
    assert unexplained(left_over(few), all_of) is None  # a hundredth of them


@pytest.mark.parametrize(("error", "lightness", "metal"), [
    (0.76, 13.0, False), (0.86, 9.0, False), (0.7, 9.4, True), (0.5, 11.5, True)])
def test_a_metal_in_paint_is_predicted_or_far_better_than_without_metallic(
        error: float, lightness: float, metal: bool) -> None:
    """The first are texels of brushed metal under a lobe that is no metal's: as a metal they flashed elsewhere."""
    name = UNIFORM_METAL.name
    tried = {"lambert": PredictionError(0.99, 18.0), "one value": PredictionError(0.88, 13.0),
             name: PredictionError(error, lightness)}
    assert seems_metal(MaterialPrediction("lamps", name, tried)) == metal
