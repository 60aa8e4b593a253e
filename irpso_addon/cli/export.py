"""irpso export: the maps that a solve left in a .blend, to files."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..blender import files
from ..blender.export_object import export_object
from ..blender.material.surfaces import shown_surfaces
from ..core.errors import BadInput
from ..core.maps import map_set
from ..core.maps.export import write_maps
from ..core.maps.targets import IRPSO
from . import console


def run(arguments: argparse.Namespace) -> None:
    """The command.  Raises BadInput."""
    scene: Path = arguments.scene
    target: str = arguments.target
    if target != IRPSO and arguments.format is not None:
        raise BadInput(f"--format {arguments.format}: target {target} sets its own formats; omit --format")
    with console.quiet():
        files.open_blend(scene)
    obj = files.solved_object(arguments.object)
    files.require_own_files(obj)
    out, kind, linked = arguments.out or scene.parent, arguments.format or "exr", files.map_files(obj)
    if target != IRPSO:
        lost: list[str] = []
        surfaces = shown_surfaces(obj, lost.append)
        maps = files.read_maps(obj) if linked is None else linked
        written, more = export_object(obj, maps, surfaces, target, out)
        for line in (*lost, *more):
            console.warn(f"warning: {line}")
    else:
        written = (write_maps(files.read_maps(obj), obj.name, out, kind) if linked is None
                   else map_set.export(linked, obj.name, out, kind))
    for path in written:
        console.say(str(path))
