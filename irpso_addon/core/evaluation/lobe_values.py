"""What lobes reflect at places whose geometry is given as the observations have it: sin2h, radius2, cos_l, factor.

``nodes``, where an environment shines: (T, V, 2, NODES) logarithms of what its lobe returns at roughnesses
(core/shading/environment.py), and V.H there.  It is the last of the lights then.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..data import F64, Coat
from ..shading import brdf, environment
from ..vectors import dot

MIDDLE = 0.35  # roughness at which V.H is taken where that of the lobe is not at hand


def lobe_values(
    lobes: F64, cos_v: F64, roughness: F64, beckmann: bool = False, nodes: F64 | None = None,
) -> F64:
    """(T, V, L) of each light at Specular IOR Level 0.5, without the gain by multiple scattering.

    lobes: (T, V, L, 4).  cos_v: (T, V) or (T, 1), not 0.  roughness: (T,).
    """
    return LobePlaces(lobes, cos_v, nodes).values(roughness, beckmann)


class LobePlaces:
    """The places of `lobe_values`, taken once for many roughnesses."""

    def __init__(self, lobes: F64, cos_v: F64, nodes: F64 | None = None) -> None:
        self.sin2h, self.radius2, cos_l, self.factor = (np.ascontiguousarray(lobes[..., k]) for k in range(4))
        self.tan2_l, self.tan2_v = 1 / np.clip(cos_l, 1e-3, 1)**2 - 1, 1 / cos_v[..., None] ** 2 - 1
        self.around = None if nodes is None else np.maximum(nodes[..., 0, :], np.log(environment.LEAST))

    def values(self, roughness: F64, beckmann: bool = False) -> F64:
        """As of `lobe_values`."""
        D: Callable[[F64, F64, F64], F64] = brdf.D_beckmann_disc if beckmann else brdf.D_ggx_disc
        root: Callable[[F64, F64], F64] = brdf.lambda_root_beckmann if beckmann else brdf.lambda_root
        alpha2 = (roughness**4)[:, None, None]
        roots = root(alpha2, self.tan2_l) + root(alpha2, self.tan2_v)
        value: F64 = D(alpha2, self.sin2h, self.radius2) * self.factor / roots
        if self.around is None:
            return value
        around = environment.at_roughness_of_logs(self.around, roughness[:, None])
        return np.concatenate([value, np.broadcast_to(around, value.shape[:-1])[..., None]], -1)


def fresnel_ratio(
    lobes: F64, cos_v: F64, level: F64, nodes: F64 | None = None, roughness: F64 | None = None,
) -> F64:
    """(T, V, L) Fresnel reflectance at a level over that at 0.5.

    level: whatever broadcasts to that.  roughness: (T,) of the lobe, which says of an environment where it looks.
    """
    return np.asarray(brdf.F_level_ratio(half_cosine(lobes, cos_v, nodes, roughness), level), np.float64)


def half_cosine(lobes: F64, cos_v: F64, nodes: F64 | None = None, roughness: F64 | None = None) -> F64:
    """(T, V, L) V.H, from N.H = (N.L + N.V) / |L + V|."""
    sin2h, cos_l = lobes[..., 0], np.clip(lobes[..., 2], 1e-3, 1)
    across = np.clip((cos_l + cos_v[..., None]) / (2 * np.sqrt(np.maximum(1 - sin2h, 1e-6))), 0, 1)
    if nodes is None:
        return np.asarray(across)
    at = np.full(len(nodes), MIDDLE) if roughness is None else roughness
    around = environment.cosine_at(nodes[..., 1, :], at[:, None])
    return np.concatenate([across, np.broadcast_to(around, across.shape[:-1])[..., None]], -1)


def metal_values(lobes: F64, cos_v: F64, roughness: F64, nodes: F64 | None = None) -> tuple[F64, F64]:
    """(T, V) each: what a metal's lobe adds for each unit of base colour, and whatever that is.

    Schlick's reflectance b + (1 - b) (1 - V.H)^5 is linear in base colour b.  Without multiple scattering.
    """
    across = half_cosine(lobes, cos_v, nodes, roughness)
    shape = lobe_values(lobes, cos_v, roughness, nodes=nodes) / brdf.F_dielectric(across)
    edge = brdf.F_schlick(across)
    return dot(shape, 1 - edge), dot(shape, edge)


def coat_values(places: LobePlaces, cos_v: F64, coat: Coat) -> tuple[F64, F64]:
    """(T, V) each: what a coat reflects, and what it leaves of all that lies below.  cos_v: (T, V) or (T, 1), not 0."""
    shape = places.values(np.full(len(cos_v), coat.roughness)).sum(-1)
    gain = brdf.principled_energy(coat.roughness, cos_v)[..., 0]
    return coat.weight * shape * gain, brdf.left_by_coat(coat, cos_v)


def diffuse_parts(lobes: F64, cos_v: F64, roughness: float) -> tuple[F64, F64]:
    """(T, V, 1) each: what a rough diffuse reflects over what a smooth one does, as of `brdf.rough_parts`.

    Each lamp counts by its share of the irradiance; what shines from all around counts as on a smooth one.
    ``roughness``: Diffuse Roughness.
    """
    sin2h, cos_l = lobes[..., 0], np.clip(lobes[..., 2], 1e-3, 1)
    both = cos_l + cos_v[..., None]
    far = both**2 / np.maximum(1 - sin2h, 1e-6)  # |L + V|^2
    share = lobes[..., 3] * 2 * cos_l * cos_v[..., None] / brdf.F_dielectric(np.clip(0.5 * np.sqrt(far), 0, 1))
    single, lost = brdf.rough_parts(cos_l, cos_v[..., None], np.clip(far / 2 - 1, -1, 1), roughness)
    return 1 + dot(share, single - 1)[..., None], dot(share, lost)[..., None]

