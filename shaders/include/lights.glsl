// Unshadowed irradiance of Cycles' lamps, and points on them.  Twin: irpso_addon/core/shading/lights.py, which also gives
// the uniforms of one lamp (light_uniforms).
//
// P: world position, metres; N: unit shading normal.  Irradiance is relative to the lamp's power: W/m^2 per watt
// (SUN: per W/m^2).  Round lamps (POINT, SPOT, SUN) are, seen from P, cones of uniform radiance of half angle sigma.

#ifndef PI
#define PI 3.14159265358979
#endif

// Software rasterisers compute every branch that a uniform decides, so programs may be made for one kind of lamp
// (LIGHT_KIND), and for lamps without a radius (LIGHT_SHARP).
#ifdef LIGHT_KIND
const int u_light_kind = LIGHT_KIND;
#else
uniform int u_light_kind;           // LIGHT_*
#endif
uniform vec3 u_light_position;      // world
uniform vec3 u_light_axis;          // world, unit: where the lamp's -Z points
#ifdef LIGHT_SHARP
const float u_light_radius = 0.0;
#else
uniform float u_light_radius;       // POINT, SPOT: metres; SUN: half angle, radians
#endif
uniform bool u_light_soft;          // POINT, SPOT: the emitter is a disc that faces P (else a sphere)
uniform mat3 u_light_to_local;      // SPOT: world offset to the lamp's frame, its scale divided out
uniform vec2 u_light_spot;          // SPOT: cosine of half the cone, 1 / (width of the blend in cosine)
uniform vec3 u_light_axis_u;        // AREA: half extents as world vectors
uniform vec3 u_light_axis_v;
uniform bool u_light_ellipse;       // AREA: disk or ellipse (else square or rectangle)
uniform vec2 u_light_spread;        // AREA: tan b, 1 / (tan b - b) with b half the spread; x = 0: no limit

// From core/shading/lights.py, through SHARED_CONSTANTS of gpu/device/programs.py:
// LIGHT_POINT, LIGHT_SUN, LIGHT_SPOT, LIGHT_AREA: kinds.
// LIGHT_ELLIPSE_SIDES: of the polygon, of the same area, that stands for an ellipse.
// LIGHT_POINT_SIZE: half extent / distance below which an AREA is a point: its outline's edges would cancel in float32,
// while the point is off by its square, 2.5e-5.
// LIGHT_QUADRATURE: squared, points where there is no closed form, AREA with spread and at the rim of a soft SPOT.

// Irradiance of a cone of uniform radiance over the horizon, relative to the same cone at the zenith.
// Lagarde and de Rousiers 2014, "Moving Frostbite to Physically Based Rendering", listing 7 (after Snyder 1996).
float cone_cosine(float cos_n, float sin_sigma) {
#ifdef LIGHT_SHARP
    return max(cos_n, 0.0);
#endif
    if (cos_n >= sin_sigma) return cos_n;
    if (cos_n <= -sin_sigma) return 0.0;
    float sin_n = sqrt(1.0 - cos_n * cos_n);
    float sin2 = sin_sigma * sin_sigma;
    float x = sqrt(1.0 / sin2 - 1.0);
    float y = clamp(-x * cos_n / sin_n, -1.0, 1.0);
    float r = sin_n * sqrt(1.0 - y * y);
    return max((cos_n * acos(y) - x * r) * sin2 + atan(r, x), 0.0) / (PI * sin2);
}

// Toward the centre of a round lamp: unnormalised offset (SUN: unit), sine of sigma, irradiance facing it.
vec3 light_round(vec3 P, out float sin_sigma, out float facing) {
    if (u_light_kind == LIGHT_SUN) {
        sin_sigma = sin(u_light_radius);
        facing = 1.0;
        return -u_light_axis;
    }
    vec3 offset = u_light_position - P;
    float d2 = dot(offset, offset), r2 = u_light_radius * u_light_radius;
    float reach2 = u_light_soft ? d2 + r2 : max(d2, r2);
    sin_sigma = sqrt(r2 / reach2);
    facing = 1.0 / (4.0 * PI * reach2);
    return offset;
}

