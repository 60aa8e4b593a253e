"""The estimate's memory against what solves take; tools/estimate_check.py has the seconds."""

from __future__ import annotations

from dataclasses import replace

import moderngl
import pytest

from irpso_addon.core.params import SolveSettings
from irpso_addon.core.reporting.estimates import ViewSize, estimate
from irpso_addon.gpu.observe.picture_memory import bytes_per_pixel
from tests.support import skies
from tests.support import synthetic as syn
from tests.support.shoots import rig, run

BYTES = {"f1": 1, "f2": 2, "f4": 4, "i4": 4, "u4": 4}


def taken(shoot: syn.Shoot) -> list[ViewSize]:
    shapes = [image.rgb.shape for image in shoot.images.values()]
    return [ViewSize(shape[1], shape[0], view.camera.name, len(view.lights),
                     view.environment.name if view.environment else "")
            for view, shape in zip(shoot.scene.views, shapes, strict=True)]


@pytest.mark.parametrize(("size", "pixels", "world"), [
    pytest.param(128, 300, False, marks=pytest.mark.one_python), (512, 72, False),
    pytest.param(128, 200, True, marks=pytest.mark.one_python)])
def test_memory_of_the_device(monkeypatch, size, pixels, world) -> None:
    """Within a factor of 1.5 of the textures alive together at the worst moment, counted as they are made and freed."""
    alive: dict[int, int] = {}
    peak = 0
    make, free = moderngl.Context.texture, moderngl.Texture.release

    def texture(self, shape, components, data=None, *, dtype="f1", **options):
        nonlocal peak
        made = make(self, shape, components, data, dtype=dtype, **options)
        alive[made.glo] = shape[0] * shape[1] * components * BYTES[dtype]
        peak = max(peak, sum(alive.values()))
        return made

    def release(self):
        alive.pop(self.glo, None)
        free(self)

    shoot = syn.shoot(syn.PATCHES, rig(2, 4), (pixels, pixels))
    if world:
        views = [replace(view, environment=skies.sky(64)) for view in shoot.scene.views]
        shoot = replace(shoot, scene=replace(shoot.scene, views=views))
    monkeypatch.setattr(moderngl.Context, "texture", texture)
    monkeypatch.setattr(moderngl.Texture, "release", release)
    run(shoot, size=size, model="one-lobe")
    expected = estimate(taken(shoot), SolveSettings(size=size, model="one-lobe"), {}, 2.0).gpu_bytes
    print(f"{size}, {pixels} pixels: {peak / 1e6:.1f} MB, expected {expected / 1e6:.1f} MB, "
          f"pictures {bytes_per_pixel(shoot.scene.views) * pixels**2 / 1e6:.1f} MB")
    assert 1 / 1.5 < expected / peak < 1.5
