"""The node that shows a two-lobe material: a group that stands in for the user's Principled BSDF.

GGX: the group has the Principled's own inputs, but two roughnesses and the weight of the first, and mixes two
Principled BSDFs that are alike in all else.  Beckmann: a Diffuse BSDF and two mixed Metallic BSDFs
(Cook-Torrance).  The user's Principled stays in the tree, collapsed and without a link to the output, so that
it comes back as it was.  One group serves every material that needs the same.
"""

from __future__ import annotations

import bpy

from .tags import PARKED_TAG, TAG

ROLE = "two_lobe"  # of the group's node in a material
LOBES = ("Roughness 1", "Roughness 2", "Weight")  # the group's inputs, in the order of the image's channels
OURS = ("Base Color", "Roughness", *LOBES)  # inputs that the maps feed: never copied
# Panels of the group, as in the Principled: how its inputs' names begin, and where they go.
PANELS = {
    "Diffuse ": "Diffuse", "Subsurface": "Subsurface", "Specular": "Specular", "Anisotropic": "Specular",
    "Tangent": "Specular", "Transmission": "Transmission", "Coat": "Coat", "Sheen": "Sheen", "Emission": "Emission",
    "Thin Film": "Thin Film",
}
# Where the Metallic BSDF approximates the conductor's Fresnel (Blender 4.5), glass comes within 1 % as a mix of
# two: a share of F82 with this colour and edge tint, the rest a conductor with this IOR and extinction.  Fitted
# to the smallest largest relative error over V.H of 0.1 to 1.
F82_SHARE, F82_COLOR, F82_TINT, CONDUCTOR_IOR, CONDUCTOR_EXTINCTION = 0.58419, 0.036260, 0.81251, 1.51220, 0.13551


def is_two_lobe(node: bpy.types.Node) -> bool:
    """Whether ``node`` is the group's node in a material."""
    return node.bl_idname == "ShaderNodeGroup" and node.get(TAG) == ROLE and node.node_tree is not None


def lobe_of(node: bpy.types.Node) -> bpy.types.Node | None:
    """The Principled BSDF itself, or one of those inside the group; None: the group has none (Beckmann)."""
    if not is_two_lobe(node):
        return node
    return next((n for n in node.node_tree.nodes if n.bl_idname == "ShaderNodeBsdfPrincipled"), None)


def parked(tree: bpy.types.ShaderNodeTree) -> bpy.types.Node | None:
    """The user's Principled BSDF that a group stands in for."""
    return next((node for node in tree.nodes if PARKED_TAG in node), None)


def park(principled: bpy.types.Node, node: bpy.types.Node) -> None:
    """Puts the group's ``node`` in the place of ``principled``: its settings, and what it feeds."""
    copy_inputs(principled, node)
    move_links(principled, node)
    if PARKED_TAG not in principled:
        # Sockets that show make a collapsed node tall.
        bare = [socket for socket in principled.inputs if not (socket.hide or socket.is_linked)]
        names = ",".join(socket.identifier for socket in bare)
        principled[PARKED_TAG] = {"hide": principled.hide, "label": principled.label, "sockets": names}
        for socket in bare:
            socket.hide = True
        principled.hide, principled.label = True, "One lobe (kept by IRPSO)"


def bring_back(node: bpy.types.Node, principled: bpy.types.Node) -> None:
    """The other way: ``principled`` takes over what was changed on the group's node meanwhile."""
    copy_inputs(node, principled)
    move_links(node, principled)


def unpark(principled: bpy.types.Node) -> None:
    """Shows ``principled`` again as it was."""
    if PARKED_TAG not in principled:
        return
    before = principled[PARKED_TAG]
    before = before.to_dict() if hasattr(before, "to_dict") else {}
    bare = str(before.get("sockets", "")).split(",")
    for socket in principled.inputs:
        if socket.identifier in bare:
            socket.hide = False
    principled.hide, principled.label = bool(before.get("hide", False)), str(before.get("label", ""))
    del principled[PARKED_TAG]


def copy_inputs(source: bpy.types.Node, target: bpy.types.Node) -> None:
    """Values and links of every input that both have, the maps' own left out."""
    links = source.id_data.links
    for socket in target.inputs:
        other = source.inputs.get(socket.name)
        if socket.name in OURS or other is None or not (socket.enabled and other.enabled):
            continue
        for link in list(socket.links):
            links.remove(link)
        socket.default_value = other.default_value
        for link in list(other.links):
            muted = link.is_muted
            links.new(link.from_socket, socket).is_muted = muted


