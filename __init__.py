"""IRPSO, a Blender extension: recovers base colour and roughness textures from pictures of an object.

Only Blender's two entry points are here; the imports are inside them, so that the package can be
imported where there is no bpy.
"""


def register() -> None:
    """Called by Blender when the extension is enabled."""
    from .irpso_addon.blender import registration
    from .operators import CLASSES

    registration.register(CLASSES, _command)


def unregister() -> None:
    """Called by Blender when the extension is disabled."""
    from .irpso_addon.blender import registration

    registration.unregister()


def _command(argv: list[str]) -> int:
    """``blender --command irpso``; imported when it is called, because every start of Blender would pay for it."""
    from .irpso_addon.__main__ import main

    return main(argv)
