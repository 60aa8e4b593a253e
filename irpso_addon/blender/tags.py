"""Custom properties by which what we made is found again, also after renaming."""

TAG = "irpso"  # on objects: their images; on nodes and node groups: their role
SPECULAR_TAG = "irpso_specular"  # on a Principled: its Specular IOR Level before we set it
SPECULAR_LINK_TAG = "irpso_specular_link"  # and what was linked there: node, socket
PARKED_TAG = "irpso_parked"  # on a Principled that a two-lobe group stands in for: how it was shown