def move_links(source: bpy.types.Node, target: bpy.types.Node) -> None:
    """Everything that ``source`` feeds is fed by ``target``."""
    links = source.id_data.links
    for link in list(source.outputs["BSDF"].links):
        muted = link.is_muted
        links.new(target.outputs["BSDF"], link.to_socket).is_muted = muted


# ---- the groups


def group_for(principled: bpy.types.Node, ndf: str) -> bpy.types.ShaderNodeTree:
    """The node group of that distribution ("ggx", "beckmann") for ``principled``: the one there is, or a new one."""
    if ndf == "beckmann":
        key = "beckmann" if _exact_metallic() else "beckmann, fitted"
        return _found(key) or _beckmann(_new_group("IRPSO Two-Lobe Beckmann", key))
    key = f"ggx {principled.distribution} {principled.subsurface_method}"
    return _found(key) or _ggx(_new_group("IRPSO Two-Lobe", key), principled)


def _found(key: str) -> bpy.types.ShaderNodeTree | None:
    return next((group for group in bpy.data.node_groups if group.get(TAG) == key and group.is_editable), None)


def _new_group(name: str, key: str) -> bpy.types.ShaderNodeTree:
    group = bpy.data.node_groups.new(name, "ShaderNodeTree")
    group[TAG] = key
    group.interface.new_socket("BSDF", in_out="OUTPUT", socket_type="NodeSocketShader")
    return group


def _ggx(group: bpy.types.ShaderNodeTree, principled: bpy.types.Node) -> bpy.types.ShaderNodeTree:
    """w P(base, r1) + (1 - w) P(base, r2)."""
    lobes = []
    for index in range(2):
        lobe = _add(group, "ShaderNodeBsdfPrincipled", (0.0, 340.0 - 700.0 * index), f"Lobe {index + 1}")
        for name in ("distribution", "subsurface_method"):
            if choice := getattr(principled, name):  # "": a newer Blender has saved the file, and this one knows fewer
                setattr(lobe, name, choice)
        lobes.append(lobe)
    panels: dict[str, bpy.types.NodeTreeInterfacePanel] = {}
    for socket in lobes[0].inputs:
        if not socket.enabled:
            continue
        if socket.name == "Roughness":
            _expose_lobes(group, socket)
            continue
        name = next((panel for start, panel in PANELS.items() if socket.name.startswith(start)), None)
        if name is not None and name not in panels:
            panels[name] = group.interface.new_panel(name, default_closed=True)
        _expose(group, socket, socket.name, panels.get(name))
    inside = _add(group, "NodeGroupInput", (-400.0, 0.0))
    for index, lobe in enumerate(lobes):
        for socket in lobe.inputs:
            if socket.enabled:
                name = LOBES[index] if socket.name == "Roughness" else socket.name
                group.links.new(inside.outputs[name], socket)
    _output(group, _mix(group, inside.outputs["Weight"], lobes[1].outputs[0], lobes[0].outputs[0], 340.0), 580.0)
    return group


def _beckmann(group: bpy.types.ShaderNodeTree) -> bpy.types.ShaderNodeTree:
    """base / pi + w s(r1) + (1 - w) s(r2), s = D F G / (4 cos_l cos_v).  Cook and Torrance 1982."""
    diffuse = _add(group, "ShaderNodeBsdfDiffuse", (0.0, 300.0), "Base")
    _expose(group, diffuse.inputs["Color"], "Base Color", None)
    _expose_lobes(group, diffuse.inputs["Roughness"])
    _expose(group, diffuse.inputs["Normal"], "Normal", None)
    inside = _add(group, "NodeGroupInput", (-300.0, 0.0))
    group.links.new(inside.outputs["Base Color"], diffuse.inputs["Color"])
    group.links.new(inside.outputs["Normal"], diffuse.inputs["Normal"])
    lobes = [_metal(group, inside, index) for index in range(2)]
    mix = _mix(group, inside.outputs["Weight"], lobes[1], lobes[0], 600.0)
    add = _add(group, "ShaderNodeAddShader", (800.0, 0.0))
    group.links.new(diffuse.outputs[0], add.inputs[0])
    group.links.new(mix, add.inputs[1])
    _output(group, add.outputs[0], 1000.0)
    return group


