"""Presets of the Solve panel, as Blender does them: a menu in its header; add and remove; ours come with the add-on.

A preset says what differs from the defaults or says everything, as those that Blender writes do.
"""

from dataclasses import fields
from pathlib import Path

import bpy
from bl_ui.utils import PresetPanel

from ..core.params import SolveSettings

FOLDER = "irpso"  # below a folder of presets
FIELDS = tuple(field.name for field in fields(SolveSettings) if field.name != "start")  # that belongs to a moment
_SHIPPED = str(Path(__file__).resolve().parents[2])  # the extension's own folder


class IRPSO_PT_solve_presets(PresetPanel, bpy.types.Panel):
    """Presets of the settings of a solve."""

    bl_label = "Solve Presets"
    preset_subdir = FOLDER
    preset_operator = "script.execute_preset"
    preset_add_operator = "irpso.add_solve_preset"

    @staticmethod
    def reset_cb(context: bpy.types.Context, _filepath: str) -> None:
        """Before a preset: the defaults."""
        for name in FIELDS:
            context.scene.irpso.property_unset(name)

    @staticmethod
    def post_cb(_context: bpy.types.Context, _filepath: str) -> None:
        """After it: Blender's operator by itself leaves nothing to undo."""
        bpy.ops.ed.undo_push(message="Solve Preset")


CLASSES = (IRPSO_PT_solve_presets,)


def register() -> None:
    """Where those that come with the add-on are."""
    bpy.utils.register_preset_path(_SHIPPED)


def unregister() -> None:
    """Takes it back."""
    bpy.utils.unregister_preset_path(_SHIPPED)
