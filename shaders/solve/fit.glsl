// How well a roughness explains a texel's observations.
//
// Model: f = rho * a(r, cv) + s(r), a = (1 - A) / pi.  At fixed r it is linear in rho, so rho is
// eliminated (variable projection, Golub and Pereyra 1973) and the search is over r alone.
// Views of one camera share pixels, hence cos_v and a: within such a group the projection is the
// variance about the group's mean.  Groups may differ in rho a little, because their pixels cover
// the texture differently: rho_group = rho + delta, delta ~ N(0, u_group_slack * noise).
#include "solve/observations.glsl"

// Sums over one group, and over the groups per channel.
struct Group { float w, d, dd, s, ss, sd, base; };
struct Total { vec3 w, r, rr, t, tt, rt; };

// Adds a group's inner variance to `fit` = (residual, gradient, curvature) and its albedo to `total`.
void fold(Group g, float diffuse, float d_diffuse, vec3 channel, inout vec3 fit, inout Total total) {
    if (g.w <= 0.0) return;
    float mean = g.d / g.w, slope = g.s / g.w;
    fit += vec3(max(g.dd - g.d * mean, 0.0), g.sd - g.s * mean, max(g.ss - g.s * slope, 0.0));
    mean += g.base;
    float rho = mean / diffuse;
    float d_rho = -(slope + rho * d_diffuse) / diffuse;
    float information = diffuse * diffuse * g.w;
    float w = information / (1.0 + u_group_slack * g.w * mean * mean);
    total.w += w * channel;
    total.r += w * rho * channel;
    total.rr += w * rho * rho * channel;
    total.t += w * d_rho * channel;
    total.tt += w * d_rho * d_rho * channel;
    total.rt += w * rho * d_rho * channel;
}

// Of the last evaluation: d(rho)/dr, and the variance of rho at that r in units of the noise's (mean of the channels).
vec2 fit_albedo;

// Residual, Gauss-Newton gradient (-half the residual's slope) and curvature of the projected
// problem at roughness r, with Kaufman's approximation (1975) of the projector's derivative.
vec3 evaluate(float r) {
    vec3 fit = vec3(0.0);
    Total total = Total(vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0));
    Group g = Group(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    Toward t = Toward(1.0, 0.0, 1.0, 0.0, 1.0, 0.0);
    vec3 channel = vec3(0.0);
    for (int n = 0; n < obs_count; n++) {
        float w = obs_weight[n];
        if (w < 0.0) {
            fold(g, t.diffuse, t.d_diffuse, channel, fit, total);
            g = Group(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, obs_base[n]);
            w = -w;
            t = toward(r, obs_cos_v[n]);
            channel = vec3(obs_channel[n] == 0, obs_channel[n] == 1, obs_channel[n] == 2);
        }
        float s, ds;
        specular_d(n, r, t, s, ds);
        float d = obs_f[n] - s;
        g.w += w;
        g.d += w * d;
        g.dd += w * d * d;
        g.s += w * ds;
        g.ss += w * ds * ds;
        g.sd += w * ds * d;
    }
    fold(g, t.diffuse, t.d_diffuse, channel, fit, total);
    // Between groups: one albedo, bounded by what a surface can reflect.
    vec3 rho = clamp(total.r / max(total.w, vec3(1e-20)), 0.0, 1.0);
    vec3 mean_t = total.t / max(total.w, vec3(1e-20));
    fit.x += dot(max(total.rr - rho * (2.0 * total.r - rho * total.w), 0.0), vec3(1.0));
    fit.y -= dot(total.rt - rho * total.t, vec3(1.0));
    fit.z += dot(max(total.tt - total.t * mean_t, 0.0), vec3(1.0));
    vec3 known = vec3(greaterThan(total.w, vec3(0.0)));
    float channels = max(dot(known, vec3(1.0)), 1.0);
    fit_albedo = vec2(dot(known, mean_t), dot(known / max(total.w, vec3(1e-20)), vec3(1.0))) / channels;
    return fit;
}

// Residual of the model without a lobe: f = rho / pi.
float evaluate_lambert() {
    vec3 fit = vec3(0.0);
    Total total = Total(vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0));
    Group g = Group(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    vec3 channel = vec3(0.0);
    for (int n = 0; n < obs_count; n++) {
        float w = abs(obs_weight[n]);
        if (obs_weight[n] < 0.0) {
            fold(g, 1.0 / PI, 0.0, channel, fit, total);
            g = Group(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, obs_base[n]);
            channel = vec3(obs_channel[n] == 0, obs_channel[n] == 1, obs_channel[n] == 2);
        }
        g.w += w;
        g.d += w * obs_f[n];
        g.dd += w * obs_f[n] * obs_f[n];
    }
    fold(g, 1.0 / PI, 0.0, channel, fit, total);
    vec3 rho = clamp(total.r / max(total.w, vec3(1e-20)), 0.0, 1.0);
    return fit.x + dot(max(total.rr - rho * (2.0 * total.r - rho * total.w), 0.0), vec3(1.0));
}