// What the cone of a SPOT lets through toward P, `offset` = lamp - P: smoothstep in the cosine to its axis.
float spot_attenuation(vec3 offset) {
    vec3 local = u_light_to_local * offset;
    float t = clamp((local.z / length(local) - u_light_spot.x) * u_light_spot.y, 0.0, 1.0);
    return t * t * (3.0 - 2.0 * t);
}

// Does such a cone, or its blend, cut through a disc of radius `reach`, metres?  offset: to the disc's centre; share:
// what it lets through of a disc that it does not cut.
bool spot_cuts(vec3 offset, float reach, out float share) {
    vec3 local = u_light_to_local * offset, row2 = u_light_to_local[0] * u_light_to_local[0]
        + u_light_to_local[1] * u_light_to_local[1] + u_light_to_local[2] * u_light_to_local[2];
    // The matrix turns, and then stretches each axis: by so much at most, of the distance.
    float by = reach * sqrt(max(max(row2.x, row2.y), row2.z)) / length(local);
    float c = local.z / length(local), s = sqrt(max(1.0 - c * c, 0.0)), wide = sqrt(max(1.0 - by * by, 0.0));
    bool around = by >= s && c > 0.0;  // the disc holds the axis
    float least = c * wide - s * by, most = around ? 1.0 : c * wide + s * by;
    bool whole = by < 1.0 && (least - u_light_spot.x) * u_light_spot.y >= 1.0;
    share = float(whole);
    return !whole && (by >= 1.0 || most > u_light_spot.x);
}

// Orthonormal basis around the unit vector n. Duff et al. 2017, "Building an Orthonormal Basis, Revisited".
void light_basis(vec3 n, out vec3 s, out vec3 t) {
    float z = n.z >= 0.0 ? 1.0 : -1.0;
    float a = -1.0 / (z + n.z), b = n.x * n.y * a;
    s = vec3(1.0 + z * n.x * n.x * a, z * b, -z * n.x);
    t = vec3(b, z + n.y * n.y * a, -n.y);
}

// A point of the unit disc for one of the unit square, area kept: the lattice below becomes a sunflower head.
vec2 disc_point(vec2 square, float n) {
    if (n == 1.0) return vec2(0.0);
    float phi = 2.0 * PI * square.y;
    return sqrt(square.x) * vec2(cos(phi), sin(phi));
}

vec3 round_sample(vec3 P, vec2 square, float n, out float weight) {
    float sin_sigma, facing;
    vec3 offset = light_round(P, sin_sigma, facing);
    float cos_sigma = max(sqrt(1.0 - min(sin_sigma * sin_sigma, 1.0)), 1e-2);
    float d = length(offset);
    vec3 s, t;
    light_basis(offset / d, s, t);
    vec2 at = disc_point(square, n) * (sin_sigma / cos_sigma);
    float stretch2 = 1.0 + dot(at, at); // (slant distance / d)^2: solid angle falls with its power 3/2
    weight = facing / (n * cos_sigma * cos_sigma * stretch2 * sqrt(stretch2));
    offset += d * (at.x * s + at.y * t);
    if (u_light_kind == LIGHT_SPOT) weight *= spot_attenuation(offset);
    return u_light_kind == LIGHT_SUN ? normalize(offset) : offset;
}

// The part of a row y (both along half extents, metres) of the emitter that sends light to P.
vec2 area_row(float y, vec2 half_size, vec2 foot, float reach) {
    float x = half_size.x;
    if (u_light_ellipse) x *= sqrt(max(1.0 - y * y / (half_size.y * half_size.y), 0.0));
    float r = sqrt(max(reach * reach - (y - foot.y) * (y - foot.y), 0.0));
    return vec2(max(-x, foot.x - r), min(x, foot.x + r));
}

