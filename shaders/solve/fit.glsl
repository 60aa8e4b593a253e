// How well a roughness explains a texel's observations.
//
// Model: f = rho * a(r, cv) + s(r), a = (1 - A) / pi.  At fixed r it is linear in rho, so rho is
// eliminated (variable projection, Golub and Pereyra 1973) and the search is over r alone.
// Views of one camera share pixels, hence cos_v and a: within such a group the projection is the
// variance about the group's mean.  Groups may differ in rho a little, because their pixels cover
// the texture differently: rho_group = rho + delta, delta ~ N(0, u_group_slack * noise).
// (Of a metal a is not the same within a group: solve/metallic.glsl.)
#include "solve/observations.glsl"
#include "solve/nodes.glsl"

// A number for each channel that is kept apart.
#if CHANNELS == 3
#define CHANNEL vec3
float sum(vec3 v) { return v.x + v.y + v.z; }
vec3 channel_of(int g) { return vec3(GROUP_CHANNEL[g] == 0, GROUP_CHANNEL[g] == 1, GROUP_CHANNEL[g] == 2); }
#else
#define CHANNEL float
float sum(float v) { return v; }
float channel_of(int g) { return 1.0; }
#endif

// Sums over one group, and over the groups per channel.
// d is the difference to the group's first: near the solution it is constant in a group, and float32 would lose its
// variance beside its mean.  A first that weighs nothing beside a later one (an edge) would not do: it is dropped.
struct Group {
    float w, d, dd, s, ss, sd, first;
#ifdef TILTS
    vec2 bd, bs;  // sums of obs_tilt times d and times s
#ifdef ROBUST
    vec2 b;       // and alone, under the present trust
#endif
#endif
};
struct Total { CHANNEL w, r, rr, t, tt, rt, first; };  // r too is the difference to one group's: join() chooses it

#ifdef TILTS
float fit_tilts;  // what tilts explain, of the last evaluation: no part of the residual
#ifdef ROBUST
#define GROUP_FROM(first) Group(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, first, vec2(0.0), vec2(0.0), vec2(0.0))
#else
#define GROUP_FROM(first) Group(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, first, vec2(0.0), vec2(0.0))
#endif
#else
const float fit_tilts = 0.0;
#define GROUP_FROM(first) Group(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, first)
#endif

const Total NOTHING = Total(CHANNEL(0.0), CHANNEL(0.0), CHANNEL(0.0), CHANNEL(0.0), CHANNEL(0.0), CHANNEL(0.0), CHANNEL(0.0));

// Adds a group's albedo, with its derivative by roughness, to `total`.
void join(float rho, float d_rho, float w, CHANNEL channel, inout Total total) {
    // Sums are about the heaviest group's so far: about a light one's, float32 would lose what the heavy ones leave.
    CHANNEL shift = (rho - total.first) * channel * step(total.w, CHANNEL(w));
    total.first += shift;
    total.rr += shift * (shift * total.w - 2.0 * total.r);
    total.r -= shift * total.w;
    total.rt -= shift * total.t;
    CHANNEL off = rho - total.first;
    total.w += w * channel;
    total.r += w * off * channel;
    total.rr += w * off * off * channel;
    total.t += w * d_rho * channel;
    total.tt += w * d_rho * d_rho * channel;
    total.rt += w * off * d_rho * channel;
}

// Adds a group's inner variance to `fit` = (residual, gradient, curvature) and its albedo to `total`.
void fold(Group g, float diffuse, float d_diffuse, CHANNEL channel, inout vec3 fit, inout Total total) {
    if (g.w <= 0.0) return;
    float mean = g.d / g.w, slope = g.s / g.w;
    vec3 inner = vec3(g.dd - g.d * mean, g.sd - g.s * mean, g.ss - g.s * slope);
#ifdef TILTS
    vec2 tilt = g.bd, d_tilt = g.bs;
#ifdef ROBUST
    tilt -= mean * g.b;
    d_tilt -= slope * g.b;
#endif
    vec3 explained = vec3(dot(tilt, tilt), dot(tilt, d_tilt), dot(d_tilt, d_tilt));
    inner -= explained;
    fit_tilts += explained.x;
#endif
    fit += vec3(max(inner.x, 0.0), inner.y, max(inner.z, 0.0));
    mean += g.first;
    float rho = mean / diffuse;
    float d_rho = -(slope + rho * d_diffuse) / diffuse;
    float information = diffuse * diffuse * g.w;
    join(rho, d_rho, information / (1.0 + u_group_slack * g.w * mean * mean), channel, total);
}

CHANNEL fit_slope, fit_information;
float fit_squares;   // of the last evaluation: the residual without what outliers cost
float fit_outliers;  // and how many good observations were not believed

