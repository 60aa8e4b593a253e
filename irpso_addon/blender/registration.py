"""Everything the add-on registers, in order; unregistered in reverse.  Errors are raised, not printed."""

from __future__ import annotations

import atexit
from collections.abc import Sequence
from typing import Any

import bpy

from . import (
    jobs,
    live,
    panels,
    preferences,
    presets,
    properties,
    sample,
    session,
    thumbnails,
    view_draw,
    view_properties,
    views,
)
from .oiio import ensure_openimageio

COMMAND = "irpso"

_command_handle: Any = None
_operators: Sequence[type] = ()
_PARTS = (view_properties, views, view_draw, sample, presets)  # that register more than classes


def register(operators: Sequence[type]) -> None:
    """Registers properties, operators, panels, the load handler and ``blender --command irpso``.

    The root package hands in the operators: nothing in ``irpso_addon`` imports above itself.
    """
    global _command_handle, _operators
    _operators = tuple(operators)
    ensure_openimageio()
    properties.register()
    for cls in (*_operators, *preferences.CLASSES, *panels.CLASSES):
        bpy.utils.register_class(cls)
    for part in _PARTS:
        part.register()
    bpy.app.handlers.load_pre.append(session.forget)
    bpy.app.handlers.save_pre.append(live.on_save)
    bpy.app.handlers.undo_post.append(live.on_undo)
    bpy.app.handlers.redo_post.append(live.on_redo)
    _command_handle = bpy.utils.register_cli_command(COMMAND, _command)
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
    bpy.app.handlers.load_pre.remove(session.forget)
    bpy.app.handlers.save_pre.remove(live.on_save)
    bpy.app.handlers.undo_post.remove(live.on_undo)
    bpy.app.handlers.redo_post.remove(live.on_redo)
    for part in reversed(_PARTS):
        part.unregister()
    for cls in reversed((*_operators, *preferences.CLASSES, *panels.CLASSES)):
        bpy.utils.unregister_class(cls)
    properties.unregister()


def _command(argv: list[str]) -> int:
    from ..__main__ import main  # here, because every start of Blender would pay for it

    return main(argv)
