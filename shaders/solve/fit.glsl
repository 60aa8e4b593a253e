// One texel's observations, and how well a roughness explains them.
//
// Model: f = rho * a(r, cv) + s(r), a = (1 - A) / pi.  At fixed r it is linear in rho, so rho is
// eliminated (variable projection, Golub and Pereyra 1973) and the search is over r alone.
// Views of one camera share pixels, hence cos_v and a: within such a group the projection is the
// variance about the group's mean.  Groups may differ in rho a little, because their pixels cover
// the texture differently: rho_group = rho + delta, delta ~ N(0, u_group_slack * noise).
//
// Defines: LAYERS observations offered, MAX_OBS kept, LIGHTS lobes a view.
#include "include/brdf.glsl"
uniform sampler2D u_texel_position;
uniform sampler2D u_observations;  // atlas: LAYERS x (1 + LIGHTS) layers of u_tile_height rows
uniform int u_tile_height;
uniform ivec2 u_tile;
uniform int u_group[LAYERS];       // camera (and channel) of each layer; equal ones follow one another
uniform float u_group_slack;

const float ROUGHNESS_MIN = 0.05;

float obs_f[MAX_OBS], obs_weight[MAX_OBS], obs_cos_v[MAX_OBS];  // weight < 0: first of its group
float lobe_sin2h[MAX_OBS * LIGHTS], lobe_spread[MAX_OBS * LIGHTS], lobe_tan2[MAX_OBS * LIGHTS], lobe_factor[MAX_OBS * LIGHTS];
int obs_channel[MAX_OBS];
bool obs_edge[MAX_OBS];
int obs_count;
float obs_base[MAX_OBS];  // mean f of the group, subtracted from each: sums of squares keep their digits in float32
float obs_total;    // number of good observations
float obs_share;    // how well the good ones' pixels stand for the texel, 0..1
float obs_free;     // degrees of freedom that the residual has at the best roughness

ivec2 texel_here() { return ivec2(gl_FragCoord.xy); }

// Noise grows with the signal, so errors count relative to it: to the observation itself where it is
// a highlight, else to the texel's typical one.  (Relative to itself always, a pixel wrongly taken
// for lit would outweigh all others by being dark.)
void weigh_observations() {
    float typical = 1e30;
    for (int pass = 0; pass < 4; pass++) {
        float sum = 0.0, total = 1e-12;
        for (int n = 0; n < obs_count; n++) {
            float f = max(obs_f[n], 0.0);
            float w = abs(obs_weight[n]) / (pass == 0 ? 1.0 : max(f, typical));
            sum += w * f;
            total += w;
        }
        typical = max(sum / total, 1e-4);
    }
    // Edges of shadow and silhouette count where there is little else; beside good observations even
    // their small weight would outweigh the precision of those.
    float edge = exp2(-6.0 * min(obs_total, 6.0));  // never zero: a group of edges alone still has a mean
    float sum = 0.0, total = 0.0;
    int first = 0;
    for (int n = 0; n < obs_count; n++) {
        float unit = max(obs_f[n], typical);
        obs_weight[n] *= (obs_edge[n] ? edge : 1.0) / (unit * unit);
        float w = abs(obs_weight[n]);
        sum += w * obs_f[n];
        total += w;
        if (n + 1 == obs_count || obs_weight[n + 1] < 0.0) {
            for (int i = first; i <= n; i++) {
                obs_base[i] = sum / total;
                obs_f[i] -= obs_base[i];
            }
            first = n + 1;
            sum = total = 0.0;
        }
    }
}

