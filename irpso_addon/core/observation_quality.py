"""How good an observation is, beside 1 for a good one seen head on: what gpu/observe and core/cpu_solver agree on."""

from __future__ import annotations

from .data import F32, OPAQUE

EDGE_WEIGHT = 0.03  # of what lies at an edge of shadow or silhouette
DARK_SHARE = 0.02  # radiance below this share of the typical one is as good as noise
# Below them nothing is observed: the long footprint of a grazing pixel, the terminator.  So too in observed.glsl and
# pixel.glsl.
MIN_COS_V, MIN_COS_L = 0.15, 0.08
# Standard error of roughness at which confidence is one half: three are 0.1, which 0.3 % of normal errors exceed.
HALF_SURE = 0.1 / 3


def useless(rgb: F32, coverage: F32) -> str:
    """Why what a picture shows of the object, (N, 3) and (N,) of its good pixels, tells nothing; "" where it does."""
    if rgb.max() <= 0:
        return "it is black where it shows the object; replace the picture or leave the view out"
    most = float(coverage.max())
    return "" if most >= OPAQUE else f"its mask or alpha is nowhere above {most:.2f}; use white (1) for the object"
