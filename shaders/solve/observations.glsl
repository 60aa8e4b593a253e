// One texel's observations, as irpso_addon/gpu/observe/observation_atlas.py lays them out.
//
// Observation n is layer n; one that a texel does not have weighs nothing, and a group that it does not have is
// passed over.  (Packing those that it has would index arrays differently in each texel: twice as slow.)
//
// Defines: LAYERS observations, GROUPS of them with their bounds GROUP_STARTS, their channels GROUP_CHANNELS;
// LIGHTS lobes a view, CHANNELS (1 or 3), LOBES of the model.  EACH_GROUP (solve/each_group.glsl) expands to
// GROUP(k, first, end) for each group, with constants where layers are so few that unrolled loops pay (compilers leave
// a loop around a loop).
// NDF_BECKMANN: Cook-Torrance with Beckmann's distribution instead of the Principled BSDF.
// SPECULAR: the Specular IOR Level of each texel is read from u_level, or with LEVEL_SEARCHED use_level() sets it;
// without, it is 0.5.
// METALLIC: of one lobe; Metallic is u_metallic; without, it is 0.
// ENVIRONMENT: layers have nodes of what lobes return of light from all around, after those of the lights.
// TILTS: normals are known roughly: what a tilt would explain of the differences within a group is no residual.
// COAT: of one lobe; what a coat reflects is taken off each observation, and the rest is what lies below it by itself.
// ROUGH_DIFFUSE: of one lobe, no metal, no coat; see rough_diffuse.glsl.
#include "include/kernel.glsl"
#include "include/brdf.glsl"
#include "solve/each_group.glsl"
uniform sampler2D u_texel_position;
uniform sampler2D u_observations;  // LAYERS x BLOCKS blocks of u_tile_height rows
uniform int u_tile_height;
uniform ivec2 u_tile;
uniform float u_group_slack;

#ifdef SPECULAR
#ifndef LEVEL_SEARCHED
uniform sampler2D u_level;
#endif
float obs_level;
#endif

#ifdef METALLIC
uniform float u_metallic;
#endif

#ifdef ROUGH_DIFFUSE
uniform float u_diffuse_roughness;
vec2 obs_rough[LAYERS];  // what a rough diffuse shows over what a smooth one does: first + second * rough_bounce
float obs_gain[LAYERS];  // the same, about the texel's base colour
#endif

#ifdef ENVIRONMENT
#include "include/node_curve.glsl"
ivec2 obs_at;  // the texel in the atlas

// The nodes 4 k to 4 k + 3 of observation n; part 1: their cosines.
vec4 nodes_of(int n, int k, int part) {
    int block = n * BLOCKS + 2 + LIGHTS + part * (ENVIRONMENT_NODES / 4) + k;
    return texelFetch(u_observations, obs_at + ivec2(0, block * u_tile_height), 0);
}

// What a lobe returns of the environment at IOR 1.5, without the gain by multiple scattering: (value, d/dr, V.H).
vec3 environment_d(int n, float r) {
    NodePlace p = node_place(r);
    int from = max(p.node - 1, 0), last = min(p.node + 2, ENVIRONMENT_NODES - 1);
    vec4 a = nodes_of(n, from / 4, 0), b = from / 4 == last / 4 ? a : nodes_of(n, last / 4, 0);
#define NODE(k) ((k) / 4 == from / 4 ? a[(k) % 4] : b[(k) % 4])
    float value, d_value, cos_vh = 1.0;
    node_curve(p, vec4(NODE(from), NODE(p.node), NODE(p.node + 1), NODE(last)), value, d_value);
#undef NODE
#if defined(SPECULAR) || defined(METALLIC)
    vec4 c = nodes_of(n, p.node / 4, 1), d = (p.node + 1) / 4 == p.node / 4 ? c : nodes_of(n, (p.node + 1) / 4, 1);
    cos_vh = clamp(mix(c[p.node % 4], d[(p.node + 1) % 4], p.t), 0.0, 1.0);
#endif
#ifdef ROUGH_DIFFUSE
    value /= obs_gain[n];
    d_value /= obs_gain[n];
#endif
    return vec3(value, d_value, cos_vh);
}
#endif

#ifdef COAT
uniform vec2 u_coat;     // weight, roughness
float obs_coat[LAYERS];  // what was taken off, as f
#endif

#if LOBES == 2
const float SEARCHED = NUMBERS_OF_TWO;  // numbers that are neither base colour nor given
#else
const float SEARCHED = 1.0;
#endif

