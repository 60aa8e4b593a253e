"""Inputs of the user's Principled BSDF that some models solve for: set from a result, and put back as they were."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from ...core.data import Coat
from ...core.shading.tables import IOR
from .tags import (
    COAT_TAG,
    DIFFUSE_ROUGHNESS_LINK_TAG,
    DIFFUSE_ROUGHNESS_TAG,
    METALLIC_LINK_TAG,
    METALLIC_TAG,
    NORMAL_LINK_TAG,
    NORMAL_ROLE,
    NORMAL_TAG,
    SPECULAR_LINK_TAG,
    SPECULAR_TAG,
    TAG,
)

Value = float | tuple[float, ...]  # of a number, of a colour


@dataclass(frozen=True)
class SolvedSocket:
    """One input, and the tags that keep what it was before."""

    name: str  # of the input
    tag: str  # its value before we set it
    link_tag: str  # and what was linked there: node, socket
    role: str  # of our texture node, where its map is solved for

    def set(
        self, tree: bpy.types.ShaderNodeTree, principled: bpy.types.Node, source: bpy.types.NodeSocket | Value | None,
    ) -> list[str]:
        """From a socket, a value, or None: as it was before we set it.  Says if a link went."""
        socket = principled.inputs[self.name]
        if source is None:
            self._restore(tree, principled, socket)
            return []
        if self.tag not in principled:
            principled[self.tag] = _plain(socket.default_value)
        users = [link for link in socket.links if link.from_node.get(TAG) != self.role]
        if users:
            principled[self.link_tag] = [users[0].from_node.name, users[0].from_socket.identifier]
        for link in list(socket.links):
            tree.links.remove(link)
        if isinstance(source, (float, tuple)):
            socket.default_value = source
            now = f"unlinked and set to {source:.3g}" if isinstance(source, float) else "unlinked and set to white"
        else:
            tree.links.new(source, socket)
            now = "linked to the solved map instead"
        return [f"{self.name} was linked; {now}"] if users else []

    def _restore(
        self, tree: bpy.types.ShaderNodeTree, principled: bpy.types.Node, socket: bpy.types.NodeSocket,
    ) -> None:
        if self.tag not in principled:
            return
        before, present = _plain(principled[self.tag]), _plain(socket.default_value)
        if isinstance(before, tuple) == isinstance(present, tuple) and _length(before) == _length(present):
            socket.default_value = before
        del principled[self.tag]
        for link in [link for link in socket.links if link.from_node.get(TAG) == self.role]:
            tree.links.remove(link)
        if self.link_tag in principled:
            _link_as_before(tree, socket, principled[self.link_tag])
            del principled[self.link_tag]


def _plain(value: object) -> Value | None:
    """Of a socket, or of what a file says that one had; None: neither a number nor numbers."""
    if isinstance(value, (int, float)):
        return float(value)
    values = tuple(value) if hasattr(value, "__len__") and not isinstance(value, str) else ()
    return values if values and all(isinstance(x, (int, float)) for x in values) else None


def _length(value: Value | None) -> int:
    return len(value) if isinstance(value, tuple) else int(value is not None)


def _link_as_before(tree: bpy.types.ShaderNodeTree, socket: bpy.types.NodeSocket, before: object) -> None:
    """``before``: node and socket, as a tag keeps them."""
    name, identifier = before if isinstance(before, list) and len(before) == 2 else ("", "")
    node = tree.nodes.get(str(name))
    output = next((o for o in node.outputs if o.identifier == identifier), None) if node else None
    if output is not None and not socket.is_linked:
        tree.links.new(output, socket)


LEVEL = SolvedSocket("Specular IOR Level", SPECULAR_TAG, SPECULAR_LINK_TAG, "specular")
METALLIC = SolvedSocket("Metallic", METALLIC_TAG, METALLIC_LINK_TAG, "metallic")
DIFFUSE_ROUGHNESS = SolvedSocket("Diffuse Roughness", DIFFUSE_ROUGHNESS_TAG, DIFFUSE_ROUGHNESS_LINK_TAG,
                                  "diffuse_roughness")
NORMAL = SolvedSocket("Normal", NORMAL_TAG, NORMAL_LINK_TAG, NORMAL_ROLE)
COAT_WEIGHT = SolvedSocket("Coat Weight", COAT_TAG, f"{COAT_TAG}_link", "coat")
COAT_ROUGHNESS = SolvedSocket("Coat Roughness", f"{COAT_TAG}_roughness", f"{COAT_TAG}_roughness_link", "coat")
COAT_IOR = SolvedSocket("Coat IOR", f"{COAT_TAG}_ior", f"{COAT_TAG}_ior_link", "coat")
COAT_TINT = SolvedSocket("Coat Tint", f"{COAT_TAG}_tint", f"{COAT_TAG}_tint_link", "coat")
COAT_NORMAL, COAT_NORMAL_TAG = "Coat Normal", f"{COAT_TAG}_normal"  # what was linked there; [] where nothing was


def set_coat(tree: bpy.types.ShaderNodeTree, principled: bpy.types.Node, coat: Coat | None) -> list[str]:
    """The coat's inputs; None: as they were before we set them.  Says if a link went."""
    values = (None,) * 4 if coat is None else (coat.weight, coat.roughness, float(IOR), (1.0, 1.0, 1.0, 1.0))
    messages = [text for solved, value in zip((COAT_WEIGHT, COAT_ROUGHNESS, COAT_IOR, COAT_TINT), values, strict=True)
                for text in solved.set(tree, principled, value)]
    socket = principled.inputs[COAT_NORMAL]
    if coat is not None:
        _same_normal(tree, principled, socket)
    elif COAT_NORMAL_TAG in principled:
        for link in list(socket.links):
            tree.links.remove(link)
        _link_as_before(tree, socket, principled[COAT_NORMAL_TAG])
        del principled[COAT_NORMAL_TAG]
    return messages


def _same_normal(
    tree: bpy.types.ShaderNodeTree, principled: bpy.types.Node, socket: bpy.types.NodeSocket,
) -> None:
    """The coat follows the normals of what lies below, which by itself it would not: so it was solved."""
    links = list(socket.links)
    if COAT_NORMAL_TAG not in principled:
        principled[COAT_NORMAL_TAG] = [links[0].from_node.name, links[0].from_socket.identifier] if links else []
    for link in links:
        tree.links.remove(link)
    for link in principled.inputs["Normal"].links:
        tree.links.new(link.from_socket, socket)


def coat_of(principled: bpy.types.Node) -> Coat | None:
    """The coat that was solved for."""
    if COAT_WEIGHT.tag not in principled:
        return None
    weight, roughness = (min(max(float(principled.inputs[solved.name].default_value), 0.0), 1.0)
                         for solved in (COAT_WEIGHT, COAT_ROUGHNESS))
    return Coat(weight, roughness)
