"""Blender operators, one per file, thin: poll, read, call, report.

May use irpso_addon.blender and the rooms below it; never cli.
"""

from .add_folder import IRPSO_OT_add_folder
from .add_rig import IRPSO_OT_add_rig
from .add_solve_preset import IRPSO_OT_add_solve_preset
from .add_view import IRPSO_OT_add_view
from .add_views import IRPSO_OT_add_views
from .apply_calibration import IRPSO_OT_apply_calibration
from .apply_remedy import IRPSO_OT_apply_remedy
from .bake_gbuffer import IRPSO_OT_bake_gbuffer
from .ball_list import IRPSO_OT_add_ball, IRPSO_OT_remove_ball
from .check_shoot import IRPSO_OT_check_shoot
from .choose_captures import IRPSO_OT_choose_captures
from .compare import IRPSO_OT_compare
from .denoise_normals import IRPSO_OT_denoise_normals
from .draw_ball import IRPSO_OT_draw_ball
from .edit_views import IRPSO_OT_edit_views
from .export_maps import IRPSO_OT_export_maps
from .exposures_by_exif import IRPSO_OT_exposures_by_exif
from .find_balls import IRPSO_OT_find_balls
from .grey_card import IRPSO_OT_grey_card
from .grey_chart import IRPSO_OT_grey_chart
from .import_shoot import IRPSO_OT_import_shoot
from .lamps_from_balls import IRPSO_OT_lamps_from_balls
from .load_captures import IRPSO_OT_load_captures
from .look_through_view import IRPSO_OT_look_back, IRPSO_OT_look_through_view
from .move_view import IRPSO_OT_move_view
from .paint_part import IRPSO_OT_paint_part
from .remove_duplicate_views import IRPSO_OT_remove_duplicate_views
from .remove_view import IRPSO_OT_remove_view
from .remove_view_light import IRPSO_OT_remove_view_light
from .restore_result import IRPSO_OT_restore_result
from .sample_scene import IRPSO_OT_sample_scene, IRPSO_OT_stop_sample
from .set_view_lights import IRPSO_OT_set_view_lights
from .show_check import IRPSO_OT_show_check
from .show_in_viewport import IRPSO_OT_show_in_viewport
from .show_views import IRPSO_OT_show_views
from .solve import IRPSO_OT_solve
from .sort_views import IRPSO_OT_sort_views
from .stop import IRPSO_OT_pause, IRPSO_OT_stop
from .test_device import IRPSO_OT_test_device
from .unwrap import IRPSO_OT_unwrap
from .write_maps import IRPSO_OT_write_maps

CLASSES = (
    IRPSO_OT_import_shoot,
    IRPSO_OT_grey_card,
    IRPSO_OT_grey_chart,
    IRPSO_OT_add_ball,
    IRPSO_OT_draw_ball,
    IRPSO_OT_remove_ball,
    IRPSO_OT_find_balls,
    IRPSO_OT_lamps_from_balls,
    IRPSO_OT_unwrap,
    IRPSO_OT_denoise_normals,
    IRPSO_OT_check_shoot,
    IRPSO_OT_show_check,
    IRPSO_OT_choose_captures,
    IRPSO_OT_load_captures,
    IRPSO_OT_add_folder,
    IRPSO_OT_add_views,
    IRPSO_OT_add_view,
    IRPSO_OT_add_rig,
    IRPSO_OT_remove_view,
    IRPSO_OT_remove_duplicate_views,
    IRPSO_OT_move_view,
    IRPSO_OT_sort_views,
    IRPSO_OT_edit_views,
    IRPSO_OT_exposures_by_exif,
    IRPSO_OT_look_through_view,
    IRPSO_OT_look_back,
    IRPSO_OT_set_view_lights,
    IRPSO_OT_remove_view_light,
    IRPSO_OT_bake_gbuffer,
    IRPSO_OT_paint_part,
    IRPSO_OT_solve,
    IRPSO_OT_add_solve_preset,
    IRPSO_OT_stop,
    IRPSO_OT_pause,
    IRPSO_OT_show_views,
    IRPSO_OT_show_in_viewport,
    IRPSO_OT_compare,
    IRPSO_OT_write_maps,
    IRPSO_OT_restore_result,
    IRPSO_OT_export_maps,
    IRPSO_OT_apply_calibration,
    IRPSO_OT_apply_remedy,
    IRPSO_OT_test_device,
    IRPSO_OT_sample_scene,
    IRPSO_OT_stop_sample,
)
