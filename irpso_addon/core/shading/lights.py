"""Unshadowed irradiance of Cycles' lamps, and points on them: float64 twin of ``shaders/include/lights.glsl``.

Same names as there.  ``P`` (..., 3) is a world position in metres, ``N`` (..., 3) the unit shading normal.
Irradiance is relative to the lamp's power: W/m^2 per watt (SUN: per W/m^2); multiply by ``Light.power``.
Round lamps (POINT, SPOT, SUN) are, seen from P, cones of uniform radiance of half angle sigma.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..data import F64, Bool, Light
from ..vectors import dot, length

KINDS = ("POINT", "SUN", "SPOT", "AREA")  # index: LIGHT_POINT ... in the shader
ELLIPSE_SIDES = 32
QUADRATURE = 12  # squared: points where there is no closed form, AREA with spread and the rim of a soft SPOT
SMALLEST = 1e-5  # metres, half extent of an AREA lamp of size 0: its radiance would be infinite
POINT_SIZE = 0.005  # half extent / distance below which an AREA lamp is taken as a point, as lights.glsl explains
GOLDEN_RATIO = 0.618033988749895


def light_uniforms(light: Light) -> dict[str, Any]:
    """The values of the uniforms of ``lights.glsl`` for this lamp; matrices column by column."""
    columns = light.matrix[:3, :3].T
    scale = np.maximum(np.linalg.norm(columns, axis=1), 1e-12)
    cos_half = np.cos(light.spot_angle / 2)
    half = np.maximum(np.array([light.size[0], light.size[0] if light.shape in ("SQUARE", "DISK") else light.size[1]])
                      * scale[:2] / 2, SMALLEST)
    b = light.spread / 2
    wide = b > np.pi / 2 - 1e-4
    return {
        "u_light_kind": KINDS.index(light.kind),
        "u_light_position": tuple(light.matrix[:3, 3].tolist()),
        "u_light_axis": tuple((-columns[2] / scale[2]).tolist()),
        "u_light_radius": float(light.radius),
        "u_light_soft": bool(light.soft_falloff),
        "u_light_to_local": tuple((columns / scale[:, None] ** 2).T.ravel().tolist()),
        # A blend of 0 is a step; 1e6 is as steep as float32 cosines can tell.
        "u_light_spot": (float(cos_half), float(1 / max((1 - cos_half) * light.spot_blend, 1e-6))),
        "u_light_axis_u": tuple((columns[0] / scale[0] * half[0]).tolist()),
        "u_light_axis_v": tuple((columns[1] / scale[1] * half[1]).tolist()),
        "u_light_ellipse": light.shape in ("DISK", "ELLIPSE"),
        "u_light_spread": (0.0, 0.0) if wide else (float(np.tan(b)), float(1 / (np.tan(b) - b))),
    }


def extent_of(light: Light) -> float:
    """Half of a lamp's width, metres, along the longer side of an AREA lamp; of a SUN the half angle, radians."""
    if light.kind != "AREA":
        return light.radius
    sides = (light.size[0],) * 2 if light.shape in ("SQUARE", "DISK") else light.size
    return 0.5 * float((np.array(sides) * np.linalg.norm(light.matrix[:3, :2], axis=0)).max())


def with_extent(light: Light, extent: float) -> Light:
    """A lamp of the same shape and power whose `extent_of` is ``extent``."""
    if light.kind != "AREA":
        return replace(light, radius=extent)
    by = extent / max(extent_of(light), SMALLEST)
    return replace(light, size=(light.size[0] * by, light.size[1] * by))