// Loads the texel's valid observations; false when it is uncovered or has none.
bool load_observations() {
    obs_count = 0;
    obs_total = obs_free = obs_share = 0.0;
    float groups = 0.0;
    ivec2 texel = texel_here();
    if (any(greaterThanEqual(texel, textureSize(u_texel_position, 0)))) return false;
    if (texelFetch(u_texel_position, texel, 0).w < 0.5) return false;
    ivec2 at = texel - u_tile;
    int group = -1;
    for (int k = 0; k < LAYERS; k++) {
        vec4 o = texelFetch(u_observations, at + ivec2(0, k * (1 + LIGHTS) * u_tile_height), 0);
        if (o.y <= 0.0 || obs_count >= MAX_OBS) continue;
        int n = obs_count++;
        bool first = u_group[k] != group;
        group = u_group[k];
        obs_f[n] = o.x;
        obs_weight[n] = first ? -o.y : o.y;
        obs_cos_v[n] = o.z;
        obs_channel[n] = int(o.w) / 2;
        obs_edge[n] = int(o.w) % 2 == 1;
        float good = obs_edge[n] ? 0.0 : 1.0;
        obs_share += good * 2.0 * fract(o.w);
        obs_total += good;
        groups += first ? good : 0.0;
        for (int l = 0; l < LIGHTS; l++) {
            vec4 g = texelFetch(u_observations, at + ivec2(0, (k * (1 + LIGHTS) + 1 + l) * u_tile_height), 0);
            lobe_sin2h[n * LIGHTS + l] = g.x;
            lobe_spread[n * LIGHTS + l] = g.y;
            lobe_tan2[n * LIGHTS + l] = 1.0 / (g.z * g.z + 1e-12) - 1.0;
            lobe_factor[n * LIGHTS + l] = g.w;
        }
    }
    obs_share /= max(obs_total, 1.0);
    weigh_observations();
    // Within groups, and between them as far as the slack lets that count; one is spent on roughness.
    float all = max(obs_total - groups, 0.0) + max(groups - 1.0, 0.0) / (1.0 + u_group_slack);
    obs_free = all * max(obs_total - 2.0, 0.25) / max(obs_total - 1.0, 0.5);
    return obs_count > 0;
}

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

// Residual, Gauss-Newton gradient (-half the residual's slope) and curvature of the projected
// problem at roughness r, with Kaufman's approximation (1975) of the projector's derivative.
vec3 evaluate(float r) {
    float alpha2 = r * r * r * r, d_alpha2 = 4.0 * r * r * r;
    vec3 fit = vec3(0.0);
    Total total = Total(vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0));
    Group g = Group(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    float diffuse = 1.0, d_diffuse = 0.0, comp = 1.0, d_comp = 0.0, root_v = 1.0, d_root_v = 0.0;
    vec3 channel = vec3(0.0);
    for (int n = 0; n < obs_count; n++) {
        float w = obs_weight[n];
        if (w < 0.0) {
            fold(g, diffuse, d_diffuse, channel, fit, total);
            g = Group(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, obs_base[n]);
            w = -w;
            vec2 energy, d_energy;
            principled_energy_d(r, obs_cos_v[n], energy, d_energy);
            comp = energy.x;
            d_comp = d_energy.x;
            diffuse = (1.0 - energy.y) / PI;
            d_diffuse = -d_energy.y / PI;
            float tan2 = 1.0 / (obs_cos_v[n] * obs_cos_v[n]) - 1.0;
            root_v = lambda_root(alpha2, tan2);
            d_root_v = 0.5 * tan2 / root_v * d_alpha2;
            channel = vec3(obs_channel[n] == 0, obs_channel[n] == 1, obs_channel[n] == 2);
        }
        float s = 0.0, ds = 0.0;
        for (int l = 0; l < LIGHTS; l++) {
            int i = n * LIGHTS + l;
            float value, slope;
            D_ggx_spread_d(alpha2, lobe_sin2h[i], lobe_spread[i], value, slope);
            float root_l = lambda_root(alpha2, lobe_tan2[i]);
            float down = 1.0 / (root_l + root_v);
            float term = lobe_factor[i] * down;
            s += term * value;
            ds += term * (slope * d_alpha2 - value * down * (0.5 * lobe_tan2[i] / root_l * d_alpha2 + d_root_v));
        }
        ds = ds * comp + s * d_comp;
        s *= comp;
        float d = obs_f[n] - s;
        g.w += w;
        g.d += w * d;
        g.dd += w * d * d;
        g.s += w * ds;
        g.ss += w * ds * ds;
        g.sd += w * ds * d;
    }
    fold(g, diffuse, d_diffuse, channel, fit, total);
    // Between groups: one albedo, bounded by what a surface can reflect.
    vec3 rho = clamp(total.r / max(total.w, vec3(1e-20)), 0.0, 1.0);
    vec3 mean_t = total.t / max(total.w, vec3(1e-20));
    fit.x += dot(max(total.rr - rho * (2.0 * total.r - rho * total.w), 0.0), vec3(1.0));
    fit.y -= dot(total.rt - rho * total.t, vec3(1.0));
    fit.z += dot(max(total.tt - total.t * mean_t, 0.0), vec3(1.0));
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
