"""Which objects glow, and with what radiance: Emission nodes and Principled BSDFs, of one colour or a picture.

Cycles' surfaces send the radiance color times strength from both sides, alike in all directions.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np

from ..core.data import F64

SOLID = {"MESH", "CURVE", "SURFACE", "FONT", "META"}  # types of objects with surfaces
DEEPEST = 64  # nodes one behind the other
CLOSURES = ("BSDF_", "SUBSURFACE_SCATTERING", "EEVEE_SPECULAR", "HOLDOUT")  # types of nodes that send no light


class Unmodelled(Exception):
    """Nodes that send a radiance which is not modelled."""


@dataclass(frozen=True)
class Glow:
    """What adds to a material's radiance."""

    factor: F64  # (3,) W/(m^2 sr)
    image: Any = None  # which it multiplies; None: the same everywhere
    uv_map: str = ""  # by which the image lies on the mesh; "": that which renders use
    repeats: bool = True  # the image beside its square; else its border goes on


def glows(obj: Any, known: dict[Any, bool] | None = None) -> bool:
    """Whether surfaces see light that an object sends, as far as its materials tell at a glance.

    ``known``: of materials that were looked at before.
    """
    if obj.type not in SOLID:
        return False
    known = {} if known is None else known
    for slot in obj.material_slots:
        material = slot.material
        if material is not None and material not in known:
            known[material] = _may_glow(material)
        if material is not None and known[material]:
            return bool(obj.visible_diffuse or obj.visible_glossy)
    return False


def is_light(obj: Any) -> bool:
    """Whether a view may name an object among its lights."""
    return obj.type == "LIGHT" or glows(obj)


def shines(obj: Any) -> bool:
    """Whether an object's light is modelled: what else glows is indirect light."""
    if not glows(obj):
        return False
    try:
        return any(glow.factor.any() for slot in obj.material_slots for glow in radiance_of(slot.material))
    except Unmodelled:
        return False


def radiance_of(material: Any) -> list[Glow]:
    """What a material sends to other surfaces; raises Unmodelled."""
    return [] if material is None else _radiance(_surface(material), 0)


def _may_glow(material: Any) -> bool:
    tree = material.node_tree
    if tree is None or (bpy.app.version < (5, 0, 0) and not material.use_nodes):
        return False
    return any(_node_may_glow(node) for node in _behind(_surface(material)))


def _node_may_glow(node: Any) -> bool:
    if node.type == "GROUP" and node.node_tree is not None:
        return any(_node_may_glow(inner) for inner in node.node_tree.nodes)
    prefix = {"EMISSION": "", "BSDF_PRINCIPLED": "Emission "}.get(node.type)
    if prefix is None or node.mute:
        return False
    color, strength = (node.inputs[prefix + name] for name in ("Color", "Strength"))
    return (color.is_linked or any(color.default_value[:3])) and (strength.is_linked or strength.default_value != 0)


def _behind(node: Any) -> Iterator[Any]:
    """A node and all that it is given shaders by, each once."""
    waiting, seen = [node], set()
    while waiting:
        at = waiting.pop()
        if at is None or at.name in seen:
            continue
        seen.add(at.name)
        yield at
        waiting += [_source(socket) for socket in at.inputs if socket.type == "SHADER"]


def _surface(material: Any) -> Any:
    tree = material.node_tree
    if tree is None or (bpy.app.version < (5, 0, 0) and not material.use_nodes):
        return None
    output = tree.get_output_node("CYCLES")
    return None if output is None else _source(output.inputs["Surface"])


def _source(socket: Any) -> Any:
    """The node behind a socket, past reroutes; None: none."""
    for _ in range(DEEPEST):
        links = [link for link in socket.links if not link.is_muted]
        if not links or links[0].from_node.type != "REROUTE":
            return links[0].from_node if links else None
        socket = links[0].from_node.inputs[0]
    return None


def _radiance(node: Any, depth: int) -> list[Glow]:
    """What a shader node sends to other surfaces."""
    if node is None or (not node.mute and node.type.startswith(CLOSURES) and not _node_may_glow(node)):
        return []
    if node.mute or depth > DEEPEST:
        raise Unmodelled
    if node.type == "EMISSION":
        return [_times(_color(node.inputs["Color"]), _number(node.inputs["Strength"]))]
    if node.type == "BSDF_PRINCIPLED" and _number(node.inputs["Alpha"]) == 1 and not any(
            _number(node.inputs[name]) for name in ("Coat Weight", "Sheen Weight")):
        return [_times(_color(node.inputs["Emission Color"]), _number(node.inputs["Emission Strength"]))]
    if node.type == "ADD_SHADER":
        return [sent for socket in node.inputs[:2] for sent in _radiance(_source(socket), depth + 1)]
    if node.type == "MIX_SHADER":
        share = _share(node.inputs[0])
        return [_times(sent, weight) for socket, weight in ((node.inputs[1], 1 - share), (node.inputs[2], share))
                if weight for sent in _radiance(_source(socket), depth + 1)]
    if any(_node_may_glow(inner) for inner in _behind(node)):
        raise Unmodelled
    return []


def _times(sent: Glow, weight: float) -> Glow:
    return replace(sent, factor=sent.factor * weight)


def _share(socket: Any) -> float:
    """A mix's factor; what the camera alone sees sends no light to surfaces."""
    node = _source(socket)
    if node is not None and node.type == "LIGHT_PATH" and _output(socket) == "Is Camera Ray":
        return 0.0
    return float(np.clip(_number(socket), 0, 1))


def _number(socket: Any) -> float:
    node = _source(socket)
    if node is not None and node.type == "VALUE" and not node.mute:
        return float(node.outputs[0].default_value)
    if node is not None:
        raise Unmodelled
    return float(socket.default_value)


def _color(socket: Any) -> Glow:
    node = _source(socket)
    if node is None:
        return Glow(np.array(socket.default_value[:3], np.float64))
    if node.mute:
        raise Unmodelled
    if node.type == "RGB":
        return Glow(np.array(node.outputs[0].default_value[:3], np.float64))
    mapping = getattr(node, "texture_mapping", None)
    if (node.type != "TEX_IMAGE" or node.image is None or node.projection != "FLAT" or _output(socket) == "Alpha"
            or node.extension not in {"REPEAT", "EXTEND"}
            or tuple(mapping.scale) != (1, 1, 1) or any(mapping.rotation) or any(mapping.translation)):
        raise Unmodelled
    return Glow(np.ones(3), node.image, _uv_map(node.inputs["Vector"]), node.extension == "REPEAT")


def _uv_map(socket: Any) -> str:
    node = _source(socket)
    if node is None or (node.type == "TEX_COORD" and _output(socket) == "UV" and not node.from_instancer):
        return ""
    if node.type != "UVMAP" or node.from_instancer:
        raise Unmodelled
    return str(node.uv_map)


def _output(socket: Any) -> str:
    """Name of the output that a socket's link, or the last reroute's, comes from."""
    link = next(link for link in socket.links if not link.is_muted)
    return _output(link.from_node.inputs[0]) if link.from_node.type == "REROUTE" else str(link.from_socket.name)
