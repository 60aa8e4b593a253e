"""irpso export: the maps that a solve left in a .blend, to files."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..blender import files
from ..core.maps import map_set
from ..core.maps.export import write_maps
from . import console


def run(arguments: argparse.Namespace) -> None:
    """The command.  Raises BadInput."""
    scene: Path = arguments.scene
    with console.quiet():
        files.open_blend(scene)
    obj = files.solved_object(arguments.object)
    out, kind, linked = arguments.out or scene.parent, arguments.format, files.map_files(obj)
    written = (write_maps(files.read_maps(obj), obj.name, out, kind) if linked is None
               else map_set.export(linked, obj.name, out, kind))
    for path in written:
        console.say(str(path))