def light_irradiance(light: Light, P: ArrayLike, N: ArrayLike) -> F64:
    """Unshadowed irradiance at P (..., 3), relative to the lamp's power; shape (...)."""
    P, N = np.broadcast_arrays(np.asarray(P, np.float64), np.asarray(N, np.float64))
    uniforms = light_uniforms(light) if light.kind in ("AREA", "SPOT") else {}
    if light.kind == "AREA" and uniforms["u_light_spread"][0] == 0:
        return area_irradiance(light, P, N)
    if light.kind == "AREA":
        return summed_irradiance(light, P, N)
    offset, sin_sigma, facing = light_round(light, P)
    irradiance: F64 = facing * cone_cosine(dot(N, offset) / length(offset), sin_sigma)
    if light.kind != "SPOT":
        return irradiance
    if light.radius == 0:
        return irradiance * spot_attenuation(uniforms, offset)
    reach = length(offset) * sin_sigma / np.maximum(np.sqrt(1 - np.minimum(sin_sigma**2, 1)), 1e-2)
    cut, share = spot_cuts(uniforms, offset, reach)
    irradiance = np.asarray(irradiance * share)
    irradiance[cut] = summed_irradiance(light, P[cut], N[cut])
    return irradiance


def summed_irradiance(light: Light, P: F64, N: F64) -> F64:
    """The same by points of the emitter."""
    total = np.zeros(P.shape[:-1])
    for cell in (np.indices((QUADRATURE, QUADRATURE)).reshape(2, -1).T + 0.5) / QUADRATURE:
        offset, weight = emitter_sample(light, P, np.broadcast_to(cell, (*P.shape[:-1], 2)), QUADRATURE**2)
        total += weight * np.maximum(dot(N, offset) / length(offset), 0)
    return total


def light_sample(light: Light, P: ArrayLike, i: ArrayLike, n: int) -> tuple[F64, F64]:
    """The i-th of n points on the emitter: (P to it (..., 3); SUN: a unit direction, weight (...)).

    Sum over i of weight * max(N.L, 0) = light_irradiance(P, N).  n = 1 gives the centre.  ``i`` broadcasts
    against P's leading axes.
    """
    index = np.asarray(i)
    shape = np.broadcast_shapes(np.shape(P)[:-1], index.shape)
    points = np.broadcast_to(np.asarray(P, np.float64), (*shape, 3))
    lattice = np.stack([(index + 0.5) / n, (0.5 + GOLDEN_RATIO * index) % 1], -1)
    return emitter_sample(light, points, np.broadcast_to(lattice, (*shape, 2)), n)


def ring_sample(light: Light, P: F64, turn: F64) -> tuple[F64, F64]:
    """The point of a ring on the emitter that lies at so many turns, as `light_sample`.

    Four of them, a quarter of a turn apart, have the first and second moments of the whole emitter (a rule of degree
    3; Stroud 1971, "Approximate Calculation of Multiple Integrals"), if it `shines_evenly`.
    """
    if light.kind == "AREA" and light.shape not in ("DISK", "ELLIPSE"):
        phi = 2 * np.pi * turn
        square = 0.5 + np.sqrt(1 / 6) * np.stack([np.cos(phi), np.sin(phi)], -1)
    else:
        square = np.stack([np.full_like(turn, 0.5), turn], -1)
    return emitter_sample(light, P, square, 4)


def shines_evenly(light: Light) -> bool:
    """Whether all parts of the emitter send a place about the same light: no cone or spread cuts some of them off."""
    return light.kind in ("POINT", "SUN") or (light.kind == "AREA" and light_uniforms(light)["u_light_spread"][0] == 0)


def emitter_sample(light: Light, P: F64, square: F64, n: int) -> tuple[F64, F64]:
    """The emitter's point that belongs to one of the unit square (..., 2), as one of n evenly spread there."""
    return (area_sample if light.kind == "AREA" else round_sample)(light, P, square, n)


def cone_cosine(cos_n: ArrayLike, sin_sigma: ArrayLike) -> F64:
    """Irradiance of a cone of uniform radiance over the horizon, relative to the same cone at the zenith.

    Lagarde and de Rousiers 2014, "Moving Frostbite to Physically Based Rendering", listing 7 (after Snyder 1996).
    """
    cos_n, sin_sigma = np.broadcast_arrays(np.asarray(cos_n, np.float64), np.asarray(sin_sigma, np.float64))
    partly = np.abs(cos_n) < sin_sigma
    if not partly.any():
        return np.asarray(np.maximum(cos_n, 0.0))
    c, sin2 = np.where(partly, cos_n, 0.0), np.where(partly, sin_sigma, 1.0) ** 2
    sin_n, x = np.sqrt(1 - c * c), np.sqrt(1 / sin2 - 1)
    y = np.clip(-x * c / sin_n, -1, 1)
    r = sin_n * np.sqrt(1 - y * y)
    cut = np.maximum((c * np.arccos(y) - x * r) * sin2 + np.arctan2(r, x), 0) / (np.pi * sin2)
    value: F64 = np.where(partly, cut, np.maximum(cos_n, 0))
    return value