const float NEGLIGIBLE = 1e-5;  // share of an observation's weight that another's may be dropped for

const int GROUP_START[GROUPS + 1] = int[](GROUP_STARTS);
const int GROUP_CHANNEL[GROUPS] = int[](GROUP_CHANNELS);
float obs_f[LAYERS], obs_weight[LAYERS];
#if LIGHTS > 0
#define LOBES_HELD (LAYERS * LIGHTS)
#else
#define LOBES_HELD 1  // no array is empty
#endif
float lobe_sin2h[LOBES_HELD], lobe_tan2[LOBES_HELD], lobe_factor[LOBES_HELD];
#ifdef LEVEL_SEARCHED
float lobe_given[LOBES_HELD], lobe_cos_vh[LOBES_HELD];  // the factor at level 0.5
#endif
#ifdef SPREAD
float lobe_radius2[LOBES_HELD];
#endif
#ifdef METALLIC
vec2 lobe_metal[LOBES_HELD];  // u_metallic times the factor of a black metal, and what a white one's has beyond
#endif
float group_cos_v[GROUPS];
float group_base[GROUPS];  // mean f of the group, subtracted from each: sums of squares keep their digits in float32
bool group_seen[GROUPS];
#ifdef TILTS
uniform sampler2D u_texel_normal;
uniform sampler2D u_lamps;  // a row for each layer: place of each light and 1, or direction to it and 0
#ifdef TILTS_TRIED
float tilt_deviation;          // standard deviation of a tilt, in radians for a relative error of noise of 1
float obs_widened;             // logarithm of by how much tilts make what is expected wider
float obs_within;              // degrees of freedom within groups, with those that tilts take
#else
uniform float u_tilt;          // the same
#define tilt_deviation u_tilt
#endif
vec2 obs_tilt[LAYERS];      // sums of errors times these are what a tilt explains; they add up to 0 in each group
#endif
#ifdef COLOUR
vec3 obs_rgb[LAYERS];  // f of R, G and B
#endif
float obs_total;    // number of good observations
float obs_share;    // how well the good ones' pixels stand for the texel, 0..1
float obs_free;     // degrees of freedom that the residual has at the best roughness

#ifdef TILTS
// Relative change of a lamp's irradiance by a tilt about each of two axes.  lobe: as the atlas has it.
vec2 tilt_slope(int n, int l, vec3 P, vec3 A, vec3 B, vec4 lobe, float cos_v) {
    vec4 lamp = texelFetch(u_lamps, ivec2(l, n), 0);
    vec3 L = normalize(lamp.xyz - lamp.w * P);
    float cos_vh = (lobe.z + cos_v) / (2.0 * sqrt(max(1.0 - lobe.x, 1e-6)));
    // Its share of the irradiance over N.L, from the lobe's factor.
    float share = lobe.w * 2.0 * cos_v / F_dielectric(min(cos_vh, 1.0));
#ifdef METALLIC
    share *= 1.0 - u_metallic;  // a metal's own part is a lobe
#endif
    return share * vec2(dot(L, A), dot(L, B));
}

// Makes of a group's slopes those of errors about its mean, so that what a tilt explains of them is a sum of squares
// (the tilt, a priori normal, is eliminated).  Returns how many degrees of freedom that takes.
float tilted(int g, float total, float typical) {
    vec2 mean = vec2(0.0);
    for (int n = GROUP_START[g]; n < GROUP_START[g + 1]; n++) mean += obs_weight[n] / total * obs_tilt[n];
    float least = 1.0 / (tilt_deviation * tilt_deviation);
    vec3 square = vec3(least, 0.0, least);
    for (int n = GROUP_START[g]; n < GROUP_START[g + 1]; n++) {
        vec2 b = typical * (obs_tilt[n] - mean);
        obs_tilt[n] = b;
        square += obs_weight[n] * vec3(b.x * b.x, b.x * b.y, b.y * b.y);
    }
    float first = inversesqrt(square.x), across = square.y * first;
    float second = inversesqrt(max(square.z - across * across, least));
#ifdef TILTS_TRIED
    obs_widened -= 2.0 * log(first * second * least);
#endif
    float taken = 0.0;
    for (int n = GROUP_START[g]; n < GROUP_START[g + 1]; n++) {
        vec2 b = obs_tilt[n];
        b.x *= first;
        b.y = (b.y - across * b.x) * second;
        obs_tilt[n] = obs_weight[n] * b;
        taken += obs_weight[n] * dot(b, b);
    }
    return taken;
}
#endif

