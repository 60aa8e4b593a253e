"""Meshes that glow: the small form of ``python -m studies.emitters``."""

from __future__ import annotations

import pytest

from irpso_addon.blender.oiio import ensure_openimageio

pytest.importorskip("bpy")

from studies import emitters
from studies.environment import radiance

KINDS = {kind.name: kind for kind in emitters.KINDS}


@pytest.mark.parametrize("shape", radiance.SHAPES)
@pytest.mark.parametrize(("name", "samples"), [("panel", 1024), ("near panel", 1024), ("bulb", 4096)])
def test_radiance_is_that_of_cycles(shape, name, samples):
    """docs/emitters.md has the others, with less noise."""
    ensure_openimageio()
    for error in emitters.errors(shape, KINDS[name], (0.4, 0.2), 20, samples):
        assert error.middle < 0.002 + error.noise / 2
        assert error.ninety < 0.006 + 1.1 * error.noise
        assert abs(error.mean) < 0.003 + error.noise / 4
