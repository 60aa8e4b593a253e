"""The copy that a second Blender renders is saved without a thumbnail, and the user's preference comes back."""

from __future__ import annotations

import bpy
import pytest

from irpso_addon.blender.jobs import indirect


@pytest.mark.parametrize("chosen", ["AUTO", "SCREENSHOT", "NONE"])
def test_no_preview_is_rendered_for_the_copy(stage, chosen) -> None:
    paths, seen = bpy.context.preferences.filepaths, []
    paths.file_preview_type = chosen
    bpy.context.preferences.is_dirty = False

    def note(*_: object) -> None:
        seen.append(paths.file_preview_type)

    bpy.app.handlers.save_pre.append(note)
    try:
        made = indirect.IndirectRenderer.of_copy()
    finally:
        bpy.app.handlers.save_pre.remove(note)
    assert made.blend.exists() and seen == ["NONE"]
    assert paths.file_preview_type == chosen and not bpy.context.preferences.is_dirty
    made.copy.cleanup()
    with pytest.raises(ZeroDivisionError), indirect._no_preview():
        raise ZeroDivisionError
    assert paths.file_preview_type == chosen
    paths.file_preview_type = "AUTO"