// Noise grows with the signal, so errors count relative to it: to the observation itself where it is
// a highlight, else to the texel's typical one.  (Relative to itself always, a pixel wrongly taken
// for lit would outweigh all others by being dark.)
void weigh_observations(bool edges[LAYERS]) {
    float typical = 1e30;
    for (int pass = 0; pass < 4; pass++) {
        float sum = 0.0, total = 1e-12;
        for (int n = 0; n < LAYERS; n++) {
            float f = max(obs_f[n], 0.0);
            float w = obs_weight[n] / (pass == 0 ? 1.0 : max(f, typical));
            sum += w * f;
            total += w;
        }
        typical = max(sum / total, 1e-4);
    }
    // Edges of shadow and silhouette count where there is little else; beside good observations even
    // their small weight would outweigh the precision of those.
    float edge = exp2(-6.0 * min(obs_total, 6.0));  // never zero: a group of edges alone still has a mean
    for (int g = 0; g < GROUPS; g++) {
        float sum = 0.0, total = 1e-30;
        for (int n = GROUP_START[g]; n < GROUP_START[g + 1]; n++) {
#ifdef COAT
            float unit = max(obs_f[n] + obs_coat[n], typical);
#else
            float unit = max(obs_f[n], typical);
#endif
            obs_weight[n] *= (edges[n] ? edge : 1.0) / (unit * unit);
            sum += obs_weight[n] * obs_f[n];
            total += obs_weight[n];
        }
        group_base[g] = sum / total;
        for (int n = GROUP_START[g]; n < GROUP_START[g + 1]; n++) obs_f[n] -= group_base[g];
#ifdef TILTS
        obs_free -= tilted(g, total, typical);
#endif
    }
}

#ifdef ROUGH_DIFFUSE
#include "solve/rough_diffuse.glsl"
#endif

