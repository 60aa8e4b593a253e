"""Preferences: made from the table, and what they say reaches the device."""

from __future__ import annotations

from dataclasses import fields

import bpy
import pytest


@pytest.fixture
def chosen(module):
    """The add-on's preferences, as they are where Blender has enabled it."""
    addon = bpy.context.preferences.addons.new()
    addon.module = "irpso_ext"
    yield addon.preferences
    bpy.context.preferences.addons.remove(addon)


def test_every_row_is_a_preference(module, chosen) -> None:
    table, device_settings = module("core.params").DeviceSettings, module("blender.preferences").device_settings
    assert device_settings() == table()
    for field in fields(table):
        rna = chosen.bl_rna.properties[field.name]
        assert (rna.name, rna.description) == (field.metadata["label"], field.metadata["doc"])
        if not field.metadata["choices"]:
            assert (rna.hard_min, rna.hard_max) == pytest.approx((field.metadata["low"], field.metadata["high"]))
    chosen.kernels, chosen.memory, chosen.slice = "fragment", 0.75, 40
    assert device_settings() == table(kernels="fragment", memory=0.75, slice=40)


def test_a_script_without_the_add_on_enabled_has_the_defaults(module) -> None:
    assert module("blender.preferences").device_settings() == module("core.params").DeviceSettings()


def test_test_device_uses_them(module, chosen, capfd) -> None:
    chosen.kernels, chosen.slice = "fragment", 33
    assert bpy.ops.irpso.test_device() == {"FINISHED"}
    assert module("gpu.device.thread").settings() == module("core.params").DeviceSettings(kernels="fragment", slice=33)
    assert "fragment shaders" in capfd.readouterr().out
    module("gpu.device.thread").configure(module("core.params").DeviceSettings())
