"""Add a rig of cameras and lamps around the active object."""

import math

import bpy
from bpy.props import EnumProperty, FloatProperty, IntProperty

from ..irpso_addon.blender.jobs.session import session
from ..irpso_addon.blender.sample import rigs
from ..irpso_addon.core.errors import BadInput
from ..irpso_addon.core.phrases import counted

ITEMS = tuple((key, name, text) for key, (name, text) in rigs.KINDS.items())
DEFAULTS = {  # cameras, lamps, low, high in degrees
    "FLASH": (20, 1, -10.0, 60.0),
    "DOME": (4, 12, -5.0, 25.0),
    "TURNTABLE": (12, 3, 10.0, 35.0),
}
ROWS = {
    "FLASH": {"cameras": "Photographs", "offset": "Flash Offset", "low": "Elevation Low", "high": "High"},
    "DOME": {"cameras": "Cameras", "lamps": "Lamps", "low": "Elevation Low", "high": "High"},
    "TURNTABLE": {"cameras": "Turns", "lamps": "Lamps", "high": "Camera Elevation", "low": "Low Lamps"},
}


def _angle(name: str, text: str, low: float, high: float, default: float) -> object:
    low, high, default = (math.radians(angle) for angle in (low, high, default))
    return FloatProperty(name=name, description=text, subtype="ANGLE", min=low, max=high, default=default)


class IRPSO_OT_add_rig(bpy.types.Operator):
    """Add cameras and lamps around the active object, and a view in the list for each picture to take"""

    bl_idname = "irpso.add_rig"
    bl_label = "Add Rig"
    bl_options = {"REGISTER", "UNDO"}

    def _set_defaults(self, _context: bpy.types.Context) -> None:
        self.cameras, self.lamps, low, high = DEFAULTS[self.kind]
        self.low, self.high = math.radians(low), math.radians(high)

    kind: EnumProperty(name="Rig", description="Arrangement of cameras and lamps", items=ITEMS, update=_set_defaults)
    cameras: IntProperty(
        name="Cameras", description="Number of cameras, or of turns of the turntable", default=DEFAULTS["FLASH"][0],
        min=1, max=500)
    lamps: IntProperty(
        name="Lamps", description="Number of lamps of the dome, or beside the turntable", default=DEFAULTS["FLASH"][1],
        min=1, max=26)
    low: _angle("Low", "Elevation of the lowest above the object's middle, in degrees", -80, 89, -10)
    high: _angle("High", "Elevation of the highest above the object's middle, in degrees", -80, 89, 60)
    distance: FloatProperty(
        name="Distance", description="Distance from the object, relative to the distance at which it fills the picture",
        default=1.0, min=0.2, max=10.0, soft_max=3.0, subtype="FACTOR", options={"SKIP_SAVE"})
    offset: _angle("Flash Offset", "Angle between flash and camera, seen from the object, in degrees", 0, 45, 10)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A mesh to stand around, and a list that is in use."""
        if session.running is not None:
            cls.poll_message_set("A job is running: wait, or stop it first")
        elif context.active_object is None or context.active_object.type != "MESH":
            cls.poll_message_set("Make a mesh object active")
        elif context.mode != "OBJECT":
            cls.poll_message_set("Leave Edit Mode first")
        elif context.scene.irpso.captures:
            cls.poll_message_set("A captures file is in use: load it into the list, or clear it")
        else:
            return True
        return False

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """With the defaults of its kind; the redo panel changes them."""
        self._set_defaults(context)
        return self.execute(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Makes it, and says how many pictures it expects where."""
        given = {name: getattr(self, name) for name in ("cameras", "lamps", "low", "high")
                 if self.properties.is_property_set(name)}
        self._set_defaults(context)  # what a script leaves out
        for name, value in given.items():
            setattr(self, name, value)
        plan = rigs.Plan(self.kind, self.cameras, self.lamps, self.low, self.high, self.distance, self.offset)
        try:
            rig = rigs.build(context.scene, context.active_object, plan)
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{rig.collection.name}: {counted(len(rig.cameras), 'camera')}, "
                    f"{counted(len(rig.lamps), 'lamp')}, {counted(len(rig.shots), 'view')}; put their images into "
                    f"//{rig.collection.name}")
        return {"FINISHED"}

    def draw(self, _context: bpy.types.Context) -> None:
        """What its kind has."""
        layout = self.layout
        layout.use_property_split, layout.use_property_decorate = True, False
        layout.prop(self, "kind")
        for name, text in ROWS[self.kind].items():
            layout.prop(self, name, text=text)
        layout.prop(self, "distance")
