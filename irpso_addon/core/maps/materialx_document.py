"""The MaterialX document of an export: OpenPBR Surface with the maps as images.

OpenPBR Surface 1.1 is nearest to what is solved.  Its base is Lambert's or rough (base_diffuse_roughness: the model of
Cycles' Diffuse Roughness, with more multiple scattering) below a GGX dielectric whose albedo dims it, alpha is
roughness^2, its metal has the F82 reflectance, Schlick's where the edge is white, and its index of refraction may be a
map.  Standard Surface has an artistic metal, glTF PBR Schlick's dielectric.

https://academysoftwarefoundation.github.io/OpenPBR; MaterialX Specification 1.39.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from xml.etree import ElementTree

from ..shading.tables import F0, IOR, level_ior

VERSION = "1.39"
COLOUR, DATA = "srgb_texture", "lin_rec709"
GREY, RGB, VECTOR = "float", "color3", "vector3"  # MaterialX' types


def materialx(
    name: str, images: Mapping[str, str], metallic: float | None, level: float | None, diffuse_roughness: float = 0.0,
    coat: tuple[float, float] = (0.0, 0.0),
) -> bytes:
    """The document of the object ``name``, UTF-8.

    ``images``: file names relative to the document, by `TargetFile.name`; <UDIM> may stand in them.  Row 0 of a file is
    its top and v = 0 is its bottom, in MaterialX as in Blender: nothing is turned.  ``metallic``, ``level``: one value
    for the object (Specular IOR Level), None: the image's.  ``diffuse_roughness``: one value for the object.
    ``coat``: weight and roughness of the object's.
    """
    document = _Document(name)
    surface = document.node("open_pbr_surface", "surface", "surfaceshader")
    document.link(surface, "base_color", RGB, document.image(images, "base_color", RGB))
    if diffuse_roughness:
        document.value(surface, "base_diffuse_roughness", GREY, diffuse_roughness)
    document.link(surface, "specular_roughness", GREY, document.image(images, "specular_roughness", GREY))
    if metallic is None:
        document.link(surface, "base_metalness", GREY, document.image(images, "base_metalness", GREY))
    else:
        document.value(surface, "base_metalness", GREY, metallic)
    if level is None:
        document.link(surface, "specular_ior", GREY, document.ior(document.image(images, "specular_level", GREY)))
    else:
        document.value(surface, "specular_ior", GREY, float(level_ior(level)))
    if coat[0] > 0:  # the Principled BSDF's coat reflects none of what leaves the base back to it
        for socket, value in zip(("weight", "roughness", "ior", "darkening"), (*coat, IOR, 0.0), strict=True):
            document.value(surface, f"coat_{socket}", GREY, value)
    if "{}_geometry_normal" in images:
        normal = document.node("normalmap", "normal_tangent", VECTOR)
        document.link(normal, "in", VECTOR, document.image(images, "geometry_normal", VECTOR))
        for layer in ("geometry_normal", *(("geometry_coat_normal",) if coat[0] > 0 else ())):
            document.link(surface, layer, VECTOR, normal)
    material = document.node("surfacematerial", document.material, "material")
    document.link(material, "surfaceshader", "surfaceshader", surface)
    return document.text()


class _Document:
    """Nodes are written in the order in which they are asked for, each before its user."""

    def __init__(self, name: str) -> None:
        self._root = ElementTree.Element("materialx", version=VERSION, colorspace=DATA)
        self.material = "M_" + re.sub("[^A-Za-z0-9_]", "_", name)  # names are ASCII identifiers

    def node(self, kind: str, name: str, type_: str) -> ElementTree.Element:
        """A node whose output is of that type."""
        return ElementTree.SubElement(self._root, kind, name=name, type=type_)

    def value(self, node: ElementTree.Element, name: str, type_: str, value: float | str) -> ElementTree.Element:
        """An input with a value."""
        text = value if isinstance(value, str) else f"{value:.7g}"
        return ElementTree.SubElement(node, "input", name=name, type=type_, value=text)

    def link(self, node: ElementTree.Element, name: str, type_: str, source: ElementTree.Element) -> None:
        """An input that another node feeds."""
        ElementTree.SubElement(node, "input", name=name, type=type_, nodename=source.attrib["name"])

    def image(self, images: Mapping[str, str], role: str, type_: str) -> ElementTree.Element:
        """An image over the UV map.  Only colours are converted: the colour space of other types says what they are."""
        node = self.node("image", f"{role}_image", type_)
        file = self.value(node, "file", "filename", images["{}_" + role])
        if type_ == RGB:
            file.set("colorspace", COLOUR)
        return node

    def ior(self, level: ElementTree.Element) -> ElementTree.Element:
        """Nodes that compute `level_ior`."""
        f0 = self._math("multiply", "specular_f0", level, 2 * F0)
        q = self.node("sqrt", "specular_q", GREY)
        self.link(q, "in", GREY, f0)
        above, below = self._math("add", "one_plus_q", q, 1.0), self.node("subtract", "one_minus_q", GREY)
        self.value(below, "in1", GREY, 1.0)
        self.link(below, "in2", GREY, q)
        found = self.node("divide", "specular_ior", GREY)
        self.link(found, "in1", GREY, above)
        self.link(found, "in2", GREY, below)
        return found

    def _math(self, kind: str, name: str, source: ElementTree.Element, value: float) -> ElementTree.Element:
        node = self.node(kind, name, GREY)
        self.link(node, "in1", GREY, source)
        self.value(node, "in2", GREY, value)
        return node

    def text(self) -> bytes:
        """As a file holds it."""
        # The surface was asked for first, but stands after what feeds it: readers need no order, people do.
        surface = next(child for child in self._root if child.tag == "open_pbr_surface")
        self._root.remove(surface)
        self._root.insert(len(self._root) - 1, surface)
        ElementTree.indent(self._root)
        return bytes(ElementTree.tostring(self._root, encoding="utf-8", xml_declaration=True)) + b"\n"