vec3 area_sample(vec3 P, vec2 square, float n, out float weight) {
    vec2 half_size = vec2(length(u_light_axis_u), length(u_light_axis_v));
    vec3 offset = u_light_position - P;
    float height = -dot(offset, u_light_axis);
    float area = (u_light_ellipse ? PI : 4.0) * half_size.x * half_size.y;
    vec2 at;
    float share = 1.0;
    if (u_light_spread.x > 0.0) {
        // Only the disc of radius height * tan b around the foot of P sends light to it: sample its rows.
        vec2 foot = -vec2(dot(offset, u_light_axis_u), dot(offset, u_light_axis_v)) / half_size;
        float reach = max(height, 0.0) * u_light_spread.x;
        vec2 rows = vec2(max(-half_size.y, foot.y - reach), min(half_size.y, foot.y + reach));
        // Denser toward the first and last row, where the length of rows falls like a square root.
        float s = square.y;
        at.y = mix(rows.x, rows.y, s * s * s * (10.0 + s * (6.0 * s - 15.0)));
        vec2 row = area_row(at.y, half_size, foot, reach);
        at.x = mix(row.x, row.y, square.x);
        float off_axis = length(at - foot) / max(height, 1e-12); // tan theta
        share = 30.0 * s * s * (1.0 - s) * (1.0 - s) * max(rows.y - rows.x, 0.0) * max(row.y - row.x, 0.0) / area
              * max(u_light_spread.x - off_axis, 0.0) * u_light_spread.y;
        at /= half_size;
    } else if (u_light_ellipse) {
        at = disc_point(square, n);
    } else {
        at = 2.0 * square - 1.0;
    }
    offset += at.x * u_light_axis_u + at.y * u_light_axis_v;
    float d2 = dot(offset, offset);
    // radiance 1 / (pi area) times solid angle area / n * cos / d^2
    weight = share * max(height, 0.0) / (PI * n * d2 * sqrt(d2));
    return offset;
}

// The emitter's point that belongs to one of the unit square, as one of n evenly spread there.
vec3 emitter_sample(vec3 P, vec2 square, float n, out float weight) {
    return u_light_kind == LIGHT_AREA ? area_sample(P, square, n, weight) : round_sample(P, square, n, weight);
}

// The i-th of n points on the emitter: from P to it (SUN: a unit direction), and how much it counts:
// sum over i of weight * max(N.L, 0) = light_irradiance(P, N).  n = 1 gives the centre.
vec3 light_sample(vec3 P, int i, int n, out float weight) {
    vec2 lattice = vec2((float(i) + 0.5) / float(n), fract(0.5 + GOLDEN_RATIO * float(i)));
    return emitter_sample(P, lattice, float(n), weight);
}

// The point of a ring on the emitter that lies at so many turns.  Four of them, a quarter of a turn apart, have the
// first and second moments of the whole emitter; not of an AREA with spread, of which P sees a part.
vec3 ring_sample(vec3 P, float turn, out float weight) {
    if (u_light_kind == LIGHT_AREA && !u_light_ellipse) {
        float phi = 2.0 * PI * turn;
        return emitter_sample(P, 0.5 + sqrt(1.0 / 6.0) * vec2(cos(phi), sin(phi)), 4.0, weight);
    }
    return emitter_sample(P, vec2(0.5, turn), 4.0, weight);
}

// One edge of Lambert's sum: from a along e.  The edge itself, not its far end, keeps small lamps precise.
float polygon_edge(vec3 a, vec3 e, vec3 N) {
    vec3 c = cross(a, e);
    float size = length(c), along = dot(a, a + e);
    return dot(c, N) * (size > 1e-6 * abs(along) ? atan(size, along) / size : 1.0 / along);
}

vec2 area_corner(int k) {
    if (!u_light_ellipse) return vec2(k == 1 || k == 2 ? 1.0 : -1.0, k >= 2 ? 1.0 : -1.0);
    float sides = float(LIGHT_ELLIPSE_SIDES), phi = 2.0 * PI / sides * (float(k) + 0.5);
    return sqrt(2.0 * PI / (sides * sin(2.0 * PI / sides))) * vec2(cos(phi), sin(phi));
}

