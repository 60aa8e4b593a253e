"""Keep the settings of a solve as a preset, or remove one."""

import bpy
from bl_operators.presets import AddPresetBase

from ..irpso_addon.blender import presets


class IRPSO_OT_add_solve_preset(AddPresetBase, bpy.types.Operator):
    """Save the settings of the Solve panel as a preset, or remove the preset"""

    bl_idname = "irpso.add_solve_preset"
    bl_label = "Add Solve Preset"

    preset_menu = presets.IRPSO_PT_solve_presets.__name__
    preset_subdir = presets.FOLDER
    preset_defines = ("settings = bpy.context.scene.irpso",)
    preset_values = tuple(f"settings.{name}" for name in presets.FIELDS)
