"""Custom properties by which what we made is found again, also after renaming.

A file may hold anything under these names.
"""

import bpy

TAG = "irpso"  # on objects: their images; on nodes and node groups: their role
SPECULAR_TAG = "irpso_specular"  # on a Principled: its Specular IOR Level before we set it
SPECULAR_LINK_TAG = "irpso_specular_link"  # and what was linked there: node, socket
PARKED_TAG = "irpso_parked"  # on a Principled that a two-lobe group stands in for: how it was shown


def maps_of(obj: bpy.types.Object) -> dict[str, bpy.types.Image]:
    """The object's maps that the file holds, by role."""
    told = obj.get(TAG)
    if not hasattr(told, "items"):
        return {}
    return {role: image for role, image in told.items() if isinstance(image, bpy.types.Image)}