// Irradiance of a uniform polygon, clipped at the horizon. Lambert 1760, "Photometria"; Baum et al. 1989, eq. 5.
float area_irradiance(vec3 P, vec3 N) {
    vec3 center = u_light_position - P;
    if (dot(center, u_light_axis) >= 0.0) return 0.0; // P lies behind the emitter
    if (max(length(u_light_axis_u), length(u_light_axis_v)) < LIGHT_POINT_SIZE * length(center)) {
        float weight;
        vec3 offset = area_sample(P, vec2(0.5), 1.0, weight);
        return weight * max(dot(N, normalize(offset)), 0.0);
    }
    int sides = u_light_ellipse ? LIGHT_ELLIPSE_SIDES : 4;
    vec3 leave = vec3(0.0), enter = vec3(0.0); // where the outline goes below the horizon and comes back
    bool clipped = false;
    float sum = 0.0;
    vec2 first = area_corner(0), corner = first;
    // Each corner's height is that of both its edges, the first's too, so that an outline comes back as often as it goes
    // below: a compiler may round cos and sin differently outside the loop.
    float z_first = dot(center + first.x * u_light_axis_u + first.y * u_light_axis_v, N), za = z_first;
    for (int k = 0; k < sides; k++) {
        bool closes = k + 1 == sides;
        vec2 next = closes ? first : area_corner(k + 1);
        vec3 a = center + corner.x * u_light_axis_u + corner.y * u_light_axis_v;
        vec3 e = (next.x - corner.x) * u_light_axis_u + (next.y - corner.y) * u_light_axis_v;
        float zb = closes ? z_first : dot(center + next.x * u_light_axis_u + next.y * u_light_axis_v, N);
        float cut = za / (za - zb); // share of the edge before the horizon, where it crosses
        if (za < 0.0 && zb >= 0.0) {
            clipped = true;
            a += e * cut;
            e *= 1.0 - cut;
            enter = a;
        } else if (za >= 0.0 && zb < 0.0) {
            clipped = true;
            e *= cut;
            leave = a + e;
        }
        if (za >= 0.0 || zb >= 0.0) sum += polygon_edge(a, e, N);
        corner = next;
        za = zb;
    }
    if (clipped) sum += polygon_edge(leave, enter - leave, N);
    float area = (u_light_ellipse ? PI : 4.0) * length(u_light_axis_u) * length(u_light_axis_v);
    return abs(sum) / (2.0 * PI * area);
}

// The same by side * side points of the emitter.
float summed_irradiance(vec3 P, vec3 N, int side) {
    float sum = 0.0;
    for (int y = 0; y < side; y++) for (int x = 0; x < side; x++) {
        float weight;
        vec2 cell = (vec2(x, y) + 0.5) / float(side);
        vec3 L = normalize(emitter_sample(P, cell, float(side * side), weight));
        sum += weight * max(dot(N, L), 0.0);
    }
    return sum;
}

// Unshadowed irradiance at P, relative to the lamp's power.
float light_irradiance(vec3 P, vec3 N) {
    if (u_light_kind == LIGHT_AREA && u_light_spread.x == 0.0) return area_irradiance(P, N);
    if (u_light_kind == LIGHT_AREA) return summed_irradiance(P, N, LIGHT_QUADRATURE);
    float sin_sigma, facing;
    vec3 offset = light_round(P, sin_sigma, facing);
    float e = facing * cone_cosine(dot(N, offset) / length(offset), sin_sigma);
    if (u_light_kind != LIGHT_SPOT) return e;
    if (u_light_radius == 0.0) return e * spot_attenuation(offset);
    float share, reach = length(offset) * sin_sigma / max(sqrt(1.0 - min(sin_sigma * sin_sigma, 1.0)), 1e-2);
    bool cut = spot_cuts(offset, reach, share);
    // A software renderer computes what a branch leaves out, but ends a loop.
    float sum = summed_irradiance(P, N, cut ? LIGHT_QUADRATURE : 0);
    return cut ? sum : e * share;
}
