"""What a texel's own numbers take out of a fit, against sums written out."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.calibration.paint import Elimination, OwnNumbers, Paint, quotients
from irpso_addon.core.evaluation.sampled_texels import OTHER_CAMERA

CAMERA = np.array([0, 1, 0, 2, 1, 0])  # of each layer, of one channel: the third camera has one view alone


@pytest.fixture
def paint() -> Paint:
    return Paint(np.arange(len(CAMERA), dtype=np.int32), tuple(n == CAMERA for n in range(3)))


def test_a_camera_counts_its_own_layers_and_little_of_the_others(paint) -> None:
    rng = np.random.default_rng(3)
    above, below = rng.uniform(0.1, 1.0, (2, 5, len(CAMERA)))
    found = quotients([paint], above, below)
    for texel, layer in np.ndindex(found.shape):
        count = np.where(CAMERA == CAMERA[layer], 1 + OTHER_CAMERA, OTHER_CAMERA)
        right = (count * above[texel]).sum() / (count * below[texel]).sum()
        assert found[texel, layer] == pytest.approx(right, rel=1e-12)


def test_layers_of_one_channel_know_nothing_of_the_others() -> None:
    layers = np.array([4, 1], np.int32)
    alone = Paint(layers, (np.ones(2, bool),))
    above, below = np.random.default_rng(4).uniform(0.1, 1.0, (2, 3, 6))
    found = quotients([alone], above, below)
    np.testing.assert_allclose(found[:, layers], np.repeat(
        above[:, layers].sum(1, keepdims=True) / below[:, layers].sum(1, keepdims=True), 2, 1), rtol=1e-12)
    assert not found[:, [0, 2, 3, 5]].any()


def test_what_is_taken_is_what_the_own_numbers_explain(paint) -> None:
    """Of slopes S under weights W: the sum of S'W(S - what remains of S)."""
    rng = np.random.default_rng(5)
    shape = (40, len(CAMERA))
    share, bend, tilt = rng.uniform(0.2, 1.0, shape), rng.normal(size=shape), rng.normal(size=shape)
    own = Elimination(OwnNumbers([paint], share, bend, (tilt,)), rng.uniform(0.0, 2.0, shape), 0.02)
    slopes = rng.normal(size=(7, *shape))
    across = np.einsum("tvm,ktv->mkt", own.weighted, slopes)
    explained = np.stack([one - own.remains(one) for one in slopes])
    np.testing.assert_allclose(own.taken(across), np.einsum("ktv,tv,ltv->kl", slopes, own.weight, explained), rtol=1e-7)
