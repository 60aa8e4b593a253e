"""What the object's materials say before the solve: normal maps to keep, and what the solver does not model."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ...core.data import F32
from ...core.errors import BadInput
from ...core.images.colour import known_space, to_linear_rec709
from ..material.solved_socket import COAT_WEIGHT, DIFFUSE_ROUGHNESS, LEVEL, METALLIC, NORMAL
from ..material.tags import TAG
from ..material.two_lobe import is_two_lobe, lobe_of

Warn = Callable[[str], None]

# Principled inputs and their values in the model that is solved (Cycles' Principled, dielectric, opaque).
_MODELLED: dict[str, float] = {
    "Metallic": 0.0, "IOR": 1.5, "Alpha": 1.0, "Diffuse Roughness": 0.0, "Subsurface Weight": 0.0,
    "Specular IOR Level": 0.5, "Anisotropic": 0.0, "Transmission Weight": 0.0, "Coat Weight": 0.0,
    "Sheen Weight": 0.0, "Emission Strength": 0.0, "Thin Film Thickness": 0.0,
}
TINT = "Specular Tint"  # of which the model's is white


@dataclass(frozen=True)
class SlotNormalMap:
    """A tangent-space normal map in use, with the UV map that its tangents follow ("": the active one)."""

    pixels: F32  # (h, w, 3) as Cycles' Normal Map node receives it, row 0 bottom
    strength: float
    uv_map: str


def read_normal_maps(obj: Any, warn: Warn) -> dict[int, SlotNormalMap]:
    """The normal maps of ``obj``'s slots; warns of every other thing that the solver does not model."""
    found: dict[int, SlotNormalMap] = {}
    if not any(slot.material for slot in obj.material_slots):
        warn(f"object '{obj.name}': has no material; Principled BSDF is assumed")
    for index, slot in enumerate(obj.material_slots):
        if slot.material is None:
            continue
        principled = find_principled(slot.material)
        if principled is None:
            warn(f"material '{slot.material.name}': its surface is not a Principled BSDF; one is assumed")
            continue
        _name_differences(slot.material, principled, warn)
        if slot.material.node_tree.get_output_node("CYCLES").inputs["Displacement"].is_linked:
            warn(f"material '{slot.material.name}': Displacement is not modelled; the mesh is read without it")
        normal_map = normal_map_of(slot.material, principled, warn)
        if normal_map is not None:
            found[index] = normal_map
            if slot.material.cycles.use_bump_map_correction:
                warn(f"material '{slot.material.name}': Bump Map Correction is on and not modelled; switch it off "
                     "in its settings, or expect errors near shadow edges")
    return found


def find_principled(material: Any) -> Any | None:
    """The Principled BSDF that the active output shows, or our group in its place; None when there is neither."""
    if material.node_tree is None or (bpy.app.version < (5, 0, 0) and not material.use_nodes):
        return None
    output = material.node_tree.get_output_node("CYCLES")
    node = None if output is None else _source(output.inputs["Surface"])[0]
    return node if node is not None and (node.type == "BSDF_PRINCIPLED" or is_two_lobe(node)) else None


def _source(socket: Any) -> tuple[Any | None, Any | None]:
    """Node and output socket that feed ``socket``, reroutes followed; None where nothing does."""
    for _ in range(100):
        if not socket.is_linked:
            return None, None
        link = socket.links[0]
        if link.from_node.type != "REROUTE":
            return link.from_node, link.from_socket
        socket = link.from_node.inputs[0]
    return None, None


def _name_differences(material: Any, principled: Any, warn: Warn) -> None:
    for name, value in differences(principled):
        if any(name == solved.name and solved.tag in principled for solved in (
                LEVEL, METALLIC, COAT_WEIGHT, DIFFUSE_ROUGHNESS)):
            continue  # a solve has set it, and the next one will decide anew
        if name == TINT:
            warn(f"material '{material.name}': {TINT} is not modelled; white is assumed")
        elif value is None:
            warn(f"material '{material.name}': {name} is linked and not modelled; {_MODELLED[name]:g} is assumed")
        else:
            warn(f"material '{material.name}': {name} is {value:.3g} and not modelled; {_MODELLED[name]:g} is assumed")
    lobe = lobe_of(principled)
    if lobe is not None and lobe.distribution != "MULTI_GGX":
        warn(f"material '{material.name}': distribution {lobe.distribution} is not modelled; "
             "Multiscatter GGX is assumed")


