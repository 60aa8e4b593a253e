"""irpso tile: one task of a job on a farm's worker.  Needs no Blender."""

from __future__ import annotations

import argparse

from ..gpu.device import thread
from ..solve import farm
from . import openjd


def run(arguments: argparse.Namespace) -> None:
    """The command.  Raises BadInput."""
    with openjd.percent_lines() as show:
        solved, blocks = thread.run(
            lambda: farm.solve_tile(arguments.work, arguments.udim, arguments.tile, arguments.tile_size),
            on_progress=show)
        openjd.status(f"UDIM {arguments.udim}, tile {arguments.tile}: {solved} of {blocks} blocks solved, the others "
                      "were already there")
