"""Everything the add-on registers, in order; unregistered in reverse.  Errors are raised, not printed."""

from __future__ import annotations

import atexit
from collections.abc import Callable, Sequence
from typing import Any

import bpy

from . import preferences, presets, properties
from .jobs import jobs, live_display, stored_result
from .jobs.session import on_load, session
from .oiio import ensure_openimageio
from .sample import sample
from .scene import thumbnails
from .shoot import picture_draw
from .ui import panels
from .viewer import editors, places_draw, view_draw, view_properties, views

COMMAND = "irpso"

_command_handle: Any = None
_operators: Sequence[type] = ()
# That register more than classes:
_PARTS = (view_properties, views, editors, view_draw, places_draw, picture_draw, sample, presets)


def register(operators: Sequence[type], command: Callable[[list[str]], int]) -> None:
    """Registers properties, operators, panels, the load handler and ``blender --command irpso``.

    The root package hands in the operators and the command line: nothing in ``irpso_addon`` imports above itself.
    """
    global _command_handle, _operators
    _operators = tuple(operators)
    ensure_openimageio()
    properties.register()
    for cls in (*_operators, *preferences.CLASSES, *panels.CLASSES):
        bpy.utils.register_class(cls)
    for part in _PARTS:
        part.register()
    bpy.app.handlers.load_pre.append(on_load)
    bpy.app.handlers.load_post.append(stored_result.on_load)
    bpy.app.handlers.save_pre.append(stored_result.on_save)
    bpy.app.handlers.save_pre.append(live_display.on_save)
    bpy.app.handlers.undo_post.append(live_display.on_undo)
    bpy.app.handlers.redo_post.append(live_display.on_redo)
    _command_handle = bpy.utils.register_cli_command(COMMAND, command)
    if bpy.app.module:
        atexit.register(unregister)  # as in properties.py


def unregister() -> None:
    """Stops a running job and takes back everything that `register` did."""
    atexit.unregister(unregister)
    bpy.utils.unregister_cli_command(_command_handle)
    session.forget()
    if session.running is not None:
        session.running.leave()
    jobs.cool_down()
    preferences.forget()
    thumbnails.release()
    bpy.app.handlers.load_pre.remove(on_load)
    bpy.app.handlers.load_post.remove(stored_result.on_load)
    bpy.app.handlers.save_pre.remove(stored_result.on_save)
    bpy.app.handlers.save_pre.remove(live_display.on_save)
    bpy.app.handlers.undo_post.remove(live_display.on_undo)
    bpy.app.handlers.redo_post.remove(live_display.on_redo)
    for part in reversed(_PARTS):
        part.unregister()
    for cls in reversed((*_operators, *preferences.CLASSES, *panels.CLASSES)):
        bpy.utils.unregister_class(cls)
    properties.unregister()
