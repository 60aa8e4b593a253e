"""irpso import: a photogrammetry project, its pictures and its mesh to a .blend that can be solved."""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import fields
from pathlib import Path

from ..blender import files
from ..blender.shoot.grey_card import GreyCard
from ..blender.shoot.grey_chart import GreyChart
from ..blender.shoot.import_shoot import Shoot, import_shoot
from ..core.errors import BadInput
from ..core.job import run_to_end
from ..core.params import ShootSettings
from ..core.phrases import counted
from ..core.storage.output_transaction import OutputTransaction
from . import console


def run(arguments: argparse.Namespace) -> None:
    """The command.  Raises BadInput; then nothing is written."""
    started = time.perf_counter()
    out: Path = arguments.out
    if out.suffix.lower() != ".blend":
        raise BadInput(f"{out}: must end in .blend; change --out")
    if os.path.lexists(out):
        raise BadInput(f"{out}: already exists, and an import replaces no file; change --out, or move the file away")
    if arguments.grey is not None and arguments.rig == "lamps":
        raise BadInput("--grey: sets the power of the flash, and --rig lamps brings no lamp; leave --grey out, place "
                       "the lamps, and click the grey card in Blender")
    folder = out.resolve().parent
    given = vars(arguments)
    settings = ShootSettings(**{field.name: given[field.name] for field in fields(ShootSettings)})
    with OutputTransaction(folder) as staging:
        with console.progress() as show, console.quiet():
            files.new_blend()
            shoot = Shoot(arguments.project, arguments.images, arguments.mesh, _grey_card(arguments.grey),
                          _grey_chart(arguments.chart, arguments.images))
            steps = import_shoot(shoot, settings, lambda path: files.relative_path(path, folder))
            imported = run_to_end(steps, show)
            name = imported.mesh.name
            files.save_copy(staging.beside(out.name))
        staging.publish()
    for message in imported.messages:
        console.warn(message)
    console.say(f"{out}: object '{name}', {counted(imported.views, 'view')} in {time.perf_counter() - started:.1f} s; "
                f"next: irpso check {out}, then irpso solve {out}")


def _grey_card(given: list[str] | None) -> GreyCard | None:
    """Of --grey FILE X Y SIDE REFLECTANCE.  Raises BadInput."""
    if given is None:
        return None
    picture, *texts = given
    try:
        return GreyCard(picture, *map(float, texts))
    except ValueError:
        raise BadInput(f"--grey {' '.join(given)}: X, Y, SIDE and REFLECTANCE must be numbers, for example "
                       f"--grey {picture} 812 640 40 0.18") from None


def _grey_chart(given: list[str] | None, images: Path) -> GreyChart | None:
    """Of --chart FILE XW YW XB YB.  Raises BadInput."""
    if given is None:
        return None
    picture, *texts = given
    try:
        left, upper, right, lower = map(float, texts)
    except ValueError:
        raise BadInput(f"--chart {' '.join(given)}: XW, YW, XB and YB must be numbers, for example --chart {picture} "
                       "812 640 412 644") from None
    inside = images / picture
    return GreyChart(str(inside if inside.is_file() else picture), (left, upper), (right, lower))
