"""What the second Blender does (see world_bake.py): render the world to a file."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import bpy

from ..second_blender import as_child
from .world_bake import BLEND, HEIGHT, PICTURE, SAMPLES


def main(name: str) -> None:
    """Does the job in the folder ``name`` and ends the process; says in one line on stderr why it could not."""
    as_child(lambda: _render(Path(name)))


def _render(folder: Path) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(folder / BLEND)) as (there, here):
        here.worlds = there.worlds[:1]
    scene = bpy.context.scene
    scene.world = here.worlds[0]
    _as_surfaces_see(scene.world)
    camera = bpy.data.objects.new("Panorama", bpy.data.cameras.new("Panorama"))
    scene.collection.objects.link(camera)
    camera.rotation_euler = (math.pi / 2, 0.0, -math.pi / 2)  # the middle of Blender's mapping is +X
    data: Any = camera.data
    data.type = "PANO"
    (data if hasattr(data, "panorama_type") else data.cycles).panorama_type = "EQUIRECTANGULAR"
    scene.camera = camera
    render: Any = scene.render
    render.engine, render.film_transparent = "CYCLES", False
    render.resolution_x, render.resolution_y, render.resolution_percentage = 2 * HEIGHT, HEIGHT, 100
    if hasattr(render.image_settings, "media_type"):  # Blender 5
        render.image_settings.media_type = "IMAGE"
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    cycles: Any = scene.cycles
    cycles.device, cycles.samples = "CPU", SAMPLES
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
    cycles.pixel_filter_type, cycles.film_exposure = "BOX", 1.0
    render.filepath, render.use_file_extension = str(folder / ("part-" + PICTURE)), False
    bpy.ops.render.render(write_still=True)
    os.replace(folder / ("part-" + PICTURE), folder / PICTURE)


def _as_surfaces_see(world: Any) -> None:
    """What is for the camera's rays alone is for none."""
    for node in world.node_tree.nodes:
        if node.type != "LIGHT_PATH":
            continue
        for output in node.outputs:
            if output.is_linked and output.name != "Is Camera Ray":
                raise ValueError(f"its Light Path node uses '{output.name}', which is not modelled")
            for link in list(output.links):
                socket = link.to_socket
                world.node_tree.links.remove(link)
                socket.default_value = 0.0
