"""The arguments of every command.  The solve's own settings come from the table in core/params.py."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import Field, fields
from pathlib import Path
from typing import Any

from ..core.params import DeviceSettings, ExportSettings, ShootSettings, SolveSettings, Table, choice_name

KINDS = ("exr", "png", "tiff")
TILES = (512, 1024, 2048, 4096, 8192)  # texels
CALIBRATED = {  # what a solve may correct: its setting, and that setting's value where it may not
    "lamps": ("lamps", "given"), "cameras": ("registration", "given"), "exposures": ("exposures", "given"),
    "normals": ("normals", "mesh")}
EXIT_CODES = """\
exit codes: 0 done; 1 unexpected error; 2 wrong usage; 3 bad input (one line states which file or object, what is
wrong, what to do); 130 cancelled (the maps found so far are kept)"""


def parser() -> argparse.ArgumentParser:
    """The whole command line."""
    top = argparse.ArgumentParser(
        prog="irpso", description="Recover base colour and roughness textures of a Blender object from pictures of it",
        epilog=EXIT_CODES, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)

    for add in (_add_import, _add_lamps, _add_check, _add_solve, _add_compare, _add_export, _add_demo, _add_farm,
                _add_doctor):
        add(commands)
    for command in commands.choices.values():
        command.add_argument("--log", type=Path, metavar="FILE", help="also write the log to this file, one JSON "
                                                                      "object per line")
        command.add_argument("-v", "--verbose", action="store_true", help="print the log to standard error")
    return top


def _command(commands: Any, name: str, purpose: str) -> argparse.ArgumentParser:
    """A command, whose purpose stands in the list of commands and in its own help."""
    made: argparse.ArgumentParser = commands.add_parser(name, help=purpose, description=purpose, epilog=EXIT_CODES)
    return made


def _add_import(commands: Any) -> None:
    shoot = _command(commands, "import", "Import a photogrammetry project, its pictures and its mesh into a .blend")
    shoot.add_argument("project", type=Path, metavar="PROJECT", help="its cameras: Metashape XML, RealityScan CSV, the "
                       "folder of a COLMAP model, Meshroom .sfm, transforms.json, Alembic, USD")
    shoot.add_argument("--images", type=Path, metavar="DIR", required=True, help="folder of the pictures, RAW or "
                       "developed")
    shoot.add_argument("--mesh", type=Path, metavar="FILE", help="mesh that the program exported: OBJ, PLY, STL, FBX, "
                       "glTF, USD, Alembic (default: the one in the Alembic or USD file, or the only one beside the "
                       "project)")
    shoot.add_argument("--grey", nargs=5, metavar=("FILE", "X", "Y", "SIDE", "REFLECTANCE"), help="a grey card that "
                       "the picture FILE shows sets the flash's power: the middle of a square on it and the side, "
                       "pixels of the upright picture from its upper left corner; REFLECTANCE is from 0 to 1")
    shoot.add_argument("--chart", nargs=5, metavar=("FILE", "XW", "YW", "XB", "YB"), help="a color chart of 24 patches "
                       "that the picture FILE shows sets the tone curve of all views, and the flash's power if FILE "
                       "has a camera: the middles of its white and its black patch, pixels as above")
    shoot.add_argument("--out", type=Path, metavar="FILE.blend", required=True, help="file to write")
    add_settings(shoot, ShootSettings)


def _add_lamps(commands: Any) -> None:
    lamps = _command(commands, "lamps", "Place the lamps of a scene by chrome balls in its pictures")
    lamps.add_argument("scene", type=Path, metavar="SCENE.blend", help="a file with views, each under one lamp")
    lamps.add_argument("--ball", nargs=5, action="append", required=True, metavar=("CAMERA", "X", "Y", "R", "MM"),
                       help="a ball that all pictures of CAMERA show: a circle around it (middle and radius, pixels of "
                       "the upright picture from its upper left corner; 0 0 0: find it), and the ball's radius in mm; "
                       "once for each ball")
    lamps.add_argument("--out", type=Path, metavar="FILE.blend", required=True, help="file to write")


def _add_check(commands: Any) -> None:
    check = _command(commands, "check", "Find what is wrong with pictures, cameras and lamps before a solve, and show "
                                        "it as a picture")
    _add_scene(check)
    check.add_argument("--out", type=Path, metavar="FILE.png", help="picture to write (default: SCENE_check.png beside "
                       "the scene)")
    add_settings(check, DeviceSettings, without=("device", "kernels"))


def _add_solve(commands: Any) -> None:
    solve = _command(commands, "solve", "Find the maps of an object from a lit scene and its reference images")
    _add_scene(solve)
    solve.add_argument("--out", type=Path, metavar="DIR", help="folder for maps, report and solved .blend "
                       "(default: SCENE_irpso beside the scene)")
    part = solve.add_mutually_exclusive_group()
    part.add_argument("--vertex-group", metavar="NAME", help="solve where the weight of this vertex group is above "
                                                             "0.5; elsewhere the maps that the object carries are kept")
    part.add_argument("--part-image", type=Path, metavar="FILE", help="solve only where this image over the UV map is "
                                                                      "white")
    part.add_argument("--selected-faces", action="store_true", help="solve only the selected faces")
    solve.add_argument("--keep", action="append", default=[], metavar="NAME", help="a lamp or camera that was "
                       "measured: a solve does not change it; may be repeated")
    _add_calibrate(solve)
    solve.add_argument("--report", type=Path, metavar="FILE", help="also write report.json to this file")
    _add_format(solve)
    add_settings(solve, SolveSettings)
    add_settings(solve, DeviceSettings)


def _add_compare(commands: Any) -> None:
    compare = _command(commands, "compare", "Solve one scene with every method, and chart error against time")
    _add_scene(compare)
    compare.add_argument("--out", type=Path, metavar="DIR", help="folder for compare.json, .png and .svg "
                         "(default: SCENE_compare beside the scene)")
    compare.add_argument("--truth", type=Path, metavar="DIR", help="folder with the true maps, OBJECT_basecolor and "
                         "OBJECT_roughness, as 'solve' names them")
    compare.add_argument("--hold-out", type=_from(0), default=5, metavar="N", help="every N-th view is kept out of the "
                         "solves and predicted; 0: none, which needs --truth (default: 5)")
    compare.add_argument("--passes", type=_from(1), nargs="*", default=[100, 400, 1600], metavar="N",
                         help="method paper: its budgets; none: leave it out (default: 100 400 1600)")
    add_settings(compare, SolveSettings, without=("udim", "method", "iterations", "start", "normals"),
                 defaults={"size": 256, "model": "one-lobe"})
    add_settings(compare, DeviceSettings, without=("device",))


def _add_export(commands: Any) -> None:
    export = _command(commands, "export", "Write the maps of a solved scene to files")
    export.add_argument("scene", type=Path, metavar="SCENE.blend", help="a .blend whose materials hold the maps "
                        "of a solve")
    export.add_argument("--object", metavar="NAME", help="object whose maps to export; needed if several have maps")
    export.add_argument("--out", type=Path, metavar="DIR", help="folder for the maps (default: the scene's own)")
    add_settings(export, ExportSettings)
    _add_format(export)
    export.set_defaults(format=None)  # so that one that was asked for can be told


def _add_demo(commands: Any) -> None:
    demo = _command(commands, "demo", "Make a small scene, render it, recover its maps, and compare them with the "
                                      "truth")
    demo.add_argument("--out", type=Path, metavar="DIR", required=True, help="folder for everything it makes")


def _add_doctor(commands: Any) -> None:
    doctor = _command(commands, "doctor", "Report versions, device and limits, and run a short self-test")
    add_settings(doctor, DeviceSettings)


def _add_farm(commands: Any) -> None:
    """A job of many tasks, and the tasks themselves."""
    job = _command(commands, "job", "Write a solve of large maps as a job for a render farm (Open Job Description)")
    _add_scene(job)
    job.add_argument("--out", type=Path, metavar="DIR", help="folder of the job: template.yaml and all that its tasks "
                     "need (default: SCENE_job beside the scene)")
    job.add_argument("--tile", type=int, choices=TILES, default=2048, help="width and height of what one task solves, "
                     "texels; the maps do not depend on it (default: 2048)")
    job.add_argument("--any-worker", action="store_true", help="tasks may run on workers without a GPU, which need "
                     "Mesa's software OpenGL and take many times as long")
    _add_format(job)
    _add_calibrate(job)
    add_settings(job, SolveSettings)
    add_settings(job, DeviceSettings, without=("device",))

    tile = _command(commands, "tile", "One task of a job: solve a tile; needs no Blender")
    merge = _command(commands, "merge", "One task of a job: put the maps of a UDIM square together; needs no Blender")
    for task in (tile, merge):
        task.add_argument("work", type=Path, metavar="WORK", help="the job's work folder")
        task.add_argument("--udim", type=int, required=True, metavar="U", help="UDIM square; 1001 is from 0 to 1")
    tile.add_argument("--tile", type=_from(0), required=True, metavar="I", help="number of the tile in it, by rows "
                      "from the bottom left")
    tile.add_argument("--tile-size", type=_from(1), required=True, metavar="N", help="width and height of a tile, "
                      "texels")
    merge.add_argument("--out", type=Path, metavar="DIR", required=True, help="folder for the maps")
    _add_format(merge)


def _add_scene(command: argparse.ArgumentParser) -> None:
    command.add_argument("scene", type=Path, metavar="SCENE.blend", help="file with mesh, cameras and lights")
    command.add_argument("--captures", type=Path, help="captures.json that names the views (default: the scene's "
                         "own list, or else the cameras' background images)")
    command.add_argument("--object", metavar="NAME", help="mesh to solve for; needed where the scene has several")


def _from(low: int) -> Callable[[str], int]:
    """Reads a whole number that is not below ``low``."""

    def read(text: str) -> int:
        value = int(text)
        if value < low:
            raise argparse.ArgumentTypeError(f"{text}: must be at least {low}")
        return value

    read.__name__ = "int"  # argparse: "invalid int value: ..."
    return read


def _add_format(command: argparse.ArgumentParser) -> None:
    command.add_argument("--format", choices=KINDS, default="exr", help="of the maps: exr is 32-bit float and linear, "
                         "png and tiff are 16-bit with sRGB base colour (default: exr)")


def add_settings(
    command: argparse.ArgumentParser, table: type[Table], without: Sequence[str] = (),
    defaults: Mapping[str, Any] | None = None,
) -> None:
    """One flag per row of a parameter table, but for ``without``; ``defaults`` other than the table's."""
    for field in fields(table):
        if field.name in without:
            continue
        default = (defaults or {}).get(field.name, field.default)
        meta = field.metadata
        unit = f" {meta['unit']}" if meta["unit"] else ""
        named = "".join(f". {_choice(key)}: {doc}" for key, doc in meta["choices"])
        help_text = f"{meta['label']}: {meta['doc']} (default: {default}{unit}){named}".replace("%", "%%")
        choices = [key for key, _ in meta["choices"]] or None
        command.add_argument(f"--{field.name.replace('_', '-')}", dest=field.name, default=default,
                             type=_reader(field), choices=choices, help=help_text)