def light_round(light: Light, P: F64) -> tuple[F64, F64, F64]:
    """Of a round lamp: (offset to its centre (..., 3), sine of sigma (...), irradiance facing it (...))."""
    ones = np.ones(P.shape[:-1])
    if light.kind == "SUN":
        direction = light.matrix[:3, 2] / max(float(np.linalg.norm(light.matrix[:3, 2])), 1e-12)
        return np.broadcast_to(direction, P.shape), ones * np.sin(light.radius), ones
    offset = light.matrix[:3, 3] - P
    d2, r2 = dot(offset, offset), light.radius**2
    reach2 = d2 + r2 if light.soft_falloff else np.maximum(d2, r2)
    return offset, np.sqrt(r2 / reach2), 1 / (4 * np.pi * reach2)


def spot_attenuation(uniforms: dict[str, Any], offset: F64) -> F64:
    """What the cone lets through toward P, ``offset`` (..., 3) = lamp - P: smoothstep in the cosine to its axis."""
    local = offset @ np.reshape(uniforms["u_light_to_local"], (3, 3))  # stored by columns: its own transpose
    cosine, steepness = uniforms["u_light_spot"]
    t = np.clip((local[..., 2] / length(local) - cosine) * steepness, 0, 1)
    value: F64 = t * t * (3 - 2 * t)
    return value


def spot_cuts(uniforms: dict[str, Any], offset: F64, reach: F64) -> tuple[Bool, F64]:
    """(whether the cone or its blend cuts through a disc; what it lets through of it where it does not).

    ``offset``: (..., 3) to the disc's centre.  ``reach``: (...) its radius, metres.
    """
    matrix = np.reshape(uniforms["u_light_to_local"], (3, 3))  # stored by columns
    local, (cosine, steepness) = offset @ matrix, uniforms["u_light_spot"]
    # The matrix turns, and then stretches each axis: by so much at most, of the distance.
    by = reach * np.sqrt((matrix**2).sum(0).max()) / length(local)
    c = local[..., 2] / length(local)
    s, wide = np.sqrt(np.maximum(1 - c * c, 0)), np.sqrt(np.maximum(1 - by * by, 0))
    around = (by >= s) & (c > 0)  # the disc holds the axis
    least, most = c * wide - s * by, np.where(around, 1.0, c * wide + s * by)
    whole = (by < 1) & ((least - cosine) * steepness >= 1)
    return ~whole & ((by >= 1) | (most > cosine)), whole.astype(np.float64)


def light_basis(n: F64) -> tuple[F64, F64]:
    """Orthonormal basis around unit vectors.  Duff et al. 2017, "Building an Orthonormal Basis, Revisited"."""
    x, y, z = np.moveaxis(n, -1, 0)
    sign = np.where(z >= 0, 1.0, -1.0)
    a = -1 / (sign + z)
    b = x * y * a
    return np.stack([1 + sign * x * x * a, sign * b, -sign * x], -1), np.stack([b, sign + y * y * a, -y], -1)


def disc_point(square: F64, n: int) -> F64:
    """A point of the unit disc for one of the unit square (..., 2), area kept: the lattice becomes a sunflower head."""
    if n == 1:
        return np.zeros(square.shape)
    phi = 2 * np.pi * square[..., 1]
    points: F64 = np.sqrt(square[..., :1]) * np.stack([np.cos(phi), np.sin(phi)], -1)
    return points