// Loads the texel's valid observations; false when it is uncovered or has none.
bool load_observations() {
    obs_total = obs_free = obs_share = 0.0;
#ifdef TILTS_TRIED
    obs_widened = 0.0;
#endif
    ivec2 texel = texel_here();
    if (any(greaterThanEqual(texel, textureSize(u_texel_position, 0)))) return false;
    if (texelFetch(u_texel_position, texel, 0).w < 0.5) return false;
    ivec2 at = texel - u_tile;
#ifdef ENVIRONMENT
    obs_at = at;
#endif
#if defined(SPECULAR) && !defined(LEVEL_SEARCHED)
    obs_level = texelFetch(u_level, texel, 0).r;
#endif
#ifdef TILTS
    vec3 P = texelFetch(u_texel_position, texel, 0).xyz, N = normalize(texelFetch(u_texel_normal, texel, 0).xyz);
    vec3 A = normalize(cross(N, abs(N.z) < 0.9 ? vec3(0.0, 0.0, 1.0) : vec3(0.0, 1.0, 0.0))), B = cross(N, A);
#endif
#ifdef ROUGH_DIFFUSE
    vec3 rough = rough_bounces(at);
#endif
    bool edges[LAYERS];
    float groups = 0.0;
    bool some = false;
    for (int g = 0; g < GROUPS; g++) {
        group_seen[g] = false;
        group_cos_v[g] = 1.0;
        float good_ones = 0.0;
        for (int n = GROUP_START[g]; n < GROUP_START[g + 1]; n++) {
            vec4 o = texelFetch(u_observations, at + ivec2(0, n * BLOCKS * u_tile_height), 0);
            bool seen = o.y > 0.0;
            obs_f[n] = o.x;
            obs_weight[n] = max(o.y, 0.0);
            edges[n] = int(o.w) % 2 == 1;
            group_cos_v[g] = seen ? o.z : group_cos_v[g];
            group_seen[g] = group_seen[g] || seen;
#ifdef COLOUR
            obs_rgb[n] = texelFetch(u_observations, at + ivec2(0, (n * BLOCKS + 1) * u_tile_height), 0).rgb;
#endif
#ifdef ROUGH_DIFFUSE
            obs_f[n] /= obs_gain[n];
#ifdef COLOUR
            obs_rgb[n] /= obs_rough[n].x + obs_rough[n].y * rough;
#endif
#endif
            float good = seen && !edges[n] ? 1.0 : 0.0;
            obs_share += good * 2.0 * fract(o.w);
#ifdef COAT
            float coat_alpha2 = u_coat.y * u_coat.y * u_coat.y * u_coat.y, coat_lobe = 0.0;
            float coat_root = lambda_root(coat_alpha2, 1.0 / (max(o.z, 1e-3) * max(o.z, 1e-3)) - 1.0);
#endif
            good_ones += good;
#ifdef TILTS
            obs_tilt[n] = vec2(0.0);
#endif
            for (int l = 0; l < LIGHTS; l++) {
                vec4 v = texelFetch(u_observations, at + ivec2(0, (n * BLOCKS + 2 + l) * u_tile_height), 0);
                int i = n * LIGHTS + l;
                lobe_sin2h[i] = v.x;
#ifdef SPREAD
                lobe_radius2[i] = v.y;
#endif
                lobe_tan2[i] = 1.0 / (v.z * v.z + 1e-12) - 1.0;
#ifdef TILTS
                if (v.w > 0.0) obs_tilt[n] += tilt_slope(n, l, P, A, B, v, o.z);  // else a layer with fewer lights
#endif
#ifdef ROUGH_DIFFUSE
                v.w /= obs_gain[n];
#endif
                lobe_factor[i] = v.w;
#ifdef COAT
                coat_lobe += v.w * D_ggx_disc(coat_alpha2, v.x, v.y)
                           / (coat_root + lambda_root(coat_alpha2, lobe_tan2[i]));
#endif
#if defined(SPECULAR) || defined(METALLIC)
                float cos_vh = (v.z + o.z) / (2.0 * sqrt(max(1.0 - v.x, 1e-6)));  // from N.H = (N.L + N.V) / |L + V|
#endif
#ifdef METALLIC
                float black = F_schlick(min(cos_vh, 1.0));
                lobe_metal[i] = u_metallic * v.w / F_dielectric(min(cos_vh, 1.0)) * vec2(black, 1.0 - black);
                lobe_factor[i] *= 1.0 - u_metallic;
#endif
#ifdef LEVEL_SEARCHED
                lobe_given[i] = lobe_factor[i];
                lobe_cos_vh[i] = min(cos_vh, 1.0);
#elif defined(SPECULAR)
                lobe_factor[i] *= F_level_ratio(min(cos_vh, 1.0), obs_level);
#endif
            }
#if defined(COAT) && defined(ENVIRONMENT)
            coat_lobe += environment_d(n, u_coat.y).x;
#endif
#ifdef COAT
            float left = seen ? left_by_coat(u_coat, o.z) : 1.0;
            obs_coat[n] = seen ? u_coat.x * principled_energy(u_coat.y, o.z).x * coat_lobe / left : 0.0;
            obs_f[n] = obs_f[n] / left - obs_coat[n];
#ifdef COLOUR
            obs_rgb[n] = obs_rgb[n] / left - obs_coat[n];
#endif
#endif
        }
        obs_total += good_ones;
        groups += min(good_ones, 1.0);
        some = some || group_seen[g];
    }
    obs_share /= max(obs_total, 1.0);
    weigh_observations(edges);
    // Within groups, and between them as far as the slack lets that count; some are spent on the search.
    // (obs_free: less what tilts take.)
#ifdef TILTS_TRIED
    obs_within = obs_total - groups;
#endif
    float all = max(obs_total - groups + obs_free, 0.0) + max(groups - 1.0, 0.0) / (1.0 + u_group_slack);
    obs_free = all * max(obs_total - 1.0 - SEARCHED, 0.25) / max(obs_total - 1.0, 0.5);
    return some;
}

#ifdef LEVEL_SEARCHED
// Of the observations that are loaded.  (To load them for each level takes many more rounds, and llvmpipe ends a
// shader's loops after 65535 in all.)
void use_level(float level) {
    obs_level = level;
    for (int i = 0; i < LAYERS * LIGHTS; i++) lobe_factor[i] = lobe_given[i] * F_level_ratio(lobe_cos_vh[i], level);
}
#endif

// What a camera's direction makes of a roughness: the diffuse a and the gain of the lobe with their
// derivatives, and of the masking term the camera's root.
#ifdef METALLIC
struct Toward { float diffuse, d_diffuse, comp, d_comp, root, d_root; vec2 metal, d_metal; };  // metal: metal_energy_d
#else
struct Toward { float diffuse, d_diffuse, comp, d_comp, root, d_root; };
#endif

