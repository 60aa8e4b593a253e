"""irpso lamps: the lamps of a scene, by chrome balls in its pictures."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from ..blender import files
from ..blender.shoot.ball_lamps import place_lamps_of_scene
from ..core.errors import BadInput
from ..core.phrases import counted
from ..core.storage.output_transaction import OutputTransaction
from . import console


def run(arguments: argparse.Namespace) -> None:
    """The command.  Raises BadInput; then nothing is written."""
    out: Path = arguments.out
    if out.suffix.lower() != ".blend":
        raise BadInput(f"{out}: must end in .blend; change --out")
    balls = [_ball(given) for given in arguments.ball]
    folder = out.resolve().parent
    with OutputTransaction(folder) as staging:
        with console.quiet():
            files.open_blend(arguments.scene)
            placed = place_lamps_of_scene(balls)
            files.keep_pictures(folder)
            files.save_copy(staging.beside(out.name))
        staging.publish()
    for message in placed.messages:
        console.warn(message)
    console.say(f"{out}: {counted(len(placed.lamps), 'lamp')} by {counted(len(placed.balls), 'ball')}; "
                f"next: irpso solve {out}")


def _ball(given: list[str]) -> tuple[str, tuple[float, ...]]:
    """Of --ball CAMERA X Y R MM: the camera's name and the four numbers.  Raises BadInput."""
    camera, *texts = given
    try:
        numbers = tuple(map(float, texts))
    except ValueError:
        numbers = ()
    if not numbers or not all(map(math.isfinite, numbers)) or min(numbers[2:]) < 0 or numbers[3] == 0:
        raise BadInput(f"--ball {' '.join(given)}: X, Y, R and MM must be numbers, R and MM positive, for example "
                       f"--ball {camera} 812 640 90 25, or 0 0 0 25 to find the circle")
    return camera, numbers
