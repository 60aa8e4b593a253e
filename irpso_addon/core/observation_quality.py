"""How good an observation is, beside 1 for a good one seen head on: what gpu/observe and core/cpu_solver agree on."""

from __future__ import annotations

EDGE_WEIGHT = 0.03  # of what lies at an edge of shadow or silhouette
DARK_SHARE = 0.02  # radiance below this share of the typical one is as good as noise
# Below them nothing is observed: the long footprint of a grazing pixel, the terminator.  So too in observed.glsl.
MIN_COS_V, MIN_COS_L = 0.15, 0.08
# Standard error of roughness at which confidence is one half: three are 0.1, which 0.3 % of normal errors exceed.
HALF_SURE = 0.1 / 3