#if defined(ROBUST) || defined(METALLIC)
float obs_off[LAYERS], obs_slope[LAYERS];  // f - s - the group's OFFSET, ds/dr
Toward group_toward[GROUPS];
#endif
#ifdef ROBUST
float obs_trust[LAYERS];  // how far believed 0..1
#endif
#ifdef METALLIC
#include "solve/metallic.glsl"
#define WEIGHT(n) metal_weight[n]
#define OFFSET(k) group_own[k].x
#define DIFFUSE(k) 1.0
#else
#define WEIGHT(n) obs_weight[n]
#define OFFSET(k) group_base[k]
#define DIFFUSE(k) group_toward[k].diffuse
#endif
#ifdef ROBUST
#include "solve/robust.glsl"
#endif

#ifndef METALLIC
// One group's observations at roughness r.
void add_group(int k, int first, int end, float r, inout vec3 fit, inout Total total) {
    Group g = GROUP_FROM(0.0);
#ifdef ROBUST
    Toward t = group_toward[k];
#else
    Toward t = toward(r, group_cos_v[k]);
#endif
    EACH_OF_GROUP(n) {
#ifdef ROBUST
        float d = obs_off[n], ds = obs_slope[n], w = obs_weight[n] * obs_trust[n];
#else
        float s, ds;
        specular_d(n, r, t, s, ds);
        float d = obs_f[n] - s, w = obs_weight[n];
#endif
        if (g.w < NEGLIGIBLE * w) g = GROUP_FROM(d);
        d -= g.first;
        g.w += w;
        g.d += w * d;
        g.dd += w * d * d;
        g.s += w * ds;
        g.ss += w * ds * ds;
        g.sd += w * ds * d;
#ifdef TILTS
        vec2 b = obs_tilt[n];
#ifdef ROBUST
        b *= obs_trust[n];
        g.b += b;
#endif
        g.bd += b * d;
        g.bs += b * ds;
#endif
    }
    g.first += group_base[k];
    fold(g, t.diffuse, t.d_diffuse, channel_of(k), fit, total);
}
#endif

// Residual, Gauss-Newton gradient (-half the residual's slope) and curvature of the projected
// problem at roughness r, with Kaufman's approximation (1975) of the projector's derivative.
vec3 evaluate(float r) {
    vec3 fit = vec3(0.0);
    Total total = NOTHING;
#ifdef TILTS
    fit_tilts = 0.0;
#endif
#if defined(METALLIC) && !defined(ROBUST)
#define GROUP(k, first, end) prepare_metal(k, first, end, r);
    EACH_GROUP
#undef GROUP
#endif
#ifdef ROBUST
    float price = disbelieve(r);
#endif
#ifdef METALLIC
    settle();
#endif
#define GROUP(k, first, end) add_group(k, first, end, r, fit, total);
    EACH_GROUP
#undef GROUP
    // Between groups: one albedo, bounded by what a surface can reflect.
    CHANNEL information = max(total.w, CHANNEL(1e-20));
    CHANNEL rho = clamp(total.first + total.r / information, 0.0, 1.0) - total.first;
    CHANNEL mean_t = total.t / information;
    fit.x += sum(max(total.rr - rho * (2.0 * total.r - rho * total.w), 0.0));
    fit.y -= sum(total.rt - rho * total.t);
    fit.z += sum(max(total.tt - total.t * mean_t, 0.0));
    fit_slope = mean_t;
    fit_information = total.w;
    fit_squares = fit.x;
#ifdef ROBUST
    fit.x += price;
#endif
    return fit;
}

// Of the last evaluation: d(rho)/dr, and the variance of rho at that r in units of the noise's; mean of the channels.
vec2 fit_albedo() {
    CHANNEL known = step(CHANNEL(1e-20), fit_information);
    return vec2(sum(known * fit_slope), sum(known / max(fit_information, CHANNEL(1e-20)))) / max(sum(known), 1.0);
}

void add_lambert(int k, int first, int end, inout vec3 fit, inout Total total) {
    Group g = GROUP_FROM(group_base[k]);
    EACH_OF_GROUP(n) {
#ifdef ROBUST
        float w = obs_weight[n] * obs_trust[n];
#else
        float w = obs_weight[n];
#endif
        g.w += w;
        g.d += w * obs_f[n];  // relative to the group's mean already
        g.dd += w * obs_f[n] * obs_f[n];
    }
    fold(g, 1.0 / PI, 0.0, channel_of(k), fit, total);
}

// Residual of the model without a lobe: f = rho / pi, and no tilts.  ROBUST: of the observations that the last evaluation believed.
float evaluate_lambert() {
    vec3 fit = vec3(0.0);
    Total total = NOTHING;
#define GROUP(k, first, end) add_lambert(k, first, end, fit, total);
    EACH_GROUP
#undef GROUP
    CHANNEL rho = clamp(total.first + total.r / max(total.w, CHANNEL(1e-20)), 0.0, 1.0) - total.first;
    return fit.x + sum(max(total.rr - rho * (2.0 * total.r - rho * total.w), 0.0));
}
