// How well two roughnesses explain a texel's observations.
//
// Model: f = rho * a + w s(r1) + (1 - w) s(r2), a = w a(r1) + (1 - w) a(r2); r1 <= r2.  Base colour rho and
// weight w are linear at fixed roughness and are eliminated as in fit.glsl; w is solved as a step from the
// weight given (about which a, the only product of both, is linearised), so that residuals keep their digits.
#include "solve/observations.glsl"

struct FitTwo {
    float residual;
    vec2 gradient;   // -half the residual's slope by (r1, r2)
    vec3 curvature;  // Gauss-Newton, r1 r1, r1 r2, r2 r2; base colour and weight projected out
    float weight;    // of lobe 1, at its best
    vec3 weight_row; // curvature of w: w w, w r1, w r2 (before projection)
    float tilts;     // what tilts explain: no part of the residual
};

// Sums over one group of d, u, t1, t2 (residual and the model's derivatives by w, r1, r2) and their products.
// Relative to those of its first observation: near the solution d is constant in a group, and float32 would
// lose its variance beside its mean.
struct GroupTwo {
    float w;
    vec4 first, v, dv;
    vec3 uv, tt;
#ifdef TILTS
    vec4 bv, cv;  // sums of the two of obs_tilt times each of the four
#endif
};
vec3 fit_tilts;  // d d, d u, u u of what tilts explain, of the last evaluation
#ifdef TILTS
#define GROUP_FROM(first) GroupTwo(0.0, first, vec4(0.0), vec4(0.0), vec3(0.0), vec3(0.0), vec4(0.0), vec4(0.0))
#else
#define GROUP_FROM(first) GroupTwo(0.0, first, vec4(0.0), vec4(0.0), vec3(0.0), vec3(0.0))
#endif

// Scatter matrix of (d, u, t1, t2): d d, d u, d t1, d t2; u u, u t1, u t2; t1 t1, t1 t2, t2 t2.
struct Scatter { vec4 dv; vec3 uv; vec3 tt; };

void add(inout Scatter sum, vec4 v, float w) {
    sum.dv += w * v.x * v;
    sum.uv += w * v.y * v.yzw;
    sum.tt += w * vec3(v.z * v.z, v.z * v.w, v.w * v.w);
}

// Of one channel, over the groups.
struct Between { float w; vec4 first; vec4 v; Scatter scatter; };

void fold(GroupTwo g, Toward one, Toward two, float weight, int channel, inout Scatter within, inout Between between[CHANNELS]) {
    if (g.w <= 0.0) return;
    within.dv += g.dv;
    within.uv += g.uv;
    within.tt += g.tt;
    add(within, g.v / g.w, -g.w);
    vec4 mean = g.v / g.w;
#ifdef TILTS
    add(within, g.bv, -1.0);
    add(within, g.cv, -1.0);
    vec2 of_d = vec2(g.bv.x, g.cv.x), of_u = vec2(g.bv.y, g.cv.y);
    fit_tilts += vec3(dot(of_d, of_d), dot(of_d, of_u), dot(of_u, of_u));
#endif
    mean += g.first;
    float a = weight * one.diffuse + (1.0 - weight) * two.diffuse;
    float rho = mean.x / a;
    vec4 q = vec4(rho, (mean.yzw + rho * vec3(one.diffuse - two.diffuse, weight * one.d_diffuse, (1.0 - weight) * two.d_diffuse)) / a);
    float w = a * a * g.w / (1.0 + u_group_slack * g.w * mean.x * mean.x);
    for (int c = 0; c < CHANNELS; c++) {  // no dynamic index: some drivers spill the array
        if (c == channel) {
            if (between[c].w == 0.0) between[c].first = q;
            vec4 off = q - between[c].first;
            between[c].w += w;
            between[c].v += w * off;
            add(between[c].scatter, off, w);
        }
    }
}

void add_group(int k, int first, int end, vec2 r, float weight, inout Scatter all, inout Between between[CHANNELS]) {
    GroupTwo g = GROUP_FROM(vec4(0.0));
    Toward one = toward(r.x, group_cos_v[k]), two = toward(r.y, group_cos_v[k]);
    EACH_OF_GROUP(n) {
        float s1, ds1, s2, ds2;
        specular_d(n, r.x, one, s1, ds1);
        specular_d(n, r.y, two, s2, ds2);
        float w = obs_weight[n];
        vec4 v = vec4(obs_f[n] - (weight * s1 + (1.0 - weight) * s2), s1 - s2, weight * ds1, (1.0 - weight) * ds2);
        if (g.w < NEGLIGIBLE * w) g = GROUP_FROM(v);
        v -= g.first;
        g.w += w;
        g.v += w * v;
        g.dv += w * v.x * v;
        g.uv += w * v.y * v.yzw;
        g.tt += w * vec3(v.z * v.z, v.z * v.w, v.w * v.w);
#ifdef TILTS
        g.bv += obs_tilt[n].x * v;
        g.cv += obs_tilt[n].y * v;
#endif
    }
    g.first.x += group_base[k];
    fold(g, one, two, weight, CHANNELS == 1 ? 0 : GROUP_CHANNEL[k], all, between);
}

// Of the last evaluation, mean of the channels: variance of rho at given (w, r1, r2) in units of the noise's, and how
// much rho falls with each of the three.
vec4 fit_albedo;

FitTwo evaluate(vec2 r, float weight) {
    Scatter all = Scatter(vec4(0.0), vec3(0.0), vec3(0.0));
    fit_tilts = vec3(0.0);
    Between between[CHANNELS];
    for (int c = 0; c < CHANNELS; c++) between[c] = Between(0.0, vec4(0.0), vec4(0.0), all);
#define GROUP(k, first, end) add_group(k, first, end, r, weight, all, between);
    EACH_GROUP
#undef GROUP
    fit_albedo = vec4(0.0);
    for (int c = 0; c < CHANNELS; c++) {
        if (between[c].w <= 0.0) continue;
        all.dv += between[c].scatter.dv;
        all.uv += between[c].scatter.uv;
        all.tt += between[c].scatter.tt;
        add(all, between[c].v / between[c].w, -between[c].w);
        fit_albedo += vec4(1.0 / between[c].w, between[c].first.yzw + between[c].v.yzw / between[c].w) / float(CHANNELS);
    }
    float wanted = weight + all.dv.y / max(all.uv.x, 1e-20);
    float best = clamp(wanted, 0.0, 1.0), step = best - weight;
    FitTwo fit;
    fit.weight = best;
    fit.tilts = fit_tilts.x - step * (2.0 * fit_tilts.y - step * fit_tilts.z);
    fit.residual = max(all.dv.x - step * (2.0 * all.dv.y - step * all.uv.x), 0.0);
    fit.gradient = all.dv.zw - step * all.uv.yz;
    fit.curvature = all.tt;
    fit.weight_row = all.uv;
    if (wanted == best) {
        vec2 share = all.uv.yz / max(all.uv.x, 1e-20);
        fit.curvature -= vec3(share.x * all.uv.y, share.x * all.uv.z, share.y * all.uv.z);
    }
    fit.curvature.xz = max(fit.curvature.xz, 0.0);
    return fit;
}
