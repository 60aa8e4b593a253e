"""The panel shows what the present model and method use, and nothing that they do not."""

from __future__ import annotations

import re
from dataclasses import fields
from itertools import product

import bpy
import pytest

from irpso_addon.blender import properties
from irpso_addon.blender.ui import panel_result, panel_solve
from irpso_addon.core.change_records import PredictionError
from irpso_addon.core.checks.check_figures import Level
from irpso_addon.core.data import MaterialPrediction
from irpso_addon.core.params import SolveSettings, choice_name

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
    """What the table's text says an option is for ("...; for method Paper") decides; nothing else is ever hidden."""
    for model, method in product(CHOICES["model"], CHOICES["method"]):
        settings.model, settings.method = model, method
        for field in fields(SolveSettings):
            said = re.search(r"; for (model|method) (.+)$", field.metadata["doc"])
            want = True
            if said:
                chosen = getattr(settings, said[1])
                # "auto" may choose two lobes; it never asks for the level.
                want = choice_name(chosen) == said[2] or (chosen == "auto" and said[2] == choice_name("two-lobe"))
            advanced = field.metadata["advanced"]
            assert (field.name in panel_solve.shown(settings, advanced)) == want, (field.name, settings.model)
            assert field.name not in panel_solve.shown(settings, not advanced)


def test_the_first_look_is_short(settings) -> None:
    assert panel_solve.shown(settings, advanced=False) == ["size", "model", "method", "start", "indirect"]
    assert panel_solve.shown(settings, advanced=True) == [
        "udim", "ndf", "loss", "registration", "lamps", "exposures", "normals", "raw_size", "seed"]


def test_the_error_of_left_out_views_is_in_per_cent_and_lightness() -> None:
    prediction = MaterialPrediction("lamps", "one value", {"lambert": PredictionError(0.3, 4.0),
                                                           "one value": PredictionError(0.1234, 1.44)})
    assert panel_result.predicted(prediction) == "Left-out lamps: 12.3 % off, 1.4 L*"


def test_each_level_of_a_check_has_a_traffic_light() -> None:
    """Icons that this Blender has; a figure without a limit has none."""
    icons = bpy.types.UILayout.bl_rna.functions["label"].parameters["icon"].enum_items.keys()
    assert set(panel_result.LIGHTS) == set(Level) and set(panel_result.LIGHTS.values()) <= set(icons)
    assert len(set(panel_result.LIGHTS.values())) == len(Level) and panel_result.LIGHTS[Level.NONE] == "BLANK1"
