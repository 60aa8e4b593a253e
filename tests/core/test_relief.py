"""The relief of flat samples under a flash: found beside levels, taken only where left-out views say so."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from irpso_addon.core.evaluation.sampled_texels import one_lobe
from irpso_addon.core.job import Steps, run_to_end
from irpso_addon.core.normals.judge import NormalsJudged, judge_normals
from irpso_addon.core.normals.relief import is_flat, judge_normals_and_relief
from irpso_addon.core.normals.texel_tilts import TexelTilts
from irpso_addon.core.normals.tilt_fit import Beside, fit_tilts
from irpso_addon.core.shading.lights import light_basis
from tests.support import tilted_sphere as balls
from tests.support.flat_relief import flat_relief

pytestmark = pytest.mark.one_python


def result_of(steps: Steps[Any]) -> Any:
    return run_to_end(steps, lambda progress: None)


def test_tilts_are_found_beside_levels() -> None:
    """Bumps of 2.4 degrees under nine flashes, 2 % noise; with one level for all hardly anything is found."""
    sample, true, level = flat_relief(slope=0.06)
    count = len(level)

    def error(beside: Beside) -> tuple[float, np.ndarray]:
        found = fit_tilts(sample, one_lobe(np.full(count, 0.35), 0.4), beside=beside)
        tilt = found.under(found.deviation())[0]
        return float(np.median(balls.degrees_between(sample.rig.normal + sample.offset(tilt), true))), found.lobes.level

    assert balls.degrees_between(sample.rig.normal, true).mean() > 2
    (left, levels), (otherwise, _) = error(Beside.LEVEL), error(Beside.NOTHING)
    assert left < 1.0 and otherwise > 2 * left  # 0.90 and 2.09 degrees
    assert np.median(np.abs(levels / level - 1)) < 0.15


@pytest.mark.parametrize("case", [{"slope": 0.03}, {"slope": 0.06, "views": 7, "noise": 0.05}])
def test_a_relief_that_highlights_show_is_taken(case: dict[str, Any]) -> None:
    sample, _, _ = flat_relief(**case)
    assert isinstance(result_of(judge_normals(sample)), str)
    judged = result_of(judge_normals_and_relief(sample))
    assert isinstance(judged, NormalsJudged) and judged.beside is Beside.LEVEL
    assert judged.refined < 0.9 * judged.given
    assert not judged.large  # the bumps are small


@pytest.mark.parametrize("case", [
    {}, {"noise": 0.0}, {"grain": 1.6}, {"slope": 0.06, "views": 4},
])
def test_no_relief_is_seen_in_what_is_flat(case: dict[str, Any]) -> None:
    """Nor in grain, which no model has; nor with too few views."""
    assert isinstance(result_of(judge_normals_and_relief(flat_relief(**case)[0])), str)


def test_only_what_is_flat_has_a_relief() -> None:
    assert is_flat(flat_relief()[0])
    assert not is_flat(balls.sphere(balls.principled(0.4))[0])


def test_tilts_of_a_relief_are_not_smoothed_and_may_be_large() -> None:
    """Known to a tenth of their size, they stay; a scan's are drawn to their neighbours."""
    size, deviation = 48, 0.05
    y, x = np.mgrid[:size, :size] / size
    position = np.stack([x, y, 0 * x], -1).astype(np.float32)
    normal = np.broadcast_to(np.float32([0, 0, 1]), position.shape)
    height = np.random.default_rng(3).normal(size=(size + 1, size + 1)) * 0.035 / size  # of a surface: no circulation
    slope = np.stack([height[:-1, 1:] - height[:-1, :-1], height[1:, :-1] - height[:-1, :-1]], -1) * size
    slope += [0.02, 0]  # in common
    offset = np.concatenate([-slope, 0 * slope[..., :1]], -1)
    found = TexelTilts(position, np.array(normal), np.ones((size, size), bool))
    first, second = light_basis(np.array(normal, np.float64))
    tilt = np.stack([(offset * first).sum(-1), (offset * second).sum(-1)], -1)
    information = np.broadcast_to(np.eye(2) / (0.1 * deviation) ** 2, (size, size, 2, 2))
    at = tuple(part.ravel().astype(np.int32) for part in np.indices((size, size)))
    found.add(at, information.reshape(-1, 2, 2), (information @ tilt[..., None])[..., 0].reshape(-1, 2))

    def left(**how: bool) -> float:
        away = found.offsets(deviation, **how) - offset
        return float(np.sqrt((away**2).sum(-1).mean() / (offset**2).sum(-1).mean()))

    kept = left(relief=True, large=True)
    assert kept < 0.08  # 0.057
    assert left(large=True) > 2 * kept  # drawn to their neighbours
    assert left(relief=True) > 3 * kept  # without what they have in common
