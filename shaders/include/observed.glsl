// What a camera's pixel observes of a light: irradiance, lobe and quality, and whether it lies at an edge.
#include "include/brdf.glsl"
#include "include/lights.glsl"
#include "include/pixel.glsl"
uniform sampler2D u_lit;       // share of the lamp's light that arrives
uniform sampler2D u_rim;       // as observe/rim.frag leaves it
uniform float u_level;         // typical radiance of the views
uniform float u_edge_weight;
uniform float u_dark;          // irradiance below this share of the level is as good as none
#ifdef LIGHT_POINTS
const int u_light_points = LIGHT_POINTS;
#else
uniform int u_light_points;    // sample points on the emitter
#endif

const float MIN_COS_V = 0.15;  // beyond 81 degrees a pixel's footprint is too long to stand for a point
const float EDGE_SHARE = 0.02;  // of the light, from which on what a lamp leaves in doubt makes a pixel an edge
const float NO_LIGHT = -1e3;   // marks a channel without light: it says nothing; below UNLIT_BELOW
const float BOUND_QUALITY = 0.5;  // of a good pixel's: a clipped one that were a worse observation says nothing at all

// Unshadowed irradiance over the pixel's footprint, relative to the lamp's power.
float irradiance_of(Pixel pixel) {
    float e = 0.0;
    for (int j = 0; j < 4; j++) {
        vec3 P, N;
        footprint_point(pixel, j, P, N);
        e += 0.25 * light_irradiance(P, N);
    }
    return e;
}

vec3 part_of_lamp(vec3 P, int i, int n, float turn, out float weight) {
#ifdef LIGHT_RING
    return normalize(ring_sample(P, (float(i) + turn) / float(n), weight));
#else
    return normalize(light_sample(P, i, n, weight));
#endif
}

#ifdef LIGHT_WIDE
// How far half vectors count by their light's cosine, 0..1.  What is mirrored is a mean over the lamp's directions, in
// which cosines cancel; but G takes what comes along the surface, as if it counted by its cosine.
float counts_by_cosine(Pixel pixel, out float typical) {
    const int SOME = 8;
    const float HIGH = 0.75, LOW = 0.3;  // the lamp's lowest cosine, of its mean one
    float lowest = 1.0, mean = 0.0, weight;
    typical = 0.0;
    for (int i = 0; i < SOME; i++) {
        float nl = dot(pixel.N, part_of_lamp(pixel.P, i, SOME, 0.0, weight));
        lowest = min(lowest, nl);
        mean += nl / float(SOME);
        typical += max(nl, 0.0) / float(SOME);
    }
    typical = max(typical, 1e-6);
    return clamp((HIGH - lowest / max(mean, 1e-6)) / (HIGH - LOW), 0.0, 1.0);
}
#endif

// A disc with the second moments of the half vectors over the pixel's footprint and the emitter (sin^2(theta_h) of its
// middle, square of its radius), the cosine to the light, and F / (2 cos_l cos_v); zero where the light is below the
// horizon.  e: as irradiance_of.
vec4 lobe_geometry(Pixel pixel, out float e) {
    float sum = 0.0, cos_l = 0.0, fresnel = 0.0, cos_v = 0.0;
    vec3 middle = vec3(0.0);
    mat3 moments = mat3(0.0);
    e = 0.0;
#ifdef LIGHT_WIDE
    float typical, by_cosine = counts_by_cosine(pixel, typical);
#endif
    for (int j = 0; j < 4; j++) {
        vec3 P, N;
        footprint_point(pixel, j, P, N);
        vec3 V = toward_camera(P);
        cos_v += 0.25 * dot(N, V);
        e += 0.25 * light_irradiance(P, N);
        for (int i = 0; i < u_light_points; i++) {
            float weight;
            vec3 L = part_of_lamp(P, i, u_light_points, 0.25 * float(j), weight);  // 16 in all of a ring
            float nl = dot(N, L);
#ifdef LIGHT_WIDE
            weight *= nl > 0.0 ? mix(1.0, nl / typical, by_cosine) : 0.0;
#else
            weight *= max(nl, 0.0);
#endif
            vec3 H = normalize(L + V);
            vec3 off = cross(N, H);
            sum += weight;
            middle += weight * off;
            moments += weight * outerProduct(off, off);
            cos_l += weight * nl;
            fresnel += weight * F_dielectric(dot(V, H));
        }
    }
    if (sum <= 0.0 || cos_v <= 0.0) return vec4(0.0);
    middle /= sum;
    moments /= sum;
    cos_l = clamp(cos_l / sum, 1e-3, 1.0);
    cos_v = clamp(cos_v, 1e-3, 1.0);
    float sin2h = dot(middle, middle), half_trace = 0.5 * max(moments[0][0] + moments[1][1] + moments[2][2] - sin2h, 0.0);
    vec2 disc = disc_of(sin2h, half_trace, max(dot(middle, moments * middle) - sin2h * sin2h, 0.0));
    return vec4(disc, cos_l, fresnel / sum / (2.0 * cos_l * cos_v));
}

