"""Save the last solution's maps as image files."""

from contextlib import suppress
from dataclasses import fields
from pathlib import Path

import bpy

from ..irpso_addon.blender import properties
from ..irpso_addon.blender.export_object import export_object
from ..irpso_addon.blender.files import painted, require_own_files
from ..irpso_addon.blender.jobs import solve_object
from ..irpso_addon.blender.jobs.session import session
from ..irpso_addon.blender.material.surfaces import shown_surfaces, solved_surfaces
from ..irpso_addon.core.errors import BadInput
from ..irpso_addon.core.maps import map_set
from ..irpso_addon.core.maps.export import write_maps
from ..irpso_addon.core.maps.targets import IRPSO
from ..irpso_addon.core.params import ExportSettings
from .helpers.needs_solution import NeedsSolution
from .helpers.paths import out_folder

MAPS = {  # as export.layers has them
    "basecolor": "base colour", "roughness": "roughness", "confidence": "confidence", "error": "error",
    "filled": "filled texels", "roughness_sigma": "standard error of roughness",
    "basecolor_sigma": "standard error of base colour", "specular": "Specular IOR Level if solved for",
    "metallic": "Metallic of a metal beside paint", "normal": "tangent-space normal map if normals were refined",
}
(TARGET,) = fields(ExportSettings)


class IRPSO_OT_export_maps(NeedsSolution, bpy.types.Operator):
    """Saves the last solution's maps."""

    bl_idname = "irpso.export_maps"
    bl_label = "Export Maps"
    bl_description = (f"Save the maps as image files: {', '.join(MAPS.values())}; or the files for another "
                      "program")
    bl_options = {"REGISTER"}

    _made: Path | None = None  # the folder that was made for the file browser

    directory: bpy.props.StringProperty(
        name="Folder", subtype="DIR_PATH", description="Folder for the files",
        options={"SKIP_SAVE", *properties.RELATIVE})
    target: bpy.props.EnumProperty(
        name=TARGET.metadata["label"], description=TARGET.metadata["doc"], items=properties.choices(TARGET),
        options={"SKIP_SAVE"})
    format: bpy.props.EnumProperty(
        name="Format", description="File format", items=properties.FORMATS, options={"SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Opens the file browser in the panel's folder."""
        settings = context.scene.irpso
        self.target, self.format = settings.target, settings.format
        self._made = None
        if settings.out.strip() and (bpy.data.filepath or not settings.out.startswith("//")):
            folder = Path(bpy.path.abspath(settings.out))
            if not folder.exists():  # the browser would open in the folder above
                with suppress(OSError):  # said when the files are written
                    folder.mkdir(parents=True)
                    self._made = folder
            self.directory = str(folder)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def cancel(self, _context: bpy.types.Context) -> None:
        """The folder that was made for the browser goes again."""
        self._remove_made()

    def draw(self, _context: bpy.types.Context) -> None:
        """Beside the file browser: a format only where there is a choice."""
        self.layout.use_property_split = True
        self.layout.prop(self, "target")
        if self.target == IRPSO:
            self.layout.prop(self, "format")

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Writes the files; folder, target and format are the panel's where the caller names none."""
        obj, settings = self.subject(context), context.scene.irpso
        try:
            out = out_folder(self.directory or settings.out)
            paths = self._write(obj, self._chosen(settings, "target"), self._chosen(settings, "format"), out)
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self._remove_made()  # where another one was chosen
        self.report({"INFO"}, f"{obj.name}: wrote {len(paths)} files to {out}")
        return {"FINISHED"}

    def _remove_made(self) -> None:
        if self._made is not None:
            with suppress(OSError):  # there is something in it
                self._made.rmdir()
            self._made = None

    def _chosen(self, settings: bpy.types.PropertyGroup, name: str) -> str:
        return getattr(self if self.properties.is_property_set(name) else settings, name)

    def _write(self, obj: bpy.types.Object, target: str, kind: str, folder: Path) -> list[Path]:
        """The files' paths; reports what is lost.  Raises BadInput."""
        require_own_files(obj)
        solution, files = self.solution(obj), session.files_of(obj)
        shown = session.running is None and solve_object.is_placed(obj)
        maps = painted(obj, solution.maps) if shown and files is None else solution.maps
        if target == IRPSO:
            return (write_maps(maps, obj.name, folder, kind) if files is None
                    else map_set.export(files, obj.name, folder, kind))
        lost: list[str] = []
        surfaces = shown_surfaces(obj, lost.append) if shown else solved_surfaces(obj, solution)
        paths, more = export_object(obj, maps if files is None else files, surfaces, target, folder)
        for line in (*lost, *more):
            self.report({"WARNING"}, line)
        return paths
