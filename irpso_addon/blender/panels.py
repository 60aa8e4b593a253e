"""The IRPSO tab of the 3D viewport's sidebar, from top to bottom the order of the work."""

from . import panel_capture, panel_result, panel_solve

CLASSES = (*panel_capture.CLASSES, *panel_solve.CLASSES, *panel_result.CLASSES)