def round_sample(light: Light, P: F64, square: F64, n: int) -> tuple[F64, F64]:
    """light_sample of a round lamp: points of the disc that spans the same cone, at the lamp's centre."""
    offset, sin_sigma, facing = light_round(light, P)
    cos_sigma = np.maximum(np.sqrt(1 - np.minimum(sin_sigma**2, 1)), 1e-2)
    d = length(offset)[..., None]
    s, t = light_basis(offset / d)
    at = disc_point(square, n) * (sin_sigma / cos_sigma)[..., None]
    stretch2 = 1 + dot(at, at)  # (slant distance / d)^2: solid angle falls with its power 3/2
    weight: F64 = facing / (n * cos_sigma**2 * stretch2**1.5)
    offset = offset + d * (at[..., :1] * s + at[..., 1:] * t)
    if light.kind == "SPOT":
        weight = weight * spot_attenuation(light_uniforms(light), offset)
    return (offset / length(offset)[..., None] if light.kind == "SUN" else offset), weight


def area_sample(light: Light, P: F64, square: F64, n: int) -> tuple[F64, F64]:
    """light_sample of an AREA lamp; where its spread is limited, only of the part that sends light to P."""
    uniforms = light_uniforms(light)
    u, v = np.asarray(uniforms["u_light_axis_u"]), np.asarray(uniforms["u_light_axis_v"])
    ellipse = uniforms["u_light_ellipse"]
    offset = light.matrix[:3, 3] - P
    height = np.maximum(-offset @ np.asarray(uniforms["u_light_axis"]), 0)
    share: F64 = np.ones(P.shape[:-1])
    if uniforms["u_light_spread"][0] > 0:
        at, share = spread_point(uniforms, offset, height, square)
    elif ellipse:
        at = disc_point(square, n)
    else:
        at = 2 * square - 1
    offset = offset + at[..., :1] * u + at[..., 1:] * v
    # radiance 1 / (pi area) times solid angle area / n * cos / d^2
    return offset, share * height / (np.pi * n * length(offset) ** 3)


def spread_point(uniforms: dict[str, Any], offset: F64, height: F64, square: F64) -> tuple[F64, F64]:
    """Where the unit square falls on the emitting part, in half extents (..., 2), and the point's share of the power.

    Only the disc of radius height * tan b around the foot of P sends light to it; its rows are sampled.
    """
    u, v = np.asarray(uniforms["u_light_axis_u"]), np.asarray(uniforms["u_light_axis_v"])
    hx, hy = np.linalg.norm(u), np.linalg.norm(v)
    tan_b, norm = uniforms["u_light_spread"]
    fx, fy = -(offset @ u) / hx, -(offset @ v) / hy
    reach = height * tan_b
    y0, y1 = np.maximum(-hy, fy - reach), np.minimum(hy, fy + reach)
    s = square[..., 1]
    y = y0 + (y1 - y0) * s**3 * (10 + s * (6 * s - 15))  # denser at the ends, where rows shorten like a root
    x = hx * np.sqrt(np.maximum(1 - (y / hy) ** 2, 0)) if uniforms["u_light_ellipse"] else hx
    r = np.sqrt(np.maximum(reach**2 - (y - fy) ** 2, 0))
    x0, x1 = np.maximum(-x, fx - r), np.minimum(x, fx + r)
    x = x0 + (x1 - x0) * square[..., 0]
    area = (np.pi if uniforms["u_light_ellipse"] else 4) * hx * hy
    off_axis = np.hypot(x - fx, y - fy) / np.maximum(height, 1e-12)  # tan theta
    cell = 30 * s**2 * (1 - s) ** 2 * np.maximum(y1 - y0, 0) * np.maximum(x1 - x0, 0)
    share: F64 = cell / area * np.maximum(tan_b - off_axis, 0) * norm
    return np.stack([x / hx, y / hy], -1), share


def polygon_edge(a: F64, e: F64, N: F64) -> F64:
    """One edge of Lambert's sum, from a along e, all (3, ...)."""
    (ax, ay, az), (ex, ey, ez) = a, e
    cx, cy, cz = ay * ez - az * ey, az * ex - ax * ez, ax * ey - ay * ex
    size, along = np.sqrt(cx * cx + cy * cy + cz * cz), ax * (ax + ex) + ay * (ay + ey) + az * (az + ez)
    far = size > 1e-6 * np.abs(along)
    angle = np.arctan2(size, along) / np.where(far, size, 1)
    if not far.all():
        angle = np.where(far, angle, 1 / np.where(along == 0, 1, along))
    value: F64 = (cx * N[0] + cy * N[1] + cz * N[2]) * angle
    return value


