"""JPEG and TIFF files with a camera's tone curve: found, and undone; and what is none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from irpso_addon.core.data import F64, Solution
from irpso_addon.core.images.colour import srgb_to_linear
from irpso_addon.core.images.response import curved
from irpso_addon.core.shading import brdf
from tests.support import shoots
from tests.support import synthetic as syn

PIXELS = (96, 96)
AUTO = {"model": "one-lobe", "registration": "given", "indirect": "off", "lamps": "auto", "exposures": "auto"}
GIVEN = {"lamps": "given", "exposures": "given"}
EXPOSURE = -1.5  # EV: highlights are below white
RESPONSE, SHOULDER = 1.6, 10.0
SIGMOID = partial(curved, response=RESPONSE, shoulder=SHOULDER)


def film(value: F64) -> F64:
    """Another curve: Narkowicz's fit of ACES (2015), white at 1, with a toe that grows as the square."""
    def fit(x: F64) -> F64:
        return np.asarray(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14))

    return np.asarray(fit(value) / fit(np.ones(1)))


def developed(shoot: syn.Shoot, curve: Callable[[F64], F64], kind: str = ".jpg") -> syn.Shoot:
    """Its pictures as files of 8 bits, of linear values that went through a curve and then through sRGB's."""
    images, views = {}, []
    for view in shoot.scene.views:
        picture = shoot.images[view.image.name]
        value = curve(np.clip(picture.rgb.astype(np.float64) * 2**EXPOSURE, 0, 1))
        encoded = np.where(value > 0.0031308, 1.055 * np.maximum(value, 1e-9) ** (1 / 2.4) - 0.055, 12.92 * value)
        shown = srgb_to_linear(np.round(255 * encoded) / 255)
        file = view.image.with_suffix(kind)
        images[file.name] = replace(picture, rgb=np.float32(shown / 2**EXPOSURE))
        views.append(replace(view, image=file, exposure=EXPOSURE))
    return replace(shoot, scene=replace(shoot.scene, views=tuple(views)), images=images)


@pytest.fixture(scope="module")
def plane() -> syn.Shoot:
    """Two cameras, eight lamps each."""
    return syn.shoot(syn.PATCHES, shoots.rig(), PIXELS)


def rough_error(shoot: syn.Shoot, solution: Solution) -> float:
    return float(np.mean(shoots.errors(solution, shoot.truth).rough))


@pytest.mark.one_python
def test_a_tone_curve_is_found(plane: syn.Shoot) -> None:
    made = developed(plane, SIGMOID)
    solution = shoots.run(made, **AUTO)
    assert solution.calibration is not None and solution.calibration.response is not None
    response = solution.calibration.response
    assert response.exponent == pytest.approx(RESPONSE, rel=0.02)
    assert response.shoulder == pytest.approx(SHOULDER, rel=0.1)
    assert any("undid a tone curve of exponent 1.6" in line for line in solution.warnings)
    ignored = rough_error(plane, shoots.run(made, **AUTO | GIVEN))
    assert rough_error(plane, solution) < 0.15 * ignored
    assert np.median(shoots.errors(solution, plane.truth).base) < 0.01


@pytest.mark.one_python
def test_so_is_one_of_another_family(plane: syn.Shoot) -> None:
    """A third is left of the error of PNG files: a tone curve is looked for in JPEG and TIFF files alone."""
    solution = shoots.run(developed(plane, film, ".tif"), **AUTO)
    alone = shoots.run(developed(plane, film, ".png"), **AUTO)
    assert solution.calibration is not None and solution.calibration.response is not None
    assert solution.calibration.response.shoulder > 2
    assert rough_error(plane, solution) < 0.33 * rough_error(plane, alone)


@pytest.mark.one_python
@pytest.mark.parametrize("material", [{}, {"diffuse_roughness": 0.8}, {"metallic": 1.0}])
def test_none_is_found_where_there_is_none(material: dict[str, float]) -> None:
    """Also of materials that one lobe does not explain."""
    shoot = syn.shoot(replace(syn.PATCHES, reflect=partial(brdf.principled, **material)), shoots.rig(), PIXELS)
    calibration = shoots.put_right(developed(shoot, lambda value: value), **AUTO).calibration
    assert calibration is None or calibration.response is None