def _metal(group: bpy.types.ShaderNodeTree, inside: bpy.types.Node, index: int) -> bpy.types.NodeSocket:
    """One Beckmann lobe with the Fresnel of glass: a conductor that absorbs nothing."""
    exact = _exact_metallic()
    kinds: dict[str, dict[str, tuple[float, ...]]] = {"PHYSICAL_CONDUCTOR": {
        "IOR": (1.5 if exact else CONDUCTOR_IOR,) * 3, "Extinction": (0.0 if exact else CONDUCTOR_EXTINCTION,) * 3}}
    if not exact:
        kinds["F82"] = {"Base Color": (*(F82_COLOR,) * 3, 1.0), "Edge Tint": (*(F82_TINT,) * 3, 1.0)}
    outputs = []
    for row, (kind, values) in enumerate(kinds.items()):
        place = (0.0, -420.0 * (row + len(kinds) * index))
        metal = _add(group, "ShaderNodeBsdfMetallic", place, f"Lobe {index + 1}")
        metal.distribution, metal.fresnel_type = "BECKMANN", kind
        for name, value in values.items():
            metal.inputs[name].default_value = value
        group.links.new(inside.outputs[LOBES[index]], metal.inputs["Roughness"])
        group.links.new(inside.outputs["Normal"], metal.inputs["Normal"])
        outputs.append(metal.outputs[0])
    return outputs[0] if exact else _mix(group, F82_SHARE, *outputs, 300.0)


def _exact_metallic() -> bool:
    """Whether the Metallic BSDF has the conductor's exact Fresnel: it came together with thin films."""
    probe = bpy.data.node_groups.new("IRPSO probe", "ShaderNodeTree")
    found = "Thin Film IOR" in probe.nodes.new("ShaderNodeBsdfMetallic").inputs
    bpy.data.node_groups.remove(probe)
    return found


def _expose_lobes(group: bpy.types.ShaderNodeTree, roughness: bpy.types.NodeSocket) -> None:
    for name in LOBES:
        item = _expose(group, roughness, name, None)
        item.default_value = 0.5
    item.description = "Share of the first lobe"


def _expose(
    group: bpy.types.ShaderNodeTree, socket: bpy.types.NodeSocket, name: str,
    panel: bpy.types.NodeTreeInterfacePanel | None,
) -> bpy.types.NodeTreeInterfaceSocket:
    """An input of the group that looks like a node's ``socket``."""
    kind = {"VALUE": "Float", "RGBA": "Color", "VECTOR": "Vector", "BOOLEAN": "Bool"}[socket.type]
    item = group.interface.new_socket(name, in_out="INPUT", socket_type=f"NodeSocket{kind}", parent=panel)
    if kind == "Float":
        item.subtype = socket.bl_idname.removeprefix("NodeSocketFloat").upper() or "NONE"
        item.min_value = 1.0 if name.endswith("IOR") else 0.0
        if item.subtype == "FACTOR":
            item.max_value = 3.8 if name.endswith("IOR") else 1.0  # Subsurface IOR is the one that is a slider
    item.default_value = socket.default_value
    # Hidden, an unlinked Normal or Tangent stays unlinked inside: the engines then take the surface's own.
    item.hide_value = socket.hide_value
    return item


def _add(
    group: bpy.types.ShaderNodeTree, kind: str, place: tuple[float, float], label: str = "",
) -> bpy.types.Node:
    node = group.nodes.new(kind)
    node.location, node.label = place, label
    return node


def _mix(
    group: bpy.types.ShaderNodeTree, weight: bpy.types.NodeSocket | float,
    first: bpy.types.NodeSocket, second: bpy.types.NodeSocket, x: float,
) -> bpy.types.NodeSocket:
    """(1 - weight) first + weight second."""
    mix = _add(group, "ShaderNodeMixShader", (x, 0.0))
    if isinstance(weight, float):
        mix.inputs[0].default_value = weight
    else:
        group.links.new(weight, mix.inputs[0])
    group.links.new(first, mix.inputs[1])
    group.links.new(second, mix.inputs[2])
    return mix.outputs[0]


def _output(group: bpy.types.ShaderNodeTree, shader: bpy.types.NodeSocket, x: float) -> None:
    group.links.new(shader, _add(group, "NodeGroupOutput", (x, 0.0)).inputs["BSDF"])
