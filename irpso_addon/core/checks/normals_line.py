"""What a user is told of shading normals that a solve refined."""

from __future__ import annotations

from ..change_records import RefinedNormals
from ..phrases import percent


def refined(normals: RefinedNormals | None) -> tuple[str, ...]:
    """The warning line; none where normals are as given."""
    if normals is None:
        return ()
    given, refined = (percent(error, 1) for error in (normals.given, normals.refined))
    follows = "" if not normals.moved else (
        f" Within the solve its vertices followed them, by {percent(normals.moved, 2)} of its size, because pictures "
        "of different cameras then agree better.")
    return (f"IRPSO tilted the shading normals by {normals.tilt:.2g}° in the median. The error on left-out views fell "
            f"from {given} to {refined} of their radiance. The result has a normal map; the mesh stays as it is."
            f"{follows}",)