def differences(principled: Any) -> Iterator[tuple[str, float | None]]:
    """The inputs that differ from the model, with their values; None: linked, or a colour."""
    for name, modelled in _MODELLED.items():
        socket = principled.inputs.get(name)
        if socket is None:
            continue
        if name == "Emission Strength" and not any(principled.inputs["Emission Color"].default_value[:3]):
            continue
        if _source(socket)[0] is not None:
            yield name, None
        elif abs(socket.default_value - modelled) > 1e-4:
            yield name, socket.default_value
    tint = principled.inputs.get(TINT)
    if tint is not None and (_source(tint)[0] is not None or min(tint.default_value[:3]) < 0.9999):
        yield TINT, None


def normal_map_of(material: Any, principled: Any, warn: Warn) -> SlotNormalMap | None:
    """The normal map that ``principled`` has; warns of one that cannot be read.  Raises BadInput for a broken image.

    Where a solve has linked its own, what was there before: the next solve decides anew.
    """
    node, _ = _source(principled.inputs["Normal"])
    if node.get(TAG) == NORMAL.role if node is not None else NORMAL.tag in principled:
        node = _before_solve(material.node_tree)
    if node is None:
        return None

    def unsupported(what: str) -> None:
        warn(f"material '{material.name}': {what}; its normals are left out")

    if node.type != "NORMAL_MAP":
        return unsupported(f"Normal comes from node '{node.name}', not from a Normal Map node")
    if node.space != "TANGENT":
        return unsupported(f"normal map '{node.name}' is in {node.space.lower().replace('_', ' ')} space, not tangent")
    if getattr(node, "convention", "OPENGL") != "OPENGL":
        return unsupported(f"normal map '{node.name}' has the {node.convention} convention, not OpenGL")
    if _source(node.inputs["Strength"])[0] is not None:
        return unsupported(f"Strength of normal map '{node.name}' is linked")
    texture, output = _source(node.inputs["Color"])
    if texture is None:
        return None  # a constant colour: the node's default is the smooth normal
    if texture.type != "TEX_IMAGE" or output.name != "Color":
        return unsupported(f"normal map '{node.name}' is fed by node '{texture.name}', not by an Image Texture")
    mapping, _ = _source(texture.inputs["Vector"])
    if mapping is not None and not (mapping.type == "UVMAP" and mapping.uv_map == node.uv_map):
        return unsupported(f"Image Texture '{texture.name}' of the normal map has its own coordinates")
    if texture.projection != "FLAT" or texture.extension != "REPEAT":
        return unsupported(f"Image Texture '{texture.name}' of the normal map is not flat and repeating")
    pixels = _pixels(material, texture, warn)
    return None if pixels is None else SlotNormalMap(pixels, float(node.inputs["Strength"].default_value), node.uv_map)


def _before_solve(tree: Any) -> Any | None:
    """The node that was linked to Normal before a solve linked its own."""
    for node in tree.nodes:
        link = node.get(NORMAL.link_tag)
        if isinstance(link, list) and link:
            return tree.nodes.get(str(link[0]))
    return None


def _pixels(material: Any, texture: Any, warn: Warn) -> F32 | None:
    """(h, w, 3) as the shader sees the image, row 0 bottom.  Raises BadInput when it cannot be read."""
    image = texture.image
    if image is None:
        warn(f"material '{material.name}': its normal map has no image; its normals are left out")
        return None
    if image.source not in {"FILE", "GENERATED"}:
        warn(f"material '{material.name}': normal map '{image.name}' is tiled or a sequence; its normals are left out")
        return None
    width, height = image.size
    if not width or not height or image.channels < 3:
        raise BadInput(f"image '{image.name}' (normal map of material '{material.name}'): cannot be read as colour; "
                       "find its file or unlink it")
    flat = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(flat)
    pixels = flat.reshape(height, width, image.channels)[..., :3].copy()
    space = known_space(image.colorspace_settings.name)
    if space not in {"Non-Color", "Linear Rec.709"} and not image.is_float:
        warn(f"image '{image.name}': a normal map with colour space '{image.colorspace_settings.name}'; "
             "set it to Non-Color if that is not intended")
        pixels = pixels if space is None else to_linear_rec709(pixels, space)
    return pixels