// Does a small tilt of the normal change the light as much as that of a point at MIN_COS_L?  A wide lamp whose middle, towards
// L, is lower may be known well by what is above the horizon.
bool is_sensitive(Pixel pixel, vec3 L) {
#ifdef LIGHT_SHARP
    return true;
#else
    const float TILT = 0.05, LEFT = (1.0 - TILT * sqrt(1.0 / (MIN_COS_L * MIN_COS_L) - 1.0)) / sqrt(1.0 + TILT * TILT);
    vec3 away = normalize(pixel.N - TILT * normalize(L - dot(pixel.N, L) * pixel.N));
    return light_irradiance(pixel.P, away) < LEFT * light_irradiance(pixel.P, pixel.N);
#endif
}

// Share of the lamp's unshadowed light that is in doubt: all of it at the terminator, and at the edge of a shadow by how much
// more of it arrives beside the pixel.
float in_doubt(ivec2 at, Pixel pixel, int rim) {
    float least = 1.0, most = 0.0;
    for (int j = 0; j < 9; j++) {
        ivec2 near = clamp(at + ivec2(j % 3, j / 3) - 1, ivec2(0), textureSize(u_lit, 0) - 1);
        float lit = texelFetch(u_lit, near, 0).r;
        bool shown = (rim >> j & 1) == 1;
        least = min(least, shown ? lit : least);
        most = max(most, shown ? lit : most);
    }
    float weight;
    vec3 L = normalize(light_sample(pixel.P, 0, 1, weight));
    float cos_l = dot(pixel.N, L);
    // Of a lamp whose middle is below the horizon, the lobe by the moments of a few points is wrong by 10 % and more.
    bool low = cos_l < 0.0 || (cos_l < MIN_COS_L && is_sensitive(pixel, L));
    return low ? 1.0 : (most - least > EDGE_SHARE ? most - least : 0.0);
}

// Radiance per irradiance and how far to trust it; zero where nothing can be told.  Edges are kept with a small
// weight: texels that have nothing else would lose all their data.  Of a clipped pixel, whose image has no quality, the
// quality is negative.
vec4 observation(vec4 image, vec3 irradiance, float cos_v, bool edge) {
    float e = (irradiance.r + irradiance.g + irradiance.b) / 3.0;
    bool clipped = image.a <= 0.0;
    if (e <= 0.0 || cos_v <= MIN_COS_V || (clipped && max(image.r, max(image.g, image.b)) <= 0.0)) return vec4(0.0);
    vec3 f = mix(vec3(NO_LIGHT), image.rgb / max(irradiance, vec3(1e-20)), greaterThan(irradiance, vec3(1e-3 * e)));
    bool doubtful = edge || (!clipped && image.a < 0.999);
    float quality = cos_v * e / (e + u_dark * u_level) * (doubtful ? u_edge_weight : 1.0);
    return vec4(f, clipped ? -quality * quality : quality * quality);
}

// An observation; of a clipped pixel what it shows at least, without quality, if it would be a good observation.
vec4 with_bound(vec4 observed, float cos_v) {
    if (observed.a >= 0.0) return observed;
    bool good = -observed.a >= BOUND_QUALITY * cos_v * cos_v;
    return vec4(good ? max(observed.rgb, vec3(0.0)) : vec3(0.0), 0.0);
}
