"""Base colours of places that pictures barely show."""

from __future__ import annotations

import numpy as np
import pytest

from irpso_addon.core.maps.barely_shown import ENOUGH, RARE, within_material

SIDE = 40


@pytest.fixture
def paints() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(base, barely, slots) of a dark and a light material, beside one another, each with a nook of white."""
    rng = np.random.default_rng(2)
    slots = np.repeat([[0, 1]], SIDE, 0).repeat(SIDE // 2, 1).astype(np.int32)
    low = np.where(slots == 0, 0.1, 0.6)[..., None]
    base = np.concatenate([rng.uniform(low, low + 0.2, (SIDE, SIDE, 3)), np.ones((SIDE, SIDE, 1))], -1)
    barely = np.zeros((SIDE, SIDE), bool)
    barely[10:20, 5:8] = barely[10:20, 30:33] = True
    base[barely] = 1.0, 0.0, 1.0, 0.02
    return base.astype(np.float32), barely, slots


def test_a_nook_keeps_to_the_colours_of_its_own_material(paints) -> None:
    base, barely, slots = paints
    kept = within_material(base, ~barely, barely, slots)
    for slot in (0, 1):
        own = barely & (slots == slot)
        least, most = np.percentile(base[(slots == slot) & ~barely, :3], [RARE, 100 - RARE], axis=0)
        assert np.allclose(kept[own, :3], [most[0], least[1], most[2]])
    assert (kept[~barely] == base[~barely]).all()
    assert (kept[..., 3] == base[..., 3]).all()


def test_what_lies_within_stays(paints) -> None:
    base, barely, slots = paints
    base[barely, :3] = np.where(slots[barely] == 0, 0.2, 0.7)[:, None]
    assert (within_material(base, ~barely, barely, slots) == base).all()


def test_few_texels_do_not_say_which_colours_a_material_has(paints) -> None:
    base, barely, slots = paints
    sure = ~barely & ((slots == 1) | (np.cumsum(slots.ravel() == 0).reshape(slots.shape) < ENOUGH))
    kept = within_material(base, sure, barely, slots)
    dark = slots == 0
    assert (kept[dark] == base[dark]).all()
    assert (kept[barely & ~dark, 0] < 1).all()


def test_outside_of_all_materials_nothing_changes(paints) -> None:
    base, barely, slots = paints
    assert (within_material(base, ~barely, barely, np.full_like(slots, -1)) == base).all()
