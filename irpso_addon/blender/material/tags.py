"""Custom properties by which what we made is found again, also after renaming.

A file may hold anything under these names.
"""

from dataclasses import replace

import bpy

from ...core.data import JointPrior

TAG = "irpso"  # on objects: their images; on nodes and node groups: their role
SPECULAR_TAG = "irpso_specular"  # on a Principled: its Specular IOR Level before we set it
SPECULAR_LINK_TAG = "irpso_specular_link"  # and what was linked there: node, socket
METALLIC_TAG = "irpso_metallic"  # the same of its Metallic
METALLIC_LINK_TAG = "irpso_metallic_link"
COAT_TAG = "irpso_coat"  # the same of its Coat Weight, and with more behind it of the coat's other inputs
DIFFUSE_ROUGHNESS_TAG = "irpso_diffuse_roughness"  # the same of its Diffuse Roughness
DIFFUSE_ROUGHNESS_LINK_TAG = "irpso_diffuse_roughness_link"
NORMAL_TAG = "irpso_normal"  # the same of its Normal
NORMAL_LINK_TAG = "irpso_normal_link"
NORMAL_ROLE = "normal_map"  # of our Normal Map node
PRIOR_TAG = "irpso_prior"  # on a material: as JointPrior, without ...
PRIOR_LEVEL_TAG = "irpso_prior_level"  # ... its level and how strongly texels' levels were drawn to it, and ...
PRIOR_BASE_TAG = "irpso_prior_base"  # ... its base colour, and how strongly texels' were drawn to that
PARKED_TAG = "irpso_parked"  # on a Principled that a two-lobe group stands in for: how it was shown


def tag_prior(material: bpy.types.Material, prior: JointPrior | None) -> None:
    """Keep what the material's texels were drawn to."""
    for name in (PRIOR_TAG, PRIOR_LEVEL_TAG, PRIOR_BASE_TAG):
        if name in material:
            del material[name]
    if prior is not None:
        material[PRIOR_TAG] = [prior.roughness, prior.strength, prior.sigma, *prior.others]
        if prior.level_strength > 0:
            material[PRIOR_LEVEL_TAG] = [prior.level, prior.level_strength]
        if prior.base:
            material[PRIOR_BASE_TAG] = [*prior.base, prior.base_strength]


def prior_of(material: bpy.types.Material) -> JointPrior | None:
    """What the material's texels were drawn to, where that is known."""
    values = _numbers(material, PRIOR_TAG)
    if not 3 <= len(values) <= 5:
        return None
    roughness, strength, sigma, *others = values
    if not all(0 < value <= 1 for value in (roughness, *others)) or strength <= 0 or sigma < 0:
        return None
    prior = JointPrior(roughness, strength, sigma, tuple(others))
    match _numbers(material, PRIOR_LEVEL_TAG):
        case [level, level_strength] if 0 < level <= 1 and level_strength > 0:
            prior = replace(prior, level=level, level_strength=level_strength)
    match _numbers(material, PRIOR_BASE_TAG):
        case [*base, base_strength] if len(base) == 3 and all(0 <= value <= 1 for value in base) and base_strength > 0:
            prior = replace(prior, base=tuple(base), base_strength=base_strength)
    return prior


def _numbers(material: bpy.types.Material, name: str) -> list[float]:
    """Of a custom property; none where it holds anything else."""
    values = material.get(name)
    if not hasattr(values, "__len__") or not all(isinstance(x, float) for x in values):
        return []
    return list(values)


def maps_of(obj: bpy.types.Object) -> dict[str, bpy.types.Image]:
    """The object's maps that the file holds, by role."""
    told = obj.get(TAG)
    if not hasattr(told, "items"):
        return {}
    return {role: image for role, image in told.items() if isinstance(image, bpy.types.Image)}