def area_corners(ellipse: bool) -> F64:
    """Outline of the emitter in half extents, (sides, 2); an ellipse is a polygon of the same area."""
    if not ellipse:
        return np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    phi = 2 * np.pi / ELLIPSE_SIDES * (np.arange(ELLIPSE_SIDES) + 0.5)
    corners: F64 = np.sqrt(2 * np.pi / (ELLIPSE_SIDES * np.sin(2 * np.pi / ELLIPSE_SIDES))) * np.stack(
        [np.cos(phi), np.sin(phi)], -1)
    return corners


def _edges_sum(outline: F64, N: F64) -> F64:
    """Lambert's sum (T,) of a polygon (3, E, T) that is above the horizon; N: (3, T)."""
    return np.asarray(polygon_edge(outline, np.roll(outline, -1, 1) - outline, N[:, None]).sum(0))


def _clipped_sum(outline: F64, N: F64) -> F64:
    """The same of one that is in part above."""
    total, clipped = np.zeros(N.shape[1:]), np.zeros(N.shape[1:], bool)
    leave, enter = np.zeros(N.shape), np.zeros(N.shape)  # where the outline goes below the horizon and comes back
    heights = (outline * N[:, None]).sum(0)
    for n in range(outline.shape[1]):
        a, following = outline[:, n], outline[:, n + 1 - outline.shape[1]]
        e, za, zb = following - a, heights[n], heights[n + 1 - len(heights)]
        rises, falls = (za < 0) & (zb >= 0), (za >= 0) & (zb < 0)
        clipped |= rises | falls
        cut = za / np.where(rises | falls, za - zb, 1)
        start, end = np.where(rises, cut, 0), np.where(falls, cut, 1)
        a, e = a + e * start, e * (end - start)
        enter, leave = np.where(rises, a, enter), np.where(falls, a + e, leave)
        total += np.where((za >= 0) | (zb >= 0), polygon_edge(a, e, N), 0)
    return total + np.where(clipped, polygon_edge(leave, enter - leave, N), 0)


def area_irradiance(light: Light, P: F64, N: F64) -> F64:
    """Irradiance of a uniform polygon, clipped at the horizon.  Lambert 1760, "Photometria"; Baum et al. 1989."""
    uniforms = light_uniforms(light)
    u, v = np.asarray(uniforms["u_light_axis_u"]), np.asarray(uniforms["u_light_axis_v"])
    center = np.asarray(uniforms["u_light_position"]) - P
    corners = area_corners(uniforms["u_light_ellipse"]) @ np.stack([u, v])
    # Components first: NumPy is faster along many places than along three numbers.
    normal = np.ascontiguousarray(N.reshape(-1, 3).T)
    outline = np.ascontiguousarray(center.reshape(-1, 3).T)[:, None] + corners.T[:, :, None]  # (3, sides, places)
    height = outline[0] * normal[0] + outline[1] * normal[1] + outline[2] * normal[2]
    whole, above = (height >= 0).all(0), (height >= 0).any(0)
    if whole.all():
        total = _edges_sum(outline, normal)
    else:
        total, part = np.zeros(len(whole)), above & ~whole
        total[whole] = _edges_sum(outline[:, :, whole], normal[:, whole])
        total[part] = _clipped_sum(outline[:, :, part], normal[:, part])
    hu, hv = np.linalg.norm(u), np.linalg.norm(v)
    total = np.abs(total.reshape(P.shape[:-1])) / (2 * np.pi * (np.pi if uniforms["u_light_ellipse"] else 4) * hu * hv)
    small = max(hu, hv) < POINT_SIZE * length(center)
    if small.any():
        offset, weight = light_sample(light, P, 0, 1)
        total = np.where(small, weight * np.maximum(dot(offset, N) / length(offset), 0), total)
    front = center @ np.asarray(uniforms["u_light_axis"]) < 0
    irradiance: F64 = np.where(front, total, 0.0)
    return irradiance
