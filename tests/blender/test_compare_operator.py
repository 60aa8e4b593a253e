"""Compare Methods as an operator: what `irpso compare` measures, kept as a chart and saved where that is wanted."""

from __future__ import annotations

import json
import sys

import bpy
import pytest

pytestmark = pytest.mark.usefixtures("extension")


@pytest.fixture
def opened(scenes, tmp_path):
    """The ball, active, with its views."""
    bpy.ops.wm.open_mainfile(filepath=str(scenes / "good" / "scene.blend"))
    settings = bpy.context.scene.irpso
    settings.captures, settings.out = "//captures.json", str(tmp_path / "out")
    settings.indirect, settings.lamps, settings.exposures, settings.registration = "off", "given", "given", "given"
    bpy.context.view_layer.objects.active = bpy.data.objects["Ball"]
    return bpy.context.window_manager.irpso_views


def test_chart_and_report(opened, tmp_path):
    opened.compare_size, opened.compare_save = 32, True
    assert bpy.ops.irpso.compare() == {"FINISHED"}
    chart = sys.modules["irpso_ext.irpso_addon.blender.viewer.views"].chart(bpy.context)
    assert opened.show == "CHART" and [panel.title[:14] for panel in chart.panels] == 2 * ["held-out views"]
    curves = {curve.label: curve for curve in chart.panels[0].curves}
    assert set(curves) == {"refined", "draft", "swarm", "no solver"}
    assert curves["refined"].values[0] < 0.5 * curves["no solver"].values[0]  # in per cent; division leaves highlights
    report = json.loads((tmp_path / "out" / "compare.json").read_text())
    assert report["size"] == 32 and report["versions"]["blender"].startswith(bpy.app.version_string[:3])
    told = {row["method"]: 100 * row["held_out"] for row in report["rows"]}
    assert {name: curve.values[0] for name, curve in curves.items()} == pytest.approx(told)


def test_too_few_views(opened):
    settings = bpy.context.scene.irpso
    bpy.ops.irpso.load_captures()
    for view in settings.views[3:]:
        view.enabled = False
    with pytest.raises(RuntimeError, match="has 3 usable views"):
        bpy.ops.irpso.compare()
