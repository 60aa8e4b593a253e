"""The panel shows what the present model and method use, and nothing that they do not."""

from __future__ import annotations

import re
from dataclasses import fields, replace
from itertools import product

import bpy
import pytest

from irpso_addon.blender import properties
from irpso_addon.blender.ui import panel_result, panel_solve
from irpso_addon.core.check_records import Checks, LightResidual
from irpso_addon.core.data import MaterialPrediction, PredictionError
from irpso_addon.core.params import SolveSettings

CHOICES = {f.name: [key for key, _ in f.metadata["choices"]] for f in fields(SolveSettings)}


@pytest.fixture
def settings(empty):
    ours = not hasattr(bpy.types.Scene, "irpso")  # opening a file registers them, for the rest of the process
    if ours:
        properties.register()
    yield bpy.context.scene.irpso
    if ours:
        properties.unregister()


def test_every_row_of_the_table_is_a_property(settings) -> None:
    """With the table's default, choices and limits; and what the panel holds is what the solver gets."""
    assert properties.settings(settings) == SolveSettings()
    for field in fields(SolveSettings):
        rna = settings.bl_rna.properties[field.name]
        assert rna.description == field.metadata["doc"]
        if field.metadata["choices"]:
            assert [item.identifier for item in rna.enum_items] == CHOICES[field.name]
            for choice in CHOICES[field.name]:
                setattr(settings, field.name, choice)
                assert getattr(properties.settings(settings), field.name) == choice
        else:
            limits = field.metadata["low"], field.metadata["high"]
            assert (rna.hard_min, rna.hard_max) == pytest.approx(limits)


def test_options_of_a_model_or_method_show_with_it_alone(settings) -> None:
    """What the table's text says an option is for ("Model two-lobe: ...") decides; nothing else is ever hidden."""
    for model, method in product(CHOICES["model"], CHOICES["method"]):
        settings.model, settings.method = model, method
        for field in fields(SolveSettings):
            said = re.match(r"(Model|Method) ([\w-]+):", field.metadata["doc"])
            want = True
            if said:
                chosen = getattr(settings, said[1].lower())
                # "auto" may choose two lobes; it never asks for the level.
                want = chosen == said[2] or (chosen == "auto" and said[2] == "two-lobe")
            advanced = field.metadata["advanced"]
            assert (field.name in panel_solve.shown(settings, advanced)) == want, (field.name, settings.model)
            assert field.name not in panel_solve.shown(settings, not advanced)


def test_the_first_look_is_short(settings) -> None:
    assert panel_solve.shown(settings, advanced=False) == ["size", "model", "method", "start", "indirect"]
    assert panel_solve.shown(settings, advanced=True) == ["udim", "ndf", "loss", "registration", "exposures", "seed"]


def test_the_error_of_left_out_views_is_in_per_cent_and_lightness() -> None:
    prediction = MaterialPrediction("lamps", "one value", {"lambert": PredictionError(0.3, 4.0),
                                                           "one value": PredictionError(0.1234, 1.44)})
    assert panel_result.predicted(prediction) == "Left-out lamps: 12.3% off, 1.4 L*"


def test_checks_have_a_row_each() -> None:
    """The worst camera and light by name; what nothing tells is unknown."""
    light = LightResidual("Key", 3, 0.9, 0.01, (0.0, 0.0, 0.0), 0.0, 0.0, 0.0)
    checks = Checks(
        name="Vase", views=(), lights=(replace(light, name="Rim", gain=1.01), light), materials=(), noise=0.012,
        structure=0.0, highlight=0.0, slope=None, unlit_share=float("nan"), clipped=0.25, no_highlight=0.5, nearest=2.0,
        doubtful=0.03, sure=True, pixels_per_texel=1.0)
    rows = dict(panel_result.figures(checks))
    assert rows["Noise"] == "1.2%" and rows["Clipped"] == "25.0%" and rows["Light in Shadows"] == "unknown"
    assert rows["Light Power"] == "-10.0% (Key)" and "Registration" not in rows
