"""Blender operators, one per file, thin: poll, read, call, report.

May use irpso_addon.blender and the rooms below it; never cli.
"""

from .add_folder import IRPSO_OT_add_folder
from .add_rig import IRPSO_OT_add_rig
from .add_solve_preset import IRPSO_OT_add_solve_preset
from .add_view import IRPSO_OT_add_view
from .add_views import IRPSO_OT_add_views
from .bake_gbuffer import IRPSO_OT_bake_gbuffer
from .compare import IRPSO_OT_compare
from .export_maps import IRPSO_OT_export_maps
from .load_captures import IRPSO_OT_load_captures
from .move_view import IRPSO_OT_move_view
from .paint_part import IRPSO_OT_paint_part
from .remove_duplicate_views import IRPSO_OT_remove_duplicate_views
from .remove_view import IRPSO_OT_remove_view
from .remove_view_light import IRPSO_OT_remove_view_light
from .sample_scene import IRPSO_OT_sample_scene, IRPSO_OT_stop_sample
from .set_view_lights import IRPSO_OT_set_view_lights
from .show_views import IRPSO_OT_show_views
from .solve import IRPSO_OT_solve
from .sort_views import IRPSO_OT_sort_views
from .stop import IRPSO_OT_pause, IRPSO_OT_stop
from .test_device import IRPSO_OT_test_device
from .write_maps import IRPSO_OT_write_maps

CLASSES = (
    IRPSO_OT_load_captures,
    IRPSO_OT_add_folder,
    IRPSO_OT_add_views,
    IRPSO_OT_add_view,
    IRPSO_OT_add_rig,
    IRPSO_OT_remove_view,
    IRPSO_OT_remove_duplicate_views,
    IRPSO_OT_move_view,
    IRPSO_OT_sort_views,
    IRPSO_OT_set_view_lights,
    IRPSO_OT_remove_view_light,
    IRPSO_OT_bake_gbuffer,
    IRPSO_OT_paint_part,
    IRPSO_OT_solve,
    IRPSO_OT_add_solve_preset,
    IRPSO_OT_stop,
    IRPSO_OT_pause,
    IRPSO_OT_show_views,
    IRPSO_OT_compare,
    IRPSO_OT_write_maps,
    IRPSO_OT_export_maps,
    IRPSO_OT_test_device,
    IRPSO_OT_sample_scene,
    IRPSO_OT_stop_sample,
)
