"""irpso job: the same solve as a job for a render farm, as an Open Job Description template."""

from __future__ import annotations

import argparse
import importlib.util
import shlex
import sys
from pathlib import Path

from ..blender import files
from ..blender.jobs.indirect import IndirectRenderer
from ..blender.material import material, material_preflight
from ..blender.scene.scene import read_scene
from ..core.images.reference_image import with_raw_size
from ..core.tiled.tiled_plan import Plan
from ..gpu.device import thread
from ..solve import farm
from . import console, options


def run(arguments: argparse.Namespace) -> None:
    """The command.  Raises BadInput."""
    device = options.device(arguments)
    thread.configure(device)
    scene: Path = arguments.scene
    folder: Path = arguments.out or scene.parent / f"{scene.stem}_job"
    with console.quiet():
        files.open_blend(scene)
    settings = options.settings(arguments)
    data = with_raw_size(read_scene(None, arguments.object, arguments.captures), settings)
    subject = files.object_named(data.mesh.name)
    material_preflight.check(subject, data.mesh.slots)
    files.require_own_files(subject)
    with console.progress() as show:
        plan: Plan = thread.run(lambda: farm.plan_job(
            data, settings, folder, IndirectRenderer.of_open_file(scene)), on_progress=show)
    maps = folder / farm.MAPS
    for message in (*plan.solution.warnings, *material.link_maps(subject, plan.solution, maps, arguments.format,
                                                                 plan.udims)):
        console.warn(f"warning: {message}")
    with console.quiet():
        files.save_copy(maps / f"{data.name}_irpso.blend")
    job = farm.write_job(plan, folder, arguments.tile, arguments.format,
                         None if arguments.any_worker else device.memory)
    squares = len(job.udims)
    console.say(f"{folder}: {squares * job.tiles} x Solve ({job.tile} x {job.tile} texels each), "
                f"then {squares} x Merge")
    console.say(f"{maps}: the maps, when these are done, and the scene with them on its material")
    console.say(f"on this machine: openjd run {shlex.quote(str(folder / farm.TEMPLATE))} -p Python={_python()}")


def _python() -> str:
    """A Python for tasks: this one, unless it is Blender's own, which finds moderngl in the extension alone."""
    moderngl = importlib.util.find_spec("moderngl")
    ours = moderngl is not None and moderngl.origin is not None and Path(moderngl.origin).is_relative_to(sys.prefix)
    return shlex.quote(sys.executable) if ours else "PYTHON (with numpy, moderngl, threadpoolctl and OpenImageIO)"
