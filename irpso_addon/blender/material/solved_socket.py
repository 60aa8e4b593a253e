"""Inputs of the user's Principled BSDF that some models solve for: set from a result, and put back as they were."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from .tags import METALLIC_LINK_TAG, METALLIC_TAG, SPECULAR_LINK_TAG, SPECULAR_TAG, TAG


@dataclass(frozen=True)
class SolvedSocket:
    """One input, and the tags that keep what it was before."""

    name: str  # of the input
    tag: str  # its value before we set it
    link_tag: str  # and what was linked there: node, socket
    role: str  # of our texture node, where its map is solved for

    def set(
        self, tree: bpy.types.ShaderNodeTree, principled: bpy.types.Node, source: bpy.types.NodeSocket | float | None,
    ) -> list[str]:
        """From a socket, a value, or None: as it was before we set it.  Says if a link went."""
        socket = principled.inputs[self.name]
        if source is None:
            self._restore(tree, principled, socket)
            return []
        if self.tag not in principled:
            principled[self.tag] = socket.default_value
        users = [link for link in socket.links if link.from_node.get(TAG) != self.role]
        if users:
            principled[self.link_tag] = [users[0].from_node.name, users[0].from_socket.identifier]
        for link in list(socket.links):
            tree.links.remove(link)
        if isinstance(source, float):
            socket.default_value = source
            now = f"unlinked and set to {source:.3g}"
        else:
            tree.links.new(source, socket)
            now = "linked to the solved map instead"
        return [f"{self.name} was linked; {now}"] if users else []

    def _restore(
        self, tree: bpy.types.ShaderNodeTree, principled: bpy.types.Node, socket: bpy.types.NodeSocket,
    ) -> None:
        if self.tag not in principled:
            return
        if isinstance(principled[self.tag], (int, float)):
            socket.default_value = principled[self.tag]
        del principled[self.tag]
        for link in [link for link in socket.links if link.from_node.get(TAG) == self.role]:
            tree.links.remove(link)
        if self.link_tag in principled:
            before = principled[self.link_tag]
            name, identifier = before if isinstance(before, list) and len(before) == 2 else ("", "")
            del principled[self.link_tag]
            node = tree.nodes.get(str(name))
            output = next((o for o in node.outputs if o.identifier == identifier), None) if node else None
            if output is not None and not socket.is_linked:
                tree.links.new(output, socket)


LEVEL = SolvedSocket("Specular IOR Level", SPECULAR_TAG, SPECULAR_LINK_TAG, "specular")
METALLIC = SolvedSocket("Metallic", METALLIC_TAG, METALLIC_LINK_TAG, "metallic")
