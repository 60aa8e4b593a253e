"""Choose a capture file."""

from pathlib import Path

import bpy

from .helpers.paths import stored


class IRPSO_OT_choose_captures(bpy.types.Operator):
    """Choose the captures.json that names the views"""

    bl_idname = "irpso.choose_captures"
    bl_label = "Choose Captures"
    bl_options = {"UNDO", "INTERNAL"}

    filepath: bpy.props.StringProperty(
        name="File", subtype="FILE_PATH", description="Capture file", options={"SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(default="*.json", options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Opens the file browser at the present file, else beside the .blend."""
        present = context.scene.irpso.captures
        if present and not (present.startswith("//") and not bpy.data.filepath):
            self.filepath = bpy.path.abspath(present)
        elif bpy.data.filepath:
            self.filepath = str(Path(bpy.data.filepath).with_name("captures.json"))
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """The panel's captures file."""
        if not self.filepath or Path(self.filepath).is_dir():
            self.report({"ERROR"}, f"{self.filepath or 'no file'}: is not a file; choose a captures.json")
            return {"CANCELLED"}
        context.scene.irpso.captures = stored(Path(bpy.path.abspath(self.filepath)))
        return {"FINISHED"}
