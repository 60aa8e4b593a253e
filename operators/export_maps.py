"""Save the last solution's maps as image files."""

from pathlib import Path

import bpy

from ..irpso_addon.blender import properties
from ..irpso_addon.blender.jobs.session import session
from ..irpso_addon.core.errors import BadInput
from ..irpso_addon.core.maps import map_set
from ..irpso_addon.core.maps.export import write_maps
from .helpers.needs_solution import NeedsSolution
from .helpers.paths import absolute

MAPS = {  # as export.layers has them
    "basecolor": "base colour", "roughness": "roughness", "confidence": "confidence", "error": "error",
    "filled": "filled texels", "roughness_sigma": "standard error of roughness",
    "basecolor_sigma": "standard error of base colour", "specular": "Specular IOR Level if it was solved for",
}


class IRPSO_OT_export_maps(NeedsSolution, bpy.types.Operator):
    """Saves the last solution's maps."""

    bl_idname = "irpso.export_maps"
    bl_label = "Export Maps"
    bl_description = f"Save the maps as image files: {', '.join(MAPS.values())}"
    bl_options = {"REGISTER"}

    directory: bpy.props.StringProperty(
        name="Folder", subtype="DIR_PATH", description="Folder that the files are written to",
        options={"SKIP_SAVE", *properties.RELATIVE})
    format: bpy.props.EnumProperty(
        name="Format", description="File format", items=properties.FORMATS, options={"SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Opens the file browser in the panel's folder."""
        settings = context.scene.irpso
        self.format = settings.format
        if bpy.data.filepath or not settings.out.startswith("//"):
            self.directory = bpy.path.abspath(settings.out)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Writes the files; folder and format are the panel's where the caller names none."""
        obj, settings = context.active_object, context.scene.irpso
        kind = self.format if self.properties.is_property_set("format") else settings.format
        try:
            folder = Path(absolute(self.directory or settings.out))
            solution, files = self.solution(obj), session.files_of(obj)
            paths = (write_maps(solution.maps, obj.name, folder, kind) if files is None
                     else map_set.export(files, obj.name, folder, kind))
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{obj.name}: wrote {len(paths)} files to {folder}")
        return {"FINISHED"}