class _Calibrate(argparse.Action):
    """Sets what `CALIBRATED` names; a flag of a single setting that comes later overrides it."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None,
    ) -> None:
        named = {"auto": tuple(CALIBRATED), "off": ()}.get(values, tuple(values.split(",")))
        unknown = next((name for name in named if name not in CALIBRATED), None)
        if unknown is not None:
            raise argparse.ArgumentError(self, f"'{unknown}' is not known; choose auto, off, or some of "
                                               f"{','.join(CALIBRATED)}")
        for name, (setting, given) in CALIBRATED.items():
            setattr(namespace, setting, "auto" if name in named else given)


def _add_calibrate(command: argparse.ArgumentParser) -> None:
    flags = ", ".join(f"--{setting}" for setting, _ in CALIBRATED.values())
    command.add_argument("--calibrate", action=_Calibrate, metavar="WHAT", default=argparse.SUPPRESS, help="what of "
                         f"the scene a solve may correct: auto (all of it), off, or a list of {','.join(CALIBRATED)}; "
                         f"sets {flags} (default: auto)")


def _choice(key: str) -> str:
    """The key, and what the interface calls it where that differs."""
    name = choice_name(key)
    return key if name.lower() == key else f"{key} ({name})"


def settings(arguments: argparse.Namespace) -> SolveSettings:
    """The settings that the flags say; the table's own where the command has no such flag."""
    given = vars(arguments)
    return SolveSettings(**{field.name: given[field.name] for field in fields(SolveSettings) if field.name in given})


def device(arguments: argparse.Namespace) -> DeviceSettings:
    """What the flags say of the device; the table's own where the command has no such flag."""
    given = vars(arguments)
    return DeviceSettings(**{field.name: given[field.name] for field in fields(DeviceSettings) if field.name in given})


def _reader(field: Field[Any]) -> Callable[[str], Any]:
    """Reads a flag's text; out of range is wrong usage, with the table's own limits in the message."""
    low, high = field.metadata["low"], field.metadata["high"]

    def read(text: str) -> Any:
        value = field.type(text)  # type: ignore[operator]  # int, float or str: a class
        if low is not None and not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text}: must be between {low} and {high}")
        return value

    read.__name__ = getattr(field.type, "__name__", "value")  # argparse: "invalid int value: ..."
    return read
