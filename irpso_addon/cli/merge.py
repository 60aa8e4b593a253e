"""irpso merge: the maps of a UDIM square from its blocks, as a task of a job.  Needs no Blender."""

from __future__ import annotations

import argparse

from ..solve import farm
from . import openjd


def run(arguments: argparse.Namespace) -> None:
    """The command.  Raises BadInput."""
    with openjd.percent_lines() as show:
        for step in farm.merge_square(arguments.work, arguments.udim, arguments.out, arguments.format):
            show(step)
        openjd.status(f"UDIM {arguments.udim}: its maps are in {arguments.out}")
