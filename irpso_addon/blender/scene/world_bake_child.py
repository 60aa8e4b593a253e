"""What the second Blender does (see world_bake.py): render the world to a file."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import bpy

from ..oiio import ensure_openimageio
from ..second_blender import as_child
from .world_bake import BLEND, BRIGHT, HEIGHT, PICTURE, SAMPLES, bright_part, seen


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
    scene.world.cycles.sampling_method = "NONE"  # it lights nothing here, and its map takes a second
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
    render.image_settings.color_mode, render.use_file_extension = "RGBA", False
    _to_file(folder / PICTURE)
    ensure_openimageio()
    again = bright_part(seen(folder))
    if again is not None:
        (left, bottom, right, top), cycles.samples = again
        render.use_border, render.use_crop_to_border = True, False
        render.border_min_x, render.border_max_x = left / (2 * HEIGHT), right / (2 * HEIGHT)
        render.border_min_y, render.border_max_y = bottom / HEIGHT, top / HEIGHT
        _to_file(folder / BRIGHT)


def _to_file(path: Path) -> None:
    """Renders the scene."""
    part = path.with_name("part-" + path.name)
    bpy.context.scene.render.filepath = str(part)
    bpy.ops.render.render(write_still=True)
    os.replace(part, path)


def _as_surfaces_see(world: Any) -> None:
    """What is for the camera's rays alone is for none, and values stay as they were when the file was written.

    Raises ValueError for light that depends on more than its direction, and for images that are not there.
    """
    output = world.node_tree.get_output_node("CYCLES")
    for link in list(output.inputs["Volume"].links):
        world.node_tree.links.remove(link)
    for owner in (world.node_tree, *bpy.data.node_groups, *bpy.data.objects):
        owner.animation_data_clear()
    for tree in (world.node_tree, *bpy.data.node_groups):
        _without_camera_rays(tree)
    for node in _used(output):
        _check(node)


def _without_camera_rays(tree: Any) -> None:
    """Is Camera Ray is 0, and what a mix shows for 1 is not looked at."""
    zero = tree.nodes.new("ShaderNodeValue").outputs[0]
    zero.default_value = 0.0
    asking = [link for link in tree.links
              if link.from_node.type == "LIGHT_PATH" and link.from_socket.name == "Is Camera Ray"]
    for socket in [socket for link in asking for socket in _ends(link)]:
        tree.links.new(zero, socket)
        if socket.node.type == "MIX_SHADER":
            for unseen in list(socket.node.inputs[2].links):
                tree.links.remove(unseen)


def _ends(link: Any) -> list[Any]:
    """The sockets that a link reaches, past reroutes."""
    if link.to_node.type != "REROUTE":
        return [link.to_socket]
    return [socket for further in link.to_node.outputs[0].links for socket in _ends(further)]


def _used(output: Any) -> list[Any]:
    """The nodes that an output node depends on, those in groups too."""
    waiting, found = [output], []
    while waiting:
        node = waiting.pop()
        if node in found:
            continue
        found.append(node)
        waiting += [link.from_node for socket in node.inputs for link in socket.links]
        if node.type == "GROUP" and node.node_tree is not None:
            waiting += [inner for inner in node.node_tree.nodes if inner.type == "GROUP_OUTPUT"]
    return found


def _check(node: Any) -> None:
    """Raises ValueError."""
    outputs = {output.name for output in node.outputs if output.is_linked}
    unknown = {"TEX_COORD": outputs & {"Camera", "Window"}, "CAMERA": outputs, "LIGHT_PATH": outputs}
    for name in sorted(unknown.get(node.type, ())):
        raise ValueError(f"its {node.bl_label} node uses '{name}', which is not modelled")
    if node.type == "VECT_TRANSFORM" and "CAMERA" in {node.convert_from, node.convert_to}:
        raise ValueError(f"its {node.bl_label} node uses the camera's space, which is not modelled")
    if node.type not in {"TEX_ENVIRONMENT", "TEX_IMAGE"}:
        return
    image = node.image
    if image is None:
        raise ValueError(f"its {node.bl_label} node has no image")
    if image.source not in {"FILE", "GENERATED"}:
        raise ValueError(f"its image '{image.name}' is not a single picture")
    path = bpy.path.abspath(image.filepath, library=image.library)
    if image.source == "FILE" and image.packed_file is None and not Path(path).is_file():
        raise ValueError(f"its image '{path}' does not exist")