Toward toward(float r, float cos_v) {
    float alpha2 = r * r * r * r, d_alpha2 = 4.0 * r * r * r;
    float tan2 = 1.0 / (cos_v * cos_v) - 1.0;
    Toward t;
#ifdef NDF_BECKMANN
    t.diffuse = 1.0 / PI;
    t.d_diffuse = t.d_comp = 0.0;
    t.comp = 1.0;
    lambda_root_beckmann_d(alpha2, tan2, t.root, t.d_root);
    t.d_root *= d_alpha2;
#else
    vec2 energy, d_energy;
#ifdef SPECULAR
    vec2 d_level;
    principled_energy_level_d(r, cos_v, obs_level, energy, d_energy, d_level);
#else
    principled_energy_d(r, cos_v, energy, d_energy);
#endif
    t.comp = energy.x;
    t.d_comp = d_energy.x;
    t.diffuse = (1.0 - energy.y) / PI;
    t.d_diffuse = -d_energy.y / PI;
    t.root = lambda_root(alpha2, tan2);
    t.d_root = 0.5 * tan2 / t.root * d_alpha2;
#endif
#ifdef METALLIC
    metal_energy_d(r, cos_v, t.metal, t.d_metal);
#endif
    return t;
}

float radius2_of(int i) {
#ifdef SPREAD
    return lobe_radius2[i];
#else
    return 0.0;  // points, seen and lit
#endif
}

// Specular part of observation n at roughness r, and its derivative.
void specular_d(int n, float r, Toward t, out float s, out float ds) {
    float alpha2 = r * r * r * r, d_alpha2 = 4.0 * r * r * r;
    s = ds = 0.0;
    for (int l = 0; l < LIGHTS; l++) {
        int i = n * LIGHTS + l;
        float value, slope;
#ifdef NDF_BECKMANN
        float root_l, d_root_l;
        D_beckmann_disc_d(alpha2, lobe_sin2h[i], radius2_of(i), value, slope);
        lambda_root_beckmann_d(alpha2, lobe_tan2[i], root_l, d_root_l);
        d_root_l *= d_alpha2;
#else
        D_ggx_disc_d(alpha2, lobe_sin2h[i], radius2_of(i), value, slope);
        float root_l = lambda_root(alpha2, lobe_tan2[i]);
        float d_root_l = 0.5 * lobe_tan2[i] / root_l * d_alpha2;
#endif
        float down = 1.0 / (root_l + t.root);
        float term = lobe_factor[i] * down;
        s += term * value;
        ds += term * (slope * d_alpha2 - value * down * (d_root_l + t.d_root));
    }
#ifdef ENVIRONMENT
    vec3 around = environment_d(n, r);
#ifdef SPECULAR
    around.xy *= F_level_ratio(around.z, obs_level);
#endif
#ifdef METALLIC
    around.xy *= 1.0 - u_metallic;
#endif
    s += around.x;
    ds += around.y;
#endif
    ds = ds * t.comp + s * t.d_comp;
    s *= t.comp;
}

#ifdef METALLIC
// Specular part of observation n at roughness r, and m (black, white - black) without the gain; with derivatives.
void metal_parts_d(int n, float r, Toward t, out vec3 parts, out vec3 slopes) {
    float alpha2 = r * r * r * r, d_alpha2 = 4.0 * r * r * r;
    parts = slopes = vec3(0.0);
    for (int l = 0; l < LIGHTS; l++) {
        int i = n * LIGHTS + l;
        float value, slope;
        D_ggx_disc_d(alpha2, lobe_sin2h[i], radius2_of(i), value, slope);
        float root_l = lambda_root(alpha2, lobe_tan2[i]);
        float down = 1.0 / (root_l + t.root), d_root_l = 0.5 * lobe_tan2[i] / root_l * d_alpha2;
        vec3 term = down * vec3(lobe_factor[i], lobe_metal[i]);
        parts += term * value;
        slopes += term * (slope * d_alpha2 - value * down * (d_root_l + t.d_root));
    }
#ifdef ENVIRONMENT
    vec3 around = environment_d(n, r);
    float black = F_schlick(around.z);
    vec3 share = vec3(1.0 - u_metallic, u_metallic / F_dielectric(around.z) * vec2(black, 1.0 - black));
#ifdef SPECULAR
    share.x *= F_level_ratio(around.z, obs_level);
#endif
    parts += share * around.x;
    slopes += share * around.y;
#endif
    slopes.x = slopes.x * t.comp + parts.x * t.d_comp;
    parts.x *= t.comp;
}
#endif
