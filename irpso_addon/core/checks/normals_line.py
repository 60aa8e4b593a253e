"""What a user is told of shading normals that a solve refined."""

from __future__ import annotations

from ..change_records import RefinedNormals


def refined(normals: RefinedNormals | None) -> tuple[str, ...]:
    """The warning line; none where normals are as given."""
    if normals is None:
        return ()
    return (f"IRPSO tilted the shading normals by {normals.tilt:.2g}° in the median. It now predicts left-out views to "
            f"{normals.refined:.1%} of their radiance instead of {normals.given:.1%}. The result has a normal map; the "
            "mesh itself stays as it is.",)
