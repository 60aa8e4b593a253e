"""The IRPSO tab of the 3D viewport's sidebar, from top to bottom the order of the work; then the Image Editor's."""

from .. import presets
from ..viewer import wipe_gizmo
from . import panel_capture, panel_result, panel_shoot, panel_solve, panel_views

CLASSES = (*panel_shoot.CLASSES, *panel_capture.CLASSES, *panel_solve.CLASSES, *panel_result.CLASSES,
           *panel_views.CLASSES, *wipe_gizmo.CLASSES, *presets.CLASSES)
