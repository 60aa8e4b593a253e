"""Custom properties by which what we made is found again, also after renaming.

A file may hold anything under these names.
"""

import bpy

from ...core.data import JointPrior

TAG = "irpso"  # on objects: their images; on nodes and node groups: their role
SPECULAR_TAG = "irpso_specular"  # on a Principled: its Specular IOR Level before we set it
SPECULAR_LINK_TAG = "irpso_specular_link"  # and what was linked there: node, socket
METALLIC_TAG = "irpso_metallic"  # the same of its Metallic
METALLIC_LINK_TAG = "irpso_metallic_link"
COAT_TAG = "irpso_coat"  # the same of its Coat Weight, and with more behind it of the coat's other inputs
NORMAL_TAG = "irpso_normal"  # the same of its Normal
NORMAL_LINK_TAG = "irpso_normal_link"
NORMAL_ROLE = "normal_map"  # of our Normal Map node
PRIOR_TAG = "irpso_prior"  # on a material: as JointPrior
PARKED_TAG = "irpso_parked"  # on a Principled that a two-lobe group stands in for: how it was shown


def tag_prior(material: bpy.types.Material, prior: JointPrior | None) -> None:
    """Keep what the material's texels were drawn to."""
    if prior is not None:
        material[PRIOR_TAG] = [prior.roughness, prior.strength, prior.sigma, *prior.others]
    elif PRIOR_TAG in material:
        del material[PRIOR_TAG]


def prior_of(material: bpy.types.Material) -> JointPrior | None:
    """What the material's texels were drawn to, where that is known."""
    values = material.get(PRIOR_TAG)
    if not hasattr(values, "__len__") or not 3 <= len(values) <= 5 or not all(isinstance(x, float) for x in values):
        return None
    roughness, strength, sigma, *others = values
    good = all(0 < value <= 1 for value in (roughness, *others)) and strength > 0 and sigma >= 0
    return JointPrior(roughness, strength, sigma, tuple(others)) if good else None


def maps_of(obj: bpy.types.Object) -> dict[str, bpy.types.Image]:
    """The object's maps that the file holds, by role."""
    told = obj.get(TAG)
    if not hasattr(told, "items"):
        return {}
    return {role: image for role, image in told.items() if isinstance(image, bpy.types.Image)}
