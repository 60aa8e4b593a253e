"""Test what computes, as ``irpso doctor`` does."""

import bpy

from ..irpso_addon.blender import preferences
from ..irpso_addon.core.errors import BadInput
from ..irpso_addon.gpu.device import thread
from ..irpso_addon.solve import device_test


class IRPSO_OT_test_device(bpy.types.Operator):
    """Solve a small scene with known maps, using these settings, and check the result"""

    bl_idname = "irpso.test_device"
    bl_label = "Test"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Not while it is tested."""
        if preferences.testing():
            cls.poll_message_set("The device is being detected")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """In the window it returns at once: the answer appears in the preferences."""
        if not bpy.app.background:
            preferences.test()
            return {"FINISHED"}
        thread.configure(preferences.device_settings())
        try:
            tested: device_test.DeviceTest = thread.run(device_test.test)
        except BadInput as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        shaders = "no" if tested.device.kernels == "numpy" else tested.device.kernels
        self.report({"INFO"}, f"{tested.device.renderer}, {tested.device.version}: {shaders} shaders, "
                    f"tested in {tested.seconds:.1f} s")
        return {"FINISHED"}
